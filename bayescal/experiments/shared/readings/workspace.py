"""Where a machine may stand: bounds of its coordinates, and where to look for the poses of its readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np

from bayescal.data.truth import round_as_written
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.poses import PoseElimination, search_poses
from bayescal.errors import InputError, say_unknown
from bayescal.experiments.shared.schema import UnitsConfig, WorkspaceConfig
from bayescal.machines.readings import POSE, Given, ReadingModel
from bayescal.machines.readings.base import draw_points
from bayescal.machines.readings.newton import share_contacts, touch
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

MEASURED_QUANTILES = (0.02, 0.98)
"""Of each coordinate over the measured poses, between which accuracy counts where no workspace is stated."""
MARGIN = 0.05  # of their distance, by which it goes beyond both
N_WORKSPACE = 200
"""How many poses stand for a workspace where a config does not say it."""
STARTS = 0.6  # of the half widths, from where poses are looked for
MOST_TRIES, SINGLE = 100, 20
ROUNDS, EACH = 5, 40  # of starts for poses that touch, in each so many for a pose
HOPELESS = 400  # starts together, none of which leads to a contact: few poses would touch in the rounds that are left
EDGE = 1e-9  # of the half widths, by which poses may lie beyond the workspace: by rounding
LARGEST_GRID = 81  # starts; beyond, they are drawn
STRAIGHT = 1e-9  # of a slope, by which it may be another elsewhere
TRIED = 150
"""Rows of many that are looked for from all starts: where the middle leads as far with each, it is the start of all."""
SAME_RATIO, FAR = 1.01, 4.0
"""By which r² may differ from the least to be as good, and by which from the largest of the tried rows to be usual."""
SINGULAR = 1e-10  # of the largest singular value of H in units of the workspace, below which a pose is not told


@dataclass(frozen=True, eq=False)
class Workspace:
    """Bounds of the coordinates, (q,) each, in mm, rad or their own units.

    ``shape``: every combination of coordinates (``box``), all within one ``ellipsoid``, or one at a time (``axes``);
    ``n_poses``: how many poses stand for it; ``scale`` (q,): what steps are small against where a bound is the other.
    """

    low: Array
    high: Array
    scale: Array
    shape: Literal["box", "ellipsoid", "axes"] = "box"
    n_poses: int = N_WORKSPACE

    @cached_property
    def volume(self) -> float:
        """Volume of the box of its bounds, one for a machine without coordinates."""
        return float(np.prod(2.0 * self.half))

    @cached_property
    def middle(self) -> Array:
        """Its middle, shape (q,)."""
        return 0.5 * (self.low + self.high)

    @cached_property
    def half(self) -> Array:
        """Half widths, shape (q,); of a coordinate that stays where it is its scale."""
        return np.where(self.high > self.low, 0.5 * (self.high - self.low), self.scale)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n poses spread evenly, shape (n, q)."""
        if self.shape == "box":
            return rng.uniform(self.low, self.high, (n, len(self.low)))
        moves = np.flatnonzero(self.high > self.low)
        if self.shape == "axes":
            inside = rng.uniform(-1.0, 1.0, (n, 1)) * (rng.integers(len(moves), size=(n, 1)) == np.arange(len(moves)))
        else:
            normal = rng.standard_normal((n, len(moves)))
            radius = rng.uniform(size=(n, 1)) ** (1.0 / len(moves))
            inside = radius * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        pose = np.tile(self.middle, (n, 1))
        pose[:, moves] += self.half[moves] * inside
        return pose

    def list_ends(self) -> Array:
        """Return its middle and the ends of its axes, shape (2 q + 1, q)."""
        half = np.diag(0.5 * (self.high - self.low))
        return self.middle + np.concatenate([np.zeros((1, len(half))), half, -half])

    def widen(self, factor: float) -> Workspace:
        """Return a workspace so many times as wide about the same middle."""
        half = 0.5 * factor * (self.high - self.low)
        return replace(self, low=self.middle - half, high=self.middle + half)

    def starts(self, seed: int) -> Array:
        """Return poses from which to look for others, the middle first, shape (S, q)."""
        q = len(self.low)
        if 3**q <= LARGEST_GRID:
            grid = np.array([*product((0.0, -1.0, 1.0), repeat=q)]).reshape(3**q, q)
        else:
            rng = np.random.default_rng([seed, 4])
            grid = np.concatenate([np.zeros((1, q)), rng.uniform(-1.0, 1.0, (LARGEST_GRID - 1, q))])
        return self.middle + STARTS * self.half * grid


