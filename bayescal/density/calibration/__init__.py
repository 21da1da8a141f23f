"""Calibration of any machine from any readings: several tables, missing readings, unknown noise, poses eliminated."""
