"""Šika et al. (2008): simulated self-calibrations of sliding platforms."""