def build_workspace(
    model: ReadingModel, given: WorkspaceConfig | Mapping[str, list[float]], section: UnitsConfig
) -> Workspace:
    """Return the workspace: what the config says, else the machine; InputError for an unknown coordinate.

    ``given``: bounds of coordinates, or half widths about the home pose of a machine whose coordinates are a pose's.
    """
    names, units, scale = (
        [one.name for one in model.coordinates],
        Units(section.length, section.angle),
        model.pose_scale,
    )
    if isinstance(given, WorkspaceConfig):
        if tuple(names) != POSE:
            raise InputError(f"workspace: found half widths, expected bounds of {', '.join(names) or 'none'}")
        half = np.concatenate([given.position_mm, np.radians(given.rotation_deg)])
        if not half.any():
            raise InputError("workspace: found zero half widths, expected one above zero")
        return Workspace(model.home_pose - half, model.home_pose + half, scale, given.shape, given.poses)
    for name in given:
        if name not in names:
            raise InputError(say_unknown("workspace", name, names))
    bounds = []
    for one in model.coordinates:
        if one.name in given:
            bounds.append([units.factor(one.unit) * limit for limit in given[one.name]])
        elif one.reach > 0.0:
            bounds.append([one.home - one.reach, one.home + one.reach])
        else:
            raise InputError(f"workspace: found no {one.name}, expected its smallest and largest value")
    low, high = np.array(bounds).reshape(-1, 2).T
    return Workspace(low, high, scale)


def find_region(
    workspace: Workspace, given: WorkspaceConfig | Mapping[str, list[float]], model: ReadingModel, pose: Array
) -> Workspace | None:
    """Return where poses (P, q) were measured: accuracy counts there where no workspace is stated; else None.

    What the machine's file or class says of its reach holds for searches; accuracy there would be extrapolated.
    """
    found = pose[np.isfinite(pose).all(axis=1)]
    stated = np.array([one.name in given for one in model.coordinates], dtype=bool)
    if isinstance(given, WorkspaceConfig) or stated.all() or len(found) < 2:
        return None
    low, high = np.quantile(found, MEASURED_QUANTILES, axis=0)
    margin = MARGIN * (high - low)
    return replace(
        workspace,
        low=np.where(stated, workspace.low, low - margin),
        high=np.where(stated, workspace.high, high + margin),
    )


def check_given(given: Mapping[str, list[float]], model: ReadingModel) -> None:
    """Raise InputError where bounds are missing of what the machine has to know of each pose, or of something else."""
    for name in given:
        if name not in model.given:
            raise InputError(say_unknown("conditions", name, model.given))
    for name in model.given:
        if name not in given:
            raise InputError(f"conditions: found no {name}, expected its smallest and largest value")


