"""Frames and points in closed form against those that made the readings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bayescal.machines.readings import closed_forms

FRAME = np.array([2310.0, -1479.0, 655.0]), Rotation.from_rotvec([-0.1, 0.4, 2.6]).as_matrix()
TOOL = np.array([30.0, -12.0, 95.0]), Rotation.from_rotvec([0.3, -1.1, 0.2]).as_matrix()


def draw_tools(rng, n=20):
    return rng.uniform(-200.0, 200.0, (n, 3)), Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (n, 3))).as_matrix()


def see(points):
    return (points - FRAME[0]) @ FRAME[1]


def test_a_frame_of_points_is_found_with_an_outlier_and_gaps(rng):
    points, _ = draw_tools(rng)
    seen = see(points)
    seen[3] += [50.0, 0.0, 0.0]
    seen[5, 1] = np.nan
    (position, axes), mirrored = closed_forms.fit_point_frame(points, seen)
    np.testing.assert_allclose(position, FRAME[0], atol=1e-8)
    np.testing.assert_allclose(axes, FRAME[1], atol=1e-10)
    assert not mirrored


@pytest.mark.parametrize("change", [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
def test_a_left_handed_frame_is_one(rng, change):
    points, _ = draw_tools(rng)
    seen = see(points) + 0.3 * rng.standard_normal(points.shape)
    (_, axes), mirrored = closed_forms.fit_point_frame(points, seen * change)
    assert mirrored
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert closed_forms.fit_point_frame(points, seen[:, [1, 0, 2]])[1]


def test_points_of_a_plane_have_no_hand(rng):
    points, _ = draw_tools(rng)
    points[:, 2] = 0.0
    assert not closed_forms.fit_point_frame(points, see(points) * [-1.0, 1.0, 1.0])[1]


def test_frames_of_hand_and_eye_are_found_together(rng):
    position, rotation = draw_tools(rng)
    seen = see(position + rotation @ TOOL[0])
    turned = FRAME[1].T @ rotation @ TOOL[1]
    eye, hand = closed_forms.fit_hand_eye(position, rotation, seen, turned)
    for found, true in zip((*eye, *hand), (*FRAME, *TOOL), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-8)


def test_a_tool_that_does_not_turn_tells_no_two_frames(rng):
    position, _ = draw_tools(rng)
    rotation = np.tile(np.eye(3), (len(position), 1, 1))
    assert closed_forms.fit_hand_eye(position, rotation, see(position), FRAME[1].T @ rotation) is None


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("zero", [0.0, 37.5])
def test_an_anchor_is_found_from_distances(rng, flat, zero):
    points, _ = draw_tools(rng)
    points[:, 2] *= not flat
    anchor = np.array([310.0, -420.0, 250.0])
    seen = np.linalg.norm(points - anchor, axis=1) - zero
    found = closed_forms.fit_anchor(points, seen, True)
    assert len(found) == 1 + flat
    assert min(np.abs(one - [*anchor, zero]).max() for one in found) < 1e-5
    assert min(np.abs(one - anchor).max() for one in closed_forms.fit_anchor(points, seen + zero, False)) < 1e-6


def test_turns_are_the_24_of_a_cube():
    turns = closed_forms.list_turns(np.array([0.1, -0.2, 0.3]))
    matrices = Rotation.from_rotvec(turns).as_matrix()
    assert len(turns) == 24
    np.testing.assert_allclose(turns[0], [0.1, -0.2, 0.3], atol=1e-12)
    assert min(np.abs(a - b).max() for k, a in enumerate(matrices) for b in matrices[:k]) > 0.5


def test_an_anchor_is_found_by_a_bar_of_one_length(rng):
    anchor, way = np.array([310.0, -420.0, 250.0]), rng.standard_normal((20, 3))
    points = anchor + 150.0 * way / np.linalg.norm(way, axis=1, keepdims=True)
    for reading in (0.0, 150.0):
        (found,) = closed_forms.fit_anchor(points, np.full(20, reading), True)
        np.testing.assert_allclose(found[:3], anchor, atol=1e-7)


NORMAL, OFFSET = np.array([0.48, -0.6, 0.64]), 210.0


def touch_plane(rng, turn, n=20):
    """Return tools turned by about so much, rad, whose tips are on a plane."""
    position, _ = draw_tools(rng, n)
    rotation = TOOL[1] @ Rotation.from_rotvec(turn * rng.uniform(-1.0, 1.0, (n, 3))).as_matrix()
    high = (position + rotation @ TOOL[0]) @ NORMAL - OFFSET
    return position - high[:, None] * NORMAL, rotation


def test_a_plane_and_the_tip_that_touches_it_are_found(rng):
    position, rotation = touch_plane(rng, 1.0)
    position[4] = np.nan
    (plane,) = closed_forms.fit_plane(position + rotation @ TOOL[0])
    _, both = closed_forms.fit_plane_and_tip(position, rotation)
    for found in (plane, both):
        side = np.sign(found[:3] @ NORMAL)
        np.testing.assert_allclose(side * found[:4], [*NORMAL, OFFSET], atol=1e-9)
    np.testing.assert_allclose(both[4:], TOOL[0], atol=1e-8)


def test_tools_that_turn_little_tell_the_tip_across_the_plane(rng):
    position, rotation = touch_plane(rng, 1e-4)
    found = closed_forms.fit_plane_and_tip(position, rotation)[0]
    side, normal = np.sign(found[:3] @ NORMAL), TOOL[1].T @ NORMAL  # in the tool's frame, to first order
    np.testing.assert_allclose(side * found[:3], NORMAL, atol=1e-7)
    np.testing.assert_allclose(np.cross(normal, found[4:]), np.cross(normal, TOOL[0]), atol=0.05)


def test_what_lies_in_no_plane_tells_none(rng):
    position, rotation = touch_plane(rng, 0.0)
    assert closed_forms.fit_plane_and_tip(position, rotation) == []  # tools that do not turn tell no tip
    assert closed_forms.fit_plane(position[:2]) == []
    assert closed_forms.fit_plane(np.outer(np.arange(9.0), NORMAL)) == []  # a line is in many planes


@pytest.mark.parametrize("on_tool", [False, True])
def test_a_left_handed_camera_is_one(rng, on_tool):
    position, rotation = draw_tools(rng)
    if on_tool:  # FRAME is where the board stands, TOOL the camera
        seen = (np.swapaxes(rotation, 1, 2) @ (FRAME[0] - position)[..., None])[..., 0]
        seen = (seen - TOOL[0]) @ TOOL[1]
    else:
        seen = see(position + rotation @ TOOL[0])
    seen = seen + 0.05 * rng.standard_normal(seen.shape)
    assert not closed_forms.is_mirrored(position, rotation, 1.002 * seen, on_tool)
    for change in ([1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]):
        assert closed_forms.is_mirrored(position, rotation, seen * change, on_tool)
    assert closed_forms.is_mirrored(position, rotation, seen[:, [1, 0, 2]], on_tool)
