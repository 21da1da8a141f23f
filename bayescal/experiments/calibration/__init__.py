"""Calibration of any machine, from any of its readings."""
