"""From an audit's design to what it computes with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.config.load import load_mechanism, look_up, points_of
from bayescal.config.schema import FixedConfig, NormalConfig, PointsConfig, TargetRingConfig
from bayescal.data.simulation import make_rings
from bayescal.errors import InputError
from bayescal.experiments.audit.from_study import Measured, read_measured
from bayescal.experiments.audit.schema import (
    ActuatorPlanConfig,
    AuditConfig,
    FilePlanConfig,
    PlanConfig,
    PoseSensorConfig,
    SensorConfig,
    WorkspacePlanConfig,
)
from bayescal.experiments.study.inputs import per_leg
from bayescal.files.csv_tables import read_matrix
from bayescal.identifiability.design import Knowledge, Plan, predict_poses
from bayescal.identifiability.frames import FRAMES, frame_symbols
from bayescal.identifiability.pose_volume import Workspace, draw_displacements, find_workspace_actuators
from bayescal.identifiability.requirements import COMPONENTS, NORMS, Requirement
from bayescal.identifiability.units import Units
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import Machine, check_home_pose, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.machines.sensors import PointSensor, PoseSensor, Sensor
from bayescal.numerics.geometry import Array

MICROMETRE = 1e-3
ARCSECOND = np.pi / 180 / 3600
LEAST_TARGETS = 3
SIX = 6
SLACK = 1e-9
REQUIRED = (*COMPONENTS, *NORMS)


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
    workspace : Workspace or None
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
    workspace: Workspace | None
    workspace_actuators: Array
    requirements: list[Requirement]
    units: Units
    measured: Measured | None = None

    def actuators(self, plan: PlanConfig, factor: float = 1.0, count: int | None = None) -> Array:
        """Return the actuator positions of another plan, shape (P, N), mm; its range may be widened by a factor."""
        return plan_actuators(self.config, self.folder, self.knowledge, self.workspace, plan, factor, count)


def read_inputs(config: AuditConfig, folder: Path) -> AuditInputs:
    """Return what an audit computes with.

    Raises
    ------
    InputError
        For anything at fault in the design or its files: unknown names, poses that the machine cannot take or the
        actuators cannot reach, sensors that are not there.
    """
    units = Units(config.units.length, config.units.angle)
    sensors = {name: build_sensor(name, sensor) for name, sensor in config.sensors.items()}
    workspace = _workspace(config)
    measured = None if config.data is None else read_measured(config, folder)
    if measured is not None:
        knowledge, plan = measured.knowledge, measured.plan
    else:
        knowledge, plan = _plan_measurements(config, folder, units, sensors, workspace)
    machine = knowledge.machine
    theta = knowledge.machine_centre
    predict_poses(machine, theta, plan.actuators)
    at = plan.actuators
    if workspace is not None:
        at = find_workspace_actuators(machine, theta, workspace, workspace.n_poses, config.seed)
    wanted = config.requirements
    requirements = [
        Requirement(name, limit * units.factor("rad" if name.startswith("rotation") else "mm"))
        for name in REQUIRED
        if (limit := getattr(wanted, name)) is not None
    ]
    return AuditInputs(config, folder, knowledge, plan, sensors, workspace, at, requirements, units, measured)


def _plan_measurements(
    config: AuditConfig, folder: Path, units: Units, sensors: dict[str, Sensor], workspace: Workspace | None
) -> tuple[Knowledge, Plan]:
    """Return what is known of a machine that has not been measured, and how it is to be."""
    assert config.mechanism is not None
    assert config.poses is not None
    assert config.noise is not None
    mechanism = load_mechanism(folder / config.mechanism)
    machine = build_machine(config, folder, mechanism)
    check_home_pose(machine)
    knowledge = Knowledge(machine, *_priors(config, machine, units))
    actuators = plan_actuators(config, folder, knowledge, workspace, config.poses)
    _check_range(mechanism, actuators)
    plan = Plan(
        actuators,
        choose_sensors(sensors, config.measured_by, "measured_by"),
        MICROMETRE * config.noise.actuator_um,
        MICROMETRE * config.noise.model_error_um,
    )
    return knowledge, plan


def build_machine(config: AuditConfig, folder: Path, mechanism: Mechanism) -> Machine:
    """Return the mechanism seen through the design's model and deformation."""
    found = look_up(MODELS, config.variant.model, "variant.model", folder)
    kind = look_up(DEFORMATIONS, config.variant.deformation, "variant.deformation", folder)

    def matrix() -> Array:
        name = config.deformation.matrix
        if name == "targets":
            raise InputError("deformation.matrix: found 'targets' without measured ones, expected a CSV file with K")
        return 1e-3 * read_matrix(folder / name, mechanism.n_legs)

    return Machine(
        mechanism,
        found.from_mechanism(mechanism),
        kind.from_nominal(NominalDeformation(config.deformation.kappa, matrix)),
    )


