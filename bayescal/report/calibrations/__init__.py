"""The page of simulated calibrations of a hexapod."""