def draw_given(bounds: Mapping[str, list[float]], count: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return what is known of each of some poses, drawn between bounds and rounded as files have it."""
    return {name: round_as_written(rng.uniform(low, high, count)) for name, (low, high) in bounds.items()}


def draw_standing(
    model: ReadingModel,
    workspace: Workspace,
    theta: Array,
    given: Given,
    count: int,
    rng: np.random.Generator,
    in_range: bool,
) -> tuple[Array, Array]:
    """Return poses (P, q) of the workspace at which a machine (D,) stands, and its readings there (P, K).

    With ``in_range`` commanded channels keep to their ranges, too. InputError where there are few such poses.
    """
    pose, exact = np.empty((count, len(workspace.low))), np.empty((count, len(model.channels)))
    rows = np.arange(count)
    for tried in range(MOST_TRIES):  # one at a time, and many where the ranges leave little of the workspace
        from_rows = np.repeat(rows, EACH if tried >= SINGLE else 1)
        some = round_as_written(workspace.draw(len(from_rows), rng))
        read = model.read(theta, some, {name: value[from_rows] for name, value in given.items()})
        found = np.isfinite(read).all(axis=1) & ~(in_range & model.find_beyond(read).any(axis=1))
        there, first = np.unique(from_rows[found], return_index=True)
        pose[there], exact[there] = some[found][first], read[found][first]
        if not len(rows := np.setdiff1d(rows, there)):
            return pose, exact
    raise InputError("workspace: found few poses in reach, expected a smaller one")


def lead_to_contact(
    model: ReadingModel,
    workspace: Workspace,
    theta: Array,
    given: Given,
    pose: Array,
    error: Array,
    rng: np.random.Generator,
) -> tuple[Array, np.ndarray]:
    """Return poses (P, q) at which the instruments that touch do so, and which channels are read there, bool (P, K).

    They begin at some of the workspace, and at others where no way leads from there to a contact within the workspace.
    ``error`` (P, K) are errors of the readings. InputError where few poses touch.
    """
    read, pose, slack = share_contacts(model, len(pose)), pose.copy(), EDGE * workspace.half
    rows = from_rows = np.arange(len(pose))
    start = pose
    for _ in range(ROUNDS):
        some = {name: value[from_rows] for name, value in given.items()}
        with np.errstate(all="ignore"):
            led, found = touch(model, theta, start, read[from_rows], error[from_rows], some)
            found &= ((led >= workspace.low - slack) & (led <= workspace.high + slack)).all(axis=1)
            exact = model.read(theta, led, some)
            found &= np.isfinite(exact).all(axis=1) & ~model.find_beyond(exact).any(axis=1)
        there, first = np.unique(from_rows[found], return_index=True)
        pose[there] = led[found][first]
        if not len(rows := np.setdiff1d(rows, there)):
            return pose, read
        if not found.any() and len(found) >= HOPELESS:
            break
        from_rows = np.repeat(rows, EACH)
        start = workspace.draw(len(from_rows), rng)
    name = model.contacts[rows[0] % len(model.contacts)]
    raise InputError(f"instruments.{name}: found few poses of the workspace that touch it, expected it within reach")


def find_starts(posterior: CalibrationPosterior, workspace: Workspace, seed: int) -> Array:
    """Return the poses (P, q) at which the machine as expected explains the readings best, from any start.

    Raises
    ------
    InputError
        For a pose whose readings do not tell where the machine stands: too few, or of sensors that cannot.
    """
    pose = search_starts(posterior, workspace, seed)
    check_told(posterior, pose, workspace)
    return pose


def search_starts(posterior: CalibrationPosterior, workspace: Workspace, seed: int) -> Array:
    """Return the same, whether readings tell where the machine stands or not."""
    likelihood = posterior.likelihood
    starts, n = workspace.starts(seed), likelihood.data.n_poses
    theta = posterior.theta(posterior.begin)
    white = likelihood.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(posterior.begin[None])))

    def search(rows: np.ndarray, some: Array) -> tuple[Array, Array]:
        """Return the best poses of some rows from some starts (S, q), or (1, P, q), and what they leave, r²."""
        from_all = some if some.ndim > 2 else np.repeat(some[:, None], len(rows), axis=1)
        with np.errstate(all="ignore"):
            found, square = search_poses(likelihood.pick(rows), theta, white.at_poses(rows), from_all)
        square = np.where(np.isnan(square), np.inf, square)
        best = square.argmin(axis=0)
        return found[best, np.arange(len(rows))], square[best, np.arange(len(rows))]

    every = np.arange(n)
    pose = np.repeat(starts[:1], n, axis=0)
    if not pose.shape[-1]:
        left = every[:0]
    elif _reads_coordinates(likelihood, theta):
        return np.asarray(search(every, _locate_rows(posterior, theta, starts[0]))[0])
    elif n <= 2 * TRIED:
        left = every
    else:
        tried = np.sort(np.random.default_rng([seed, 5]).choice(n, TRIED, replace=False))
        _, least = search(tried, starts)
        pose, square = search(every, _locate_rows(posterior, theta, starts[0]))
        usual = bool((square[tried] <= SAME_RATIO * least + SAME_RATIO - 1.0).all())
        left = every[square > FAR * least.max()] if usual else every
    if len(left):
        pose[left], _ = search(left, starts)
    return np.asarray(pose)


def _reads_coordinates(likelihood: PoseElimination, theta: Array) -> bool:
    """Return whether each row has commanded channels that are the coordinates but for scale: one pose has them alone.

    So are those of a machine (D,) whose slopes are everywhere the same.
    """
    model, data = likelihood.model, likelihood.data
    commanded = model.select(model.commanded)
    if len(commanded) != len(model.coordinates) or not data.present[:, commanded].all():
        return False
    _, pose, given = draw_points(model)
    slope = model.linearise(theta, pose, False, given).by_pose[:, commanded]
    same = np.abs(slope - slope[:1]) <= STRAIGHT * np.abs(slope[:1]).max()
    return bool(same.all() and np.linalg.matrix_rank(slope[0]) == len(commanded))


def _locate_rows(posterior: CalibrationPosterior, theta: Array, home: Array) -> Array:
    """Return where a machine (D,) stands by what its commanded channels read, (1, P, q); at home where it does not."""
    data, model = posterior.likelihood.data, posterior.likelihood.model
    commands = data.values[:, model.select(model.commanded)] if model.commanded else np.empty((data.n_poses, 0))
    pose = np.broadcast_to(home, (data.n_poses, len(home))).copy()
    if commands.shape[1] < len(home):
        return pose[None]
    there = np.flatnonzero(data.present[:, model.select(model.commanded)].all(axis=1))
    found, good = model.locate(theta, commands[there], {name: one[there] for name, one in data.given.items()})
    pose[there[good]] = found[good]
    return pose[None]


def check_told(posterior: CalibrationPosterior, pose: Array, workspace: Workspace) -> None:
    """Raise InputError for poses (P, q) whose readings do not tell where the machine stands."""
    likelihood, q = posterior.likelihood, pose.shape[1]
    for k in np.flatnonzero(likelihood.n_readings < q)[:1]:
        raise InputError(
            f"pose {likelihood.data.poses[k]!r}: found {likelihood.n_readings[k]} readings, expected "
            f"at least {q}; omit coordinates that no reading depends on"
        )
    if not q:
        return
    white = likelihood.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(posterior.begin[None])))
    error, slope, _ = likelihood.linearise(posterior.theta(posterior.begin[None]), pose[None], white)
    somewhere = np.flatnonzero(np.isfinite(error[0]).all(axis=1) & np.isfinite(slope[0]).all(axis=(1, 2)))
    values = np.linalg.svd(slope[0, somewhere] * workspace.half, compute_uv=False)
    for k in somewhere[values[:, -1] <= SINGULAR * values[:, 0]][:1]:
        raise InputError(
            f"pose {likelihood.data.poses[k]!r}: found readings that do not determine {q} "
            "coordinates; omit coordinates that no reading depends on"
        )
