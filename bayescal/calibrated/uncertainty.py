"""How well the tool of a calibrated machine is known over its workspace: GUM's budget, Monte Carlo of JCGM 101.

The law of propagation gives each pose's covariance: that of the geometry and those of what commands err by besides. By
Monte Carlo draws of the posterior go through the kinematics, each with errors of its own; where both agree the expanded
uncertainty k u of the budget may be stated, otherwise that of the draws (JCGM 101:2008, section 8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import (
    check_determined,
    draw_poses,
    find_curved,
    place_machine,
    predict_poses,
    split,
    spread_outputs,
)
from bayescal.errors import InputError
from bayescal.machines.readings.base import NOTHING, Given
from bayescal.numerics.geometry import Array

GEOMETRY = "geometry"
BATCH = 16  # poses at a time that draws go through


@dataclass(frozen=True, eq=False)
class Budget:
    """Covariances of P poses by source.

    Attributes
    ----------
    commands : ndarray, shape (P, C)
    tool : ndarray, shape (P, m)
        Where it is, as the posterior has it in the mean.
    parts : dict of str to ndarray, shape (P, m, m)
        Of the tool, by source.
    """

    commands: Array
    tool: Array
    parts: dict[str, Array]

    @property
    def combined(self) -> Array:
        """Covariance of each pose, all sources together, shape (P, m, m)."""
        return np.sum(list(self.parts.values()), axis=0)

    def sd(self, source: str | None = None) -> Array:
        """Return standard uncertainties (P, m) in the tool's units, of one source or combined."""
        covariance = self.combined if source is None else self.parts[source]
        return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False)
class Spread:
    """What Monte Carlo finds of P poses.

    Attributes
    ----------
    half_width : ndarray, shape (P, m)
        Half the interval, as wide on both sides of the mean, that holds the stated share of draws.
    radius : ndarray, shape (P,)
        Of the sphere about the mean that holds it, mm; zero for a tool without lengths.
    n_draws : int
        How many draws of the posterior.
    """

    half_width: Array
    radius: Array
    n_draws: int


def compute_budget(calibrated: CalibratedMachine, commands: Array, given: Given = NOTHING) -> Budget:
    """Return the covariances of the tool at commands (P, C), by source.

    Raises
    ------
    InputError
        Where there is no covariance of the posterior.
    """
    if calibrated.covariance is None:
        raise InputError(f"experiment {calibrated.source.experiment}: found no draws of its posterior, expected some")
    check_determined(calibrated)
    curved, m = find_curved(calibrated), len(calibrated.model.tool_channels)
    sources = calibrated.errors.split()
    found: dict[str, list[Array]] = {name: [] for name in (GEOMETRY, *sources)}
    for part in split(len(commands)):
        at = place_machine(calibrated, commands[part], {name: value[part] for name, value in given.items()})
        found[GEOMETRY].append(spread_outputs(calibrated, at, curved)[1][:, :m, :m])
        to_tool = at.gain[:, :m]
        for name, errors in sources.items():
            covariance = errors.covariance(at.pose, at.commands, at.given)
            found[name].append(to_tool @ covariance @ np.swapaxes(to_tool, 1, 2))
    parts = {name: np.concatenate(some) for name, some in found.items()}
    return Budget(commands, predict_poses(calibrated, commands, given).tool, parts)


def coverage_factor(coverage: float) -> float:
    """Return k by which a normal quantity lies within k u of its mean with a probability (GUM, annex G)."""
    return float(norm.ppf(0.5 * (1.0 + coverage)))


def propagate(
    calibrated: CalibratedMachine, commands: Array, coverage: float, n_draws: int, seed: int, given: Given = NOTHING
) -> Spread:
    """Return by Monte Carlo what holds a share of tools at commands (P, C) (JCGM 101:2008, section 7).

    Raises
    ------
    InputError
        Where there are no draws.
    """
    rng, mean = np.random.default_rng(seed), predict_poses(calibrated, commands, given)
    half_width, radius, n = np.empty_like(mean.tool), np.empty(len(commands)), 0
    for start in range(0, len(commands), BATCH):
        part = slice(start, start + BATCH)
        some = {name: value[part] for name, value in given.items()}
        drawn = draw_poses(calibrated, commands[part], n_draws, rng, some)
        apart = calibrated.comparison.subtract(drawn, mean.tool[part])
        half_width[part] = np.nanquantile(np.abs(apart), coverage, axis=0)
        radius[part] = np.nanquantile(np.linalg.norm(apart[..., calibrated.lengths], axis=-1), coverage, axis=0)
        n = len(apart)
    return Spread(half_width, radius, n)
