"""How accurate a calibrated machine is at poses like those that calibrated it, in a box about home, or in all reach.

What lies outside of the measured poses is extrapolated: there uncertainty is larger, and rests on the model alone.

GUM's budget: the law of propagation gives each pose's covariance, that of the geometry and those of what commands err
by besides. By Monte Carlo draws of the posterior go through the kinematics, each with errors of its own; where both
agree the expanded uncertainty k u of the budget may be stated, otherwise that of the draws (JCGM 101:2008, section 8).
Figures of merit are those of ISO 9283 (manipulators) and ISO 230-2 (linear axes).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm, qmc

from bayescal.calibrated.drawn_machines import AlignedMachine, draw_machines, place_drawn
from bayescal.calibrated.machine import NOISE, CalibratedMachine
from bayescal.calibrated.predict import (
    bound_workspace,
    check_determined,
    compensate_poses,
    find_curved,
    find_errors,
    is_pose,
    place_machine,
    predict_poses,
    split,
    spread_outputs,
)
from bayescal.density.calibration.measurements import Comparison
from bayescal.errors import InputError
from bayescal.machines.readings.base import NO_CONDITIONS, Given
from bayescal.numerics.geometry import Array

FEWEST = 16
"""Poses that figures over a region need."""
TRIES = 64
"""Poses of a box that are tried for each one wanted: legs reach few of its corners."""

BARELY = 0.05
"""Of the box's extent, by which a pose may lie outside of it and still count as within."""
GEOMETRY = "geometry"
BATCH = 16  # poses at a time that draws go through
CYCLES = 30
"""Visits of each pose, as ISO 9283 has them; ISO 230-2 has at least five."""
AXIS_CYCLES = 5
AXIS_POSITIONS = 11
INSET = 0.1  # of the cube's diagonal, by which the outer four poses of ISO 9283 lie within its corners
MOST_LENGTHS = 3
SHRINKS = 40  # halvings of an interval about the edge of the largest cube


@dataclass(frozen=True, eq=False)
class Region:
    """A box of poses: coordinates from home, a rotation vector about the base axes."""

    # (q,): mm, rad, or what else a coordinate is in
    low: Array
    high: Array
    words: str  # what the box is


def enclose_measured(calibrated: CalibratedMachine) -> Region | None:
    """Return the box of the poses that calibrated a machine; None where they are not known."""
    if calibrated.measured is None:
        return None
    model = calibrated.model
    pose, found = model.locate(calibrated.theta, calibrated.measured, calibrated.given, weights=calibrated.weights)
    if not found.any():
        return None
    apart = Comparison(model.pose_channels).subtract(pose[found], model.home_pose)
    words = f"the box of {len(apart)} calibration poses"
    return Region(apart.min(axis=0), apart.max(axis=0), words)


def find_largest_cube(calibrated: CalibratedMachine, region: Region, tool: Array) -> float:
    """Return the edge of the largest cube about home's tool within a region, mm; zero where home is not inside.

    Where the coordinates are not the tool, it is that within the box of tools (P, m) all over the region.
    """
    low, high = region.low, region.high
    if not is_pose(calibrated):
        home = calibrated.model.tool_values(calibrated.theta, calibrated.model.home_pose)
        apart = calibrated.comparison.subtract(tool, home)
        low, high = apart.min(axis=0), apart.max(axis=0)
    lengths = calibrated.lengths
    return max(0.0, 2.0 * float(np.minimum(-low[lengths], high[lengths]).min(initial=np.inf)))


def measure_beyond(calibrated: CalibratedMachine, commands: Array, known: Region | None) -> float:
    """Return the share of commands (P, C) outside of the box of the poses that calibrated a machine; 0 if unknown.

    Poses are judged by their lengths; those of a machine without any by all coordinates.
    """
    if known is None:
        return 0.0
    model = calibrated.model
    lengths = np.array([one.unit == "mm" for one in model.coordinates], dtype=bool)
    chosen = lengths if lengths.any() else np.ones_like(lengths)
    given = calibrated.typical(len(commands))
    pose, found = model.locate(calibrated.theta, commands, given, weights=calibrated.weights)
    apart = Comparison(model.pose_channels).subtract(pose[found], model.home_pose)
    slack = BARELY * (known.high - known.low)
    outside = (apart < known.low - slack) | (apart > known.high + slack)
    return float(outside[:, chosen].any(axis=1).mean())


def box_about_home(half: Array) -> Region:
    """Return the box of half extents (q,) about home, in the coordinates' units."""
    return Region(-half, half, "the stated box")


