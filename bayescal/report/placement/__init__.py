"""The page of an experiment on sensor placement."""
