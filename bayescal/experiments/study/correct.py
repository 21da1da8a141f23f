"""The last stage of a posterior: draws and evidence corrected by the exact density of the measured poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from bayescal.density.exact import ExactDensity
from bayescal.density.legs import LegPosterior
from bayescal.inference.correction import Correction, CostlyDensity, Move, correct
from bayescal.inference.ensemble import run_ensembles
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import resample
from bayescal.inference.sampling import Sample
from bayescal.inference.straightening import Straightening
from bayescal.numerics.geometry import Array

WEIGHED = 256  # draws of a posterior, a round
PROPOSED = 1500
USED = 1024  # at most
WEIGHED_AT_ONCE, PER_COORDINATE, PROPOSED_AT_ONCE = 128, 2, 1000
"""The same where only the evidence is wanted, and the draws of a regression."""
ENOUGH = 0.02
"""Standard error in nats that is enough then: evidences under other priors are themselves known to 0.03."""
STEP = 1e-4


def correct_draws(
    exact: ExactDensity, exploration: Exploration, sample: Sample, seed: np.random.SeedSequence
) -> Correction:
    """Return the correction from draws of the posterior."""
    draws = sample.straight.reshape(-1, sample.straight.shape[-1])
    chosen = np.random.default_rng(seed).choice(len(draws), min(USED, len(draws)), replace=False)
    modes = _sort(exploration, draws)
    centred = np.concatenate([own - own.mean(axis=0) for k in np.unique(modes) for own in (draws[modes == k],)])
    covariance = np.atleast_2d(np.cov(centred.T))
    return correct(build_costly(exact, exploration), draws[chosen], modes[chosen], covariance, WEIGHED)


def correct_evidence(exact: ExactDensity, exploration: Exploration, seed: np.random.SeedSequence) -> Correction:
    """Return the correction from some draws of the proposal."""
    drawn = draw_to_correct(exploration, np.random.default_rng(seed), USED // 2, PROPOSED_AT_ONCE)
    return correct(build_costly(exact, exploration), *drawn, WEIGHED_AT_ONCE, PER_COORDINATE, ENOUGH)


def draw_to_correct(
    exploration: Exploration, rng: np.random.Generator, n_draws: int, n_proposed: int = PROPOSED
) -> tuple[Array, np.ndarray, Array]:
    """Return draws of the posterior (S, n) in straight coordinates, their modes (S,), a mode's covariance (n, n)."""
    proposal = exploration.proposal
    draws = resample(exploration.straight.log_density, proposal, rng, n_proposed, n_draws).draws
    main = proposal.factors[np.argmax(proposal.weights)]
    return draws, _sort(exploration, draws), main @ main.T


def _sort(exploration: Exploration, draws: Array) -> np.ndarray:
    """Return which component of the proposal each draw (S, n) belongs to, shape (S,)."""
    if len(exploration.proposal.weights) == 1:
        return np.zeros(len(draws), dtype=int)
    return np.argmax(exploration.proposal.component_log_densities(draws), axis=0)


def move_sample(sample: Sample, exploration: Exploration, correction: Correction) -> Sample:
    """Return a sample whose draws are those of the exact density, as far as the correction is enough."""
    moved = correction.move(sample.straight.reshape(-1, sample.straight.shape[-1])).reshape(sample.straight.shape)
    density = sample.log_density - correction.move.log_volume + correction.log_ratio
    return Sample(exploration.straight, moved, density, sample.acceptance)


def sample_exactly(
    exact: ExactDensity, exploration: Exploration, sample: Sample, move: Move, seeds: list[np.random.SeedSequence]
) -> Sample:
    """Return draws of ensembles that walk on the exact density itself, as many as a sample has: slow.

    They start from the moved proposal; half as many steps again are left out at first.
    """
    straight, (_, n_walkers, n_steps, _) = exploration.straight, sample.straight.shape
    density, proposal = build_costly(exact, exploration).log_density, move.move_proposal(exploration.proposal)
    ensembles = run_ensembles(density, proposal, seeds, n_walkers, n_steps // 2, n_steps)
    return Sample.from_ensembles(straight, ensembles)


def list_corrected(arrays: Mapping[str, Array], correction: Correction | None) -> dict[str, Array]:
    """Return the log-evidences of a task's arrays after the correction, and what it was worth."""
    if correction is None:
        return {}
    shift, error = correction.log_ratio, correction.standard_error
    methods = {name: arrays[name] for name in ("importance", "bridge", "tempered") if name in arrays}
    corrected = {
        name: np.array([value + shift, np.hypot(se, error), *rest]) for name, (value, se, *rest) in methods.items()
    }
    quality = [shift, error, correction.efficiency, correction.pareto_k, correction.n_draws]
    return corrected | {"correction": np.array(quality)}


def build_costly(exact: ExactDensity, exploration: Exploration) -> CostlyDensity:
    """Return the exact density in straight coordinates, beside the one that was explored."""
    straight = exploration.straight
    posterior = cast(LegPosterior, straight.posterior)

    def excess(x: Array) -> Array:
        y = straight.y_from_x(x)
        theta, errors = posterior.theta(y), posterior.errors.amplitudes(posterior.zeta(y))
        with np.errstate(invalid="ignore"):
            found = exact(theta, errors) - posterior.likelihood(theta, errors)
        return np.where(np.isfinite(found), found, -np.inf)

    information = _inform(posterior, exact, straight, exploration.modes[0].y)
    return CostlyDensity(straight.log_density, excess, information)


def _inform(posterior: LegPosterior, exact: ExactDensity, straight: Straightening, y: Array) -> Array:
    """Return the information on straight coordinates that the exact density has more at y (n,), shape (n, n).

    That on the model errors is taken as the same.
    """
    theta = posterior.theta(y[None])[0]
    change = posterior.sampling.jacobian(theta)
    more = (
        change.T @ exact.information(theta, posterior.errors.amplitudes(posterior.zeta(y))) @ change
        - posterior.information(y)[0]
    )
    return pull_back(straight, y, more)


def pull_back(straight: Straightening, y: Array, information: Array) -> Array:
    """Return information on the geometry's coordinates (m, m), at y (n,), as that on all straight ones (n, n)."""
    x, unit = straight.x_from_y(y[None]), STEP * np.eye(len(y))
    slope = (straight.y_from_x(x + unit) - straight.y_from_x(x - unit))[:, : len(information)].T / (2 * STEP)
    found = slope.T @ information @ slope
    return np.asarray(0.5 * (found + found.T))
