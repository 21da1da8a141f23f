"""Whether a calibration still holds: the fewest poses that tell, and what they say once they are measured."""
