"""Checks of a study's own config: simulation-based calibration, and the usual faults looked for one by one."""
