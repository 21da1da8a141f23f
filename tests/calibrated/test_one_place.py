"""A machine calibrated at two places in a row is commanded at one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import studies
from calibrated_readings import Planned, calibrate

from bayescal.calibrated.one_place import take_one_place
from bayescal.calibrated.predict import compensate_poses, predict_poses
from bayescal.machines.read import read_reading_model


@pytest.fixture
def printer(rng):
    model = read_reading_model(studies.EXPERIMENTS / "flsun_v400" / "machine.toml")
    tolerances = {"r": 1.0, "l": 1.0, "e": 1.0}
    noise = {"s": 5e-3, "height": 0.02, "distance": 0.04}
    half = model.pose_scale
    return calibrate(Planned(model, tolerances, noise, model.home_pose - half, model.home_pose + half, {}), 40, rng)


def test_commands_of_one_place_lead_where_those_of_both_do(printer):
    one = take_one_place(printer)
    assert one.model.commanded == ("s[1]", "s[2]", "s[3]")
    assert one.measured.shape == (80, 3)
    both, alone = predict_poses(printer, printer.measured), predict_poses(one, printer.measured[:, :3])
    np.testing.assert_allclose(alone.tool, both.tool, atol=1e-9)
    np.testing.assert_allclose(alone.covariance, both.covariance, rtol=1e-6, atol=1e-12)
    commands = compensate_poses(one, alone.tool).commands
    np.testing.assert_allclose(commands, printer.measured[:, :3], atol=1e-9)


def test_other_machines_are_as_they_are(printer):
    one = take_one_place(printer)
    assert take_one_place(one) is one
    with_functions = replace(printer, functions=SimpleNamespace())
    assert take_one_place(with_functions) is with_functions
