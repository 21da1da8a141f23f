"""What an error is a function of: never the number whose density is computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import OwnChannelRows, build_model_error
from bayescal.density.calibration.terms import ErrorModel
from bayescal.machines.readings import FunctionModel

N_ROWS = 30
SD = np.array([0.03, 0.03, 0.01, 0.01])


class Cell(ReadingMachine):
    """A force cell of two bridges with known loads."""

    member = "bridge"
    parameters = (ParameterBlock("k", (1.0, 1.0), "1"),)
    coordinates = (Coordinate("fx", "N", 0.0, 25.0), Coordinate("fy", "N", 0.0, 25.0))
    channels = (
        *(Channel(f"g[{k}]", "mV") for k in (1, 2)),
        *(Channel(one, "N", external=True) for one in ("fx", "fy")),
    )
    tool_channels = (Channel("fx", "N"), Channel("fy", "N"))

    def read(self, parameters, v, given):
        g = parameters["k"] * v
        return np.concatenate([g, np.broadcast_to(v, g.shape)], axis=-1)


@pytest.mark.parametrize("of_reading", [False, True])
def test_an_error_of_the_reading_itself_is_rewarded_for_explaining_nothing(of_reading):
    """Gains of a third beside lead errors of two thirds explain as much as gains of one: no more than that.

    As a function of the reading g, g - c g - k f is nearly zero for c near one, whatever was read.
    """
    model, rng = FunctionModel("cell", Cell(None)), np.random.default_rng(5)
    pose = rng.uniform(-25.0, 25.0, (N_ROWS, 2))
    values = model.read(model.layout.nominal, pose) + SD * rng.standard_normal((N_ROWS, 4))
    data = Measurements(tuple(map(str, range(N_ROWS))), values, np.tile(SD, (N_ROWS, 1)))
    positions = RowPositions.find(model.channels, data, model.read(model.layout.nominal, pose), np.zeros(4))
    if of_reading:
        positions = replace(positions, positions=values)
    used, reach = np.ones(N_ROWS, dtype=bool), np.array([25.0, 25.0, 0.0, 0.0])
    own = OwnChannelRows.find(model, data, pose, used, positions, reach)
    own = replace(own, covered=~np.eye(2, dtype=bool))  # lead errors alone, no couplings
    errors = ErrorModel(build_model_error(own, 4, ("linear",), (0.01, 0.02), {}, each=False))
    likelihood = CalibrationLikelihood(model, data, 50.0**2, pose)
    sizes = np.linspace(0.0, 6.0, 40)[:, None]  # up to many times the range
    right = likelihood.density(np.ones((1, 2)), errors, np.array([[-3.0]]))[0]
    wrong = likelihood.density(np.full((len(sizes), 2), 0.3), errors, sizes).max()
    assert (wrong > right) == of_reading
