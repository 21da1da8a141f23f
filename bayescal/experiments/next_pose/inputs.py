"""From the config to what is computed with: the variants, the workspace and the poses that may be measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.calibrated.tables import list_columns, read_given, read_named, read_quantities
from bayescal.data.actuators import read_moves
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.errors import InputError, say_reversed, say_unknown
from bayescal.experiments.next_pose.schema import NextCandidatesConfig, NextPoseConfig
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.memory import check_arrays
from bayescal.experiments.shared.design import read_workspace
from bayescal.experiments.shared.measured import MeasuredReadings, measure_variants
from bayescal.experiments.shared.readings.workspace import Workspace, lead_to_contact
from bayescal.experiments.shared.requirements import is_aligned, name_required_units, read_requirements
from bayescal.experiments.shared.schema import WorkspaceConfig
from bayescal.experiments.shared.search_memory import list_readings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.identifiability.pose_volume import PoseVolume, find_workspace_actuators
from bayescal.identifiability.reading_rows import differentiate_poses, typical_given
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.readings import Channel, Coordinate, Given, Legs, ReadingModel
from bayescal.machines.readings.newton import share_contacts, touch
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.units import Units
from bayescal.pose_selection import (
    ActuatorBox,
    Candidates,
    Design,
    WorkspaceBox,
    candidates_at,
    candidates_at_actuators,
    factorial_candidates,
)
from bayescal.pose_selection.next_pose import find_unmeasured

CANDIDATES, WORKSPACE = 31, 32  # of the seeds
N_WORKSPACE = 200
SEEN, PLACED = 6, 4
"""Arrays of all candidates by legs and parameters where they are placed and seen, and of their poses."""
TRIES = 20
"""Times so many poses are drawn to find those at which a machine can be."""
DRAWS, SEARCHED = 8, 6
"""Arrays of all draws, and of all candidates and poses of the workspace by channels and parameters."""
APART = 0.02  # of the half widths of workspace or commands: closer to a measured pose, it would be the same again
MOST_ERRORS = 2_000_000  # draws times poses of the workspace: their errors are kept
DECIMALS = {"mm": 3, "deg": 4}
EXPECTED = "Own sensors, expected"


@dataclass(frozen=True, eq=False)
class NextPoseInputs:
    """What was measured so far, and what may come."""

    config: NextPoseConfig
    origin: str  # of the data, in words
    subjects: dict[str, MeasuredVariant]  # variants that may be right, with the poses measured so far
    n_candidates: int
    units: dict[str, str]  # of each requirement, as the config states it
    slip: FoundSlip | None  # what would explain the data many times better than they are

    @property
    def requirements(self) -> list[Requirement]:
        """What is required."""
        return next(iter(self.subjects.values())).requirements


def read_next_pose(config: NextPoseConfig, folder: Path) -> NextPoseInputs:
    """Return what was measured so far, read and checked.

    InputError where the file calibrates no machine, a variant is not there, the workspace is out of reach or no
    candidate is left.
    """
    path = folder / config.study
    found = measure_variants(*load(path), path, config.variants, config.with_model_error)
    if config.goal == "variants" and len(found) < 2:
        raise InputError(f"{path}: expected --require NAME=VALUE, [requirements], or two variants")
    first = next(iter(found.values()))
    touching = first.posterior.likelihood.model.contacts
    if touching and (config.goal == "variants" or first.posterior.likelihood.model.legs is not None):
        raise InputError(f"{path}: found {', '.join(touching)} to touch, expected instruments that read at any pose")
    there = first.posterior.likelihood.data.n_poses
    n = there if config.n_first_poses is None else config.n_first_poses
    if n > there:
        raise InputError(f"n_first_poses: found {n}, expected at most {there}")
    legs = first.posterior.likelihood.model.legs
    if legs is None:
        _check_same_readings(found)
        _check_redundant(first)
        low, high = _read_bounds(config, first)
        found = {name: replace(one, low=low, high=high) for name, one in found.items()}
    if config.accuracy_frame is not None:
        frame = config.accuracy_frame
        found = {
            name: replace(one, aligned=is_aligned(frame, one.posterior.likelihood.model, one.posterior.priors))
            for name, one in found.items()
        }
    so_far = {name: one if n == there else one.pick(np.arange(n)) for name, one in found.items()}
    first = next(iter(so_far.values()))
    if legs is None:
        pose = _draw_poses(first, N_WORKSPACE, np.random.default_rng([config.seed, WORKSPACE]))
        workspace = Poses(pose, typical_given(first.posterior.likelihood.data.given, len(pose)))
        rng = np.random.default_rng([config.seed, CANDIDATES])
        candidates = Poses(*_list_candidates(config.candidates, folder, first, rng))
        if touching:
            candidates = _lead_to_contact(candidates, first, rng)
    else:
        workspace, candidates = _place_legs(config, folder, first, legs)
    model = first.posterior.likelihood.model
    requirements = list(read_requirements(config.requirements, model, config.units))
    units = name_required_units(config.requirements, model, config.units)
    if requirements and legs is None:
        _check_located(first, workspace.values)
    subjects = {name: MeasuredVariant(one, requirements, workspace, candidates) for name, one in so_far.items()}
    origin = first.origin.partition(": study ")[0]
    return NextPoseInputs(
        config,
        origin,
        subjects,
        len(candidates.values),
        units,
        find_slip((one.readings for one in found.values()), first.denied),
    )


# --- machines on legs ----------------------------------------------------------------------------------------------


def _place_legs(config: NextPoseConfig, folder: Path, measured: MeasuredReadings, legs: Legs) -> tuple[Poses, Poses]:
    """Return the poses of workspace and candidates of a study's machine, by its actuators."""
    section, posterior = config.workspace, measured.posterior
    if isinstance(section, dict):
        raise InputError(f"workspace: found {', '.join(section)}, expected position_mm and rotation_deg for legs")
    priors = {name: one for name, one in posterior.priors.items() if name in legs.machine.layout.names}
    mechanism, nominal = legs.machine.mechanism, legs.layout.nominal
    fixed = {name: one for name, one in posterior.fixed.items() if name in legs.machine.layout.names}
    machine = replace(legs.machine, mechanism=replace(mechanism, actuator_gains=None))  # by true travel
    design, volume = Design(machine, priors, fixed), read_workspace(section)
    candidates = read_candidates(config, folder, design, volume).placed.actuators
    if mechanism.n_legs != DEGREES_OF_FREEDOM or config.candidates.half is not None:  # by where the platform stands
        candidates = legs.read_actuators(nominal, candidates)
    workspace = candidates
    if volume is not None:
        standing = find_workspace_actuators(machine, design.theta, volume, volume.n_poses, config.seed)
        workspace = legs.read_actuators(nominal, standing)
    return Poses(workspace, {}, commanded=True), Poses(candidates, {}, commanded=True)


