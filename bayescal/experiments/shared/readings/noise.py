"""Noise of the readings: as stated in the config or beside each reading, and what of it is unknown."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayescal.density.calibration.terms import ErrorTerm, ModelErrorTerm, NoiseFactor
from bayescal.errors import InputError, say_unknown
from bayescal.experiments.shared.readings.priors import spread_over_legs
from bayescal.experiments.shared.readings.reading_tables import PoseReadings
from bayescal.experiments.shared.readings.schema import NOISE_UNITS, ChannelConfig
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.machines.readings import Channel, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import units_like


def stated_noise(sensors: Mapping[str, ChannelConfig], readings: PoseReadings, model: ReadingModel) -> Array:
    """Return the deviations of all readings, (P, K), in the channels' units: their own, or those of the config.

    Raises
    ------
    InputError
        For an unknown channel, a noise in a unit of another kind, or a list of another length.
    """
    result = readings.sd.copy()
    for name, section in sensors.items():
        places = model.select([name])
        field = next(one for one in ("noise", *NOISE_UNITS) if getattr(section, one) is not None)
        values = spread_over_legs(getattr(section, field), len(places), f"sensors.{name}")
        for place, value in zip(places, values, strict=True):
            factor = _factor(name, model.channels[place], field) if value > 0.0 else 1.0  # zero has no unit
            missing = ~np.isfinite(result[:, place])
            result[missing, place] = factor * value
    return result


def noise_of_channels(sensors: Mapping[str, ChannelConfig], model: ReadingModel) -> Array:
    """Return what the config says of each channel, (K,); NaN where it says nothing."""
    nothing = np.full((1, len(model.channels)), np.nan)
    empty = PoseReadings(("",), np.zeros(1, dtype=bool), nothing, nothing.copy(), None, np.zeros(nothing.shape, bool))
    return stated_noise(sensors, empty, model)[0]


def _factor(name: str, channel: Channel, field: str) -> float:
    if field == "noise":
        if channel.unit in ("mm", "rad"):
            expected = " or ".join(one for one, unit in NOISE_UNITS.items() if unit in units_like(channel.unit))
            raise InputError(f"sensors.{name}: found no unit of noise, expected {expected}")
        return 1.0
    units = units_like(channel.unit)
    if NOISE_UNITS[field] not in units:
        raise InputError(f"sensors.{name}: found {field}, expected a noise in {channel.unit}, which {name} reads in")
    return units[NOISE_UNITS[field]]


def build_noise(
    config: StudyConfig, section: VariantConfig, model: ReadingModel, chosen: np.ndarray
) -> tuple[ErrorTerm, ...]:
    """Return what of the noise of the chosen channels is unknown; InputError for a group that no channel belongs to."""
    groups = group_channels(config, model)
    for table, stated in (("noise_factor_log_sd", config.noise_factor_log_sd), ("model_error", config.channel_errors)):
        for name in stated:
            if name not in groups:
                raise InputError(say_unknown(table, name, dict.fromkeys(filter(None, groups))))
    if section.noise_known:
        return ()
    members = {name: np.array([groups[k] == name for k in chosen]) for name in groups}
    factors = [
        NoiseFactor(name, members[name], sd) for name, sd in config.noise_factor_log_sd.items() if members[name].any()
    ]
    errors = []
    for name, one in config.channel_errors.items():
        units = {c.unit for g, c in zip(groups, model.channels, strict=True) if g == name}
        if members[name].any() and len(units) > 1:
            raise InputError(f"model_error.{name}: found several units, expected one")
        if members[name].any():
            errors.append(ModelErrorTerm(name, members[name], one.scale, units.pop()))
    return (*factors, *errors)


def group_channels(config: StudyConfig, model: ReadingModel) -> list[str]:
    """Return the group of each channel, empty for those without noise."""
    result = []
    for channel in model.channels:
        section = config.sensors.get(channel.name, config.sensors.get(channel.kind))
        result.append("" if section is None else section.noise_group or channel.kind)
    return result
