"""From an audit's design to what it computes with."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayescal.data.actuators import read_moves
from bayescal.density.model_error import build_kernel
from bayescal.errors import InputError
from bayescal.experiments.audit.from_study import Measured, draw_measured, read_measured, refuse_independent
from bayescal.experiments.audit.schema import AuditConfig, PosesConfig, StructuredErrorConfig
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.design import (
    REQUIRED,
    build_sensor,
    find_actuators,
    plan_sensors,
    read_machine,
    read_tolerances,
    read_workspace,
)
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.readings.schema import ChannelConfig
from bayescal.experiments.shared.schema import FramesConfig, ModelConfig, WorkspaceConfig
from bayescal.identifiability.design import FunctionOfPose, Knowledge, Plan, predict_poses
from bayescal.identifiability.pose_volume import PoseVolume, draw_displacements, find_workspace_actuators
from bayescal.identifiability.profile import check_profiles
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.units import Units
from bayescal.machines.frames import FRAMES, frame_symbols
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.units import MICROMETRE

SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class AuditInputs:
    """A design, read and checked.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
        Where the design's file names start.
    knowledge : Knowledge
    plan : Plan
    sensors : dict of name to Sensor
        All that the design lists, those that it does not use too.
    workspace : PoseVolume or None
    workspace_actuators : ndarray, shape (W, N)
        Actuator positions of the workspace's poses; those of the plan where there is no workspace.
    requirements : list of Requirement
    units : Units
    measured : Measured or None
        Where the design has data.
    """

    config: AuditConfig
    folder: Path
    knowledge: Knowledge
    plan: Plan
    sensors: dict[str, Sensor]
    workspace: PoseVolume | None
    workspace_actuators: Array
    requirements: list[Requirement]
    units: Units
    measured: Measured | None = None

    def actuators(self, plan: PosesConfig, factor: float = 1.0, count: int | None = None) -> Array:
        """Return the actuator positions of another plan, shape (P, N), mm; its range may be widened by a factor."""
        return plan_actuators(self.config, self.folder, self.knowledge, self.workspace, plan, factor, count)


@dataclass(frozen=True, eq=False)
class AuditDesign:
    """A design as read: inputs of a machine that is planned, or a machine that has been measured.

    Attributes
    ----------
    config : AuditConfig
    folder : Path
    planned : AuditInputs or None
    measured : MeasuredVariant or None
        Where the design has data.
    """

    config: AuditConfig
    folder: Path
    planned: AuditInputs | None
    measured: MeasuredVariant | None


def read_design(config: AuditConfig, folder: Path) -> AuditDesign:
    """Return a design, read and checked.

    Raises
    ------
    InputError
        For anything at fault in the design or its files: unknown names, poses that the machine cannot take or the
        actuators cannot reach, sensors that are not there.
    """
    if config.data is not None:
        return AuditDesign(config, folder, None, read_measured(config, folder))
    if config.structured_error is not None:
        refuse_independent(config)
    units = Units(config.units.length, config.units.angle)
    sensors = _read_sensors(config, folder)
    knowledge, plan = _plan_measurements(config, folder, units, sensors)
    return AuditDesign(config, folder, _complete(config, folder, knowledge, plan, None), None)


def read_inputs(config: AuditConfig, folder: Path) -> AuditInputs:
    """Return what an audit computes with; for a machine that has been measured its posterior is drawn."""
    return prepare(read_design(config, folder), Run())


def prepare(design: AuditDesign, run: Run) -> AuditInputs:
    """Return what an audit computes with; what is known of a measured machine is drawn from its posterior."""
    if design.planned is not None:
        return design.planned
    assert design.measured is not None
    measured = draw_measured(design.config, design.measured, run)
    return _complete(design.config, design.folder, measured.knowledge, measured.plan, measured)


def _complete(
    config: AuditConfig, folder: Path, knowledge: Knowledge, plan: Plan, measured: Measured | None
) -> AuditInputs:
    units, workspace = Units(config.units.length, config.units.angle), read_volume(config)
    check_profiles(knowledge, config.profiles)
    predict_poses(knowledge.machine, knowledge.machine_centre, plan.actuators)
    at = find_actuators(knowledge, workspace, config.seed, plan.actuators)
    requirements = _read_requirements(config, units)
    sensors = _read_sensors(config, folder)
    return AuditInputs(config, folder, knowledge, plan, sensors, workspace, at, requirements, units, measured)


def _read_sensors(config: AuditConfig, folder: Path) -> dict[str, Sensor]:
    return {
        name: build_sensor(name, sensor, folder)
        for name, sensor in config.sensors.items()
        if not isinstance(sensor, ChannelConfig)
    }


def _read_requirements(config: AuditConfig, units: Units) -> list[Requirement]:
    """Return the largest errors of a pose that are allowed, mm and rad."""
    for name in config.requirements:
        if name not in REQUIRED:
            raise InputError(f"requirements: found {name!r}, expected some of {', '.join(REQUIRED)}")
    return [
        Requirement(name, config.requirements[name] * units.factor("rad" if name.startswith("rotation") else "mm"))
        for name in REQUIRED
        if name in config.requirements
    ]


def list_measuring(config: AuditConfig) -> list[str]:
    """Return the instruments that see each planned pose."""
    chosen = config.variants[0].sensors
    return list(config.sensors) if chosen is None else chosen


def read_volume(config: AuditConfig) -> PoseVolume | None:
    """Return where accuracy counts; None where nothing is said."""
    return read_workspace(config.workspace if isinstance(config.workspace, WorkspaceConfig) else None)


def _plan_measurements(
    config: AuditConfig, folder: Path, units: Units, sensors: dict[str, Sensor]
) -> tuple[Knowledge, Plan]:
    """Return what is known of a machine that has not been measured, and how it is to be."""
    assert config.machine is not None
    assert config.noise is not None
    variant = config.variants[0]
    assert variant.model is not None
    model = ModelConfig(model=variant.model, deformation=variant.deformation)
    machine = read_machine(folder / config.machine, model, config.deformation, folder)
    priors, fixed = read_tolerances(machine, config.parameters, variant.free, units, Path(config.name))
    knowledge = Knowledge(machine, priors | _read_frames(config.frames, units), fixed)
    actuators = plan_actuators(config, folder, knowledge, read_volume(config), config.poses)
    _check_range(machine.mechanism, actuators)
    plan = plan_sensors(actuators, sensors, list_measuring(config), config.noise, "variants.sensors")
    return knowledge, replace(plan, function=_read_function(config.structured_error))


def _read_function(config: StructuredErrorConfig | None) -> FunctionOfPose | None:
    if config is None:
        return None
    return FunctionOfPose(build_kernel(config.kernel, config.length), MICROMETRE * config.scale_um)


def _read_frames(frames: FramesConfig, units: Units) -> dict[str, float]:
    """Return standard deviations of the frames that the calibration has to find, by parameter."""
    priors: dict[str, float] = {}
    for frame in FRAMES:
        section = getattr(frames, frame)
        if section is not None:
            moved, turned = frame_symbols(frame)
            priors |= dict.fromkeys(moved, section.position * units.factor("mm"))
            priors |= dict.fromkeys(turned, section.rotation * units.factor("rad"))
    return priors


# --- poses -------------------------------------------------------------------------------------------------------


def plan_actuators(
    config: AuditConfig,
    folder: Path,
    knowledge: Knowledge,
    workspace: PoseVolume | None,
    plan: PosesConfig,
    factor: float = 1.0,
    count: int | None = None,
) -> Array:
    """Return the actuator positions of a plan, shape (P, N), mm.

    Parameters
    ----------
    config, folder
        The design and where its files are.
    knowledge : Knowledge
    workspace : PoseVolume or None
    plan : PlanConfig
    factor : float
        On the displacements.
    count : int, optional
        Number of poses; a table's rows are taken round and round.
    """
    mechanism = knowledge.machine.mechanism
    start = mechanism.initial_actuator_positions
    rng = np.random.default_rng([config.seed, 1])
    if plan.file is not None:
        raise InputError("poses.file: found poses of a platform that instruments see, expected configurations")
    if plan.configurations is not None:
        moves = read_moves(folder / plan.configurations, plan.unit_mm, mechanism.n_legs)
        moves = moves if count is None else moves[np.arange(count) % len(moves)]
        return start + factor * moves
    n = plan.count if count is None else count
    assert n is not None
    if plan.plan != "workspace":
        half = mechanism.actuator_range if plan.range_mm is None else plan.range_mm
        drawn = start + factor * draw_displacements(plan.plan, n, mechanism.n_legs, half, rng)
        return close_legs(knowledge, drawn)
    if workspace is None:
        raise InputError("poses: found plan 'workspace' without [workspace], expected it")
    theta = knowledge.machine_centre
    found = find_workspace_actuators(knowledge.machine, theta, workspace, max(n, 12), config.seed)
    return start + factor * (rng.permutation(found)[:n] - start)


def close_legs(knowledge: Knowledge, actuators: Array) -> Array:
    """Return positions near the given ones (P, N) at which redundant legs close too; six legs always do.

    The poses are those of least squares; where there is none, or a leg cannot follow, the position stays as it was.
    """
    machine = knowledge.machine
    if machine.mechanism.n_legs == DEGREES_OF_FREEDOM:
        return actuators
    theta = knowledge.machine_centre
    found = solve_forward_kinematics(machine, theta, actuators, check=False)
    back = solve_inverse_kinematics(machine, theta, found.position, found.rotation, check=False)
    good = found.converged & back.converged
    return np.where(good[:, None], back.actuators, actuators)


def _check_range(mechanism: Mechanism, actuators: Array) -> None:
    moved = np.abs(actuators - mechanism.initial_actuator_positions)
    if np.any(moved > mechanism.actuator_range * (1.0 + SLACK)):
        pose, leg = np.unravel_index(int(np.argmax(moved)), moved.shape)
        raise InputError(
            f"poses: pose {pose + 1}, leg {leg + 1}: found a displacement of {moved[pose, leg]:g} mm, "
            f"expected at most the actuator range of {mechanism.actuator_range:g} mm"
        )