def _check_candidates(n: int, design: Design) -> None:
    """Raise InputError where there is no memory to place so many candidates."""
    n_legs, size = design.machine.mechanism.n_legs, design.machine.layout.size
    held = [(SEEN, n, n_legs, size + n_legs), (PLACED, n, DEGREES_OF_FREEDOM, size)]
    check_arrays({"candidates": n}, held, "fewer candidates")


def read_candidates(config: NextPoseConfig, folder: Path, design: Design, volume: PoseVolume | None) -> Candidates:
    """Return the poses that may be measured."""
    section, mechanism = config.candidates, design.machine.mechanism
    rng = np.random.default_rng([config.seed, CANDIDATES])
    if section.configurations is None:
        _check_candidates(section.count, design)
    redundant, half = mechanism.n_legs != DEGREES_OF_FREEDOM, section.half
    if redundant and half is None:
        half = None if volume is None else volume.half
        if half is None or section.configurations is not None or section.range_mm is not None:
            raise InputError(
                f"candidates: found {mechanism.n_legs} legs, expected position_mm and rotation_deg, "
                "or [workspace] alone"
            )
    if half is not None:
        return factorial_candidates(WorkspaceBox(design, half), section.count, rng)
    domain = ActuatorBox(design)
    if section.configurations is not None:
        moves = read_moves(folder / section.configurations, section.unit_mm, mechanism.n_legs)
        _check_candidates(len(moves), design)
        return candidates_at_actuators(domain, mechanism.initial_actuator_positions + moves)
    reach = mechanism.actuator_range if section.range_mm is None else section.range_mm
    if reach > mechanism.actuator_range:
        raise InputError(f"candidates.range_mm: found {reach:g}, expected at most {mechanism.actuator_range:g}")
    whole = factorial_candidates(domain, section.count, rng)
    return candidates_at(domain, whole.shares * reach / mechanism.actuator_range)


# --- machines of any readings --------------------------------------------------------------------------------------


def _check_same_readings(found: Mapping[str, MeasuredReadings]) -> None:
    """Raise InputError where variants have other readings, so that their evidences do not compare."""
    (name, first), *others = found.items()
    data = first.posterior.likelihood.data
    for other, one in others:
        theirs = one.posterior.likelihood
        same = theirs.model.names == first.posterior.likelihood.model.names and theirs.data.poses == data.poses
        if not same or not np.array_equal(theirs.data.present, data.present):
            raise InputError(
                f"variants: found different readings in {other!r} and {name!r}, expected the same; "
                "choose variants = [...]"
            )


