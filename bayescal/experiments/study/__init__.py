"""Calibration studies: variants of a machine ranked by measured poses."""
