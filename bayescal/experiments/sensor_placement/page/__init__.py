"""The page of a sensor placement."""
