"""Machines drawn by their outlines: a mount points where it says, and what draws nothing is refused in a line."""

from __future__ import annotations

import numpy as np
import own_arm
import pytest

from bayescal.errors import InputError
from bayescal.experiments.shared import show
from bayescal.machines.readings.mount import PIER, Mount, MountConfig

MOUNTS = {
    "north": (MountConfig(), [0.5, 0.4]),
    "south": (MountConfig(azimuth_from="south"), [np.pi - 0.5, 0.4]),
    "equatorial": (MountConfig(axes="equatorial", latitude_deg=90.0), [np.pi - 0.5, 0.4]),
}


@pytest.mark.parametrize("name", MOUNTS)
def test_a_tube_points_where_the_mount_says(name):
    """At the pole an hour angle, from south to the west, is an azimuth from there."""
    config, at = MOUNTS[name]
    points, pairs = Mount(config).outline({}, np.array([at, at]))
    assert points.shape == (2, 6 if name == "equatorial" else 5, 3)
    east = np.sin(0.5) * (1.0 if name != "equatorial" else -1.0)
    np.testing.assert_allclose(points[0, 2] / PIER, [np.cos(0.4) * east, np.cos(0.4) * np.cos(0.5), np.sin(0.4)])
    assert points[0, 2] @ points[0, 3] == pytest.approx(0.0, abs=1e-6)
    assert max(map(max, pairs)) == points.shape[1] - 1


def test_a_class_without_an_outline_is_refused():
    with pytest.raises(InputError, match="found a class without drawing, expected legs, struts, lines or"):
        show._describe(own_arm.Arm(None), "arm")


class Sketch(own_arm.Arm):
    """The arm with an outline that is given."""

    def outline(self, parameters, v):
        return self.config(v)


FAULTS = {
    "a plane": (lambda v: (np.zeros((*v.shape[:-1], 4, 2)), []), "outline: failed with ValueError: .*expected points"),
    "another line": (
        lambda v: (np.zeros((4, 3)), [(0, 4)]),
        "outline: failed with IndexError: .*pairs of their numbers",
    ),
    "no number": (lambda v: (np.full((4, 3), np.nan), []), "outline: found no finite points, expected some at home"),
    "text": (lambda v: "lines", "outline: failed with ValueError"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_outline_is_refused_in_a_line(fault):
    draw, said = FAULTS[fault]
    with pytest.raises(InputError, match=said) as error:
        show._describe(Sketch(draw), "arm")
    assert len(str(error.value).splitlines()) == 1


def test_an_outline_is_drawn_at_the_ends_of_each_coordinate():
    arm = Sketch(lambda v: (np.stack([0.0 * v, v], axis=-2), [(0, -1)]))
    (scene,) = show._describe(arm, "arm").sections[0].blocks
    assert scene.poses[:3] == ("home", *(f"{arm.coordinates[0].name} {end}" for end in ("smallest", "largest")))
    largest = [one.home + one.reach * (k == 0) for k, one in enumerate(arm.coordinates)]
    assert scene.points[1].at[2] == pytest.approx(largest)
    assert scene.lines[0].points == (0, 1)
