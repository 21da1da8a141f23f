"""Simulated calibrations of hexapods as in Yu, Wu and Wang (2023)."""
