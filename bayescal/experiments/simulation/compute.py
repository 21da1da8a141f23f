"""Readings of any machine, and what an instrument sees of a platform on legs, with the truth beside them.

The twin of the telescope is reconstructed from RR-8096's tables: nobody measured it. Its true kinematics is that of a
model with offsets from nominal and a deformation matrix K; the targets on the leg pads follow K alone. An offset of κ
acts in the kinematics only: by eqs. (39) and (40) it is an error of the actuator's gain, which poses cannot tell from a
deformation and which leaves the ring as it is. So targets give back K, and a calibration K plus the offset.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.config.classes import name_failures
from bayescal.config.load import look_up, read_toml
from bayescal.data.actuators import name_actuators, read_moves
from bayescal.data.instruments.read_points import (
    POLAR,
    PointNoise,
    Stations,
    convert_polar,
    read_probe,
    read_stations,
    spread_polar,
)
from bayescal.data.instruments.read_poses import VALUES
from bayescal.data.photogrammetry.survey import BODIES, REFERENCE_COLUMNS, TARGET_COLUMNS, BodyTargets, Survey
from bayescal.data.truth import (
    PARAMETERS_FILE,
    POSES_FILE,
    format_true_parameters,
    format_true_poses,
    list_true_symbols,
    read_true_parameters,
    round_as_written,
)
from bayescal.density.priors import Prior
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.shared.readings.instruments import read_instruments
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import check_optional, choose_priors, spread_over_legs
from bayescal.experiments.shared.readings.workspace import (
    Workspace,
    build_workspace,
    check_given,
    draw_given,
    draw_standing,
    lead_to_contact,
)
from bayescal.experiments.shared.rows import USES
from bayescal.experiments.simulation.schema import (
    FrameTruthConfig,
    MeasurementFrameConfig,
    PlatformInstrumentConfig,
    PointInstrumentConfig,
    PoseInstrumentConfig,
    SimulationConfig,
    TargetsConfig,
)
from bayescal.files.csv_tables import format_table, read_matrix
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.kinematics import ForwardKinematics, Machine, check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import build_chosen_machine, choose_model, load_mechanism, points_of, read_reading_model
from bayescal.machines.readings import Channel, InstrumentedMachine, Legs, ReadingModel, place
from bayescal.machines.readings.legs import TILTS
from bayescal.machines.readings.tracker import frame_blocks, move_frames
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from bayescal.numerics.units import ARCSECOND, MICROMETRE, MICRORADIAN, Units

DECIMALS = {"mm": 6, "rad": 9}
TARGET_DECIMALS = 6
POSE_COORDINATES = ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad")

type Placed = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class ReadingPlan:
    """A machine with the channels that are read, its priors, its workspace, and a truth if one is given."""

    config: SimulationConfig
    model: ReadingModel
    noise: Array
    priors: dict[str, Prior]
    fixed: dict[str, float]
    common: dict[str, tuple[str, ...]]
    workspace: Workspace
    truth: Array | None
    seen: SeenTool | SeenTargets | None = None  # by an instrument whose files have poses, points or targets

    @property
    def layout(self) -> ParameterLayout:
        """The true parameters', those of the instrument's frames among them."""
        return self.model.layout if self.seen is None else self.seen.extend(self.model.layout)

    @property
    def n_held_back(self) -> int:
        """How many poses are held back."""
        return self.config.n_verification_poses

    @property
    def n_poses(self) -> int:
        """Number of poses, those held back among them."""
        return (self.config.n_poses or 0) + self.n_held_back

    @property
    def width(self) -> int:
        """How many numbers are simulated of each."""
        return len(self.model.channels) + (0 if self.seen is None else self.seen.width)

    def simulate(self, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of all files by their names, and the true parameters (D,)."""
        config, model = self.config, self.model
        drawn = self._draw_machine(rng)  # in any case, so that a given truth leaves poses and noise as they are
        theta = round_as_written(drawn if self.truth is None else self.truth)
        given = draw_given(config.conditions, self.n_poses, rng)
        pose, exact = draw_standing(model, self.workspace, theta, given, self.n_poses, rng, in_range=True)
        error = self.noise * rng.standard_normal(exact.shape)
        if model.contacts:
            pose, read = lead_to_contact(model, self.workspace, theta, given, pose, error, rng)
            exact = np.where(read, model.read(theta, pose, given), np.nan)
        measured = exact + error
        n_calibration = self.n_poses - self.n_held_back
        names = [f"C{k:03d}" for k in range(1, n_calibration + 1)]
        names += [f"V{k:02d}" for k in range(1, self.n_held_back + 1)]
        uses = [USES[k >= n_calibration] for k in range(len(names))]
        coordinates = [f"{one.name}_{one.unit}" for one in model.coordinates]
        origin = config.provenance.text
        truth = {
            PARAMETERS_FILE: format_true_parameters([origin, "True parameters."], model.layout, theta),
            POSES_FILE: format_true_poses([origin, "True poses."], coordinates, names, pose),
        }
        if self.seen is None:
            return {
                "readings.csv": _format_readings(origin, model.channels, names, uses, measured, given)
            } | truth, theta
        own = model.select(model.commanded)
        commands = [model.channels[k] for k in own]
        files = {"actuators.csv": _format_readings(origin, commands, names, uses, measured[:, own], given)}
        if len(own) < len(model.channels):
            files["readings.csv"] = _format_readings(origin, model.channels, names, uses, measured, given)
        tool = InstrumentedMachine(model, ()).place_tool(theta, pose)
        standing = tool[:, :3], matrix_from_rotation_vector(tool[:, 3:])
        files |= self.seen.format(tuple(names), *standing, origin, rng)
        return files | truth, np.concatenate([theta, self.seen.frames.ravel()])

    def _draw_machine(self, rng: np.random.Generator) -> Array:
        """Return a machine within its priors, (D,)."""
        layout = self.model.layout
        theta = layout.nominal.copy()
        for name, value in self.fixed.items():
            theta[layout.names.index(name)] = value
        for name, prior in self.priors.items():
            drawn = float(prior.draw(1, rng)[0])
            places = [layout.names.index(one) for one in self.common.get(name, (name,))]
            theta[places] += drawn - theta[places[0]]
        layout.check(theta)
        return theta


