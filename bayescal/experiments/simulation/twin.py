"""What an instrument or photogrammetry sees of a platform on legs: a twin of a machine whose truth is known.

The twin of the telescope is reconstructed from RR-8096's tables: nobody measured it. Its true kinematics is that of a
model with offsets from nominal and a deformation matrix K; the targets on the leg pads follow K alone. An offset of κ
acts in the kinematics only: by eqs. (39) and (40) it is an error of the actuator's gain, which poses cannot tell from a
deformation and which leaves the ring as it is. So targets give back K, and a calibration K plus the offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

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
)
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.simulation.readings import read_model, read_truth
from bayescal.experiments.simulation.schema import (
    FrameTruthConfig,
    PlatformInstrumentConfig,
    PointInstrumentConfig,
    PoseInstrumentConfig,
    SimulationConfig,
)
from bayescal.files.csv_tables import format_table
from bayescal.machines.deformations import MatrixDeformation
from bayescal.machines.frames import frame_blocks, move_frames
from bayescal.machines.kinematics import ForwardKinematics, Machine, check_home_pose, solve_forward_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.parameters import ParameterLayout
from bayescal.machines.read import points_of
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from bayescal.numerics.units import ARCSECOND, MICROMETRE, MICRORADIAN

DECIMALS = 6
POSE_COORDINATES = ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad")


type Poses = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Twin:
    """The machine behind simulated data.

    Attributes
    ----------
    machine : Machine
        Mechanism, model and matrix deformation.
    theta : ndarray, shape (D,)
        True parameters.
    config : SimulationConfig
    calibration, verification : ndarray, shapes (P, N)
        Displacements of the actuators from their initial positions, mm.
    """

    machine: Machine
    theta: Array
    config: SimulationConfig
    calibration: Array
    verification: Array

    @property
    def mechanism(self) -> Mechanism:
        """The nominal geometry."""
        return self.machine.mechanism


def build_twin(config: SimulationConfig, folder: Path) -> Twin:
    """Return the twin that a config describes; its files are relative to ``folder``.

    Raises
    ------
    InputError
        For another machine than one on legs, unknown models or parameters, lists without one entry per leg, or tables
        of another width.
    """
    model = read_model(config, folder)
    if not isinstance(model, Legs):
        raise InputError(
            f"machine: found {config.machine!r}, which has no legs, expected a mechanism, whose platform "
            "[targets] and [instrument] see; any machine has [sensors] and [instruments]"
        )
    machine, poses, targets = model.machine, config.poses, config.targets
    assert poses is not None
    check_home_pose(machine)
    if targets is not None and targets.per_pad and not isinstance(machine.deformation, MatrixDeformation):
        raise InputError(
            f"targets.per_pad: found {targets.per_pad} on a machine with a deformation of its own, expected a "
            "mechanism's file and truth.deformation_matrix, which pads follow"
        )
    tables = (poses.calibration, poses.verification)
    calibration, verification = (read_moves(folder / name, poses.unit_mm, model.n_legs) for name in tables)
    theta = read_truth(config, machine.layout, folder)
    assert theta is not None
    return Twin(machine, theta, config, calibration, verification)


def simulate_survey(twin: Twin, rng: np.random.Generator, theta: Array | None = None) -> Survey:
    """Return one survey of the twin as `survey_twin` does, without the true poses."""
    return survey_twin(twin, rng, theta)[0]


def survey_twin(twin: Twin, rng: np.random.Generator, theta: Array | None = None) -> tuple[Survey, Array]:
    """Return one survey of the twin, with noise of its own, and the true poses.

    Parameters
    ----------
    twin : Twin
        The machine and the plan of measurement.
    rng : Generator
        Source of all noise and of the measurement frames.
    theta : ndarray, shape (D,), optional
        Other true parameters than the twin's.

    Returns
    -------
    survey : Survey
    poses : ndarray, shape (P, 6)
        Where the platform truly stood, the actuators' noise included: position in mm and rotation vector in rad, base
        frame.
    """
    config, mechanism = twin.config, twin.mechanism
    assert config.measurement_frame is not None
    assert config.noise is not None
    assert config.noise.target_um is not None
    commanded, actual, pose = move(twin, rng, twin.theta if theta is None else theta)
    base, platform = make_targets(twin.config, mechanism)
    deflection = (actual - mechanism.initial_actuator_positions) @ _ring_matrix(twin).T
    moved = np.broadcast_to(platform.reference, (len(actual), *platform.reference.shape)).copy()
    pads = platform.leg > 0
    moved[:, pads, 2] += deflection[:, platform.leg[pads] - 1]
    on_platform = pose.position[:, None] + moved @ np.swapaxes(pose.rotation, -1, -2)
    on_base = np.broadcast_to(base.reference, (len(actual), *base.reference.shape))
    frame = config.measurement_frame
    angle = np.radians(frame.angle_deg) * rng.uniform(-1, 1, (len(actual), 3)) / np.sqrt(3)
    rotation, origin = matrix_from_rotation_vector(angle), frame.distance_mm * rng.uniform(-1, 1, (len(actual), 3))
    measured = []
    for points in (on_base, on_platform):
        seen = origin[:, None] + points @ np.swapaxes(rotation, -1, -2)
        measured.append(seen + rng.normal(0.0, config.noise.target_um * MICROMETRE, seen.shape))
    survey = Survey(
        *name_poses(twin),
        commanded,
        BodyTargets(base.names, base.leg, base.reference, measured[0]),
        BodyTargets(platform.names, platform.leg, platform.reference, measured[1]),
    )
    return survey, stack_poses(pose)


def move(twin: Twin, rng: np.random.Generator, theta: Array) -> tuple[Array, Array, ForwardKinematics]:
    """Return commanded and actual actuator positions (P, N), mm, and the poses of a machine θ (D,) there."""
    assert twin.config.noise is not None
    displacement = np.concatenate([twin.calibration, twin.verification])
    commanded = twin.mechanism.initial_actuator_positions + displacement
    actual = commanded + rng.normal(0.0, twin.config.noise.actuator_um * MICROMETRE, commanded.shape)
    found = solve_forward_kinematics(twin.machine, theta, actual, check=False)
    if not found.converged.all():
        raise NumericalError(_name_unreached(twin, int(np.argmin(found.converged))))
    return commanded, actual, found


def _name_unreached(twin: Twin, index: int) -> str:
    """Return which row of which table asks for a pose that the machine has not, and what to do about it."""
    poses, n_calibration = twin.config.poses, len(twin.calibration)
    assert poses is not None
    later = index >= n_calibration
    file, row = (poses.verification, index - n_calibration) if later else (poses.calibration, index)
    moves = (twin.verification if later else twin.calibration)[row]
    return (
        f"{file}: row {row + 1} below the header, pose {name_poses(twin)[0][index]!r}: found displacements "
        f"{', '.join(f'{move:g}' for move in moves)} mm, at which forward kinematics finds no pose, expected ones that "
        "the machine can take: smaller ones, in the unit of unit_mm, columns in the order of the machine's legs"
    )


def stack_poses(found: ForwardKinematics) -> Array:
    """Return poses as position in mm and rotation vector in rad, base frame, shape (P, 6)."""
    return np.concatenate([found.position, rotation_vector_from_matrix(found.rotation)], axis=1)


def name_poses(twin: Twin) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of all poses, and which are for verification."""
    n_calibration = len(twin.calibration)
    names = [f"C{k:02d}" for k in range(1, n_calibration + 1)]
    names += [f"V{k:02d}" for k in range(1, len(twin.verification) + 1)]
    return tuple(names), np.arange(len(names)) >= n_calibration


