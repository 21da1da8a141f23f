"""What simulated calibrations share: the machine of a config, its sets of sensors with their noise, and the poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import FunctionModel, ReadingModel
from bayescal.machines.readings.sliding_platform import SlidingPlatform, matrix_of_angle
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from sika2008.schema import PathConfig, PosesConfig, SelfCalibrationsConfig, SensorConfig, TolerancesConfig
from sika2008.sensors import FreeParameters, SensorSet

ZEROS = ("phi0", "psi0", "tilt_a0", "tilt_b0")
POSES, TARGETS, CALIBRATIONS, SWEEP, MACHINES = range(5)
"""Streams of random numbers, so that what one part draws changes nothing in another."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A set of sensors and what is calibrated with it.

    Attributes
    ----------
    name : str
    sensors : SensorSet
    free : FreeParameters
    """

    name: str
    sensors: SensorSet
    free: FreeParameters

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of what is calibrated."""
        names = self.sensors.model.layout.names
        return tuple(names[k] for k in self.free.places)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units, mm or rad."""
        units = self.sensors.model.layout.units
        return tuple(units[k] for k in self.free.places)


@dataclass(frozen=True, eq=False)
class Plans:
    """All sets of sensors on one machine.

    Attributes
    ----------
    plans : tuple of Plan
    every : Plan
        All sensors of all sets together: what is measured once and shared by the sets.
    """

    plans: tuple[Plan, ...]
    every: Plan

    def columns(self, plan: Plan) -> np.ndarray:
        """Return where a set's sensors stand among all."""
        return np.searchsorted(self.every.sensors.chosen, plan.sensors.chosen)


@dataclass(frozen=True, eq=False)
class Setup:
    """The documented machine and where it is measured and judged.

    Attributes
    ----------
    config : SelfCalibrationsConfig
    folder : Path
        Where the config's file names start.
    machine : FunctionModel
        Of a `SlidingPlatform`.
    plans : Plans
    pose : ndarray, shape (P, 3)
        Measured poses.
    targets : ndarray, shape (V, 3)
        Poses over the same workspace at which the tool's centre is judged.
    path : ndarray, shape (L, 3)
        A circle along which it is shown.
    """

    config: SelfCalibrationsConfig
    folder: Path
    machine: FunctionModel
    plans: Plans
    pose: Array
    targets: Array
    path: Array

    def rng(self, *stream: int) -> np.random.Generator:
        """Return the random numbers of a stream."""
        return np.random.default_rng([self.config.seed, *stream])


def read_setup(config: SelfCalibrationsConfig, folder: Path) -> Setup:
    """Return the setup of an experiment.

    Raises
    ------
    InputError
        For a fault of the machine, an unknown sensor, a noise in the wrong unit, a set with fewer equations than
        unknowns, a pose out of reach or with crossed legs.
    """
    machine = read_reading_model(folder / config.machine)
    platform = platform_of(machine)
    assert isinstance(machine, FunctionModel)
    plans = build_plans(machine, config, config.sensors)
    for plan in plans.plans:
        try:
            plan.sensors.check(config.poses.n_poses, len(plan.free.places))
        except InputError as error:
            raise InputError(f"sets: {plan.name!r}: {error}") from error
    rng = [np.random.default_rng([config.seed, stream]) for stream in (POSES, TARGETS)]
    pose = draw_poses(machine, config.poses, rng[0])
    targets = draw_poses(machine, config.poses.model_copy(update={"n_poses": config.verification_poses}), rng[1])
    path = follow_path(machine, config.path)
    platform.check_poses(path, lambda k: f"path: pose {k + 1}")
    return Setup(config, folder, machine, plans, pose, targets, path)


def platform_of(model: ReadingModel) -> SlidingPlatform:
    """Return the platform on sliding legs that a model is of; InputError where it is another machine."""
    machine = model.machine if isinstance(model, FunctionModel) else None
    if not isinstance(machine, SlidingPlatform):
        raise InputError("machine: found another machine, expected kind = 'sliding_platform'")
    return machine


def build_plans(machine: ReadingModel, config: SelfCalibrationsConfig, sensors: dict[str, SensorConfig]) -> Plans:
    """Return the sets of a config on a machine, with the noise of these sensors."""

    def build(name: str, names: list[str]) -> Plan:
        chosen = build_sensors(machine, sensors, names)
        return Plan(name, chosen, free_parameters(machine, chosen.names, config.tolerances))

    plans = []
    for one in config.sets:
        try:
            plans.append(build(one.name, one.sensors))
        except InputError as error:
            raise InputError(f"sets: {one.name!r}: {error}") from error
    every = list(dict.fromkeys(name for plan in plans for name in plan.sensors.names))
    return Plans(tuple(plans), build("every", every))


