"""Aligning base and tool takes away their motions and nothing else: in a plane, in space, with turns and without."""

from __future__ import annotations

from dataclasses import replace

import calibrations
import numpy as np
import pytest
import reading_machines
import studies

from bayescal.identifiability.alignment import find_alignment
from bayescal.machines.read import read_reading_model
from bayescal.numerics.geometry import matrix_from_rotation_vector

M2 = studies.EXPERIMENTS / "sliding_star" / "m2_hexapod_machine.toml"
BASE, TOOL = np.array([0.2, -0.1, 0.4, 1e-3, -2e-3, 3e-3]), np.array([-0.3, 0.5, 0.1, 2e-3, 1e-3, -4e-3])


def align(model, pose):
    place = model.tool_values(model.layout.nominal, pose)
    return place, find_alignment(model, place, pose)


def move(position, rotation):
    """Return what a motion of the base and one of the tool make of position and turn, (W, 6), to first order."""
    shift = BASE[:3] + np.cross(BASE[3:], position) + rotation @ TOOL[:3]
    return np.concatenate([shift, BASE[3:] + rotation @ TOOL[3:]], axis=1)


@pytest.fixture
def star(rng):
    """Return the planar star, whose poses shift by 200 mm, and with them the angle of half a turn's sixth."""
    model = reading_machines.sliding_star()
    return model, model.home_pose + rng.uniform(-1.0, 1.0, (50, 3)) * [200.0, 200.0, np.pi / 6]


def test_motions_in_a_plane_are_taken_away(star):
    model, pose = star
    place, found = align(model, pose)
    assert found.motions.shape[1] == 5
    position = np.pad(place, ((0, 0), (0, 1)))
    rotation = model.rotation_in_space(pose)
    error = move(position, rotation)[:, :2] - np.cross(np.array([BASE[3], BASE[4], 0.0]), position)[:, :2]
    assert np.abs(found.remove(error[..., None])).max() < 1e-11


def test_a_scale_stays_where_nothing_turns(star):
    """Closed form: a scale s about any point leaves s (p - mean p), for it is orthogonal to shifts and to turns."""
    model, pose = star
    place, found = align(model, pose * [1.0, 1.0, 0.0])
    assert found.motions.shape[1] == 3
    scale = 2e-3 * (place - [300.0, 700.0])
    np.testing.assert_allclose(found.remove(scale[..., None])[..., 0], 2e-3 * (place - place.mean(axis=0)), atol=1e-12)


def test_motions_in_space_are_taken_away_of_whole_poses(rng):
    model = replace(read_reading_model(M2), tool_point=None)
    pose = model.home_pose + rng.uniform(-1.0, 1.0, (50, 6)) * [7.0, 7.0, 6.0, 0.5, 0.5, 0.5]
    place, found = align(model, pose)
    assert found.motions.shape[1] == 12
    error = move(place[:, :3], matrix_from_rotation_vector(pose[:, 3:]))
    assert np.abs(found.remove(error[..., None])).max() < 1e-11
    one_sided = error * [1.0, 1.0, 1.0, 1.0, 1.0, -1.0]  # of a turn about z with the wrong sign
    assert np.abs(found.remove(one_sided[..., None])[:, 5]).max() > 1e-4


def test_a_workspace_that_hardly_turns_has_no_tool_to_align(rng):
    model = read_reading_model(M2)
    pose = model.home_pose + rng.uniform(-1.0, 1.0, (50, 6)) * [7.0, 7.0, 6.0, 2e-3, 2e-3, 1e-3]
    assert align(model, pose)[1].motions.shape[1] == 6


def test_a_machine_that_says_no_rotation_has_its_base_aligned(rng):
    model = read_reading_model(calibrations.OWN_MACHINE / "machine.toml")
    pose = rng.uniform(-1.0, 1.0, (50, 3)) * [80.0, 80.0, 20.0]
    place, found = align(model, pose)
    assert found.motions.shape[1] == 6
    error = BASE[:3] + np.cross(BASE[3:], place)
    assert np.abs(found.remove(error[..., None])).max() < 1e-11


def test_a_point_has_shifts_alone():
    model = read_reading_model(calibrations.OWN_MACHINE / "machine.toml")
    _, found = align(model, np.full((20, 3), 0.1))
    assert found.motions.shape[1] == 3


def test_motions_elsewhere_are_those_of_the_same_numbers(rng):
    model = replace(read_reading_model(M2), tool_point=None)
    pose = model.home_pose + rng.uniform(-1.0, 1.0, (50, 6)) * [7.0, 7.0, 6.0, 0.5, 0.5, 0.5]
    place, found = align(model, pose)
    other = model.home_pose + rng.uniform(-1.0, 1.0, (9, 6)) * [9.0, 9.0, 8.0, 0.7, 0.7, 0.7]
    there = model.tool_values(model.layout.nominal, other)
    coefficients = found.fit(move(place[:, :3], matrix_from_rotation_vector(pose[:, 3:]))[..., None])
    expected = move(there[:, :3], matrix_from_rotation_vector(other[:, 3:]))
    np.testing.assert_allclose((found.at(there, other) @ coefficients)[..., 0], expected, atol=1e-11)
