"""What a calibration of any machine would tell, before there is a machine."""
