"""Candidates of a reverification are led to where the ball sits in one socket or another, within the workspace."""

from __future__ import annotations

from dataclasses import replace

import calibrated_machines as made_up
import numpy as np
import pandas as pd
import pytest
from refusals import line_of
from serial_arms import PANDA, build_arm

from bayescal.calibrated.machine import CommandErrors, build_calibrated
from bayescal.calibrated.predict import bound_workspace
from bayescal.calibrated.tables import read_commands
from bayescal.calibrated.verify.plan import (
    VerificationGoal,
    expect_readings,
    format_plan,
    lead_to_contacts,
    list_candidates,
    plan_reverification,
)
from bayescal.calibrated.verify.statistics import choose_suspects
from bayescal.machines.readings import FunctionModel, place
from bayescal.machines.readings.sockets import SocketConfig, SocketInstrument

ENCODER, BALL = 1e-4, 0.02  # rad, mm


@pytest.fixture(scope="module")
def arm():
    bare = FunctionModel("panda", build_arm(PANDA.read_text(), tip="ball_link"))
    apart = np.array([[0.0] * 7, [0.3, 0.2, -0.2, 0.3, 0.1, -0.2, 0.0]])
    balls = bare.tool_values(bare.layout.nominal, bare.home_pose + apart)[:, :3]
    sockets = {f"socket{k}": SocketInstrument(SocketConfig(place_mm=list(one))) for k, one in enumerate(balls, start=1)}
    model, rng = place(bare, sockets), np.random.default_rng(3)
    free = np.array([name.startswith("offset") or "_place" in name for name in model.layout.names])
    sizes = np.where(np.array(model.layout.units) == "mm", 0.05, 1e-4)
    draws = model.layout.nominal + free * sizes * rng.standard_normal((400, len(sizes)))
    errors = CommandErrors(np.eye(7) * ENCODER**2, np.zeros(7))
    found = build_calibrated(model, model.layout.nominal, draws, errors, made_up.SOURCE)
    return replace(found, noise=np.array([ENCODER] * 7 + [BALL] * 6))


def test_balls_sit_in_sockets_in_turns(arm, tmp_path):
    model, anywhere = arm.model, list_candidates(arm, 0.9)
    commands, given, planned, touching = lead_to_contacts(arm, *anywhere, expect_readings(arm.noise))
    pose, found = model.locate(arm.theta, commands)
    assert found.all()
    low, high = bound_workspace(arm)
    assert ((pose >= low - 1e-9) & (pose <= high + 1e-9)).all()
    read = model.read(arm.theta, pose)
    assert min(touching.count(name) for name in model.contacts) >= 20
    for name in model.contacts:
        own = np.array(touching) == name
        places = model.instrument_places[name]
        np.testing.assert_allclose(read[np.ix_(own, places)], 0.0, atol=1e-5)
        np.testing.assert_array_equal(planned.present[:, places], np.tile(own[:, None], 3))
    suspects = choose_suspects(arm, ["offset"])
    shift = np.full(len(suspects.names), 0.01)
    suspects = suspects.pick(np.array([name not in ("offset[1]", "offset[7]") for name in suspects.names]))
    goal = VerificationGoal(shift[: len(suspects.names)])
    plan = plan_reverification(arm, suspects, commands, given, planned, goal)
    (tmp_path / "plan.csv").write_text(format_plan(arm, plan, "A plan", "Touch each", touching))
    table = pd.read_csv(tmp_path / "plan.csv", comment="#")
    assert list(table["instruments"]) == [touching[k] for k in plan.chosen]
    np.testing.assert_allclose(read_commands(tmp_path / "plan.csv", arm)[1], commands[plan.chosen], atol=1e-6)


def test_a_socket_that_is_not_read_is_not_touched(arm):
    anywhere, model = list_candidates(arm, 0.9), arm.model
    first = np.where(np.arange(13) < 10, arm.noise, np.nan)
    assert {*lead_to_contacts(arm, *anywhere, expect_readings(first))[3]} == {"socket1"}
    none = expect_readings(np.where(np.arange(13) < 7, arm.noise, np.nan))
    assert lead_to_contacts(arm, *anywhere, none)[0] is anywhere[0]
    home = model.home_pose
    narrow = replace(arm, workspace=np.stack([home + 1.0, home + 1.01]))
    said = line_of(lead_to_contacts, narrow, *anywhere, expect_readings(arm.noise))
    assert "touches socket1 or socket2" in said
