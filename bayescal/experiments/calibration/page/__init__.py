"""The page of a calibration, made from its tables alone."""
