"""Many simulated calibrations of a hexapod: what measurement poses and weighting make of the calibrated machine."""
