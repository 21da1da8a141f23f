"""How well a variant predicts readings that were held back: poses for verification, or folds of all poses in turn."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.prediction import ReadingPredictions, predict_readings
from bayescal.density.prediction import compute_elpd
from bayescal.experiments.shared.readings.inputs import ReadingInputs, Variant
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.numerics.geometry import Array

PROPOSED = 8  # draws of the proposal for each that is kept


@dataclass(frozen=True, eq=False)
class Held:
    """What one fold tells.

    Attributes
    ----------
    rows : ndarray of int, shape (V,)
        The held-back poses, of the variant's.
    elpd : float
        Log predictive density of all their readings together.
    efficiency, pareto_k : float
        Of the posterior's draws.
    predictions : ReadingPredictions
        Its poses count within ``rows``.
    """

    rows: np.ndarray
    elpd: float
    efficiency: float
    pareto_k: float
    predictions: ReadingPredictions


def list_folds(inputs: ReadingInputs, variant: Variant) -> list[np.ndarray]:
    """Return which poses are held back together, masks (P,): those for verification, or random folds of all."""
    n, folds = variant.data.n_poses, inputs.config.validation.folds
    if variant.verification.any():
        return [variant.verification]
    order = np.random.default_rng([inputs.config.seed, 6]).permutation(n)
    return [np.isin(np.arange(n), order[k::folds]) for k in range(min(folds, n))]


def hold_back(inputs: ReadingInputs, variant: Variant, fold: int, known: Array | None = None) -> Held:
    """Return how the held-back poses of a fold are predicted from the others.

    Where these are the poses for verification, ``known`` are draws (T, n) of the posterior that has been found already.
    """
    held = list_folds(inputs, variant)[fold]
    posterior, effort = variant.posterior(~held).anchored(), inputs.config.validation.draws
    first, second = np.random.SeedSequence([inputs.config.seed, 7, fold, zlib.crc32(variant.name.encode())]).spawn(2)
    rng = np.random.default_rng(second)
    efficiency, pareto_k = 1.0, float("nan")
    if known is None:
        found = explore(posterior, first, inputs.config.sampler.walkers, max_pilots=0)  # draws are weighed anyway
        drawn = resample(found.straight.log_density, found.proposal, rng, PROPOSED * effort, effort)
        y, efficiency, pareto_k = found.straight.y_from_x(drawn.draws), drawn.efficiency, drawn.pareto_k
    else:
        y = known[np.linspace(0, len(known) - 1, min(effort, len(known))).astype(int)]
    likelihood = variant.likelihood(held)
    with np.errstate(all="ignore"):
        elpd = compute_elpd(posterior.predict_density(likelihood, y))
        predictions = predict_readings(posterior, likelihood, y, rng)
    return Held(np.flatnonzero(held), elpd, efficiency, pareto_k, predictions)
