"""Simulated self-calibrations of a machine with different sensors, and of many plausible machines."""
