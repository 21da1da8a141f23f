"""One machine calibrated from the readings of its own sensors: posterior, evidence, audit, prediction, report."""
