"""The page of a machine calibrated from its own readings."""
