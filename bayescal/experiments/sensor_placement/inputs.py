"""From a config to what sensor placement computes with: a machine, what may be bought, poses and workspace."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from bayescal.errors import InputError
from bayescal.experiments.sensor_placement.schema import PlacementConfig, PlacementMachineConfig, PlacementSensorConfig
from bayescal.experiments.shared.reading_machine import build_sensors, poses_about_home, tolerance_of
from bayescal.experiments.shared.sensor_sets import SensorSet
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import check_home_pose
from bayescal.machines.read import build_named_machine, load_mechanism, read_sliding_platform
from bayescal.machines.readings import Legs, ReadingModel, SlidingPlatform
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

MOST_CHOICES = 16  # 65,535 sets
ORIGIN = [0.0, 0.0, 0.0]


@dataclass(frozen=True, eq=False)
class Choice:
    """What may be bought: one sensor, or an instrument with several readings.

    Attributes
    ----------
    name : str
    channels : ndarray of int
        Where its readings stand among all of the machine.
    price : float
    always : bool
        Whether it is in every set.
    """

    name: str
    channels: np.ndarray
    price: float
    always: bool

    @property
    def kind(self) -> str:
        """What its name starts with."""
        return self.name.partition("[")[0]

    @property
    def leg(self) -> str:
        """The leg it stands on, empty for an instrument."""
        return self.name.partition("[")[2].rstrip("]")


@dataclass(frozen=True, eq=False)
class PlacementInputs:
    """What an experiment computes with.

    Attributes
    ----------
    config : PlacementConfig
    model : SlidingPlatform or Legs
    choices : tuple of Choice
    sensors : SensorSet
        All readings that any choice has.
    pose : ndarray, shape (P, q)
        Poses of the calibration.
    workspace : ndarray, shape (W, q)
        Poses at which the tool's centre counts.
    """

    config: PlacementConfig
    model: SlidingPlatform | Legs
    choices: tuple[Choice, ...]
    sensors: SensorSet
    pose: Array
    workspace: Array

    @cached_property
    def free(self) -> np.ndarray:
        """Where the parameters stand that some listed sensor sees, but for the frames where these are given."""
        layout = self.model.layout
        given = self.model.frame_parameters() if self.config.frames == "given" else ()
        return np.array([k for k, name in enumerate(layout.names) if name in self._seen and name not in given])

    @cached_property
    def _seen(self) -> set[str]:
        return set(self.model.seen_parameters(self.sensors.names))

    @cached_property
    def tolerances(self) -> Array:
        """Standard deviations beforehand of the free parameters, shape (n,), mm and rad."""
        layout = self.model.layout
        return np.array([tolerance_of(layout.names[k], layout.units[k], self.config.tolerances) for k in self.free])

    @cached_property
    def members(self) -> np.ndarray:
        """Which of the sensors each choice has, shape (C, K), bool."""
        return np.array([np.isin(self.sensors.chosen, choice.channels) for choice in self.choices])

    @property
    def optional(self) -> np.ndarray:
        """Which choices are not in every set, shape (k,)."""
        return np.array([k for k, choice in enumerate(self.choices) if not choice.always], dtype=int)

    def enumerate_sets(self) -> np.ndarray:
        """Return which choices each set has, shape (S, C), bool: all sets but the empty one."""
        optional = self.optional
        bits = (np.arange(2 ** len(optional))[:, None] >> np.arange(len(optional))) & 1
        sets = np.ones((len(bits), len(self.choices)), dtype=bool)
        sets[:, optional] = bits.astype(bool)
        return sets[sets.any(axis=1)]

    def set_of(self, names: list[str]) -> np.ndarray:
        """Return the set of named choices or kinds, with those that are always there, shape (C,), bool."""
        result = np.array([choice.always for choice in self.choices])
        for name in names:
            found = [k for k, choice in enumerate(self.choices) if name in (choice.name, choice.kind)]
            if not found:
                known = ", ".join(choice.name for choice in self.choices)
                raise InputError(f"sensor {name!r}: unknown here, expected some of {known}")
            result[found] = True
        return result


def read_placement(config: PlacementConfig, folder: Path) -> PlacementInputs:
    """Return what an experiment computes with.

    Raises
    ------
    InputError
        For anything at fault in the config or its files: an unknown sensor, one without noise, more sensors than can
        be enumerated, a pose that cannot be reached or at which legs cross.
    """
    model = build_model(config.machine, folder)
    choices = list_choices(model, config)
    noise = {name: s for name, s in config.sensors.items() if s.reads is None}
    noise |= {part: s for s in config.sensors.values() for part in s.reads or ()}
    channels = np.sort(np.concatenate([choice.channels for choice in choices]))
    sensors = build_sensors(model, noise, [model.names[k] for k in channels])
    width = half_widths(model, config)
    rng = np.random.default_rng([config.seed, 0])
    pose = displace(model, width * rng.uniform(-1.0, 1.0, (config.poses.n_poses, len(width))))
    model.check_poses(pose)
    even = 2.0 * qmc.Halton(len(width), scramble=False).random(config.workspace_poses + 1)[1:] - 1.0
    workspace = displace(model, width * even)
    model.check_poses(workspace, lambda k: f"workspace pose {k + 1}")
    inputs = PlacementInputs(config, model, choices, sensors, pose, workspace)
    for names in config.named.values():
        inputs.set_of(names)
    return inputs


def build_model(config: PlacementMachineConfig, folder: Path) -> SlidingPlatform | Legs:
    """Return the machine of a config; InputError where there is none."""
    path = folder / config.file
    if config.model is None:
        return read_sliding_platform(path)
    mechanism = load_mechanism(path)
    zero = NominalDeformation(0.0, lambda: np.zeros((mechanism.n_legs,) * 2))
    machine = build_named_machine(mechanism, path, config.model, config.deformation, zero, "machine", folder)
    if machine.deformation.uses_matrix:
        raise InputError(f"{path}: machine.deformation: found 'matrix', expected 'linear' or 'none'")
    check_home_pose(machine)
    return Legs(machine, np.array(ORIGIN if config.tool_mm is None else config.tool_mm), inclined=True)


def list_choices(model: ReadingModel, config: PlacementConfig) -> tuple[Choice, ...]:
    """Return what may be bought, kinds spread over the legs.

    Raises
    ------
    InputError
        For an unknown sensor, a reading that is listed twice, and more choices than can be enumerated.
    """
    choices: list[Choice] = []
    single = {name for name in config.sensors if "[" in name}
    for name, section in config.sensors.items():
        choices += _choices_of(model, name, section, single)
    taken = np.concatenate([choice.channels for choice in choices])
    for k in taken:
        if (taken == k).sum() > 1:
            raise InputError(f"sensors: found {model.names[k]} twice, expected each reading once")
    n = sum(not choice.always for choice in choices)
    if n > MOST_CHOICES:
        raise InputError(
            f"sensors: found {n} to choose from, which makes {2.0**n:.1e} sets, expected at most {MOST_CHOICES}; "
            "those that are always there do not count, nor do readings of one instrument"
        )
    return tuple(choices)


def _choices_of(model: ReadingModel, name: str, section: PlacementSensorConfig, single: set[str]) -> list[Choice]:
    """Return the choices of one entry; legs that have an entry of their own are left out of their kind's."""
    if section.reads is not None:
        return [Choice(name, model.select(section.reads), section.price, section.always)]
    channels = [k for k in model.select([name]) if model.names[k] == name or model.names[k] not in single]
    return [Choice(model.names[k], np.array([k]), section.price, section.always) for k in channels]


def half_widths(model: SlidingPlatform | Legs, config: PlacementConfig) -> Array:
    """Return the half widths of the workspace, shape (q,), mm and rad; InputError where they are of another machine."""
    poses = config.poses
    if isinstance(model, SlidingPlatform):
        if poses.angle_deg is None:
            raise InputError("poses: found three rotations, expected position_mm with angle_deg of a planar platform")
        assert isinstance(poses.position_mm, float)
        return np.array([poses.position_mm, poses.position_mm, np.radians(poses.angle_deg)])
    if poses.rotation_deg is None:
        raise InputError("poses: found one angle, expected three position_mm with three rotation_deg")
    assert isinstance(poses.position_mm, list)
    return np.array([*poses.position_mm, *np.radians(poses.rotation_deg)])


def displace(model: SlidingPlatform | Legs, displacement: Array) -> Array:
    """Return the poses (P, q) at displacements from home (P, q), mm and rad."""
    if isinstance(model, SlidingPlatform):
        return poses_about_home(model, displacement)
    turned = matrix_from_rotation_vector(displacement[:, 3:]) @ model.rotation(model.home_pose)
    return np.concatenate([model.home_pose[:3] + displacement[:, :3], rotation_vector_from_matrix(turned)], axis=1)