def _ring_matrix(twin: Twin) -> Array:
    """Return K, which the pads follow; offsets of κ are not in it."""
    deformation, n = twin.machine.deformation, twin.mechanism.n_legs
    return deformation.matrix if isinstance(deformation, MatrixDeformation) else np.zeros((n, n))


def make_targets(config: SimulationConfig, mechanism: Mechanism) -> tuple[BodyTargets, BodyTargets]:
    """Return the targets of base and platform in their body frames, not yet measured."""
    assert config.targets is not None
    nothing = np.empty((0, 0, 3))
    base = points_of(config.targets.base)
    rigid = points_of(config.targets.platform)
    pads = []
    for joint in mechanism.platform_points:
        azimuth = 2 * np.pi * np.arange(config.targets.per_pad) / config.targets.per_pad
        circle = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1)
        pads.append(joint + (config.targets.pad_radius_mm or 0.0) * circle)
    reference = np.round(np.concatenate([rigid, *pads]), DECIMALS)
    leg = np.concatenate(
        [np.zeros(len(rigid), int), np.repeat(np.arange(1, mechanism.n_legs + 1), config.targets.per_pad)]
    )
    names = [f"P{k:02d}" for k in range(1, len(rigid) + 1)]
    names += [f"L{i}{k}" for i in range(1, mechanism.n_legs + 1) for k in range(1, config.targets.per_pad + 1)]
    return (
        BodyTargets(tuple(f"B{k:02d}" for k in range(1, len(base) + 1)), np.zeros(len(base), int), base, nothing),
        BodyTargets(tuple(names), leg, reference, nothing),
    )