@dataclass(frozen=True, eq=False)
class SeenTool:
    """An instrument that sees the tool of any machine, a pose or points of a probe on it, in frames of its own."""

    config: PlatformInstrumentConfig
    folder: Path
    frames: Array  # (S + 1, 6): true ones of stations and probe, mm and rad
    width = DEGREES_OF_FREEDOM

    def extend(self, layout: ParameterLayout) -> ParameterLayout:
        """Return a machine's parameters with those of the frames."""
        return layout.extend(frame_blocks(len(self.frames) - 1))

    def measure_twin(self, twin: Twin, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of the tables of a twin by their names, and its true poses (P, 6), mm and rad."""
        commanded, _, found = move(twin, rng, twin.theta)
        origin = twin.config.provenance.text
        files = {"actuators.csv": format_actuators(twin.names, twin.held_back, commanded, origin)}
        return files | self.format(twin.names, found.position, found.rotation, origin, rng), stack_poses(found)

    def format(
        self, names: tuple[str, ...], position: Array, rotation: Array, origin: str, rng: np.random.Generator
    ) -> dict[str, str]:
        """Return the text of its table by the file's name, of a tool at (P, 3), mm, turned by (P, 3, 3)."""
        config = self.config
        pairs = np.concatenate([self.frames[:-1], np.broadcast_to(self.frames[-1:], self.frames[:-1].shape)], axis=1)
        seen = move_frames(pairs, position[None], rotation[None])
        if config.kind == "points":
            return {"points.csv": _format_points(names, seen, config, self.folder, origin, rng)}
        return {"poses.csv": _format_poses(names, (seen[0][0], seen[1][0]), config, origin, rng)}


@dataclass(frozen=True, eq=False)
class SeenTargets:
    """Cameras that see targets on base and tool of any machine, in a frame that wanders from pose to pose."""

    base: BodyTargets  # not yet measured
    platform: BodyTargets
    frame: MeasurementFrameConfig
    noise: float  # of a target's coordinates, mm
    frames = np.zeros((0, DEGREES_OF_FREEDOM))  # that a calibration has to find: none

    @property
    def width(self) -> int:
        """How many numbers are seen of each pose."""
        return 3 * (len(self.base.names) + len(self.platform.names))

    def extend(self, layout: ParameterLayout) -> ParameterLayout:
        """Return a machine's parameters: cameras add none."""
        return layout

    def measure(
        self, position: Array, rotation: Array, rng: np.random.Generator, lifted: Array | None = None
    ) -> tuple[BodyTargets, BodyTargets]:
        """Return the targets as measured on a tool at (P, 3), mm, turned by (P, 3, 3).

        ``lifted`` (P, N) is by how much the pads of N legs stand higher, mm; targets of pads are there with it.
        """
        moved = np.broadcast_to(self.platform.reference, (len(position), *self.platform.reference.shape)).copy()
        if lifted is not None:
            pads = self.platform.leg > 0
            moved[:, pads, 2] += lifted[:, self.platform.leg[pads] - 1]
        on_platform = position[:, None] + moved @ np.swapaxes(rotation, -1, -2)
        on_base = np.broadcast_to(self.base.reference, (len(position), *self.base.reference.shape))
        angle = np.radians(self.frame.angle_deg) * rng.uniform(-1, 1, (len(position), 3)) / np.sqrt(3)
        turned, origin = matrix_from_rotation_vector(angle), self.frame.distance_mm * rng.uniform(-1, 1, angle.shape)
        measured = []
        for body, points in ((self.base, on_base), (self.platform, on_platform)):
            seen = origin[:, None] + points @ np.swapaxes(turned, -1, -2)
            measured.append(replace(body, measured=seen + rng.normal(0.0, self.noise, seen.shape)))
        return measured[0], measured[1]

    def survey(self, twin: Twin, rng: np.random.Generator, theta: Array | None = None) -> tuple[Survey, Array]:
        """Return one survey of a twin, or of other true parameters (D,), with noise and measurement frames of its own.

        And where the platform truly stood, (P, 6), the actuators' noise included: position in mm and rotation vector in
        rad, base frame.
        """
        mechanism = twin.mechanism
        commanded, actual, pose = move(twin, rng, twin.theta if theta is None else theta)
        ring = twin.machine.deformation.coupling(mechanism.n_legs)  # which the pads follow; offsets of κ are not in it
        lifted = (actual - mechanism.initial_actuator_positions) @ ring.T
        base, platform = self.measure(pose.position, pose.rotation, rng, lifted)
        return Survey(twin.names, twin.held_back, commanded, base, platform), stack_poses(pose)

    def measure_twin(self, twin: Twin, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of the tables of a twin by their names, and its true poses; see `survey`."""
        survey, poses = self.survey(twin, rng)
        return format_survey(survey, twin.config.provenance.text), poses

    def format(
        self, names: tuple[str, ...], position: Array, rotation: Array, origin: str, rng: np.random.Generator
    ) -> dict[str, str]:
        """Return the texts of its tables by their files' names, of a tool at (P, 3), mm, turned by (P, 3, 3)."""
        return _format_targets(names, self.measure(position, rotation, rng), origin)


def _place_targets(config: SimulationConfig, mechanism: Mechanism | None) -> SeenTargets:
    """Return the targets of a config, those on pads of a mechanism's legs among them."""
    assert config.targets is not None
    assert config.measurement_frame is not None
    assert config.noise is not None
    assert config.noise.target_um is not None
    base, platform = make_targets(config.targets, mechanism)
    return SeenTargets(base, platform, config.measurement_frame, config.noise.target_um * MICROMETRE)


def _read_instrument(config: SimulationConfig, model: ReadingModel, folder: Path) -> SeenTool | SeenTargets | None:
    """Return the instrument that sees the tool; InputError where the machine does not say where that is, or turned."""
    targets, instrument = config.targets, config.instrument
    if targets is None and instrument is None:
        return None
    which = "targets" if targets is not None else "instrument"
    if not model.commanded:
        raise InputError(f"sensors: found no commanded channel, expected some with [{which}]")
    if not model.places_tool:
        raise InputError("machine: found no tool position, expected tool_channels, up to three in mm")
    positions = instrument is not None and instrument.kind == "poses" and instrument.arcseconds is None
    if (targets is not None or not positions) and not InstrumentedMachine(model, ()).tells_rotation:
        raise InputError(
            f"{which}: found a machine that does not say how its tool is turned, expected [instrument] poses without "
            "orientation_arcsec"
        )
    if targets is not None:
        if targets.targets_per_pad:
            raise InputError(f"targets.targets_per_pad: found {targets.targets_per_pad}, expected 0 without [poses]")
        return _place_targets(config, None)
    assert instrument is not None
    return SeenTool(instrument, folder, _read_frames(instrument, folder))


def _format_readings(
    origin: str,
    channels: Sequence[Channel],
    names: Sequence[str],
    uses: Sequence[str],
    values: Array,
    given: Mapping[str, Array],
) -> str:
    """Return the text of a table of readings (P, K) of channels, and of what is given of each row."""
    columns = ["pose", "use", *(f"{one.stem}_{one.unit}" for one in channels), *given]
    decimals = [DECIMALS.get(one.unit, 9) for one in channels]
    rows = [
        (
            name,
            use,
            *("" if np.isnan(x) else f"{round(x, d) + 0.0:.{d}f}" for x, d in zip(row, decimals, strict=True)),
            *(f"{value[k]:.12g}" for value in given.values()),
        )
        for k, (name, use, row) in enumerate(zip(names, uses, values, strict=True))
    ]
    return format_table([origin, "Columns end with their unit."], columns, rows)


def plan_readings(config: SimulationConfig, folder: Path) -> ReadingPlan:
    """Return what is simulated; InputError for every fault of the config or its files."""
    whole = read_model(config, folder)
    check_given(config.conditions, whole)
    noise = noise_of_channels(config.sensors, whole)
    chosen = whole.select(config.sensors)
    priors, fixed, common = choose_priors(config, config, whole.layout)
    check_optional(whole.pick(chosen), [one for name in priors for one in common.get(name, (name,))])
    truth = read_truth(config, whole.layout, folder)
    workspace = build_workspace(whole, config.workspace, config.units)
    model = whole.pick(chosen)
    seen = _read_instrument(config, model, folder)
    return ReadingPlan(config, model, noise[chosen], priors, fixed, common, workspace, truth, seen)


def read_model(config: SimulationConfig, folder: Path) -> ReadingModel:
    """Return the machine before the config's instruments: any machine's file, or a mechanism's seen through ``model``.

    InputError for faults of the files, for a mechanism without a model, and for a model or matrix of another machine.
    """
    path, truth = folder / config.machine, config.truth
    matrix, named = None if truth is None else truth.deformation_matrix, set(config.parameters)
    if truth is not None:
        named |= {*(truth.offsets or {})}
        named |= set() if truth.parameters is None else list_true_symbols(folder / truth.parameters)
    if "kind" not in read_toml(path)[0]:
        legs = _read_mechanism(config, folder, matrix).with_optional(named)
        return place(legs, read_instruments(config.instruments, folder))
    for field, found in (("model", config.model), ("truth.deformation_matrix", matrix)):
        if found is not None:
            raise InputError(f"{field}: found {found!r}, expected none with this machine file")
    return place(read_reading_model(path).with_optional(named), read_instruments(config.instruments, folder))


def _read_mechanism(config: SimulationConfig, folder: Path, matrix: str | None) -> Legs:
    mechanism = load_mechanism(folder / config.machine)
    if config.model is None:
        raise InputError("model: missing, expected a kinematic model")
    n_legs = mechanism.n_legs
    bent = np.zeros((n_legs, n_legs)) if matrix is None else 1e-3 * read_matrix(folder / matrix, n_legs)
    chosen = choose_model(config.model, "model", folder)
    with name_failures(chosen.found, "model"):
        machine = build_chosen_machine(chosen, mechanism, MatrixDeformation(bent))
    return Legs(machine, inclined=any(name.partition("[")[0] in TILTS for name in config.sensors))


def read_truth(config: SimulationConfig, layout: ParameterLayout, folder: Path) -> Array | None:
    """Return the given true parameters (D,) with the digits that are written of them; None where none are given."""
    truth = config.truth
    if truth is None:
        return None
    if truth.parameters is not None:
        return round_as_written(read_true_parameters(folder / truth.parameters, layout))
    theta, units = layout.nominal.copy(), Units(config.units.length, config.units.angle)
    for symbol, offset in (truth.offsets or {}).items():
        index = look_up(layout.index, symbol, "truth.offsets")
        values = spread_over_legs(offset, len(index), symbol, "truth.offsets")
        theta[index] += units.factor(layout.block(symbol).unit) * np.array(values)
    layout.check(theta)
    return round_as_written(theta)


@dataclass(frozen=True, eq=False)
class Twin:
    """The machine behind simulated data, and where it is measured."""

    legs: Legs  # mechanism, model and matrix deformation
    theta: Array  # (D,), true parameters of the machine
    config: SimulationConfig
    folder: Path  # where the config's file names start
    calibration: Array  # (P, N), displacements of the actuators from their initial positions, mm
    verification: Array
    seen: SeenTool | SeenTargets

    @property
    def machine(self) -> Machine:
        """Mechanism, model and matrix deformation."""
        return self.legs.machine

    @property
    def mechanism(self) -> Mechanism:
        """The nominal geometry."""
        return self.machine.mechanism

    @property
    def layout(self) -> ParameterLayout:
        """All true parameters', those of the instrument's frames among them."""
        return self.seen.extend(self.legs.layout)

    @property
    def n_held_back(self) -> int:
        """How many poses are held back."""
        return len(self.verification)

    @property
    def n_poses(self) -> int:
        """Number of poses, those held back among them."""
        return len(self.calibration) + self.n_held_back

    @property
    def width(self) -> int:
        """How many coordinates of targets or of the platform, and actuators, are seen at each."""
        return self.mechanism.n_legs + self.seen.width

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all poses, those for verification last."""
        names = [f"C{k:02d}" for k in range(1, len(self.calibration) + 1)]
        return (*names, *(f"V{k:02d}" for k in range(1, self.n_held_back + 1)))

    @property
    def held_back(self) -> np.ndarray:
        """Which poses are for verification."""
        return np.arange(self.n_poses) >= len(self.calibration)

    def simulate(self, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of all files by their names, and all true parameters."""
        files, poses = self.seen.measure_twin(self, rng)
        return files | format_truth(self, poses), np.concatenate([self.theta, self.seen.frames.ravel()])


def build_twin(config: SimulationConfig, folder: Path) -> Twin:
    """Return the twin that a config describes; its files are relative to ``folder``.

    InputError for another machine than one on legs, unknown models or parameters, lists without one entry per leg or
    station, or tables of another width.
    """
    model = read_model(config, folder).legs
    if model is None:
        raise InputError(
            f"machine: found {config.machine!r} without legs, expected a mechanism for [targets] and [poses]; "
            "others take [sensors] and n_poses"
        )
    legs = Legs(model.machine, has_gains=model.has_gains)  # without inclinometers
    machine, poses, targets = model.machine, config.poses, config.targets
    assert poses is not None
    check_home_pose(machine)
    if targets is not None and targets.targets_per_pad and not machine.deformation.uses_matrix:
        raise InputError(
            f"targets.targets_per_pad: found {targets.targets_per_pad}, expected "
            "truth.deformation_matrix with a mechanism's file"
        )
    tables = (poses.calibration, poses.verification)
    calibration, verification = (read_moves(folder / name, poses.unit_mm, model.n_legs) for name in tables)
    theta = read_truth(config, legs.layout, folder)
    assert theta is not None
    seen = _read_instrument(config, legs, folder) if targets is None else _place_targets(config, legs.machine.mechanism)
    assert seen is not None
    return Twin(legs, theta, config, folder, calibration, verification, seen)


def _read_frames(config: PlatformInstrumentConfig, folder: Path) -> Array:
    """Return the true frames of each station and of the probe, shape (S + 1, 6), mm and rad."""
    n_stations = 1
    if config.kind == "points" and config.stations is not None:
        n_stations = len(read_stations(folder / config.stations).names)
    bases = config.frames.base or [FrameTruthConfig()] * n_stations
    if len(bases) != n_stations:
        raise InputError(f"instrument.frames.base: found {len(bases)} frames, expected {n_stations} (one per station)")
    return np.array([[*one.position_mm, *np.radians(one.rotation_deg)] for one in (*bases, config.frames.tool)])


def move(twin: Twin, rng: np.random.Generator, theta: Array) -> tuple[Array, Array, ForwardKinematics]:
    """Return what actuators are to read and where they stand, (P, N), mm, and the poses of a machine θ (D,) there."""
    assert twin.config.noise is not None
    assert twin.config.noise.actuator_um is not None
    displacement = np.concatenate([twin.calibration, twin.verification])
    commanded = twin.mechanism.initial_actuator_positions + displacement
    read = commanded + rng.normal(0.0, twin.config.noise.actuator_um * MICROMETRE, commanded.shape)
    found = twin.legs.solve(theta, read)
    for k in np.flatnonzero(~found.converged)[:1]:
        poses, n_calibration = twin.config.poses, len(twin.calibration)
        assert poses is not None
        file, row = (poses.calibration, k) if k < n_calibration else (poses.verification, k - n_calibration)
        raise NumericalError(
            f"{file}: row {row + 1}, pose {twin.names[k]!r}: found displacements "
            f"{', '.join(f'{move:g}' for move in displacement[k])} mm without a pose, expected "
            "smaller ones, in unit_mm, in leg order"
        )
    return commanded, twin.legs.place_actuators(theta, read), found


def stack_poses(found: ForwardKinematics) -> Array:
    """Return poses as position in mm and rotation vector in rad, base frame, shape (P, 6)."""
    return np.concatenate([found.position, rotation_vector_from_matrix(found.rotation)], axis=1)


def make_targets(config: TargetsConfig, mechanism: Mechanism | None) -> tuple[BodyTargets, BodyTargets]:
    """Return the targets of base and platform in their body frames, not yet measured; of pads for a mechanism."""
    nothing = np.empty((0, 0, 3))
    base, rigid = points_of(config.base), points_of(config.platform)
    pads, joints = list[Array](), np.zeros((0, 3)) if mechanism is None else mechanism.platform_points
    for joint in joints:
        azimuth = 2 * np.pi * np.arange(config.targets_per_pad) / config.targets_per_pad
        circle = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        pads.append(joint + (config.pad_radius_mm or 0.0) * circle)
    reference = np.round(np.concatenate([rigid, *pads]), TARGET_DECIMALS)
    leg = np.concatenate([np.zeros(len(rigid), int), np.repeat(np.arange(1, len(joints) + 1), config.targets_per_pad)])
    names = [f"P{k:02d}" for k in range(1, len(rigid) + 1)]
    names += [f"L{i}{k}" for i in range(1, len(joints) + 1) for k in range(1, config.targets_per_pad + 1)]
    return (
        BodyTargets(tuple(f"B{k:02d}" for k in range(1, len(base) + 1)), np.zeros(len(base), int), base, nothing),
        BodyTargets(tuple(names), leg, reference, nothing),
    )


def format_actuators(names: tuple[str, ...], verification: np.ndarray, actuators: Array, origin: str) -> str:
    """Return the text of a table of actuator positions (P, N), mm."""
    rows = [
        (pose, "verification" if held else "calibration", *(f"{x:.{TARGET_DECIMALS}f}" for x in position))
        for pose, held, position in zip(names, verification, actuators, strict=True)
    ]
    text = "Actuator positions rho in mm; displacements are counted from the initial positions of the mechanism."
    return format_table([origin, text], ("pose", "use", *name_actuators(actuators.shape[1])), rows)


def format_truth(twin: Twin, poses: Array) -> dict[str, str]:
    """Return the texts of two CSV files by their names: the twin's true parameters, and true poses (P, 6)."""
    origin = twin.config.provenance.text
    about_parameters = "True parameters of the machine that the survey is of."
    about_poses = "True poses of the platform frame in the base frame at the survey: position, rotation vector."
    return {
        PARAMETERS_FILE: format_true_parameters([origin, about_parameters], twin.legs.layout, twin.theta),
        POSES_FILE: format_true_poses([origin, about_poses], POSE_COORDINATES, twin.names, poses),
    }


def format_survey(survey: Survey, origin: str) -> dict[str, str]:
    """Return the texts of the three CSV files of a survey, by file name; units in every header."""
    actuators = format_actuators(survey.poses, survey.verification, survey.actuators, origin)
    return _format_targets(survey.poses, (survey.base, survey.platform), origin) | {"actuators.csv": actuators}


def _format_targets(poses: Sequence[str], measured: Sequence[BodyTargets], origin: str) -> dict[str, str]:
    """Return the texts of a table of targets and of one of where they sit on base and platform."""
    bodies = dict(zip(BODIES, measured, strict=True))
    rows = [
        (pose, body, name, *(f"{x:.{TARGET_DECIMALS}f}" for x in targets.measured[p, k]))
        for p, pose in enumerate(poses)
        for body, targets in bodies.items()
        for k, name in enumerate(targets.names)
        if np.isfinite(targets.measured[p, k, 0])
    ]
    reference = [
        (body, name, targets.leg[k], *(f"{x:.{TARGET_DECIMALS}f}" for x in targets.reference[k]))
        for body, targets in bodies.items()
        for k, name in enumerate(targets.names)
    ]
    return {
        "targets.csv": format_table(
            [origin, "Targets in the measurement frame, which differs from pose to pose; coordinates in mm."],
            TARGET_COLUMNS,
            rows,
        ),
        "target_reference.csv": format_table(
            [origin, ("Targets on their bodies, body frames, in mm; leg 0: rigid part, leg i: pad of leg i's joint.")],
            REFERENCE_COLUMNS,
            reference,
        ),
    }


def _format_poses(
    names: tuple[str, ...], seen: Placed, config: PoseInstrumentConfig, origin: str, rng: np.random.Generator
) -> str:
    n = len(names)
    position = seen[0] + rng.normal(0.0, config.position_um * MICROMETRE, (n, 3))
    columns, values = list(VALUES[:3]), position
    deviations = {f"sd_{axis}_um": config.position_um for axis in "xyz"}
    if config.arcseconds is not None:
        sd = config.arcseconds * ARCSECOND
        turned = matrix_from_rotation_vector(rng.normal(0.0, sd, (n, 3))) @ seen[1]
        columns += VALUES[3:]
        values = np.concatenate([position, np.degrees(rotation_vector_from_matrix(turned))], axis=1)
        deviations |= {f"sd_r{axis}_urad": round(sd / MICRORADIAN, 6) for axis in "xyz"}
    comments = [origin, ("Pose of the probe in the instrument's frame: position in mm, rotation vector in degrees.")]
    rows = [(name, *(f"{x:.8f}" for x in one), *deviations.values()) for name, one in zip(names, values, strict=True)]
    return format_table(comments, ["pose", *columns, *deviations], rows)


def _format_points(
    names: tuple[str, ...],
    seen: Placed,
    config: PointInstrumentConfig,
    folder: Path,
    origin: str,
    rng: np.random.Generator,
) -> str:
    points, probe = read_probe(folder / config.probe)
    stations = read_stations(None if config.stations is None else folder / config.stations)
    places = seen[0][:, :, None] + np.einsum("spij,qj->spqi", seen[1], probe)
    reading = _aim(places, stations)
    noise = PointNoise((), config.range_um, config.range_ppm, config.azimuth_arcsec, config.elevation_arcsec)
    reading = reading + spread_polar(noise, reading[..., 0]) * rng.standard_normal(reading.shape)
    there = rng.random(reading.shape[:-1]) >= config.missing_fraction
    there[0, :, 0] |= ~there.any(axis=(0, 2))  # a pose without any point would be none
    rows = [
        (name, station, point, f"{r:.6f}", f"{np.degrees(azimuth):.9f}", f"{np.degrees(elevation):.9f}")
        for p, name in enumerate(names)
        for s, station in enumerate(stations.names)
        for q, point in enumerate(points)
        if there[s, p, q]
        for r, azimuth, elevation in [reading[s, p, q]]
    ]
    comments = [origin, ("Points on the platform as stations see them: range in mm, azimuth and elevation in degrees.")]
    return format_table(comments, ["pose", "station", "point", *POLAR], rows)


def _aim(places: Array, stations: Stations) -> Array:
    """Return range (mm), azimuth and elevation (rad) of places (S, P, Q, 3), base frame, in each station's frame."""
    offset = places - stations.position[:, None, None]
    x, y, z = np.moveaxis(np.einsum("sji,spqj->spqi", stations.rotation, offset), -1, 0)
    reading = np.stack([np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
    assert np.allclose(convert_polar(reading)[0], np.stack([x, y, z], axis=-1))
    return reading
