"""Profiles: how well readings agree with a machine at each value of one parameter, all others being at their best.

A parameter that is determined has a parabola; along an unidentified direction the profile is flat, and the path that
the others take to keep it so is the ridge itself, bent as it is, where derivatives only give its tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.calibration.joint_fit import JointFit
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.errors import InputError, NumericalError
from bayescal.numerics.geometry import Array

REACH = 3.0  # tolerances to either side
N_SIDE = 15


@dataclass(frozen=True, eq=False)
class Profile:
    """A parameter held at K values, all others at their best with their priors; its own prior left out."""

    name: str
    values: Array  # (K,): in the parameter's unit
    # (K,) each: twice what the log-likelihood, and the log-density with the others' priors, lack to where the
    # latter is best; along a ridge the data alone may lack less than nothing. NaN where there is no machine
    data_deviance: Array
    deviance: Array
    path: Array  # (K, n): all free parameters, in their units


def check_profiles(free: Sequence[str], names: Sequence[str]) -> None:
    """Raise InputError for names that are not free."""
    for name in names:
        if name not in free:
            raise InputError(f"profile of {name!r}: fixed, expected one of {', '.join(free)}")


def compute_profile(posterior: CalibrationPosterior, name: str, zeta: Array, n_side: int = N_SIDE) -> Profile:
    """Return the profile of a free parameter about the machine expected, whose readings the data are.

    The posterior has normal priors, centred where the machine is expected; coordinates ``zeta`` (k,) of the errors
    stay. On either side of the expected value there are n others, evenly spread as far as `REACH`: K is 2 n + 1.
    InputError for a name that is not free.
    """
    check_profiles(posterior.sampling.names, [name])
    place, sampling = posterior.sampling.names.index(name), posterior.sampling
    prior, n = posterior.priors[name], posterior.n_geometry
    alike = posterior.common.get(name, (name,))
    offset = {one: float(sampling.start[sampling.layout.names.index(one)]) - prior.mean for one in alike}
    free = replace(
        posterior,
        priors={one: other for one, other in posterior.priors.items() if one != name},
        common={one: members for one, members in posterior.common.items() if one != name},
    )
    moves, deviance = np.full((2 * n_side + 1, n), np.nan), np.full((2 * n_side + 1, 2), np.nan)
    others, grid = np.delete(np.arange(n), place), REACH * np.arange(-n_side, n_side + 1) / n_side
    for sign in (1, -1):
        before: list[tuple[Array, Array]] = []
        for k in range(n_side, n_side + sign * (n_side + 1), sign):
            value = prior.mean + prior.sd * grid[k]
            held = replace(free, fixed={**free.fixed, **{one: value + away for one, away in offset.items()}})
            start = before[-1] if before else (np.zeros(n - 1), posterior.likelihood.start)
            if len(before) > 1:  # towards where the two before point, so that the path stays on its ridge
                start = (2.0 * start[0] - before[-2][0], 2.0 * start[1] - before[-2][1])
            fit = JointFit(held.likelihood, held.sampling, held.errors, zeta)
            try:
                with np.errstate(all="ignore"):
                    y, pose = fit.run(*start)
                    _, at = held.likelihood.explain(*held.at(np.concatenate([y, zeta])[None]))
            except NumericalError:
                break
            before.append((y, pose))
            moves[k, others], moves[k, place] = y, grid[k]
            deviance[k] = float(at.square.sum()), float(at.square.sum() + y @ y)
    path = np.array([sampling.start[sampling.free]]) + moves * posterior.prior_sd[:n]
    best = deviance[np.nanargmin(deviance[:, 1])]
    data, total = (deviance - best).T
    return Profile(name, prior.mean + prior.sd * grid, data, total, path)
