"""From the sections of a config to machine, sensors, tolerances and poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.readings import ReadingModel, SlidingPlatform
from bayescal.machines.readings.schema import (
    PlanarPosesConfig,
    ReadingSensorConfig,
    ReadingTolerancesConfig,
)
from bayescal.machines.readings.sliding_platform import matrix_of_angle
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from bayescal.reproductions.sika2008.sensor_sets import FreeParameters, SensorSet

ZEROS = ("phi0", "psi0", "tilt_a0", "tilt_b0")


def build_sensors(
    model: ReadingModel, sensors: Mapping[str, ReadingSensorConfig], names: Iterable[str] | None = None
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


def sensor_config(name: str, sensors: Mapping[str, ReadingSensorConfig]) -> ReadingSensorConfig:
    """Return the config of one sensor; InputError where it has none."""
    found = sensors.get(name, sensors.get(name.partition("[")[0]))
    if found is None:
        raise InputError(f"sensor {name}: found no noise, expected an entry in [sensors]")
    return found


def _noise(model: ReadingModel, place: int, sensors: Mapping[str, ReadingSensorConfig]) -> float:
    channel = model.channels[place]
    config = sensor_config(channel.name, sensors)
    if channel.unit == "mm":
        if config.noise_um is None:
            raise InputError(f"sensors.{channel.name}: found noise_arcsec, expected noise_um, for it reads a length")
        return config.noise_um * MICROMETRE
    if config.noise_arcsec is None:
        raise InputError(f"sensors.{channel.name}: found noise_um, expected noise_arcsec, for it reads an angle")
    return config.noise_arcsec * ARCSECOND


def free_parameters(
    model: SlidingPlatform, names: Iterable[str], tolerances: ReadingTolerancesConfig
) -> FreeParameters:
    """Return what a calibration with some sensors frees: what they see, but for what defines the frames.

    An instrument beside the machine would define the base frame too; here it is taken to be set up in that frame.
    """
    layout, given = model.layout, model.frame_parameters()
    free = [name for name in model.seen_parameters(names) if name not in given]
    places = np.array([layout.names.index(name) for name in free], dtype=int)
    scale = [tolerance_of(name, layout.units[k], tolerances) for name, k in zip(free, places, strict=True)]
    return FreeParameters(places, layout.nominal, np.array(scale))


def tolerance_of(name: str, unit: str, tolerances: ReadingTolerancesConfig) -> float:
    """Return the standard deviation of a parameter beforehand, mm or rad."""
    if unit == "mm":
        return tolerances.length_mm
    zero = name.partition("[")[0] in ZEROS
    return float(np.radians(tolerances.zero_deg if zero else tolerances.angle_deg))


def draw_poses(model: SlidingPlatform, config: PlanarPosesConfig, rng: np.random.Generator) -> Array:
    """Return poses (P, 3) whose tool's centre and angle lie within half widths of home.

    Raises
    ------
    InputError
        For a pose that a leg cannot reach or at which two legs cross.
    """
    width = np.array([config.position_mm, config.position_mm, np.radians(config.angle_deg)])
    pose = poses_about_home(model, width * rng.uniform(-1.0, 1.0, (config.n_poses, 3)))
    model.check_poses(pose)
    return pose


def poses_about_home(model: SlidingPlatform, displacement: Array) -> Array:
    """Return poses (P, 3) from displacements of the tool's centre and angle from home (P, 3), mm and rad."""
    angle = model.home[2] + displacement[:, 2]
    home = model.home[:2] + matrix_of_angle(model.home[2:])[0] @ model.tool_point
    origin = home + displacement[:, :2] - np.einsum("pij,j->pi", matrix_of_angle(angle), model.tool_point)
    return np.concatenate([origin, angle[:, None]], axis=1)
