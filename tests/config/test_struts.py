"""Mechanism files of struts: lengths given or from the home pose, and every fault as one line."""

from __future__ import annotations

import re

import numpy as np
import pytest
import studies
from test_load import fail

from bayescal.machines.kinematics import guess_home_pose
from bayescal.machines.read import load_mechanism

M2 = studies.EXPERIMENTS / "audit" / "m2_hexapod_mechanism.toml"
TELESCOPE = studies.TELESCOPE / "mechanism.toml"
HOME = "[home]\nposition_mm = [0.0, 0.0, -703.0]\n"
STRUT = 'actuated_joint = "strut"'


def test_lengths_of_struts_are_given_or_follow_from_home(tmp_path):
    path = tmp_path / "mechanism.toml"
    by_home, text = load_mechanism(M2), M2.read_text()
    assert (by_home.drive, by_home.home_position) == ("strut", (0.0, 0.0, -703.0))
    expected = np.linalg.norm(by_home.platform_points + by_home.home_position - by_home.base_points, axis=1)
    np.testing.assert_array_equal(by_home.leg_lengths, expected)
    assert (by_home.home_joints == by_home.base_points).all()
    assert not by_home.directions.any()
    path.write_text(text.replace(HOME, "").replace(STRUT, f"{STRUT}\nlength_mm = {expected.tolist()}"))
    given = load_mechanism(path)
    np.testing.assert_array_equal(given.leg_lengths, expected)
    assert given.home_position is None


def test_drive_of_the_telescope_is_at_the_base():
    telescope = load_mechanism(TELESCOPE)
    assert (telescope.drive, telescope.home_position) == ("base", None)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "position_mm = [0.0, 0.0, -703.0]",
            "",
            "line 29: home: expected position_mm, or platform",
        ),
        (HOME, '[home]\nplatform = "below"\n', "line 32: legs.length_mm: missing,"),
        (
            HOME,
            '[home]\nplatform = "besides"\n',
            "line 30: home.platform: found 'besides', expected 'above' or",
        ),
        (STRUT, f"{STRUT}\ndirection = [0.0, 0.0, 1.0]", "line 32: legs: found direction with actuated_joint 'strut'"),
        (STRUT, f"{STRUT}\nlength_mm = 493.0", "line 32: legs.length_mm: found lengths"),
        (HOME, "", "line 30: legs.length_mm: missing,"),
        (STRUT, 'actuated_joint = "strat"', "line 33: legs.actuated_joint: found 'strat', expected 'base' or 'strut'"),
        (STRUT, f"{STRUT}\ninitial_actuator_position_mm = [1, 2]", "legs.initial_actuator_position_mm: found 2 legs"),
        ("position_mm = [0.0, ", "position_mm = [", "line 30: home.position_mm: found [0.0, -703.0], expected: list"),
        ("position_mm", "position", "line 30: home.position: unknown key, did you mean 'position_mm'?"),
        ("-703.0]", "-1196.0]", "home.position_mm: found leg 1 of length zero"),
        ("    [1256.87, -419.29, 931.6],\n", "", "platform: found 5 legs, expected 6 as in base"),
    ],
)
def test_faulty_struts(tmp_path, old, new, expected):
    path = tmp_path / "mechanism.toml"
    path.write_text(M2.read_text())
    studies.edit(path, old, new)
    assert expected in fail(load_mechanism, path)


def test_legs_driven_at_the_base_need_their_lengths(tmp_path):
    path = tmp_path / "mechanism.toml"
    path.write_text(TELESCOPE.read_text())
    studies.edit(path, "length_mm = 500.0\n", "")
    place = f"{path}, line {studies.find_line(path, '[legs]')}: legs.length_mm: "
    assert re.fullmatch(rf"{re.escape(place)}missing, .* home\.position_mm", fail(load_mechanism, path))


def test_hanging_machine_of_given_lengths(tmp_path):
    """Directions are normalised; the platform stands where the file says."""
    path = tmp_path / "mechanism.toml"
    path.write_text(TELESCOPE.read_text() + '\n[home]\nplatform = "below"\n')
    studies.edit(path, "direction = [0.0, 0.0, 1.0]", "direction = [0.0, 0.0, -2.0]")
    hanging = load_mechanism(path)
    np.testing.assert_array_equal(hanging.directions, np.tile([0.0, 0.0, -1.0], (6, 1)))
    position, rotation = guess_home_pose(hanging)
    assert position[2] == pytest.approx(-guess_home_pose(load_mechanism(TELESCOPE))[0][2])
    np.testing.assert_array_equal(rotation, np.eye(3))


def test_home_gives_the_lengths_of_legs_on_carriages(tmp_path):
    """From the lower joints at the initial actuator positions to the platform's joints."""
    path = tmp_path / "mechanism.toml"
    path.write_text(TELESCOPE.read_text() + "\n[home]\nposition_mm = [0.0, 0.0, 497.41]\n")
    studies.edit(path, "length_mm = 500.0\n", "")
    machine = load_mechanism(path)
    np.testing.assert_allclose(machine.leg_lengths, 500.0, atol=0.01)
    assert machine.home_position == (0.0, 0.0, 497.41)