def sample_region(calibrated: CalibratedMachine, region: Region, n: int, seed: int) -> Array:
    """Return commands (n, C) of poses all over a region, as far as they are in reach.

    InputError where fewer than `FEWEST` are.
    """
    model, compared = calibrated.model, Comparison(calibrated.model.pose_channels)
    q = len(model.coordinates)
    sobol, kept, count = qmc.Sobol(q, rng=np.random.default_rng(seed)), list[Array](), 0
    size, (low, high) = int(2 ** np.ceil(np.log2(n))), model.command_range.T
    for _ in range(TRIES):
        apart = qmc.scale(sobol.random(size), region.low, np.maximum(region.high, region.low + 1e-12))
        pose = compared.add(np.broadcast_to(model.home_pose, apart.shape), apart)
        commands = model.read(calibrated.theta, pose, calibrated.typical(size))[:, calibrated.commanded]
        with np.errstate(invalid="ignore"):
            there = ((commands >= low) & (commands <= high)).all(axis=1)
        kept.append(commands[there])
        count += int(there.sum())
        if count >= n:
            break
    if count < FEWEST:
        raise InputError(
            f"workspace: found {count} of {TRIES * size} poses of {region.words} in reach, expected {FEWEST}"
        )
    return np.concatenate(kept)[:n]


def enclose_workspace(calibrated: CalibratedMachine) -> Region | None:
    """Return the workspace of a machine whose commands have no range; None where they have."""
    if np.isfinite(calibrated.model.command_range).all():
        return None
    low, high = bound_workspace(calibrated) - calibrated.model.home_pose
    return Region(low, high, "the workspace")


def sample_range(calibrated: CalibratedMachine, n: int, seed: int) -> Array:
    """Return commands (about n, C) all over their range, that have a pose; all over the workspace where they have none.

    InputError where none has.
    """
    model = calibrated.model
    workspace = enclose_workspace(calibrated)
    if workspace is not None:
        return sample_region(calibrated, workspace, n, seed)
    low, high = model.command_range.T
    share = qmc.Sobol(len(low), rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(n))))
    commands = 0.5 * (low + high) + 0.5 * (high - low) * (2.0 * share[:n] - 1.0)
    _, found = model.locate(calibrated.theta, commands, calibrated.typical(len(commands)))
    if not found.any():
        raise InputError(f"machine {calibrated.name!r}: found no pose within its command range")
    return np.asarray(commands[found])


@dataclass(frozen=True, eq=False)
class Budget:
    """Covariances of P poses by source."""

    commands: Array  # (P, C)
    tool: Array  # (P, m): where it is, as the posterior has it in the mean
    parts: dict[str, Array]  # (P, m, m): of the tool, by source

    @property
    def combined(self) -> Array:
        """Covariance of each pose, all sources together, shape (P, m, m)."""
        return np.sum(list(self.parts.values()), axis=0)

    def sd(self, source: str | None = None) -> Array:
        """Return standard uncertainties (P, m) in the tool's units, of one source or combined."""
        covariance = self.combined if source is None else self.parts[source]
        return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False)
class MonteCarloSpread:
    """What Monte Carlo finds of P poses."""

    # (P, m): half the interval, as wide on both sides of the mean, that holds the stated share of draws
    half_width: Array
    radius: Array  # (P,): of the sphere about the mean that holds it, mm; zero for a tool without lengths
    n_draws: int  # how many draws of the posterior


def compute_budget(
    calibrated: CalibratedMachine, commands: Array, given: Given = NO_CONDITIONS, aligned: AlignedMachine | None = None
) -> Budget:
    """Return the covariances of the tool at commands (P, C), by source.

    InputError where there is no covariance of the posterior.

    Parameters
    ----------
    aligned : Aligned, optional
        Base and tool over the same poses, whose motions are then no errors of the geometry.
    """
    if calibrated.covariance is None:
        raise InputError(f"experiment {calibrated.source.experiment}: found no posterior draws")
    check_determined(calibrated)
    curved, m = find_curved(calibrated), len(calibrated.model.tool_channels)
    found: dict[str, list[Array]] = {}
    factors = list[Array]()
    for part in split(len(commands)):
        at = place_machine(calibrated, commands[part], {name: value[part] for name, value in given.items()})
        errors, to_tool = find_errors(calibrated, at), at.gain[:, :m]
        factors.append(spread_outputs(calibrated, at, errors, curved)[1][:, :m])
        for name, covariance in errors.parts.items():
            found.setdefault(name, []).append(to_tool @ covariance @ np.swapaxes(to_tool, 1, 2))
    every = np.concatenate(factors)
    every = every if aligned is None else aligned.alignment.remove(every)
    parts = {GEOMETRY: every @ np.swapaxes(every, 1, 2)}
    parts |= {name: np.concatenate(some) for name, some in found.items()}
    return Budget(commands, predict_poses(calibrated, commands, given).tool, parts)


def coverage_factor(coverage: float) -> float:
    """Return k by which a normal quantity lies within k u of its mean with a probability (GUM, annex G)."""
    return float(norm.ppf(0.5 * (1.0 + coverage)))


