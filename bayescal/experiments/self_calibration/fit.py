"""One variant's posterior, estimated, and how well it explains the readings."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from bayescal.density.prediction import compute_elpd
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant
from bayescal.experiments.shared.estimate import Estimate, estimate_posterior
from bayescal.experiments.shared.function_errors import FoundFunctions, find_functions
from bayescal.experiments.shared.reading_trees import SavedDraws, save_draws
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Fit(Estimate):
    """What inference found for one variant.

    Attributes
    ----------
    names : tuple of str
        Of the n coordinates: free parameters, or symbols of those that deviate alike.
    theta : ndarray, shape (T, D)
        Some of the draws, as machines.
    prior_sd : ndarray, shape (n,)
    elpd : float
        Of the readings kept for verification; NaN without any.
    square : ndarray, shape (P,)
        What the mode leaves of each calibration pose's readings, squared, in units of the noise.
    saved : SavedDraws
        What the posterior's file holds.
    functions : FoundFunctions or None
        Errors of the sensors that are functions of what they read.
    common : tuple of pairs of ndarray
        Draws of these, as `CommonDraws.parts`.
    """

    names: tuple[str, ...]
    theta: Array
    prior_sd: Array
    elpd: float
    square: Array
    saved: SavedDraws
    functions: FoundFunctions | None
    common: tuple[tuple[Array, Array], ...]


def fit_variant(inputs: ReadingInputs, variant: Variant) -> Fit:
    """Compute one variant; all numbers depend on the inputs, the config's seed and the variant's name alone."""
    posterior, config = inputs.posterior(variant).anchored(), inputs.config
    found = estimate_posterior(posterior, config.seed, variant.name, config.sampler, config.evidence)
    theta, elpd = posterior.theta(found.kept), float("nan")
    if inputs.table.verification.any():
        held = inputs.likelihood(variant, verification=True)
        elpd = compute_elpd(posterior.predict_density(held, found.kept))
    error = posterior.residuals(found.mode[None]).error[0]
    square, key = np.einsum("pk,pk->p", error, error), zlib.crc32(variant.name.encode())
    seed = [config.seed, 8, key]
    saved = save_draws(posterior, found.kept, len(found.natural), config.sampler.ensembles, seed)
    draws = posterior.draw_common(found.kept, np.random.default_rng([config.seed, 9, key]))
    return Fit(
        **vars(found),
        names=posterior.names,
        theta=theta,
        prior_sd=posterior.prior_sd,
        elpd=elpd,
        square=square,
        saved=saved,
        functions=find_functions(posterior, found.kept, draws),
        common=draws.parts,
    )
