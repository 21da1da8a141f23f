"""One machine calibrated from the readings of its own sensors: posteriors, evidence, audit and prediction."""
