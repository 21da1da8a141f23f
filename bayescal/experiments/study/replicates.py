"""Draws of the prior, and the poses that they predict."""

from __future__ import annotations

import numpy as np

from bayescal.density.errors import TAU
from bayescal.density.legs import LegPosterior
from bayescal.density.prediction import replicate
from bayescal.experiments.shared.trees import PRIOR_DRAWS, limit_draws
from bayescal.numerics.geometry import Array

TRIES = 4  # draws of the prior for each that is wanted: some are no machine


def replicate_prior(posterior: LegPosterior, seed: np.random.SeedSequence) -> dict[str, Array]:
    """Return draws of the prior, ``prior`` (T, n) in own units, and what they make of the calibration poses.

    That is ``prior_misfit`` (T, P, 6), measured minus replicated poses.
    """
    rng, likelihood = np.random.default_rng(seed), posterior.likelihood
    values, theta = _draw(posterior, rng, limit_draws(PRIOR_DRAWS, 6 * likelihood.n_poses))
    tau = posterior.zeta(values)[:, posterior.errors.place(TAU)]
    with np.errstate(all="ignore"):
        made = [replicate(part, theta, _spread(posterior, tau), rng) for _, part in likelihood.parts()]
    return {
        "prior": values,
        "prior_misfit": np.concatenate([one.misfit.astype(np.float32) for one in made], axis=1),
    }


def _draw(posterior: LegPosterior, rng: np.random.Generator, n_wanted: int) -> tuple[Array, Array]:
    """Return draws of the prior that are machines, in own units (T, n) and as parameter vectors (T, D)."""
    values = np.stack([one.draw(TRIES * n_wanted, rng) for one in posterior.all_priors().values()], axis=-1)
    theta = np.broadcast_to(posterior.sampling.start, (len(values), len(posterior.sampling.start))).copy()
    theta[:, posterior.sampling.free] = values[:, : posterior.n_geometry]
    values, theta = (part[posterior.likelihood.layout.inside(theta)] for part in (values, theta))
    closes = np.ones(len(theta[: 2 * n_wanted]), dtype=bool)
    with np.errstate(all="ignore"):
        for _, part in posterior.likelihood.parts():
            closes &= np.isfinite(part.errors(theta[: 2 * n_wanted])).all(axis=(1, 2))
    good = np.flatnonzero(closes)[:n_wanted]
    return values[good], theta[good]


def _spread(posterior: LegPosterior, tau: Array) -> Array:
    """Return model errors (T, N) from free ones (T, 0, 1 or N)."""
    n_legs = posterior.likelihood.n_legs
    return np.broadcast_to(tau, (len(tau), n_legs)) if tau.shape[1] else np.zeros(n_legs)
