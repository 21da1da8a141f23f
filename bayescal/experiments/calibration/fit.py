"""One variant's posterior, estimated."""

from __future__ import annotations

from dataclasses import dataclass

from bayescal.experiments.calibration.inputs import CalibrationInputs, Variant
from bayescal.experiments.shared.estimate import Estimate, estimate_posterior
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Fit(Estimate):
    """What inference found for one variant.

    Attributes
    ----------
    names, units : tuple of str
        Of the n coordinates.
    prior_sd : ndarray, shape (n,)
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    prior_sd: Array


def fit_variant(inputs: CalibrationInputs, variant: Variant) -> Fit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config = variant.posterior().anchored(), inputs.config
    found = estimate_posterior(posterior, config.seed, variant.name, config.sampler, config.evidence)
    return Fit(**vars(found), names=posterior.names, units=posterior.units, prior_sd=posterior.prior_sd)
