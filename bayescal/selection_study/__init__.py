"""Experiments on pose selection: sets of poses chosen, compared, and tried by simulated calibrations."""
