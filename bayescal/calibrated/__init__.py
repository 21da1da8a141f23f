"""The machine that a calibration left: as files for the next tool, and what it does with poses and actuators."""
