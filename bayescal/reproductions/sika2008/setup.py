"""What the simulated calibrations of an experiment share: the machine, its sets of sensors, and the poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.read import read_sliding_platform
from bayescal.machines.readings import SlidingPlatform
from bayescal.machines.readings.schema import ReadingSensorConfig
from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.reading_machine import build_sensors, draw_poses, free_parameters, poses_about_home
from bayescal.reproductions.sika2008.schema import PathConfig, SelfCalibrationsConfig
from bayescal.reproductions.sika2008.sensor_sets import FreeParameters, SensorSet

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
    machine : SlidingPlatform
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
    machine: SlidingPlatform
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
    machine = read_sliding_platform(folder / config.machine)
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
    machine.check_poses(path, lambda k: f"path: pose {k + 1}")
    return Setup(config, folder, machine, plans, pose, targets, path)


def build_plans(
    machine: SlidingPlatform, config: SelfCalibrationsConfig, sensors: dict[str, ReadingSensorConfig]
) -> Plans:
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


def follow_path(machine: SlidingPlatform, config: PathConfig) -> Array:
    """Return poses (L, 3) of the tool's centre on a circle about home, the platform swinging to either side."""
    turn = 2.0 * np.pi * np.arange(config.n_poses) / config.n_poses
    moves = [config.radius_mm * np.cos(turn), config.radius_mm * np.sin(turn)]
    return poses_about_home(machine, np.stack([*moves, np.radians(config.angle_deg) * np.sin(turn)], axis=1))
