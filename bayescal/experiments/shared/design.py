"""A mechanism on legs, sensors of its poses and its workspace, from the sections of a config."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.errors import InputError, name_faults
from bayescal.experiments.shared.schema import (
    DeformationConfig,
    ModelConfig,
    OwnSensorConfig,
    SensorConfig,
    WorkspaceConfig,
)
from bayescal.files.csv_tables import read_matrix
from bayescal.identifiability.pose_volume import PoseVolume
from bayescal.identifiability.requirements import COMPONENTS, NORMS
from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import Machine, check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models import MODELS
from bayescal.machines.read import build_named_machine, load_mechanism, points_of
from bayescal.machines.sensors import PointSensor, PoseSensor, Sensor
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

LEAST_TARGETS = 3
REQUIRED = (*COMPONENTS, *NORMS)


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
            raise InputError("deformation.matrix: found 'targets', expected a CSV file with K")
        return 1e-3 * read_matrix(folder / name, mechanism.n_legs)

    nominal = NominalDeformation(deformation.kappa, matrix)
    machine = build_named_machine(mechanism, path, variant.model, variant.deformation, nominal, "variant", folder)
    with name_faults(path):
        check_home_pose(machine)
    return machine


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


def build_sensor(name: str, config: SensorConfig, folder: Path) -> Sensor:
    """Return a sensor of the design, whose file stands in a folder."""
    if isinstance(config, OwnSensorConfig):
        return _build_own_sensor(name, config, folder)
    if config.kind == "pose":
        position, angle = config.position_um, config.arcseconds
        return PoseSensor(
            None if position is None else MICROMETRE * position,
            None if angle is None else ARCSECOND * angle,
            config.axes,
        )
    platform = points_of(config.platform)
    base = None if config.base is None else points_of(config.base)
    if base is not None and (len(base) < LEAST_TARGETS or np.linalg.matrix_rank(base - base.mean(axis=0)) < 2):
        raise InputError(f"sensors.{name}.base: found {len(base)} targets on a line, expected three off it")
    return PointSensor(platform, MICROMETRE * config.noise_um, base)


def _build_own_sensor(name: str, config: OwnSensorConfig, folder: Path) -> Sensor:
    field = f"sensors.{name}"
    chosen = choose("SENSORS", config.kind, Sensor, f"{field}.kind", folder, config.options)  # type: ignore[type-abstract]
    with name_failures(chosen.found, f"{field}.kind"):
        sensor = chosen.make()
        told = np.asarray(sensor.information(np.zeros((2, 3)), np.broadcast_to(np.eye(3), (2, 3, 3))))
    fine = told.shape == (2, 6, 6) and np.isfinite(told).all() and np.allclose(told, np.swapaxes(told, -1, -2))
    if not fine:
        raise InputError(
            f"{field}: found information of shape {told.shape} from {config.kind}, expected (2, 6, "
            "6), symmetric, for two poses"
        )
    return sensor


# --- workspace ---------------------------------------------------------------------------------------------------


def read_workspace(section: WorkspaceConfig | None) -> PoseVolume | None:
    """Return where accuracy counts."""
    if section is None:
        return None
    half = np.concatenate([section.position_mm, np.radians(section.rotation_deg)])
    return PoseVolume(half, section.shape, section.poses)
