"""Poses stay on the assembly branch of home or are named; homes are level or refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from bayescal.errors import InputError, NumericalError
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import (
    check_home_pose,
    compute_signs,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
FILES = {
    "hexaglide": EXPERIMENTS / "hexaglide" / "mechanism.toml",
    "telescope": EXPERIMENTS / "telescope" / "mechanism.toml",
    "camera": EXPERIMENTS / "audit" / "camera_hexapod_mechanism.toml",
}


def build(path, model="six_pus"):
    mechanism = load_mechanism(path)
    zero = NominalDeformation(0.0, lambda: np.zeros((mechanism.n_legs,) * 2))
    return build_named_machine(mechanism, path, model, "none", zero, "machine", path.parent)


@pytest.fixture(scope="module")
def hexaglide():
    return build(FILES["hexaglide"])


@pytest.fixture(scope="module")
def spread(hexaglide):
    """Return actuators anywhere in their range, and where they put the platform."""
    mechanism = hexaglide.mechanism
    travel = 400.0 * np.random.default_rng(0).uniform(-1.0, 1.0, (200, 6))
    actuators = mechanism.initial_actuator_positions + travel
    return actuators, solve_forward_kinematics(hexaglide, hexaglide.layout.nominal, actuators, check=False)


def measure_gains(machine, position, rotation, actuators):
    """Return u · g of every leg and the determinant of the closure's Jacobian, written without the library's."""
    mechanism = machine.mechanism
    arms = np.einsum("pij,nj->pni", rotation, mechanism.platform_points)
    feet = mechanism.base_points + actuators[..., None] * mechanism.directions
    legs = position[:, None] + arms - feet
    lines = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    jacobian = np.concatenate([lines, np.cross(arms, lines)], axis=-1)
    return (legs * mechanism.directions).sum(axis=-1), np.linalg.det(jacobian)


def test_poses_of_long_independent_travel_are_those_of_homes_branch(hexaglide, spread):
    actuators, found = spread
    good = found.converged
    assert 10 < good.sum() < 100
    gain, turn = measure_gains(hexaglide, found.position[good], found.rotation[good], actuators[good])
    home = check_home_pose(hexaglide)
    start = hexaglide.mechanism.initial_actuator_positions[None]
    gain_home, turn_home = measure_gains(hexaglide, home.position[None], home.rotation[None], start)
    assert (gain * gain_home > 0.0).all()
    assert (turn * turn_home > 0.0).all()
    back = solve_inverse_kinematics(hexaglide, hexaglide.layout.nominal, found.position[good], found.rotation[good])
    np.testing.assert_allclose(back.actuators, actuators[good], atol=1e-9)


def test_what_closes_on_another_branch_alone_is_named(hexaglide, spread):
    """Newton's method by itself ends on the other side of a foot for some of these actuators."""
    actuators, found = spread
    theta = hexaglide.layout.nominal
    loose = solve_forward_kinematics(hexaglide, theta, actuators, check=False, follow=False)
    side, turn = compute_signs("base", hexaglide.layout, theta, loose.position, loose.rotation, actuators)
    other = loose.converged & ((side != hexaglide.branch.sides).any(axis=1) | (turn != hexaglide.branch.turn))
    assert other.sum() > 5
    np.testing.assert_allclose(
        hexaglide.linearise(theta, loose.position[other], loose.rotation[other], actuators[other]).residual,
        0,
        atol=1e-8,
    )
    lost = np.flatnonzero(~found.converged)
    faults = set()
    for k in lost[:40]:
        with pytest.raises(NumericalError) as error:
            solve_forward_kinematics(hexaglide, theta, actuators[k])
        faults.add(re.sub(r"^.*pose 1 of 1 ", "", str(error.value)))
    assert faults == {
        "not found in 30 Newton steps, expected one nearer to home that the legs can reach",
        "not reached from home without a jump, only on another assembly branch",
    }


@pytest.mark.parametrize("name", FILES)
def test_what_a_workspace_holds_is_found_again(name):
    """Forth from poses to actuators and back, where no pose may be lost: the branch is not narrower than it is."""
    machine = build(FILES[name], "six_ups" if name == "camera" else "six_pus")
    theta, home, rng = machine.layout.nominal, check_home_pose(machine), np.random.default_rng(1)
    size = {"hexaglide": 60.0, "telescope": 0.5, "camera": 10.0}[name]
    position = home.position + size * rng.uniform(-1.0, 1.0, (300, 3))
    turn = np.radians(0.1 * size if name != "telescope" else 0.2) * rng.uniform(-1.0, 1.0, (300, 3))
    rotation = matrix_from_rotation_vector(turn) @ home.rotation
    actuators = solve_inverse_kinematics(machine, theta, position, rotation).actuators
    found = solve_forward_kinematics(machine, theta, actuators)
    np.testing.assert_allclose(found.position, position, atol=1e-8)
    one = solve_forward_kinematics(machine, theta, actuators[0])
    np.testing.assert_allclose(one.position, position[0], atol=1e-8)


def test_a_home_that_is_only_tilted_is_refused(tmp_path):
    text = FILES["camera"].read_text()
    machine = build(FILES["camera"], "six_ups")
    lengths = machine.mechanism.leg_lengths
    position = check_home_pose(machine).position
    tilted = matrix_from_rotation_vector(np.radians([3.0, 0.0, 0.0]))
    spans = position + machine.mechanism.platform_points @ tilted.T - machine.mechanism.base_points
    values = ", ".join(f"{x:.9f}" for x in np.linalg.norm(spans, axis=1))
    assert np.abs(np.linalg.norm(spans, axis=1) - lengths).max() > 1.0
    path = tmp_path / "mechanism.toml"
    changed = re.sub(r"(?m)^\[home\]\n(?:(?!\[).*\n)*", "", text)
    changed = re.sub(r"(?m)^length_mm = .*$", "", changed)
    path.write_text(changed.replace("[legs]\n", f"[legs]\nlength_mm = [{values}]\n"))
    with pytest.raises(InputError, match=r"only with the platform tilted by 3 deg, expected it level to 1 deg"):
        check_home_pose(build(path, "six_ups"))
