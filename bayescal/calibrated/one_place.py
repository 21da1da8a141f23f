"""A machine that was calibrated two places in a row of the data, as it is used: at one place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.machines.readings import FunctionModel, InstrumentedMachine
from bayescal.machines.readings.places import PLACES, name_channel


def take_one_place(calibrated: CalibratedMachine) -> CalibratedMachine:
    """Return a calibrated machine as one that stands at one place, which commands and poses are of.

    Any other is returned as it is; so is one with errors that are functions of both places.
    """
    whole = calibrated.model.bare
    pair = whole.of_function
    if pair is None or pair.at_one_place is pair or calibrated.functions is not None:
        return calibrated
    one = FunctionModel(calibrated.name, pair.at_one_place)
    names = [[name_channel(channel, place).name for channel in one.channels] for place in PLACES]
    read = [k for k, name in enumerate(names[0]) if name in whole.names]
    one = one.pick(np.array(read, dtype=int))
    instruments = calibrated.model.beside
    model = InstrumentedMachine(one, tuple(instruments)) if instruments else one
    own = [name_channel(channel, PLACES[0]).name for channel in one.channels]
    places = [calibrated.model.names.index(name) for name in (*own, *model.names[len(own) :])]
    commands = [[names[k][one.sensors.index(channel)] for channel in one.channels] for k in range(len(PLACES))]
    first = [calibrated.model.commanded.index(name) for name in commands[0] if name in calibrated.model.commanded]
    also = [calibrated.model.commanded.index(name) for name in commands[1] if name in calibrated.model.commanded]
    errors, measured = calibrated.errors, calibrated.measured
    if len(first) != len(also):
        return calibrated
    shown = dict(zip(own, one.names, strict=True))
    return replace(
        calibrated,
        model=model,
        drawn=model,
        errors=replace(errors, noise=errors.noise[np.ix_(first, first)], model_variance=errors.model_variance[first]),
        measured=None if measured is None else np.concatenate([measured[:, first], measured[:, also]]),
        given={
            name: np.concatenate([calibrated.given[f"{name}_{place}"] for place in PLACES])
            for name in one.given
            if f"{name}_{PLACES[0]}" in calibrated.given
        },
        workspace=None if calibrated.workspace is None else calibrated.workspace[:, : len(one.coordinates)],
        noise=None if calibrated.noise is None else calibrated.noise[places],
        units={shown.get(name, name): unit for name, unit in calibrated.units.items() if name in shown},
    )