def follow_path(machine: ReadingModel, config: PathConfig) -> Array:
    """Return poses (L, 3) of the tool's centre on a circle about home, the platform swinging to either side."""
    turn = 2.0 * np.pi * np.arange(config.n_poses) / config.n_poses
    moves = [config.radius_mm * np.cos(turn), config.radius_mm * np.sin(turn)]
    return poses_about_home(machine, np.stack([*moves, np.radians(config.angle_deg) * np.sin(turn)], axis=1))


# --- sensors, tolerances, poses --------------------------------------------------------------------------------------


def build_sensors(
    model: ReadingModel, sensors: Mapping[str, SensorConfig], names: Iterable[str] | None = None
) -> SensorSet:
    """Return sensors with their noise.

    Parameters
    ----------
    model : ReadingModel
    sensors : mapping of name to config
        Of single sensors such as ``s[2]``, or of a kind such as ``s``; a single one goes before its kind.
    names : iterable of str, optional
        Which of them, all by default.

    Raises
    ------
    InputError
        For an unknown sensor, one without noise, and a noise in the wrong unit.
    """
    model.select(sensors)
    chosen = model.select(sensors if names is None else names)
    noise = [_noise(model, k, sensors) for k in chosen]
    return SensorSet(model, chosen, np.array(noise))


def sensor_config(name: str, sensors: Mapping[str, SensorConfig]) -> SensorConfig:
    """Return the config of one sensor; InputError where it has none."""
    found = sensors.get(name, sensors.get(name.partition("[")[0]))
    if found is None:
        raise InputError(f"sensor {name}: found no noise, expected an entry in [sensors]")
    return found


def _noise(model: ReadingModel, place: int, sensors: Mapping[str, SensorConfig]) -> float:
    channel = model.channels[place]
    config = sensor_config(channel.name, sensors)
    if channel.unit == "mm":
        if config.noise_um is None:
            raise InputError(f"sensors.{channel.name}: found noise_arcsec, expected noise_um, for it reads a length")
        return config.noise_um * MICROMETRE
    if config.noise_arcsec is None:
        raise InputError(f"sensors.{channel.name}: found noise_um, expected noise_arcsec, for it reads an angle")
    return config.noise_arcsec * ARCSECOND


def free_parameters(model: ReadingModel, names: Iterable[str], tolerances: TolerancesConfig) -> FreeParameters:
    """Return what a calibration with some sensors frees: what they see, but for what defines the frames.

    An instrument beside the machine would define the base frame too; here it is taken to be set up in that frame.
    """
    layout, given = model.layout, platform_of(model).frame_parameters()
    free = [name for name in model.seen_parameters(names) if name not in given]
    places = np.array([layout.names.index(name) for name in free], dtype=int)
    scale = [tolerance_of(name, layout.units[k], tolerances) for name, k in zip(free, places, strict=True)]
    return FreeParameters(places, layout.nominal, np.array(scale))


def tolerance_of(name: str, unit: str, tolerances: TolerancesConfig) -> float:
    """Return the standard deviation of a parameter beforehand, mm or rad."""
    if unit == "mm":
        return tolerances.length_mm
    zero = name.partition("[")[0] in ZEROS
    return float(np.radians(tolerances.zero_deg if zero else tolerances.angle_deg))


def draw_poses(model: ReadingModel, config: PosesConfig, rng: np.random.Generator) -> Array:
    """Return poses (P, 3) whose tool's centre and angle lie within half widths of home.

    Raises
    ------
    InputError
        For a pose that a leg cannot reach or at which two legs cross.
    """
    width = np.array([config.position_mm, config.position_mm, np.radians(config.angle_deg)])
    pose = poses_about_home(model, width * rng.uniform(-1.0, 1.0, (config.n_poses, 3)))
    platform_of(model).check_poses(pose)
    return pose


def poses_about_home(model: ReadingModel, displacement: Array) -> Array:
    """Return poses (P, 3) from displacements of the tool's centre and angle from home (P, 3), mm and rad."""
    home, tool = model.home_pose, platform_of(model).tool_point
    angle = home[2] + displacement[:, 2]
    centre = home[:2] + matrix_of_angle(home[2:])[0] @ tool
    origin = centre + displacement[:, :2] - np.einsum("pij,j->pi", matrix_of_angle(angle), tool)
    return np.concatenate([origin, angle[:, None]], axis=1)
