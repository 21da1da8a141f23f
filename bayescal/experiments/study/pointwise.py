"""What draws say of each pose: its density and what they predict, some poses at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.legs import LegPosterior, Likelihood
from bayescal.density.prediction import replicate
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class SomeDraws:
    """Draws that predict: parameter vectors (T, D) and their model errors (T, N) or (N,), mm."""

    theta: Array
    model_error: Array

    def choose(self, chosen: np.ndarray) -> SomeDraws:
        """Return some of them."""
        errors = self.model_error
        return SomeDraws(self.theta[chosen], errors if errors.ndim == 1 else errors[chosen])


def evaluate_poses(
    posterior: LegPosterior,
    likelihood: Likelihood,
    y: Array,
    every: SomeDraws,
    some: SomeDraws,
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return densities of the poses, from draws, and what some of them predict.

    Parameters
    ----------
    posterior : LegPosterior
    likelihood : Likelihood
        Of the poses.
    y : ndarray, shape (S, n)
        All draws, in sampling coordinates.
    every, some : SomeDraws
        The same, and those that predict.
    rng : Generator
        For the noise of what they predict.

    Returns
    -------
    dict of str to ndarray
        ``log_likelihood`` (P, S), the fields of a `Prediction`, ``misfit`` (P, T, 6) measured minus replicated poses
        and, where poses may be blunders, ``blunder_probability`` (P,).
    """
    pieces: dict[str, list[Array]] = {}
    for _, part in likelihood.parts():
        for name, value in _evaluate(posterior, part, y, every, some, rng).items():
            pieces.setdefault(name, []).append(value)
    return {name: values[0] if len(values) == 1 else np.concatenate(values) for name, values in pieces.items()}


def _evaluate(
    posterior: LegPosterior,
    likelihood: Likelihood,
    y: Array,
    every: SomeDraws,
    some: SomeDraws,
    rng: np.random.Generator,
) -> dict[str, Array]:
    if not posterior.errors.outliers.expected:
        density = likelihood.pointwise(every.theta, every.model_error)
    else:
        density = posterior.predict_density(likelihood, y)
    made = replicate(likelihood, some.theta, some.model_error, rng)
    misfit = made.misfit.astype(np.float32).swapaxes(0, 1)
    found = {"log_likelihood": density.T, **vars(made.summarise()), "misfit": misfit}
    return found | _suspect(posterior, likelihood, y)


def _suspect(posterior: LegPosterior, likelihood: Likelihood, y: Array) -> dict[str, Array]:
    """Return how probable it is that each pose is a blunder, shape (P,), where they may be."""
    if not posterior.errors.outliers.expected:
        return {}
    return {
        "blunder_probability": likelihood.outlier_probabilities(
            posterior.theta(y), posterior.errors, posterior.zeta(y)
        ).mean(axis=0)
    }
