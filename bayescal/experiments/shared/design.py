"""A machine as designed: what is known of it, what measures it and what is required, from the sections of a config."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.config.load import look_up
from bayescal.density.schema import FixedConfig, NormalConfig, PriorConfig
from bayescal.errors import InputError
from bayescal.experiments.shared.per_leg import spread_over_legs, spread_widths
from bayescal.experiments.shared.schema import (
    ActuatorNoiseConfig,
    DeformationConfig,
    ModelConfig,
    OwnSensorConfig,
    PoseSensorConfig,
    RequirementsConfig,
    SensorConfig,
    WorkspaceConfig,
)
from bayescal.files.csv_tables import read_matrix
from bayescal.identifiability.design import Knowledge, Plan, PoseVolume, find_workspace_actuators
from bayescal.identifiability.requirements import COMPONENTS, NORMS, Requirement
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import Machine, check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.machines.read import build_named_machine, load_mechanism, points_of
from bayescal.machines.sensors import PointSensor, PoseSensor, Sensor
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE, Units

LEAST_TARGETS = 3
REQUIRED = (*COMPONENTS, *NORMS)


@dataclass(frozen=True, eq=False)
class Design:
    """A machine as designed, with what measures it and where it has to be accurate.

    Attributes
    ----------
    knowledge : Knowledge
    plan : Plan
        Sensors and noise; its poses are those of an audit's plan, none where they are still to be chosen.
    workspace : PoseVolume or None
    workspace_actuators : ndarray, shape (W, N)
        Actuator positions of the workspace's poses, mm; those of the plan where there is no workspace.
    requirements : list of Requirement
    """

    knowledge: Knowledge
    plan: Plan
    workspace: PoseVolume | None
    workspace_actuators: Array
    requirements: list[Requirement]


def read_machine(
    path: Path,
    variant: ModelConfig,
    deformation: DeformationConfig,
    folder: Path,
    measured: Callable[[], Array] | None = None,
) -> Machine:
    """Return a mechanism seen by a model and a deformation; K is ``measured``, or in a file of its own, in 1e-3."""
    mechanism = load_mechanism(path)

    def matrix() -> Array:
        if measured is not None:
            return measured()
        name = deformation.matrix
        if name == "targets":
            raise InputError("deformation.matrix: found 'targets' without measured ones, expected a CSV file with K")
        return 1e-3 * read_matrix(folder / name, mechanism.n_legs)

    nominal = NominalDeformation(deformation.kappa, matrix)
    machine = build_named_machine(mechanism, path, variant.model, variant.deformation, nominal, "variant", folder)
    check_home_pose(machine)
    return machine


# --- tolerances --------------------------------------------------------------------------------------------------


def read_tolerances(
    machine: Machine, parameters: dict[str, PriorConfig], free: list[str] | None, units: Units, where: Path
) -> tuple[dict[str, float], dict[str, float]]:
    """Return standard deviations of the free parameters and values of the fixed ones that are not nominal.

    Parameters
    ----------
    machine : Machine
    parameters : dict of symbol to PriorConfig
    free : list of str or None
        Symbols; None for all that have a tolerance.
    units : Units
        Of the tolerances.
    where : Path
        For the message.

    Raises
    ------
    InputError
        For an unknown symbol, a free one without a tolerance, and lists without one entry per leg.
    """
    blocks = {block.symbol: block for block in machine.layout.blocks}
    known = known_symbols(machine.mechanism) | set(blocks)
    priors: dict[str, float] = {}
    fixed: dict[str, float] = {}
    for symbol in free or ():
        look_up(blocks, symbol, "variant.free", where)
        if symbol not in parameters or isinstance(parameters[symbol], FixedConfig):
            raise InputError(f"variant.free: found {symbol!r} without a tolerance in [parameters], expected one")
    for symbol, prior in parameters.items():
        if symbol not in known:
            look_up(dict.fromkeys(sorted(known)), symbol, "parameters", where)
        if symbol not in blocks:
            continue
        block, factor = blocks[symbol], units.factor(blocks[symbol].unit)
        if isinstance(prior, FixedConfig):
            offsets = spread_over_legs(prior.offset, len(block.nominal), symbol)
            fixed |= {n: v + factor * o for n, v, o in zip(block.names, block.nominal, offsets, strict=True)}
        elif free is None or symbol in free:
            normal = isinstance(prior, NormalConfig)
            given = prior.sd if isinstance(prior, NormalConfig) else prior.half_width
            widths = spread_widths(given, len(block.nominal), symbol, block.unit, factor)
            scale = factor if normal else factor / np.sqrt(3.0)
            priors |= {name: scale * width for name, width in zip(block.names, widths, strict=True)}
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


def plan_sensors(
    actuators: Array,
    sensors: dict[str, Sensor],
    measured_by: list[str],
    noise: ActuatorNoiseConfig,
    field: str,
) -> Plan:
    """Return a plan of poses at actuator positions (P, N), mm, seen by some of the sensors."""
    return Plan(
        actuators,
        choose_sensors(sensors, measured_by, field),
        MICROMETRE * noise.actuator_um,
        MICROMETRE * noise.model_error_um,
    )


def choose_sensors(sensors: dict[str, Sensor], names: list[str], field: str) -> tuple[Sensor, ...]:
    """Return sensors by name; InputError for one that the design does not list."""
    for name in names:
        if name not in sensors:
            raise InputError(f"{field}: found sensor {name!r}, expected one of {', '.join(sorted(sensors))}")
    return tuple(sensors[name] for name in names)


def build_sensor(name: str, config: SensorConfig, folder: Path) -> Sensor:
    """Return a sensor of the design, whose file stands in a folder."""
    if isinstance(config, OwnSensorConfig):
        return _build_own_sensor(name, config, folder)
    if isinstance(config, PoseSensorConfig):
        position, angle = config.position_um, config.arcseconds
        return PoseSensor(
            None if position is None else MICROMETRE * position,
            None if angle is None else ARCSECOND * angle,
            config.axes,
        )
    platform = points_of(config.platform)
    base = None if config.base is None else points_of(config.base)
    if base is not None and (len(base) < LEAST_TARGETS or np.linalg.matrix_rank(base - base.mean(axis=0)) < 2):
        raise InputError(f"sensors.{name}.base: found {len(base)} targets on a line, expected three or more off it")
    return PointSensor(platform, MICROMETRE * config.noise_um, base)


def _build_own_sensor(name: str, config: OwnSensorConfig, folder: Path) -> Sensor:
    field = f"sensors.{name}"
    chosen = choose("SENSORS", config.kind, Sensor, f"{field}.kind", folder, config.options)  # type: ignore[type-abstract]
    with name_failures(chosen.found, f"{field}.kind", folder):
        sensor = chosen.found.from_config(chosen.options)
        told = np.asarray(sensor.information(np.zeros((2, 3)), np.broadcast_to(np.eye(3), (2, 3, 3))))
    fine = told.shape == (2, 6, 6) and np.isfinite(told).all() and np.allclose(told, np.swapaxes(told, -1, -2))
    if not fine:
        raise InputError(
            f"{folder}: {field}: found information of shape {told.shape} from {config.kind}, expected "
            "symmetric finite matrices of shape (2, 6, 6) for two poses"
        )
    return sensor


# --- workspace ---------------------------------------------------------------------------------------------------


def read_workspace(section: WorkspaceConfig | None) -> PoseVolume | None:
    """Return where accuracy counts."""
    if section is None:
        return None
    half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    return PoseVolume(half, section.shape, section.poses)


def find_actuators(knowledge: Knowledge, workspace: PoseVolume | None, seed: int, otherwise: Array) -> Array:
    """Return actuator positions of a workspace's poses (W, N), mm; others where there is none."""
    if workspace is None:
        return otherwise
    return find_workspace_actuators(knowledge.machine, knowledge.machine_centre, workspace, workspace.n_poses, seed)


def read_requirements(section: RequirementsConfig, units: Units) -> list[Requirement]:
    """Return the largest errors of a pose that are allowed, mm and rad."""
    return [
        Requirement(name, limit * units.factor("rad" if name.startswith("rotation") else "mm"))
        for name in REQUIRED
        if (limit := getattr(section, name)) is not None
    ]
