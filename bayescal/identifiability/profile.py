"""Profiles: how well data agree with a machine at each value of one parameter, all others being at their best.

A parameter that is determined has a parabola; along an unidentified direction the profile is flat, and the path that
the others take to keep it so is the ridge itself, bent as it is, where derivatives only give its tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.identifiability.calibration import simulate_measurements
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.fits import Fits, Fitter, Measurements
from bayescal.numerics.geometry import Array

REACH = 3.0  # tolerances to either side
N_SIDE = 15
FREE_SHARE = 1e-6  # of the own prior's precision, for the best value without it


@dataclass(frozen=True, eq=False)
class Profile:
    """A parameter held at K values, all others at their best with their priors; its own prior left out.

    Attributes
    ----------
    name : str
    values : ndarray, shape (K,)
        In the parameter's unit.
    data_deviance, deviance : ndarray, shape (K,)
        Twice what the log-likelihood, and the log-density with the others' priors, lack to where the latter is best;
        along a ridge the data alone may lack less than nothing. NaN where there is no machine.
    path : ndarray, shape (K, n)
        All free parameters, in their units.
    converged : ndarray of bool, shape (K,)
    """

    name: str
    values: Array
    data_deviance: Array
    deviance: Array
    path: Array
    converged: np.ndarray


def check_profiles(knowledge: Knowledge, names: Sequence[str]) -> None:
    """Raise InputError for names that are not free."""
    for name in names:
        if name not in knowledge.names:
            raise InputError(f"profile of {name!r}: not free here, expected one of {', '.join(knowledge.names)}")


def compute_profiles(
    knowledge: Knowledge,
    plan: Plan,
    names: Sequence[str],
    rng: np.random.Generator | None = None,
    n_side: int = N_SIDE,
    reach: float = REACH,
) -> list[Profile]:
    """Return the profiles of some free parameters.

    Parameters
    ----------
    knowledge : Knowledge
    plan : Plan
    names : sequence of str
    rng : Generator, optional
        Of the noise of one set of measured poses of the expected machine; without it they are exact.
    n_side : int
        Number of values on either side of the expected one, evenly spread: K is 2 n + 1.
    reach : float
        How far they go, in tolerances.

    Raises
    ------
    InputError
        For names that are not free.
    """
    check_profiles(knowledge, names)
    fitter = Fitter(knowledge, plan)
    places = np.array([knowledge.names.index(name) for name in names], dtype=int)
    poses, nothing = fitter.expected.poses, np.zeros((1, len(knowledge.sd)))
    measured = Measurements(poses.position[None], poses.rotation[None], plan.actuators[None])
    if rng is not None:
        measured, _ = simulate_measurements(fitter, nothing, rng)
    own = np.ones((len(names), len(knowledge.names)))
    own[np.arange(len(names)), places] = FREE_SHARE
    best = fitter.fit(measured.take(np.zeros(len(names), dtype=int)), prior_weight=own)
    grid = reach * np.arange(n_side + 1) / n_side
    moves, data, total, converged = _follow(fitter, measured, places, grid)
    data, total = data - best.data_deviance[:, None], total - best.deviance[:, None]
    path = knowledge.centre[knowledge.free] + moves * knowledge.sd
    return [
        Profile(name, path[k, :, place], data[k], total[k], path[k], converged[k])
        for k, (name, place) in enumerate(zip(names, places, strict=True))
    ]


def _follow(
    fitter: Fitter, measured: Measurements, places: np.ndarray, grid: Array
) -> tuple[Array, Array, Array, np.ndarray]:
    """Return moves (M, K, n), both deviances (M, K) and convergence, for M parameters held along a grid.

    Each fit starts where the two before it point, from the middle outwards, so that the path stays on its ridge. The
    grid is one side of the values, from zero, in tolerances.
    """
    rows = np.arange(2 * len(places))
    held, sides = np.tile(places, 2), np.repeat([-1.0, 1.0], len(places))
    data = measured.take(np.zeros(len(rows), dtype=int))
    weight = np.ones((len(rows), len(fitter.knowledge.sd)))
    weight[rows, held] = 0.0
    found: list[Fits] = []
    for value in grid:
        start = found[-1].moves.copy() if found else np.zeros_like(weight)
        if len(found) > 1:
            start += found[-1].moves - found[-2].moves
        start[rows, held] = sides * value
        found.append(fitter.fit(data, start, weight))

    def arrange(name: str) -> Array:
        lower, upper = np.split(np.stack([getattr(fits, name) for fits in found], axis=1), 2)
        return np.concatenate([lower[:, :0:-1], upper], axis=1)

    data_deviance, deviance = arrange("data_deviance"), arrange("deviance")
    lost = ~np.isfinite(deviance)
    data_deviance[lost], deviance[lost] = np.nan, np.nan
    return arrange("moves"), data_deviance, deviance, arrange("converged").astype(bool)
