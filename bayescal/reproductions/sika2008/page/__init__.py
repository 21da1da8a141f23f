"""The page of simulated self-calibrations."""
