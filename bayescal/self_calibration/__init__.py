"""Calibration of a machine by its own sensors: the pose at each measurement is unknown and is eliminated."""