def _priors(config: AuditConfig, machine: Machine, units: Units) -> tuple[dict[str, float], dict[str, float]]:
    """Return standard deviations of the free parameters and values of the fixed ones that are not nominal."""
    blocks = {block.symbol: block for block in machine.layout.blocks}
    known = known_symbols(machine.mechanism)
    priors: dict[str, float] = {}
    fixed: dict[str, float] = {}
    free = config.variant.free
    for symbol in free or ():
        look_up(blocks, symbol, "variant.free", Path(config.name))
        if symbol not in config.parameters or isinstance(config.parameters[symbol], FixedConfig):
            raise InputError(f"variant.free: found {symbol!r} without a tolerance in [parameters], expected one")
    for symbol, prior in config.parameters.items():
        if symbol not in known:
            look_up(dict.fromkeys(sorted(known)), symbol, "parameters", Path(config.name))
        if symbol not in blocks:
            continue
        block, factor = blocks[symbol], units.factor(blocks[symbol].unit)
        if isinstance(prior, FixedConfig):
            offsets = per_leg(prior.offset, len(block.nominal), symbol)
            fixed |= {n: v + factor * o for n, v, o in zip(block.names, block.nominal, offsets, strict=True)}
        elif free is None or symbol in free:
            normal = isinstance(prior, NormalConfig)
            given = prior.sd if isinstance(prior, NormalConfig) else prior.half_width
            widths = per_leg(given, len(block.nominal), symbol)
            scale = factor if normal else factor / np.sqrt(3.0)
            priors |= {name: scale * width for name, width in zip(block.names, widths, strict=True)}
    for frame in FRAMES:
        section = getattr(config.frames, frame)
        if section is not None:
            moved, turned = frame_symbols(frame)
            priors |= dict.fromkeys(moved, section.position * units.factor("mm"))
            priors |= dict.fromkeys(turned, section.rotation * units.factor("rad"))
    return priors, fixed


def known_symbols(mechanism: Mechanism) -> set[str]:
    """Return the symbols of all models that this mechanism may be seen through, and of all deformations."""
    known: set[str] = set()
    n_legs = mechanism.n_legs
    for model in MODELS.values():
        try:
            known |= {block.symbol for block in model.from_mechanism(mechanism).blocks(mechanism)}
        except InputError:  # lacks what the model needs, or is driven otherwise
            continue
    nominal = NominalDeformation(0.0, lambda: np.zeros((n_legs, n_legs)))
    for kind in DEFORMATIONS.values():
        known |= {block.symbol for block in kind.from_nominal(nominal).blocks(n_legs)}
    return known


# --- sensors -----------------------------------------------------------------------------------------------------


def choose_sensors(sensors: dict[str, Sensor], names: list[str], field: str) -> tuple[Sensor, ...]:
    """Return sensors by name; InputError for one that the design does not list."""
    for name in names:
        if name not in sensors:
            raise InputError(f"{field}: found sensor {name!r}, expected one of {', '.join(sorted(sensors))}")
    return tuple(sensors[name] for name in names)


def build_sensor(name: str, config: SensorConfig) -> Sensor:
    """Return a sensor of the design."""
    if isinstance(config, PoseSensorConfig):
        position, angle = config.position_um, config.orientation_arcsec
        return PoseSensor(
            None if position is None else MICROMETRE * position,
            None if angle is None else ARCSECOND * angle,
            config.axes,
        )
    platform = _targets(config.platform)
    base = None if config.base is None else _targets(config.base)
    if base is not None and (len(base) < LEAST_TARGETS or np.linalg.matrix_rank(base - base.mean(axis=0)) < 2):
        raise InputError(f"sensors.{name}.base: found {len(base)} targets on a line, expected three or more off it")
    return PointSensor(platform, MICROMETRE * config.noise_um, base)


def _targets(config: list[TargetRingConfig] | PointsConfig) -> Array:
    return points_of(config) if isinstance(config, PointsConfig) else make_rings(config)


# --- poses -------------------------------------------------------------------------------------------------------


def _workspace(config: AuditConfig) -> Workspace | None:
    section = config.workspace
    if section is None:
        return None
    half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    return Workspace(half, section.shape, section.poses)


def plan_actuators(
    config: AuditConfig,
    folder: Path,
    knowledge: Knowledge,
    workspace: Workspace | None,
    plan: PlanConfig,
    factor: float = 1.0,
    count: int | None = None,
) -> Array:
    """Return the actuator positions of a plan, shape (P, N), mm.

    Parameters
    ----------
    config, folder
        The design and where its files are.
    knowledge : Knowledge
    workspace : Workspace or None
    plan : PlanConfig
    factor : float
        On the displacements.
    count : int, optional
        Number of poses; a table's rows are taken round and round.
    """
    mechanism = knowledge.machine.mechanism
    start = mechanism.initial_actuator_positions
    rng = np.random.default_rng([config.seed, 1])
    if isinstance(plan, FilePlanConfig):
        moves = plan.unit_mm * read_matrix(folder / plan.configurations, mechanism.n_legs)
        moves = moves if count is None else moves[np.arange(count) % len(moves)]
        return start + factor * moves
    n = plan.count if count is None else count
    if isinstance(plan, ActuatorPlanConfig):
        half = mechanism.actuator_range if plan.range_mm is None else plan.range_mm
        drawn = start + factor * draw_displacements(plan.plan, n, mechanism.n_legs, half, rng)
        return close_legs(knowledge, drawn)
    assert isinstance(plan, WorkspacePlanConfig)
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
    if machine.mechanism.n_legs == SIX:
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
