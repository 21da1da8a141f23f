"""Errors of sensors that are functions of what they read: their prior from the config, and what was found of them."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayescal.density.model_error import INDEPENDENT
from bayescal.density.readings.functions import SensorFunctions
from bayescal.density.readings.likelihood import BATCH
from bayescal.density.readings.poses import SensorSet
from bayescal.density.readings.posterior import SelfCalibrationPosterior
from bayescal.density.readings.structured_posterior import StructuredReadingPosterior
from bayescal.errors import InputError
from bayescal.experiments.frame.memory import Need, check_memory
from bayescal.experiments.self_calibration.schema import ReadingVariantConfig, SelfCalibrationConfig
from bayescal.experiments.shared.reading_machine import poses_about_home
from bayescal.machines.readings import SlidingPlatform
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

if TYPE_CHECKING:
    from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant

MARGIN = 1.05  # of the largest travel of all readings, up to where functions are told
CURVE = 25
SHOWN = {"mm": (1.0 / MICROMETRE, "um"), "rad": (1.0 / ARCSECOND, "arcsec")}
INTERVAL = [0.05, 0.95]


def build_functions(
    config: SelfCalibrationConfig, section: ReadingVariantConfig, sensors: SensorSet, readings: Array
) -> SensorFunctions:
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
    functions = SensorFunctions(
        kernel=wanted.name_for(section),
        length=wanted.length_for(section),
        lengths=wanted.lengths_for(section),
        places=places,
        home=home,
        travel=travel,
        reach=MARGIN * max(1.0, float(np.abs((readings[:, places] - home) / travel).max())),
        group=np.array([labels.index(owner) for owner in owners]),
        scale=np.array([size[unit] for unit in units]),
        spread=wanted.kernel_spread,
        labels=labels,
        scale_units=units,
    )
    check_memory(_estimate(functions, len(readings)), 1)
    return functions


def _estimate(functions: SensorFunctions, n_poses: int) -> Need:
    """Return what functions take: products of their columns at every pose, matrices of all coefficients in a batch."""
    n = len(functions.places)
    r = functions.columns(np.zeros((1, int(functions.places.max()) + 1))).shape[-1]
    return Need(
        each=8.0 * (0.5 * n * (n + 1) * n_poses * r**2 + BATCH * (6.0 * (n * r) ** 2 + 4.0 * n_poses * n**2)),
        sizes=f"{n_poses} poses with {n * r} coefficients of sensors' errors",
        remedy=f"fewer poses, a longer kernel_length or kernel {INDEPENDENT!r}",
    )


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


@dataclass(frozen=True, eq=False)
class FoundFunctions:
    """What was found of the errors of F sensors, in µm and arcsec.

    Attributes
    ----------
    coefficients : ndarray, shape (T, N)
        Draws, as `SensorFunctions.evaluate` takes them, mm and rad.
    rows : list of dict
        Of each sensor: how probable its error is, its scale, its size over the calibration poses.
    curves : list of dict
        Its course over what was read.
    """

    coefficients: Array
    rows: list[dict[str, Any]]
    curves: list[dict[str, Any]]


def find_functions(
    inputs: ReadingInputs, variant: Variant, posterior: SelfCalibrationPosterior, kept: Array
) -> FoundFunctions | None:
    """Return what draws (T, n) tell of a variant's functions; None where it has none."""
    if not isinstance(posterior, StructuredReadingPosterior):
        return None
    rng = np.random.default_rng([inputs.config.seed, 9, zlib.crc32(variant.name.encode())])
    parts = np.array_split(kept, max(1, len(kept) // 100))
    coefficients = np.concatenate([posterior.absorb(part).draw(rng) for part in parts])
    functions, names = posterior.functions, variant.sensors.names
    present, scales = posterior.probability_of_error(kept), posterior.scales(kept)
    readings = posterior.likelihood.measured
    at_poses = functions.evaluate(coefficients, readings)
    grid = np.linspace(readings.min(axis=0), readings.max(axis=0), CURVE)
    along = functions.evaluate(coefficients, grid)
    rows, curves = [], []
    for k, group in zip(functions.places, functions.group, strict=True):
        factor, unit = SHOWN[functions.scale_units[group]]
        size = factor * np.sqrt(np.mean(at_poses[..., k] ** 2, axis=1))
        low, high = np.quantile(size, INTERVAL)
        rows.append(
            {
                "sensor": names[k],
                "unit": unit,
                "kernel": functions.kernel,
                "present": float(present[group]),
                **_describe_scale(functions, factor, group, scales[:, group]),
                "rms": float(size.mean()),
                "rms_low": float(low),
                "rms_high": float(high),
            }
        )
        mean, (low, high) = along[..., k].mean(axis=0), np.quantile(along[..., k], INTERVAL, axis=0)
        curves += [
            {"sensor": names[k], "unit": unit, "reading": x, "mean": m, "low": a, "high": b}
            for x, m, a, b in zip(grid[:, k], factor * mean, factor * low, factor * high, strict=True)
        ]
    return FoundFunctions(coefficients, rows, curves)


def _describe_scale(functions: SensorFunctions, factor: float, group: int, scale: Array) -> dict[str, float]:
    """Return a scale as stated and as found where there is an error, and what is left of its prior's spread."""
    there = scale[scale > 0.0]
    found = {"scale_stated": factor * float(functions.scale[group]), "scale": float("nan"), "left": float("nan")}
    if len(there) > 1:
        found["scale"] = factor * float(np.median(there))
        found["left"] = float(np.log(there).std() / functions.spread)
    return found


def tabulate_functions(found: Sequence[tuple[str, FoundFunctions]]) -> dict[str, pd.DataFrame]:
    """Return the tables of all variants with such errors; none where none has."""
    if not found:
        return {}
    return {
        "functions": pd.DataFrame([{"variant": name, **row} for name, one in found for row in one.rows]),
        "function_curves": pd.DataFrame([{"variant": name, **row} for name, one in found for row in one.curves]),
    }
