"""One machine at two places in a row: what doubles, the distance, rows of one place alone."""

from __future__ import annotations

import numpy as np
import own_arm
import pytest

from bayescal.errors import InputError
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import Channel, FunctionModel
from bayescal.machines.readings.places import TwoPlaces

MACHINE = """kind = "line_machine"
name = "slung"
places = 2

[machine]
gear = 10.0
spool_buildup_mm = 0.0
tension = "measured"
workspace_half_width_mm = [500.0, 500.0, 400.0]
force_at_origin_n = [9.0, 9.0, 9.0]
lines = [
  { anchor_mm = [0.0, -900.0, 1500.0], spool_radius_mm = 40.0 },
  { anchor_mm = [800.0, 500.0, 1500.0], spool_radius_mm = 40.0 },
  { anchor_mm = [-800.0, 500.0, 1500.0], spool_radius_mm = 40.0 },
]
"""


class Arm(own_arm.Arm):
    """An arm with a temperature beside each place."""

    given = ("temperature",)
    commanded = ("encoder",)

    def read(self, parameters, v, given):
        return super().read(parameters, v, {}) + 1e-3 * given["temperature"][..., None]


def test_readings_are_those_of_two_machines_and_the_distance(rng):
    arm = FunctionModel("arm", Arm(None))
    pair = FunctionModel("arm", TwoPlaces(Arm(None)))
    n, q, theta = 5, len(arm.coordinates), arm.layout.nominal
    pose = pair.home_pose + 0.1 * rng.standard_normal((n, 2 * q))
    warm = rng.uniform(10.0, 20.0, (2, n))
    read = pair.read(theta, pose, {"temperature_a": warm[0], "temperature_b": warm[1]})
    each = [arm.read(theta, one, {"temperature": at}) for one, at in zip((pose[:, :q], pose[:, q:]), warm, strict=True)]
    np.testing.assert_allclose(read[:, :-1], np.concatenate(each, axis=1))
    ends = [arm.tool_values(theta, one) for one in (pose[:, :q], pose[:, q:])]
    np.testing.assert_allclose(read[:, -1], np.linalg.norm(ends[1] - ends[0], axis=1))
    np.testing.assert_allclose(pair.tool_values(theta, pose), ends[0])
    assert pair.commanded == tuple(one.name for one in pair.channels if one.kind == "encoder")


def test_names_of_a_file_with_two_places(tmp_path):
    (tmp_path / "machine.toml").write_text(MACHINE)
    found = read_reading_model(tmp_path / "machine.toml")
    assert [one.stem for one in found.channels[:4]] == ["motor_1a", "motor_2a", "motor_3a", "x_a"]
    assert found.channels[-1] == Channel("distance", "mm", external=True)
    assert [one.name for one in found.coordinates] == ["x_a", "y_a", "z_a", "x_b", "y_b", "z_b"]
    assert found.given == tuple(f"force_{k}_{place}" for place in "ab" for k in (1, 2, 3))
    assert len(found.select(["motor"])) == 6


def test_a_place_without_readings_stands_where_the_farthest_row_does():
    arm = own_arm.Arm(None)
    pair, k = FunctionModel("arm", TwoPlaces(arm)), len(arm.channels)
    own = np.array([not one.external for one in arm.channels])
    values = np.full((3, 2 * k + 1), np.nan)
    values[0, :k], values[1, k : 2 * k], values[2, :k], values[2, -1] = 1.0, 2.0, 5.0, 4.0
    found = pair.complete(values)
    assert (found[0, k : 2 * k][own] == 5.0).all()
    assert (found[1, :k][own] == 5.0).all()
    assert np.isnan(found[:2, np.r_[:k, k : 2 * k]][:, np.tile(~own, 2)]).sum() == 2 * (~own).sum()
    np.testing.assert_array_equal(found[2], values[2])  # a distance leads somewhere: that place has to be read
    some = pair.pick(np.flatnonzero([not one.external for one in pair.channels]))
    assert np.isfinite(some.complete(values[:2, some.places])).all()


def test_a_machine_on_legs_is_refused(tmp_path):
    path = tmp_path / "machine.toml"
    path.write_text('places = 2\nkind = "legs"\nname = "legs"\nmechanism = "mechanism.toml"\nmodel = "six_ups"\n')
    with pytest.raises(InputError, match="places: found 2, expected 1"):
        read_reading_model(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("places = 2", "places = 3"), "places: found 3, expected 1 or 2"),
        (('kind = "line_machine"', 'kind = "mount"'), "places: found a tool without lengths, expected one in mm"),
    ],
)
def test_what_is_no_pair_is_refused(tmp_path, change, said):
    text = MACHINE.replace(*change)
    if "mount" in text:
        text = text.partition("[machine]")[0]
    (tmp_path / "machine.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_reading_model(tmp_path / "machine.toml")