def propagate(
    calibrated: CalibratedMachine,
    commands: Array,
    coverage: float,
    n_draws: int,
    seed: int,
    given: Given = NO_CONDITIONS,
    aligned: AlignedMachine | None = None,
) -> MonteCarloSpread:
    """Return by Monte Carlo what holds a share of tools at commands (P, C) (JCGM 101:2008, section 7).

    InputError where there are no draws. ``aligned``: base and tool, whose motions are then no errors.
    """
    rng, mean = np.random.default_rng(seed), predict_poses(calibrated, commands, given)
    half_width, radius = np.empty_like(mean.tool), np.empty(len(commands))
    machines = draw_machines(calibrated, n_draws, rng)
    fitted = None if aligned is None else aligned.fit(machines)
    for start in range(0, len(commands), BATCH):
        part = slice(start, start + BATCH)
        some = {name: value[part] for name, value in given.items()}
        drawn = place_drawn(calibrated, machines, commands[part], rng, some)
        apart = calibrated.comparison.subtract(drawn, mean.tool[part])
        if aligned is not None and fitted is not None:
            apart = apart - aligned.move(mean.tool[part], mean.pose[part], fitted)
        half_width[part] = np.nanquantile(np.abs(apart), coverage, axis=0)
        radius[part] = np.nanquantile(np.linalg.norm(apart[..., calibrated.lengths], axis=-1), coverage, axis=0)
    return MonteCarloSpread(half_width, radius, len(machines.theta))


@dataclass(frozen=True, eq=False)
class PoseFigures:
    """ISO 9283:1998 of poses, (...,) each."""

    accuracy: Array  # AP_p, distance of the barycentre of attained positions from the commanded one, mm
    repeatability: Array  # RP_l = l̄ + 3 S_l of the distances from the barycentre, mm


@dataclass(frozen=True, eq=False)
class AxisFigures:
    """ISO 230-2:2014 of an axis approached from one side, (...,) each, mm."""

    accuracy: Array  # A, from the largest x̄ + 2 s to the smallest x̄ - 2 s
    systematic: Array  # E, from the largest mean deviation to the smallest
    repeatability: Array  # R, the largest 4 s


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
        return f"they need one to three lengths; the tool ({names}) has {n or 'none'}"
    if len(model.tool_channels) < len(model.coordinates):
        return f"the tool ({names}) does not determine the machine's coordinates"
    place = model.home_pose[None]
    _, slopes, _ = model.tool(calibrated.theta, place, False)
    if np.linalg.matrix_rank(slopes[0, calibrated.lengths] * model.pose_scale) < n or np.linalg.matrix_rank(
        slopes[0] * model.pose_scale
    ) < len(model.tool_channels):
        return f"the tool ({names}) cannot move along each axis alone"
    return ""


def fit_cube(calibrated: CalibratedMachine, centre: Array, most: float = np.inf) -> float:
    """Return the edge in mm, two digits of it, of the largest cube about a tool all of whose corners are in reach.

    InputError where the centre itself is out of reach.

    Parameters
    ----------
    centre : ndarray, shape (m,)
        The tool in its middle; it keeps its orientation.
    most : float
        Edge that it has at most, mm.
    """
    n = len(calibrated.lengths)
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * n)).reshape(n, -1).T

    def reaches(edge: float) -> bool:
        visited = place_lengths(calibrated, centre, edge * corners)
        return bool(compensate_poses(calibrated, visited, calibrated.typical(len(visited))).reached.all())

    if not reaches(0.0):
        raise InputError("cube: found its centre out of reach, expected a home pose in range")
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


def draw_cycles(
    calibrated: CalibratedMachine,
    poses: Array,
    n_cycles: int,
    n_draws: int,
    seed: int,
    aligned: AlignedMachine | None = None,
) -> Array:
    """Return deviations of attained from commanded tools (P, m) in length by draws of the posterior, (S, P, n, d), mm.

    A draw's geometry and its model errors stay the same in all cycles, the noise of the commands does not. InputError
    where a pose is out of reach. ``aligned``: base and tool, whose motions are then no deviations.
    """
    rng, lengths, given = np.random.default_rng(seed), calibrated.lengths, calibrated.typical(len(poses))
    found = compensate_poses(calibrated, poses, given)
    if not found.reached.all():
        raise InputError(f"cube: found a pose out of reach ({next(one for one in found.faults if one)})")
    noise = compute_budget(calibrated, found.commands, given).parts[NOISE][:, lengths[:, None], lengths]
    steady = replace(calibrated, errors=calibrated.errors.without_noise())
    machines = draw_machines(steady, n_draws, rng)
    attained = place_drawn(steady, machines, found.commands, rng, given)
    if aligned is not None:
        pose = predict_poses(steady, found.commands, given).pose
        attained = attained - aligned.move(poses, pose, aligned.fit(machines))
    attained = attained[..., lengths]
    values, vectors = np.linalg.eigh(noise)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    normal = rng.standard_normal((len(attained), len(poses), n_cycles, len(lengths)))
    moved = np.einsum("pij,spnj->spni", root, normal)
    return np.asarray((attained - poses[:, lengths])[:, :, None, :] + moved)