def _check_redundant(measured: MeasuredReadings) -> None:
    """Raise InputError where no pose says anything of the parameters, or the machine alone nothing of its tool."""
    likelihood = measured.posterior.likelihood
    read, q = likelihood.data.present.any(axis=0), len(likelihood.model.coordinates)
    if read.sum() <= q:
        raise InputError(f"variants: found {read.sum()} channels for {q} pose coordinates, expected more")


def _check_located(measured: MeasuredReadings, workspace: Array) -> None:
    """Raise InputError where the machine's own channels do not determine its pose: its error then has no bound."""
    posterior = measured.posterior
    given = typical_given(posterior.likelihood.data.given, len(workspace))
    seen = differentiate_poses(posterior, measured.half, posterior.begin, workspace, given).select_channels(
        measured.internal
    )
    lost = ~np.isfinite(seen.tool).all(axis=(1, 2))
    if lost.any():
        names = posterior.likelihood.model.names
        own = ", ".join(name for name, internal in zip(names, measured.internal, strict=True) if internal)
        raise InputError(
            f"requirements: found own sensors ({own or 'none'}) that do not determine {lost.sum()} of "
            f"{len(lost)} workspace poses, expected more sensors"
        )


def _read_bounds(config: NextPoseConfig, measured: MeasuredReadings) -> tuple[Array, Array]:
    """Return smallest and largest coordinates, (q,) each: the section's, otherwise those of the calibration."""
    section, units = config.workspace, Units(config.units.length, config.units.angle)
    low, high = measured.low.copy(), measured.high.copy()
    coordinates = measured.posterior.likelihood.model.coordinates
    names = [one.name for one in coordinates]
    if isinstance(section, WorkspaceConfig):
        raise InputError(
            f"workspace: found position_mm without a hexapod, expected bounds of {', '.join(names)}, "
            f"such as {names[0]} = [-1.0, 1.0]"
        )
    for name, bounds in (section or {}).items():
        if name not in names:
            raise InputError(say_unknown("workspace", name, names))
        k = names.index(name)
        if not bounds[0] < bounds[1]:
            raise InputError(say_reversed(f"workspace.{name}", bounds[0], bounds[1]))
        low[k], high[k] = (units.factor(coordinates[k].unit) * one for one in bounds)
    return low, high


def _draw_poses(measured: MeasuredReadings, n: int, rng: np.random.Generator) -> Array:
    """Return n random poses of the workspace that the machine as expected can take, (n, q)."""
    posterior = measured.posterior
    model, found = posterior.likelihood.model, np.empty((0, len(measured.low)))
    for _ in range(TRIES):
        pose = rng.uniform(measured.low, measured.high, (n, len(measured.low)))
        read = model.read(posterior.first_machine, pose, typical_given(posterior.likelihood.data.given, n))
        found = np.concatenate([found, pose[np.isfinite(read).all(axis=-1)]])
        if len(found) >= n:
            return found[:n]
    raise InputError("workspace: found few poses in reach, expected a smaller one")


def _list_candidates(
    section: NextCandidatesConfig, folder: Path, measured: MeasuredReadings, rng: np.random.Generator
) -> tuple[Array, Given]:
    """Return the poses that may be measured, (C, q), and what is known of each: a table, or random ones."""
    likelihood = measured.posterior.likelihood
    for name in ("unit_mm", "range_mm", "position_mm", "rotation_deg"):
        if name in section.model_fields_set:
            raise InputError(f"candidates.{name}: found without legs, expected count or configurations")
    if section.configurations is not None:
        model = likelihood.model
        expected = [*(f"{one.name}_{one.unit}" for one in model.coordinates), *model.given]
        known = [*list_columns(model.coordinates), *model.given]
        table, _ = read_named(folder / section.configurations, known, expected)
        return read_quantities(table, model.coordinates), read_given(table, model.given)
    pose = _draw_poses(measured, section.count, rng)
    return pose, typical_given(likelihood.data.given, len(pose))


