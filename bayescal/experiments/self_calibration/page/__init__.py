"""The page of a self-calibration."""
