"""Figures of merit of ISO 9283 (manipulators) and ISO 230-2 (linear axes), of attained poses: measured or predicted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine, IndependentErrors
from bayescal.calibrated.predict import command_poses, draw_poses
from bayescal.calibrated.uncertainty import ACTUATORS, compute_budget
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

CYCLES = 30
"""Visits of each pose, as ISO 9283 has them; ISO 230-2 has at least five."""
AXIS_CYCLES = 5
AXIS_POSITIONS = 11
INSET = 0.1  # of the cube's diagonal, by which the outer four poses of ISO 9283 lie within its corners
SHRINKS = 40  # halvings of an interval about the edge of the largest cube


@dataclass(frozen=True, eq=False)
class PoseFigures:
    """ISO 9283:1998 of poses, (...,) each.

    Attributes
    ----------
    accuracy : ndarray
        AP_p, distance of the barycentre of attained positions from the commanded one, mm.
    repeatability : ndarray
        RP_l = l̄ + 3 S_l of the distances from the barycentre, mm.
    """

    accuracy: Array
    repeatability: Array


@dataclass(frozen=True, eq=False)
class AxisFigures:
    """ISO 230-2:2014 of an axis approached from one side, (...,) each, mm.

    Attributes
    ----------
    accuracy : ndarray
        A, from the largest x̄ + 2 s to the smallest x̄ - 2 s.
    systematic : ndarray
        E, from the largest mean deviation to the smallest.
    repeatability : ndarray
        R, the largest 4 s.
    """

    accuracy: Array
    systematic: Array
    repeatability: Array


def judge_poses(deviations: Array) -> PoseFigures:
    """Return the figures of deviations (..., n, 3) of attained from commanded positions, n cycles, mm."""
    centre = deviations.mean(axis=-2)
    distance = np.linalg.norm(deviations - centre[..., None, :], axis=-1)
    spread = distance.std(axis=-1, ddof=1)
    return PoseFigures(np.linalg.norm(centre, axis=-1), distance.mean(axis=-1) + 3.0 * spread)


def judge_axis(deviations: Array) -> AxisFigures:
    """Return the figures of deviations (..., m, n) at m positions along an axis, n cycles, mm."""
    mean, sd = deviations.mean(axis=-1), deviations.std(axis=-1, ddof=1)
    span = (mean + 2.0 * sd).max(axis=-1) - (mean - 2.0 * sd).min(axis=-1)
    return AxisFigures(span, np.ptp(mean, axis=-1), (4.0 * sd).max(axis=-1))


def fit_cube(calibrated: CalibratedMachine, centre: Array, rotation: Array, most: float = np.inf) -> float:
    """Return the edge in mm, two digits of it, of the largest cube about a position all of whose corners are in reach.

    Parameters
    ----------
    calibrated : CalibratedMachine
    centre, rotation : ndarray, shapes (3,) and (3, 3)
        Where it stands, base frame, mm, and how the platform is turned there.
    most : float
        Edge that it has at most, mm.

    Raises
    ------
    InputError
        Where the centre itself is out of reach.
    """
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T

    def reaches(edge: float) -> bool:
        return bool(command_poses(calibrated, centre + edge * corners, np.tile(rotation, (8, 1, 1))).reached.all())

    if not reaches(0.0):
        raise InputError("cube: found its centre out of reach, expected a home pose within the actuators' range")
    low, high = 0.0, 1.0
    while reaches(high) and high < 1e6:
        low, high = high, 2.0 * high
    for _ in range(SHRINKS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reaches(middle) else (low, middle)
    low = min(low, most)
    step = 10.0 ** (np.floor(np.log10(low)) - 1.0)
    return float(np.floor(low / step) * step)


def list_cube_poses(centre: Array, edge: float) -> Array:
    """Return ISO 9283's five positions (5, 3) of a cube: its centre and four in a diagonal plane near the corners."""
    signs = np.array([[0, 0, 0], [1, 1, 1], [-1, 1, 1], [-1, -1, -1], [1, -1, -1]])
    return np.asarray(centre + (0.5 - INSET) * edge * signs)


def list_axis_poses(centre: Array, edge: float, axis: int) -> Array:
    """Return positions (m, 3) along an axis through the centre of a cube."""
    return np.asarray(centre + np.linspace(-0.5, 0.5, AXIS_POSITIONS)[:, None] * edge * np.eye(3)[axis])


def draw_cycles(
    calibrated: CalibratedMachine, position: Array, rotation: Array, n_cycles: int, n_draws: int, seed: int
) -> Array:
    """Return deviations of attained from commanded positions (P, 3) by draws of the posterior, (S, P, n, 3), mm.

    A draw's geometry and its model errors stay the same in all cycles, the noise of the actuators does not.

    Raises
    ------
    InputError
        Where a pose is out of reach.
    """
    rng = np.random.default_rng(seed)
    found = command_poses(calibrated, position, np.tile(rotation, (len(position), 1, 1)))
    if not found.reached.all():
        raise InputError(f"cube: found a pose out of reach ({next(one for one in found.faults if one)}), expected none")
    noise = compute_budget(calibrated, found.actuators).parts[ACTUATORS][:, :3, :3]
    attained, _ = draw_poses(_without_noise(calibrated), found.actuators, n_draws, rng)
    values, vectors = np.linalg.eigh(noise)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    normal = rng.standard_normal((len(attained), len(position), n_cycles, 3))
    return np.asarray((attained - position)[:, :, None, :] + np.einsum("pij,spnj->spni", root, normal))


def _without_noise(calibrated: CalibratedMachine) -> CalibratedMachine:
    """Return the machine with actuators that make no noise."""
    errors = calibrated.errors
    assert isinstance(errors, IndependentErrors)  # the budget has refused others
    return replace(calibrated, errors=replace(errors, actuator_noise=0.0))
