"""The density of any readings: poses eliminated, errors as terms of a composition."""

ERRORS = {"function": "bayescal.density.calibration.functions:FunctionErrors"}
"""Built-in terms of errors, by the ``kind`` of their sections."""
