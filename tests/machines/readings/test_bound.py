"""Readings bound to poses that stay against those of the machine, and an instrument whose frames are free."""

from __future__ import annotations

from dataclasses import replace

import hexapods
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.machines.models import MODELS
from bayescal.machines.readings import Legs, Tracker
from bayescal.machines.readings.placed import place
from bayescal.machines.readings.tracker import move_frames
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector, rotation_vector_from_matrix

N_POSES, B = 7, 4
PROBE = np.array([[100.0, 0.0, 40.0], [-60.0, 80.0, 20.0], [-50.0, -90.0, 60.0]])
OFF = 2e-3  # mm, that encoders are off, and hundredths of it in other units


def build_legs(model):
    """Return the telescope or its struts with a K that couples the legs."""
    return Legs(machines.build_machine("matrix", model=model))


def build_tracker(points):
    """Return a hexapod that two stations see."""
    legs = Legs(machines.build_machine("none", hexapods.load_hexapod("m2"), "six_ups"))
    seen = [(k % 2, one) for k, one in enumerate(PROBE)] if points else [(0, None), (1, None)]
    found = place(legs, {"": Tracker(("A", "B"), seen)})
    return found.pick(np.array([one.name not in ("x", "y", "z", "rx", "ry", "rz") for one in found.channels]))


CASES = {model: lambda model=model: build_legs(model) for model in MODELS}
CASES |= {f"{model} with gains": lambda model=model: build_legs(model).with_optional(["gain"]) for model in MODELS}
CASES |= {"tracker of poses": lambda: build_tracker(False), "tracker of points": lambda: build_tracker(True)}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """Return a machine, machines near one another (B, D), poses, and readings near what those read there."""
    model, rng = CASES[request.param](), np.random.default_rng(4)
    layout = model.layout
    scale = np.array([1.0 if unit == "mm" else 1e-2 for unit in layout.units])
    mine = machines.spread_of(model.whole.machine.layout if hasattr(model, "whole") else model.machine.layout)
    scale[: len(mine)] = mine
    theta = layout.nominal + 0.3 * scale * rng.standard_normal(layout.size)
    near = theta + 1e-3 * scale * rng.standard_normal((B, layout.size))
    near[0] = theta
    reach = np.array([one.reach for one in model.coordinates])
    home = model.whole.home_pose if hasattr(model, "whole") else model.home_pose
    pose = home + 0.3 * reach * rng.uniform(-1, 1, (N_POSES, 6))
    units = np.array([1.0 if one.unit == "mm" else 1e-2 for one in model.channels])
    values = model.read(theta, pose) + OFF * units * rng.standard_normal((N_POSES, len(model.channels)))
    return model, near, pose, values


def test_bound_readings_are_those_of_the_machine(case):
    """To first order in how far readings are off: exact for the machine that is bound, and in parts for others."""
    model, near, pose, values = case
    bound = model.bind(near[0], values, pose)
    exact = model.read(near[:, None], pose)[..., bound.places].transpose(2, 1, 0)
    off = np.abs(bound.read(near) - exact)
    change = np.abs(exact - exact[..., :1]).max()
    assert change > 1e-4
    assert off[..., 0].max() < 1e-6
    assert off.max() < 2e-3 * change


def test_they_follow_parameters_and_poses(case):
    model, near, pose, values = case
    bound = model.bind(near[0], values, pose)
    here = model.linearise(near[1], pose)
    by_pose, by_parameters = bound.differentiate(near[1])
    places = bound.places
    units = np.array([1.0 if one.unit == "mm" else 1e-2 for one in model.channels])[places, None]
    sizes = np.array([1.0] * 3 + [1e-2] * 3), np.abs(near[2] - near[0]) / 1e-3
    pairs = (by_pose, here.by_pose[:, places]), (by_parameters, here.by_parameters[:, places])
    for (found, whole), size in zip(pairs, sizes, strict=True):
        assert np.abs(whole * size / units).max() > 0.1
        np.testing.assert_allclose(found * size / units, whole * size / units, rtol=0, atol=0.02)
    bound.read(near)  # of which it follows
    step = 1e-3 * np.random.default_rng(2).standard_normal((6, N_POSES, B)) * ([[[1.0]]] * 3 + [[[1e-2]]] * 3)
    moved = pose + step.transpose(2, 1, 0)
    change = (model.read(near[:, None], moved) - model.read(near[:, None], pose))[..., places].transpose(2, 1, 0)
    assert np.abs(change).max() > 1e-4
    np.testing.assert_allclose(bound.follow(step), change, rtol=0, atol=2e-3 * np.abs(change).max())


def test_legs_without_an_encoder_or_with_inclinometers_bind_nothing():
    model = build_legs("six_pus")
    pose = np.tile(model.home_pose, (3, 1))
    values = model.read(model.layout.nominal, pose)
    missing = values.copy()
    missing[0, 0] = np.nan
    assert model.bind(model.layout.nominal, missing, pose) is None
    inclined = replace(model, inclined=True, channels=())
    inclined = replace(inclined, channels=inclined.sensors)
    every = inclined.read(inclined.layout.nominal, pose)
    assert inclined.bind(inclined.layout.nominal, every, pose) is None


# --- frames ----------------------------------------------------------------------------------------------------------


def test_a_tracker_sees_what_moves_with_its_frames(rng):
    model = build_tracker(False)
    theta = model.layout.nominal.copy()
    frames = rng.standard_normal(18) * np.tile(np.repeat([2.0, 0.2], 3), 3)
    theta[-18:] = frames
    assert model.layout.names[-18:][::6] == ("base1_x", "base2_x", "tool_x")
    pose = model.whole.home_pose + rng.uniform(-1, 1, (N_POSES, 6)) * ([5.0] * 3 + [0.1] * 3)
    read = model.read(theta, pose)[:, 6:]
    rotation = matrix_from_rotation_vector(pose[:, 3:])
    for k in range(2):
        pair = np.concatenate([frames[6 * k : 6 * k + 6], frames[12:]])
        place_seen, turned = move_frames(pair, pose[:, :3], rotation)
        found = read[:, 6 * k : 6 * k + 6]
        error = compute_pose_error(found[:, :3], matrix_from_rotation_vector(found[:, 3:]), place_seen, turned)
        np.testing.assert_allclose(error, 0.0, atol=1e-9)
    whole = model.read(theta, pose)[:, 6:12]
    assert np.abs(rotation_vector_from_matrix(rotation) - whole[:, 3:]).max() > 1e-2
    points = build_tracker(True).read(theta, pose)[:, 6:].reshape(N_POSES, 3, 3)
    for k, point in enumerate(PROBE):
        pair = np.concatenate([frames[6 * (k % 2) : 6 * (k % 2) + 6], frames[12:]])
        place_seen, turned = move_frames(pair, pose[:, :3], rotation)
        np.testing.assert_allclose(points[:, k], place_seen + turned @ point, atol=1e-9)
