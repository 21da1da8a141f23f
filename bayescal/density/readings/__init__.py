"""Self-calibration: densities of the readings of a machine's own sensors, poses eliminated."""
