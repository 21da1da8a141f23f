"""Figures of merit of ISO 9283 (manipulators) and ISO 230-2 (linear axes), of attained poses: measured or predicted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.calibrated.machine import NOISE, CalibratedMachine
from bayescal.calibrated.predict import command_poses, draw_poses
from bayescal.calibrated.uncertainty import compute_budget
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

CYCLES = 30
"""Visits of each pose, as ISO 9283 has them; ISO 230-2 has at least five."""
AXIS_CYCLES = 5
AXIS_POSITIONS = 11
INSET = 0.1  # of the cube's diagonal, by which the outer four poses of ISO 9283 lie within its corners
MOST_LENGTHS = 3
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
    """Return the figures of deviations (..., n, d) of attained from commanded positions, n cycles, mm."""
    centre = deviations.mean(axis=-2)
    distance = np.linalg.norm(deviations - centre[..., None, :], axis=-1)
    spread = distance.std(axis=-1, ddof=1)
    return PoseFigures(np.linalg.norm(centre, axis=-1), distance.mean(axis=-1) + 3.0 * spread)


def judge_axis(deviations: Array) -> AxisFigures:
    """Return the figures of deviations (..., m, n) at m positions along an axis, n cycles, mm."""
    mean, sd = deviations.mean(axis=-1), deviations.std(axis=-1, ddof=1)
    span = (mean + 2.0 * sd).max(axis=-1) - (mean - 2.0 * sd).min(axis=-1)
    return AxisFigures(span, np.ptp(mean, axis=-1), (4.0 * sd).max(axis=-1))


def check_standards(calibrated: CalibratedMachine) -> str:
    """Return why figures of ISO 9283 and 230-2 have no meaning for a machine, in words; empty where they have."""
    model, n = calibrated.model, len(calibrated.lengths)
    names = ", ".join(one.name for one in model.tool_channels)
    if not 1 <= n <= MOST_LENGTHS:
        return f"they are of one to three lengths, and the tool ({names}) has {n or 'none'}"
    if len(model.tool_channels) < len(model.coordinates):
        return f"the tool's {len(model.tool_channels)} numbers ({names}) do not tell the machine's coordinates"
    place = model.home_pose[None]
    _, slopes, _ = model.tool(calibrated.theta, place)
    if np.linalg.matrix_rank(slopes[0, calibrated.lengths] * model.pose_scale) < n or np.linalg.matrix_rank(
        slopes[0] * model.pose_scale
    ) < len(model.tool_channels):
        return f"the machine cannot move its tool ({names}) along each of these alone"
    return ""


def fit_cube(calibrated: CalibratedMachine, centre: Array, most: float = np.inf) -> float:
    """Return the edge in mm, two digits of it, of the largest cube about a tool all of whose corners are in reach.

    Parameters
    ----------
    calibrated : CalibratedMachine
    centre : ndarray, shape (m,)
        The tool in its middle; it keeps its orientation.
    most : float
        Edge that it has at most, mm.

    Raises
    ------
    InputError
        Where the centre itself is out of reach.
    """
    n = len(calibrated.lengths)
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * n)).reshape(n, -1).T

    def reaches(edge: float) -> bool:
        visited = place_lengths(calibrated, centre, edge * corners)
        return bool(command_poses(calibrated, visited, calibrated.typical(len(visited))).reached.all())

    if not reaches(0.0):
        raise InputError("cube: found its centre out of reach, expected a home pose within the actuators' range")
    low, high = 0.0, 1.0
    if np.isfinite(most) and reaches(most):
        low, high = most, most
    while low < most and reaches(high) and high < 1e6:
        low, high = high, 2.0 * high
    for _ in range(SHRINKS if low < high else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reaches(middle) else (low, middle)
    low = min(low, most)
    step = 10.0 ** (np.floor(np.log10(low)) - 1.0)
    return float(np.floor(low / step) * step)


def place_lengths(calibrated: CalibratedMachine, centre: Array, moves: Array) -> Array:
    """Return tools (P, m) that are moved from a centre (m,) along its lengths, moves (P, d), mm."""
    poses = np.tile(centre, (len(moves), 1))
    poses[:, calibrated.lengths] += moves
    return poses


def list_cube_poses(edge: float, n: int = MOST_LENGTHS) -> Array:
    """Return ISO 9283's five positions (5, n) about a cube's centre: it, and four in a diagonal plane near corners."""
    signs = np.array([[0, 0, 0], [1, 1, 1], [-1, 1, 1], [-1, -1, -1], [1, -1, -1]])
    return np.asarray((0.5 - INSET) * edge * signs[:, :n])


def list_axis_poses(edge: float, axis: int, n: int = MOST_LENGTHS) -> Array:
    """Return positions (k, n) along an axis through a cube's centre, from there."""
    return np.asarray(np.linspace(-0.5, 0.5, AXIS_POSITIONS)[:, None] * edge * np.eye(n)[axis])


def draw_cycles(calibrated: CalibratedMachine, poses: Array, n_cycles: int, n_draws: int, seed: int) -> Array:
    """Return deviations of attained from commanded tools (P, m) in length by draws of the posterior, (S, P, n, d), mm.

    A draw's geometry and its model errors stay the same in all cycles, the noise of the commands does not.

    Raises
    ------
    InputError
        Where a pose is out of reach.
    """
    rng, lengths, given = np.random.default_rng(seed), calibrated.lengths, calibrated.typical(len(poses))
    found = command_poses(calibrated, poses, given)
    if not found.reached.all():
        raise InputError(f"cube: found a pose out of reach ({next(one for one in found.faults if one)}), expected none")
    noise = compute_budget(calibrated, found.commands, given).parts[NOISE][:, lengths[:, None], lengths]
    steady = replace(calibrated, errors=calibrated.errors.without_noise())
    attained = draw_poses(steady, found.commands, n_draws, rng, given)[..., lengths]
    values, vectors = np.linalg.eigh(noise)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    normal = rng.standard_normal((len(attained), len(poses), n_cycles, len(lengths)))
    moved = np.einsum("pij,spnj->spni", root, normal)
    return np.asarray((attained - poses[:, lengths])[:, :, None, :] + moved)
