"""One variant's posterior, fitted, and what it says beside of readings that were held back and of the sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.prediction import compute_elpd
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.reading_fit import ReadingFit, fit_readings
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class VariantFit(ReadingFit):
    """What inference found for one variant.

    Attributes
    ----------
    theta : ndarray, shape (T, D)
        Some of the draws, as machines.
    elpd : float
        Of the readings kept for verification; NaN without any.
    square : ndarray, shape (P,)
        Squares of the residuals of each calibration pose at the mode, in units of the noise.
    """

    theta: Array
    elpd: float
    square: Array


def fit_variant(inputs: ReadingInputs, variant: Variant) -> VariantFit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config, elpd = inputs.posterior(variant).anchored(), inputs.config, float("nan")
    found = fit_readings(posterior, config.seed, variant.name, config.sampler, config.evidence)
    if inputs.table.verification.any():
        held = inputs.likelihood(variant, verification=True)
        elpd = compute_elpd(posterior.predict_density(held, found.kept))
    error = posterior.likelihood.residuals(*posterior.at(found.mode[None]))[0]
    square = np.einsum("pk,pk->p", error, error)
    return VariantFit(**vars(found), theta=posterior.theta(found.kept), elpd=elpd, square=square)