def format_actuators(names: tuple[str, ...], verification: np.ndarray, actuators: Array, origin: str) -> str:
    """Return the text of a table of actuator positions (P, N), mm."""
    rows = [
        (pose, "verification" if held else "calibration", *(f"{x:.{DECIMALS}f}" for x in position))
        for pose, held, position in zip(names, verification, actuators, strict=True)
    ]
    text = "Actuator positions rho in mm; displacements are counted from the initial positions of the mechanism."
    return format_table([origin, text], ("pose", "use", *name_actuators(actuators.shape[1])), rows)


def format_truth(twin: Twin, names: Sequence[str], poses: Array) -> dict[str, str]:
    """Return the texts of two CSV files by their names: the twin's true parameters, and true poses (P, 6)."""
    origin = twin.config.origin.text
    about_parameters = "True parameters of the machine that the survey is of."
    about_poses = "True poses of the platform frame in the base frame at the survey: position, rotation vector."
    return {
        PARAMETERS_FILE: format_true_parameters([origin, about_parameters], twin.machine.layout, twin.theta),
        POSES_FILE: format_true_poses([origin, about_poses], POSE_COORDINATES, names, poses),
    }


def format_survey(survey: Survey, origin: str) -> dict[str, str]:
    """Return the texts of the three CSV files of a survey, by file name; units in every header."""
    bodies = dict(zip(BODIES, (survey.base, survey.platform), strict=True))
    rows = [
        (pose, body, name, *(f"{x:.{DECIMALS}f}" for x in targets.measured[p, k]))
        for p, pose in enumerate(survey.poses)
        for body, targets in bodies.items()
        for k, name in enumerate(targets.names)
        if np.isfinite(targets.measured[p, k, 0])
    ]
    reference = [
        (body, name, targets.leg[k], *(f"{x:.{DECIMALS}f}" for x in targets.reference[k]))
        for body, targets in bodies.items()
        for k, name in enumerate(targets.names)
    ]
    return {
        "targets.csv": format_table(
            [origin, "Targets in the measurement frame, which differs from pose to pose; coordinates in mm."],
            TARGET_COLUMNS,
            rows,
        ),
        "actuators.csv": format_actuators(survey.poses, survey.verification, survey.actuators, origin),
        "target_reference.csv": format_table(
            [origin, "Targets on their bodies, body frames, in mm; leg 0: rigid part, leg i: pad of leg i's joint."],
            REFERENCE_COLUMNS,
            reference,
        ),
    }


