"""Errors of sensors that are functions of what they read: their prior from the config."""

from __future__ import annotations

from itertools import product

import numpy as np

from bayescal.density.calibration.functions import FunctionErrors, Travel
from bayescal.errors import InputError, name_faults
from bayescal.experiments.self_calibration.schema import ReadingVariantConfig, SelfCalibrationConfig
from bayescal.experiments.shared.function_errors import check_functions
from bayescal.experiments.shared.reading_machine import poses_about_home
from bayescal.experiments.shared.sensor_sets import SensorSet
from bayescal.machines.readings import SlidingPlatform
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

MARGIN = 1.05  # of the largest travel of all readings, up to where functions are told


def build_functions(
    config: SelfCalibrationConfig, section: ReadingVariantConfig, sensors: SensorSet, readings: Array
) -> FunctionErrors:
    """Return the prior of the errors of a variant's sensors, whose readings are (P, K), those kept back too.

    Raises
    ------
    InputError
        For an unknown sensor, a variant without any of those named, and functions that change too fast.
    """
    model, wanted = sensors.model, config.model_error
    assert isinstance(model, SlidingPlatform)
    places = np.flatnonzero(_is_wanted(config, section, sensors))
    home = sensors.read(model.layout.nominal, np.array(model.home))[places]
    travel = np.nanmax(np.abs(sensors.read(model.layout.nominal, _list_ends(config, model))[:, places] - home), axis=0)
    channels = [model.channels[sensors.chosen[k]] for k in places]
    owners = [channel.name if wanted.kernel_per_leg else channel.kind for channel in channels]
    labels = tuple(dict.fromkeys(owners))
    units = tuple(channels[owners.index(label)].unit for label in labels)
    size = {"mm": wanted.kernel_scale_um * MICROMETRE, "rad": wanted.kernel_scale_arcsec * ARCSECOND}
    with name_faults("model_error.kernel_length"):
        functions = FunctionErrors(
            kernel=wanted.name_for(section),
            length=wanted.length_for(section),
            lengths=wanted.lengths_for(section),
            places=places,
            travel=Travel("reading", places, home, travel),
            reach=MARGIN * max(1.0, float(np.abs((readings[:, places] - home) / travel).max())),
            group=np.array([labels.index(owner) for owner in owners]),
            scale=np.array([size[unit] for unit in units]),
            spread=wanted.kernel_spread,
            labels=labels,
            scale_units=units,
        )
    check_functions(functions, *readings.shape)
    return functions


def _list_ends(config: SelfCalibrationConfig, model: SlidingPlatform) -> Array:
    """Return the ends of the workspace and what is half way between them, poses (27, 3), some out of reach."""
    size = config.workspace
    half = np.array([size.position_mm, size.position_mm, np.radians(size.angle_deg)])
    return poses_about_home(model, half * np.array(list(product([-1.0, 0.0, 1.0], repeat=3))))


def _is_wanted(config: SelfCalibrationConfig, section: ReadingVariantConfig, sensors: SensorSet) -> np.ndarray:
    """Return which sensors of a variant may err so, a mask (K,)."""
    model, names = sensors.model, config.model_error.kernel_sensors
    if names is None:
        return np.array([not model.channels[k].external for k in sensors.chosen])
    try:
        found = np.isin(sensors.chosen, model.select(names))
    except InputError as error:
        raise InputError(f"model_error.kernel_sensors: {error}") from error
    if not found.any():
        raise InputError(
            f"variant {section.name!r}: model_error.kernel_sensors: found {', '.join(names)}, expected some of "
            f"{', '.join(sensors.names)}"
        )
    return found