def _lead_to_contact(candidates: Poses, measured: MeasuredReadings, rng: np.random.Generator) -> Poses:
    """Return candidates at which instruments touch, one in each in turn."""
    posterior = measured.posterior
    model, n = posterior.likelihood.model, len(candidates.values)
    workspace = Workspace(measured.low, measured.high, measured.half)
    theta, nothing = posterior.theta(posterior.begin[None])[0], np.zeros((n, len(model.channels)))
    pose, _ = lead_to_contact(model, workspace, theta, candidates.given, candidates.values, nothing, rng)
    return replace(candidates, values=pose, touching=tuple(model.contacts[k % len(model.contacts)] for k in range(n)))


@dataclass(frozen=True)
class PoseColumn:
    """A column of the poses to come, as the page shows it."""

    column: str
    heading: str
    unit: str
    group: str
    decimals: int


@dataclass(frozen=True, eq=False)
class Poses:
    """C poses of a machine: coordinates, or commands where it is commanded, and what it has to know of each (C,)."""

    values: Array  # (C, q) or (C, N), mm and rad
    given: Given
    commanded: bool = False
    touching: tuple[str, ...] = ()  # the instrument that touches at each; none where all channels are read

    def split(self, model: ReadingModel) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield places of poses at which the same channels are read, and these as a mask (K,)."""
        if not self.touching:
            yield np.arange(len(self.values)), np.ones(len(model.channels), dtype=bool)
        for k, name in enumerate(model.contacts if self.touching else ()):
            yield np.flatnonzero(np.array(self.touching) == name), share_contacts(model, k + 1)[k]

    def place(self, model: ReadingModel, theta: Array) -> Array:
        """Return coordinates (C, q) of a machine (D,); NaN where it has no such pose."""
        if self.touching:
            read = share_contacts(model, len(self.values))
            pose, found = touch(model, theta, self.values, read, np.zeros(read.shape), self.given)
            return np.where(found[:, None], pose, np.nan)
        return model.locate(theta, self.values, self.given)[0] if self.commanded else self.values


@dataclass(frozen=True, eq=False)
class MeasuredVariant:
    """One variant of a machine with the poses measured so far, and those that may be measured."""

    measured: MeasuredReadings
    requirements: list[Requirement]
    workspace: Poses
    candidates: Poses

    @property
    def posterior(self) -> CalibrationPosterior:
        """Of the readings so far."""
        return self.measured.with_pose_guesses

    @property
    def model(self) -> ReadingModel:
        """What the machine reads."""
        return self.measured.posterior.likelihood.model

    @property
    def n_poses(self) -> int:
        """How many poses have been measured."""
        return self.measured.posterior.likelihood.data.n_poses

    @cached_property
    def allowed(self) -> np.ndarray:
        """Which candidates have not been measured, shape (C,)."""
        reach, measured = self.measured.half, self.posterior.likelihood.start
        if self.candidates.commanded:
            reach = 0.5 * np.ptp(self.model.command_range, axis=1)
            measured = self.posterior.likelihood.data.values[:, self.model.select(self.model.commanded)]
        return find_unmeasured(self.candidates.values, measured, APART * reach)

    def first(self, n: int) -> MeasuredVariant:
        """Return the same after the first n of its poses."""
        return replace(self, measured=self.measured.pick(np.arange(n)))

    def list_arrays(self, n_draws: int) -> list[Sequence[float]]:
        """Return what it holds of candidates, workspace and so many draws; see `estimate_arrays`."""
        n, n_channels = self.posterior.n_parameters, len(self.model.channels)
        width = n_channels * (self.model.layout.size + len(self.model.coordinates) + n_channels)
        return [
            *list_readings(self.n_poses, n_channels, n, len(self.model.coordinates)),
            (SEARCHED, len(self.candidates.values) + len(self.workspace.values), width),
            (DRAWS, n_draws, n + n_channels),
        ]

    def list_shown(self) -> list[PoseColumn]:
        """Return what the page shows of the poses to come: how to go there, and what is expected there."""
        channels = [one for one, own in zip(self.model.channels, self.measured.internal, strict=True) if own]
        commands = self.model.commanded if self.candidates.commanded else ()
        found = []
        for one in channels:
            if one.name in commands:
                number = one.name.partition("[")[2].rstrip("]")
                found.append(_show(one, f"displacement_{number}", number, "Displacement of actuator"))
        group = "Platform, expected" if commands else "Pose"
        found += [_show(one, one.name, one.name, group) for one in self.model.coordinates]
        return found + [_show(one, one.name.replace("[", "_").rstrip("]"), one.name, EXPECTED) for one in channels]


def _show(one: Coordinate | Channel, stem: str, heading: str, group: str) -> PoseColumn:
    unit = "deg" if one.unit == "rad" else one.unit
    return PoseColumn(f"{stem}_{unit}", heading, unit, group, DECIMALS.get(unit, 4))