@dataclass(frozen=True, eq=False)
class InstrumentPlan:
    """A twin, and the folder where its config's file names start."""

    twin: Twin
    folder: Path

    @property
    def config(self) -> SimulationConfig:
        """The twin's."""
        return self.twin.config

    @cached_property
    def layout(self) -> ParameterLayout:
        """The true parameters', those of the instrument's frames among them."""
        if self.config.instrument is None:
            return self.twin.machine.layout
        return self.twin.machine.layout.extend(frame_blocks(count_stations(self.config.instrument, self.folder)))

    @cached_property
    def theta(self) -> Array:
        """The true parameters, shape (D,)."""
        found = self.config.instrument
        if found is None:
            return self.twin.theta
        return np.concatenate([self.twin.theta, true_frames(found, count_stations(found, self.folder))])

    @property
    def n_held_back(self) -> int:
        """How many poses are held back."""
        return len(self.twin.verification)

    @property
    def n_poses(self) -> int:
        """Number of poses, those held back among them."""
        return len(self.twin.calibration) + self.n_held_back

    @property
    def width(self) -> int:
        """How many coordinates of targets or of the platform, and actuators, are seen at each."""
        targets, n_legs = self.config.targets, self.twin.mechanism.n_legs
        if targets is None:
            return n_legs + DEGREES_OF_FREEDOM
        n_targets = sum(ring.count for ring in (*targets.base, *targets.platform)) + n_legs * targets.per_pad
        return n_legs + 3 * n_targets

    def simulate(self, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        """Return the texts of all files by their names, and the true parameters (D,)."""
        twin, instrument = self.twin, self.config.instrument
        if instrument is None:
            survey, poses = survey_twin(twin, rng)
            files = format_survey(survey, self.config.origin.text)
        else:
            files, poses = simulate_readings(twin, instrument, self.folder, rng)
        return files | format_truth(twin, name_poses(twin)[0], poses), self.theta


def plan_instrument(config: SimulationConfig, folder: Path) -> InstrumentPlan:
    """Return what is simulated; InputError for every fault of the config or its files."""
    plan = InstrumentPlan(build_twin(config, folder), folder)
    assert plan.theta.shape == (plan.layout.size,)
    return plan


def true_frames(config: PlatformInstrumentConfig, n_stations: int) -> Array:
    """Return the true frames as parameters, each station's and the tool's, shape (6 S + 6,), mm and rad."""
    bases = config.frames.base or [FrameTruthConfig()] * n_stations
    if len(bases) != n_stations:
        raise InputError(f"instrument.frames.base: found {len(bases)} frames, expected {n_stations}, one per station")
    return np.concatenate([[*one.position_mm, *np.radians(one.rotation_deg)] for one in (*bases, config.frames.tool)])


def count_stations(config: PlatformInstrumentConfig, folder: Path) -> int:
    """Return how many stations an instrument has."""
    if isinstance(config, PoseInstrumentConfig) or config.stations is None:
        return 1
    return len(read_stations(folder / config.stations).names)


def simulate_readings(
    twin: Twin, config: PlatformInstrumentConfig, folder: Path, rng: np.random.Generator
) -> tuple[dict[str, str], Array]:
    """Return the texts of the tables that an instrument leaves of a twin, by their names, and the true poses (P, 6)."""
    commanded, _, found = move(twin, rng, twin.theta)
    frames = true_frames(config, count_stations(config, folder)).reshape(-1, 6)
    pairs = np.concatenate([frames[:-1], np.broadcast_to(frames[-1:], frames[:-1].shape)], axis=1)
    seen = move_frames(pairs, found.position[None], found.rotation[None])
    names, held = name_poses(twin)
    origin = twin.config.origin.text
    files = {"actuators.csv": format_actuators(names, held, commanded, origin)}
    if isinstance(config, PoseInstrumentConfig):
        files["poses.csv"] = _format_poses(names, (seen[0][0], seen[1][0]), config, origin, rng)
    else:
        files["points.csv"] = _format_points(names, seen, config, folder, origin, rng)
    return files, stack_poses(found)


def _format_poses(
    names: tuple[str, ...], seen: Poses, config: PoseInstrumentConfig, origin: str, rng: np.random.Generator
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
    comments = [origin, "Pose of the probe in the instrument's frame: position in mm, rotation vector in degrees."]
    rows = [(name, *(f"{x:.8f}" for x in one), *deviations.values()) for name, one in zip(names, values, strict=True)]
    return format_table(comments, ["pose", *columns, *deviations], rows)


def _format_points(
    names: tuple[str, ...],
    seen: Poses,
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
    there = rng.random(reading.shape[:-1]) >= config.missed
    there[0, :, 0] |= ~there.any(axis=(0, 2))  # a pose without any point would be none
    rows = [
        (name, station, point, f"{r:.6f}", f"{np.degrees(azimuth):.9f}", f"{np.degrees(elevation):.9f}")
        for p, name in enumerate(names)
        for s, station in enumerate(stations.names)
        for q, point in enumerate(points)
        if there[s, p, q]
        for r, azimuth, elevation in [reading[s, p, q]]
    ]
    comments = [origin, "Points on the platform as stations see them: range in mm, azimuth and elevation in degrees."]
    return format_table(comments, ["pose", "station", "point", *POLAR], rows)


def _aim(places: Array, stations: Stations) -> Array:
    """Return range (mm), azimuth and elevation (rad) of places (S, P, Q, 3), base frame, in each station's frame."""
    offset = places - stations.position[:, None, None]
    x, y, z = np.moveaxis(np.einsum("sji,spqj->spqi", stations.rotation, offset), -1, 0)
    reading = np.stack([np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
    assert np.allclose(convert_polar(reading)[0], np.stack([x, y, z], axis=-1))
    return reading
