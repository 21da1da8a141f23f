"""A posterior found again when a few measurements have come to those it was found for: updated, not begun again.

More measurements of the same machine move the mode by little. A few Newton steps from where it was lead to the new one;
Laplace's approximation there, in coordinates that straighten the funnel of the model errors, is a proposal whose draws
are weighed by the density itself. Where their weights have a heavy tail, or other modes may hold mass, the posterior is
explored again. Where errors hang together from row to row their sizes have no mode to speak of: covariance and evidence
are then those of the draws.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayescal.inference.exploration import DOF, explore
from bayescal.inference.importance import Resampled, resample
from bayescal.inference.mode import DECREMENT_TOLERANCE, Mode, find_mode
from bayescal.inference.peaks import GaussianMode, bend_at, proposal_from_peaks
from bayescal.inference.reparameterisation import straighten
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.solutions import find_solutions
from bayescal.inference.target import LogDensity
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

STEPS, HALVINGS = 20, 6
PER_KEPT = 2  # draws of the proposal for each that is kept
ENSEMBLES, WALKERS, BURN_IN, LENGTH = 4, 64, 30, 60  # where importance resampling will not do

type Way = Literal["updated", "explored", "sampled"]


@dataclass(frozen=True, eq=False)
class LaplacePosterior:
    """What is known of the n coordinates of a posterior."""

    y: Array  # (n,): the mode
    # (n, n): inverse of minus the Gauss-Newton Hessian there; of the draws where geometry is known given the errors
    covariance: Array
    # by Laplace's formula, with that covariance where it was updated; by the draws' weights where geometry is known
    # given the errors
    log_evidence: float
    draws: Array  # (S, n): of the posterior, in its coordinates
    # share of the proposal's draws that count, and the shape of the tail of their weights
    efficiency: float
    pareto_k: float
    way: Way  # ``updated`` from the last mode, ``explored`` again, or ``sampled`` by ensembles


def update(
    posterior: LogDensity, start: Array | None, n_draws: int, seed: int, *, may_explore: bool = True
) -> LaplacePosterior:
    """Return what is known of a posterior whose mode is near a start.

    Parameters
    ----------
    posterior : Target
    start : ndarray, shape (n,), or None
        The mode before the last measurements; None to begin at the machine as expected.
    n_draws : int
        How many draws to return.
    seed : int
        The same one gives draws that differ from those before by what the measurements tell alone.
    may_explore : bool
        Whether to explore the posterior again where the update will not do; it takes a second or two.

    Raises
    ------
    NumericalError
        Where no mode is found.
    """
    mode = maximise(posterior, posterior.least_squares_start() if start is None else start)
    if not (may_explore and posterior.mode_candidates(mode.y)):
        straight = straighten(posterior, mode)
        centre = straight.x_from_y(mode.y[None])
        rough = GaussianMode(centre[0], np.linalg.cholesky(mode.covariance), mode.log_density)
        straight, peak = bend_at(straight, rough)
        proposal, rng = proposal_from_peaks([peak], DOF), np.random.default_rng(seed)
        made = resample(straight.log_density, proposal, rng, PER_KEPT * n_draws, n_draws)
        if not may_explore or made.pareto_k <= PARETO_K_LIMIT:
            return _collect(posterior, mode, straight.y_from_x(made.draws), made, "updated")
    return _begin_anew(posterior, n_draws, seed)


def maximise(posterior: LogDensity, start: Array) -> Mode:
    """Return the mode that Newton's steps from a start (n,) lead to, with the Gauss-Newton covariance there.

    Steps that do not gain are halved; where that does not help, the search of `bayescal.inference.mode` takes over.
    """
    if posterior.linear_geometry(start) is not None:
        return find_mode(posterior, start)
    y, value = start, float(posterior.log_density(start[None])[0])
    for _ in range(STEPS):
        gradient, hessian = posterior.gradient(y)
        try:
            covariance = np.linalg.inv(-hessian)
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            break
        step = covariance @ gradient
        if gradient @ step < DECREMENT_TOLERANCE:
            return Mode(y, value, covariance, True)
        trials = y + step * 0.5 ** np.arange(HALVINGS)[:, None]
        values = posterior.log_density(trials)
        if not np.any(values > value):
            break
        first = int(np.argmax(values > value))
        y, value = trials[first], float(values[first])
    return find_mode(posterior, start if not np.isfinite(value) else y)


def _begin_anew(posterior: LogDensity, n_draws: int, seed: int) -> LaplacePosterior:
    """Return what is known by exploring the posterior, and by ensembles where importance resampling will not do.

    Of several solutions the most probable one is kept: a mean over several is no machine.
    """
    explore_seed, draw_seed, ensemble_seed = np.random.SeedSequence([seed, 1]).spawn(3)
    found = explore(posterior, explore_seed, from_prior=True)
    straight, rng = found.straight, np.random.default_rng(draw_seed)
    made = resample(straight.log_density, found.proposal, rng, PER_KEPT * n_draws, n_draws)
    way: Way = "explored" if made.pareto_k <= PARETO_K_LIMIT else "sampled"
    if way == "explored":
        draws = straight.y_from_x(made.draws)[None, None]
    else:
        draws = sample_posterior(found, ensemble_seed, ENSEMBLES, WALKERS, BURN_IN, LENGTH).y
    solutions = find_solutions(draws, found.modes, posterior.n_geometry)
    mode = found.modes[int(np.argmax(solutions.of_modes == 0))]
    mine = draws[solutions.label == 0]
    chosen = mine if len(mine) == n_draws else mine[rng.choice(len(mine), n_draws, replace=len(mine) < n_draws)]
    return _collect(posterior, mode, chosen, made, way)


def _collect(posterior: LogDensity, mode: Mode, draws: Array, made: Resampled, way: Way) -> LaplacePosterior:
    covariance, log_evidence = mode.covariance, mode.log_evidence
    if posterior.linear_geometry(mode.y) is not None:
        covariance, log_evidence = np.cov(draws, rowvar=False), made.log_evidence
    return LaplacePosterior(mode.y, covariance, log_evidence, draws, made.efficiency, made.pareto_k, way)
