"""Simulated self-calibrations with different sets of sensors: errors, calibrability, coverage (Šika et al. 2008)."""
