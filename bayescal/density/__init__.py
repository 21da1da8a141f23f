"""Densities of measurements and parameters: priors, likelihoods, posteriors, predictions."""
