"""Where a calibrated machine is judged: at poses like those that calibrated it, in a box about home, or in all reach.

What lies outside of the measured poses is extrapolated: there uncertainty is larger, and rests on the model alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

FEWEST = 16
"""Poses that figures over a region need."""
TRIES = 64
"""Poses of a box that are tried for each one wanted: legs reach few of its corners."""

BARELY = 0.05
"""Of the box's extent, by which a position may lie outside of it and still count as within."""


@dataclass(frozen=True, eq=False)
class Region:
    """A box of poses: position (mm) and rotation vector (rad) from home, base axes.

    Attributes
    ----------
    low, high : ndarray, shape (6,)
    words : str
        What it is.
    """

    low: Array
    high: Array
    words: str

    @property
    def cube(self) -> float:
        """Edge of the largest cube about home within it, mm; zero where home is not inside."""
        return max(0.0, 2.0 * float(np.minimum(-self.low[:3], self.high[:3]).min()))


def enclose_measured(calibrated: CalibratedMachine) -> Region | None:
    """Return the box of the poses that calibrated a machine; None where they are not known."""
    if calibrated.measured is None:
        return None
    home = check_home_pose(calibrated.machine)
    found = solve_forward_kinematics(calibrated.machine, calibrated.theta, calibrated.measured, check=False)
    turned = rotation_vector_from_matrix(found.rotation[found.converged] @ home.rotation.T)
    apart = np.concatenate([found.position[found.converged] - home.position, turned], axis=1)
    if not len(apart):
        return None
    words = f"the box of the {len(apart)} poses that calibrated the machine"
    return Region(apart.min(axis=0), apart.max(axis=0), words)


def measure_beyond(calibrated: CalibratedMachine, position: Array) -> float:
    """Return the share of positions (P, 3) outside of the box of the poses that calibrated a machine; 0 if unknown."""
    known = enclose_measured(calibrated)
    if known is None:
        return 0.0
    apart = position - check_home_pose(calibrated.machine).position
    slack = BARELY * (known.high - known.low)[:3]
    outside = (apart < known.low[:3] - slack) | (apart > known.high[:3] + slack)
    return float(outside.any(axis=1).mean())


def box_about_home(position: tuple[float, float, float], rotation: tuple[float, float, float]) -> Region:
    """Return the box of half extents in mm and rad about home."""
    half = np.array([*position, *rotation])
    return Region(-half, half, "the box about home as stated")


def sample_region(calibrated: CalibratedMachine, region: Region, n: int, seed: int) -> Array:
    """Return actuator positions (n, N), mm, of poses all over a region, as far as they are in reach.

    Raises
    ------
    InputError
        Where fewer than `FEWEST` are.
    """
    machine, home = calibrated.machine, check_home_pose(calibrated.machine)
    sobol, kept, count = qmc.Sobol(6, rng=np.random.default_rng(seed)), list[Array](), 0
    size = int(2 ** np.ceil(np.log2(n)))
    for _ in range(TRIES):
        apart = qmc.scale(sobol.random(size), region.low, np.maximum(region.high, region.low + 1e-12))
        rotation = matrix_from_rotation_vector(apart[:, 3:]) @ home.rotation
        found = solve_inverse_kinematics(machine, calibrated.theta, home.position + apart[:, :3], rotation, check=False)
        moved = np.abs(found.actuators - machine.mechanism.initial_actuator_positions).max(axis=1)
        there = found.converged & (moved <= machine.mechanism.actuator_range)
        kept.append(found.actuators[there])
        count += int(there.sum())
        if count >= n:
            break
    if count < FEWEST:
        raise InputError(
            f"workspace: found {count} of {TRIES * size} poses of {region.words} in reach of the actuators, expected "
            f"{FEWEST} at least"
        )
    return np.concatenate(kept)[:n]


def sample_range(calibrated: CalibratedMachine, n: int, seed: int) -> Array:
    """Return actuator positions (about n, N), mm, all over the actuators' range, that have a pose.

    Raises
    ------
    InputError
        Where none has.
    """
    mechanism = calibrated.machine.mechanism
    share = qmc.Sobol(calibrated.n_legs, rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(n))))
    actuators = mechanism.initial_actuator_positions + mechanism.actuator_range * (2.0 * share[:n] - 1.0)
    found = solve_forward_kinematics(calibrated.machine, calibrated.theta, actuators, check=False)
    if not found.converged.any():
        raise InputError(f"mechanism {mechanism.name!r}: found no pose within the actuators' range")
    return actuators[found.converged]
