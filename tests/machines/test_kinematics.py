"""Forward against inverse kinematics, redundant machines, published figures, and what must be refused.

Poses stay on the assembly branch of home or are named; homes are level or refused.
"""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import telescope_machines as machines
from refusals import line_of

from bayescal.errors import InputError, NumericalError
from bayescal.machines.deformations import LinearDeformation, NominalDeformation
from bayescal.machines.kinematics import (
    check_home_pose,
    compute_home_legs,
    compute_signs,
    guess_home_pose,
    solve_forward_kinematics,
    solve_inverse_kinematics,
)
from bayescal.machines.mechanism import ExternalLoad
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector


class Own(SixPus):
    """The same closure by another class, of which nothing is known."""


class OwnStruts(SixUps):
    """The same."""


@pytest.mark.parametrize("kappa", [0.0, 0.011, 0.9])
@pytest.mark.parametrize("own", [Own, OwnStruts])
def test_closed_form_of_perfect_legs_is_what_newton_finds(own, kappa, rng):
    """A joint that an actuator moves nearly as far as it moves itself is left to Newton's method."""
    machine = machines.build_machine("none", model=own.name)
    machine = replace(machine, deformation=LinearDeformation(kappa))
    theta = machine.layout.nominal + 1e-3 * rng.standard_normal((4, 1, machine.layout.size))
    home = machine.nominal_home
    position = home.position + rng.uniform(-3, 3, (50, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.02, 0.02, (50, 3))) @ home.rotation
    found = solve_inverse_kinematics(machine, theta, position, rotation)
    other = solve_inverse_kinematics(replace(machine, model=own()), theta, position, rotation)
    np.testing.assert_allclose(found.actuators, other.actuators, rtol=0, atol=1e-9)
    closure = machine.linearise(theta, position, rotation, found.actuators)
    assert np.abs(closure.residual).max() < 1e-9


def test_batches_of_machines_equal_single_ones(rng):
    machine = machines.build_machine("matrix")
    theta = machines.telescope_truth(machine) + rng.normal(0, 1e-3, (3, machine.layout.size))
    actuators = machines.table_3_actuators()[:5]
    batch = solve_forward_kinematics(machine, theta[:, None], actuators[None])
    assert batch.position.shape == (3, 5, 3)
    assert batch.rotation.shape == (3, 5, 3, 3)
    one = solve_forward_kinematics(machine, theta[2], actuators[4])
    np.testing.assert_allclose(batch.position[2, 4], one.position, atol=1e-11)
    again = solve_inverse_kinematics(machine, theta[:, None], batch.position, batch.rotation)
    np.testing.assert_allclose(again.actuators, np.broadcast_to(actuators, (3, 5, 6)), atol=1e-9)
    here = batch.position[0], batch.rotation[0]  # the first machine's poses, as the others reach them
    others = solve_inverse_kinematics(machine, theta[:, None], *here)
    alone = solve_inverse_kinematics(machine, theta[1], *here)
    np.testing.assert_allclose(others.actuators[1], alone.actuators, atol=1e-11)


def test_newton_converges_quadratically_at_large_rotations(rng):
    """Some ten degrees away six steps are enough, and the closure vanishes to rounding."""
    machine = machines.build_machine("none", machines.build_random_mechanism(6, seed=6))
    home = check_home_pose(machine)
    position = home.position + rng.uniform(-5, 5, (50, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.15, 0.15, (50, 3)))
    actuators = solve_inverse_kinematics(machine, machine.layout.nominal, position, rotation).actuators
    found = solve_forward_kinematics(machine, machine.layout.nominal, actuators)
    assert found.n_iterations <= 6
    here = machine.linearise(machine.layout.nominal, found.position, found.rotation, actuators)
    assert np.abs(here.residual).max() < 1e-11


def test_home_pose_of_the_telescope():
    machine = machines.build_machine("matrix")
    home = check_home_pose(machine)
    np.testing.assert_allclose(home.position, [0, 0, machines.HOME_HEIGHT], atol=0.005)
    np.testing.assert_allclose(home.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(compute_home_legs(machine), axis=1), 500.0, atol=1e-9)


def test_worst_pose_error_of_one_micrometre_of_motor_error():
    """RR-8096 states 6 µm at worst; with the recovered geometry the worst of all signs at the 40 poses is 5.9 µm."""
    machine = machines.build_machine("none")
    theta, actuators = machine.layout.nominal, machines.table_3_actuators()
    pose = solve_forward_kinematics(machine, theta, actuators)
    here = machine.linearise(theta, pose.position, pose.rotation, actuators)
    slope = -np.linalg.solve(here.pose, here.actuators)[:, :3]
    signs = np.array(list(itertools.product([-1.0, 1.0], repeat=6)))
    error = np.linalg.norm(np.einsum("pij,sj->psi", slope, signs), axis=-1)
    assert error.max() == pytest.approx(5.9, abs=0.05)  # µm per µm
    # the linear figure is that of the machine: the worst signs at the worst pose, by forward kinematics
    worst, choice = np.unravel_index(np.argmax(error), error.shape)
    moved = solve_forward_kinematics(machine, theta, actuators[worst] + 1e-3 * signs[choice])
    assert np.linalg.norm(moved.position - pose.position[worst]) == pytest.approx(1e-3 * error.max(), rel=1e-3)


# --- what cannot be reached ------------------------------------------------------------------------------------------


@pytest.fixture(params=machines.model_names())
def telescope(request):
    """Return the telescope with K, seen through each model."""
    return machines.build_machine("matrix", model=request.param)


def fail(solve, *arguments):
    """Return the one line with which a solver fails."""
    return line_of(solve, *arguments, error=NumericalError)


def far_poses():
    """Return three poses about home, the second three metres aside."""
    position = np.array([[0.0, 0.0, machines.HOME_HEIGHT]] * 3)
    position[1, 0] += 3000.0
    return position, np.tile(np.eye(3), (3, 1, 1))


def test_pose_out_of_reach_is_named_with_its_leg_or_flagged(telescope):
    """A strut reaches any pose: its range is another matter."""
    theta, poses, reached = telescope.layout.nominal, far_poses(), telescope.mechanism.drive == "strut"
    found = solve_inverse_kinematics(telescope, theta, *poses, check=False)
    assert found.converged.tolist() == [True, reached, True]
    assert np.abs(telescope.linearise(theta, *poses, found.actuators).residual[found.converged]).max() < 1e-9
    if not reached:
        message = fail(solve_inverse_kinematics, telescope, theta, *poses)
        assert re.search(r"leg (\d) cannot reach pose 2 of 3, l\[\1\] is 500 mm", message)


def test_the_leg_that_cannot_reach_is_named():
    """Where every leg closes by itself: one leg is too short for a pose that the others reach."""
    machine = machines.build_machine("none")
    theta, home = machine.layout.nominal.copy(), check_home_pose(machine)
    theta[machine.layout.index["l"][2]] = 50.0
    message = fail(solve_inverse_kinematics, machine, theta, home.position[None], home.rotation[None])
    assert re.search(r"pose 1 of 1.*\bl\[3\] .*50 mm", message)


def test_missing_pose_is_named_or_flagged(telescope):
    """A leg pushed to where no pose closes."""
    theta, actuators = telescope.layout.nominal, machines.table_3_actuators()[:3]
    actuators[1, 0] += 1e5
    assert "pose 2 of 3" in fail(solve_forward_kinematics, telescope, theta, actuators)
    found = solve_forward_kinematics(telescope, theta, actuators, check=False)
    assert found.converged.tolist() == [True, False, True]
    assert found.n_iterations == 30
    left = telescope.linearise(theta, found.position, found.rotation, actuators).residual
    assert np.abs(left[[0, 2]]).max() < 1e-9


def test_nothing_is_found_silently(telescope):
    """Actuator positions and poses that are no numbers are not converged."""
    theta, actuators = telescope.layout.nominal, machines.table_3_actuators()[:3]
    pose = solve_forward_kinematics(telescope, theta, actuators)
    actuators[1, 3] = np.nan
    assert solve_forward_kinematics(telescope, theta, actuators, check=False).converged.tolist() == [True, False, True]
    position = pose.position.copy()
    position[2, 0] = np.nan
    found = solve_inverse_kinematics(telescope, theta, position, pose.rotation, check=False)
    assert found.converged.tolist() == [True, True, False]


@pytest.mark.parametrize("model", ["stiffness", "stiffness_fixed"])
def test_an_equilibrium_that_is_not_found_is_named(model):
    """A hundred million newtons aside."""
    machine = machines.build_machine("none", machines.build_telescope(load=ExternalLoad(force=(1e8, 0.0, 0.0))), model)
    arguments = machine, machine.layout.nominal, machines.table_3_actuators()[:3]
    assert not solve_forward_kinematics(*arguments, check=False).converged.any()
    assert "pose 1 of 3" in fail(solve_forward_kinematics, *arguments)


def test_no_machine_is_not_converged(telescope):
    """A direction off the unit sphere; where there are none, a length that is no number."""
    theta = telescope.layout.nominal.copy()
    symbol, value = ("u_x", 1.2) if "u_x" in telescope.layout.index else ("l", np.nan)
    theta[telescope.layout.index[symbol][2]] = value
    actuators = machines.table_3_actuators()[:2]
    found = solve_forward_kinematics(telescope, theta, actuators, check=False)
    assert not found.converged.any()
    assert "pose 1 of 2" in fail(solve_forward_kinematics, telescope, theta, actuators)
    position, rotation = far_poses()
    reached = solve_inverse_kinematics(telescope, theta, position[:1], rotation[:1], check=False)
    assert not reached.converged.any()
    assert "pose 1 of 1" in fail(solve_inverse_kinematics, telescope, theta, position[:1], rotation[:1])


@pytest.mark.parametrize("model", machines.model_names())
def test_a_machine_without_home_pose_finds_nothing_that_needs_it(model):
    """One leg of a tenth of its length: the 6-PUS stands elsewhere or nowhere, what is referred to home nowhere."""
    machine = machines.build_machine("none", model=model)
    theta = machine.layout.nominal.copy()
    theta[machine.layout.index["l"][2]] = 50.0
    found = solve_forward_kinematics(machine, theta, machines.table_3_actuators()[:2], check=False)
    assert not found.converged.any()


def hexagon(radius):
    angle = np.radians([0, 60, 120, 180, 240, 300])
    return radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


@pytest.mark.parametrize(
    ("base_points", "platform_points"),
    [
        (hexagon(130.0), hexagon(130.0)),  # parallel legs
        (hexagon(155.0), hexagon(130.0)),  # similar hexagons: all legs meet in one point
        (hexagon(155.0), np.tile([20.0, 0.0, 0.0], (6, 1))),
        (hexagon(155.0), np.zeros((6, 3))),
    ],
    ids=["parallel", "similar", "one joint", "one joint at the origin"],
)
def test_singular_geometry_is_refused(base_points, platform_points):
    mechanism = machines.build_telescope(base_points=base_points, platform_points=platform_points)
    with pytest.raises(InputError, match="telescope"):
        check_home_pose(machines.build_machine("none", mechanism))


def test_regular_geometry_is_accepted():
    mechanism = machines.build_telescope(base_points=machines.build_telescope().base_points + np.array([5.0, 0.0, 0.0]))
    assert check_home_pose(machines.build_machine("none", mechanism)).converged.all()


def spoil(**changes):
    """Return the telescope with some of its fields changed, as far as it can be made."""
    telescope = machines.build_telescope()
    return machines.build_telescope(**{name: change(getattr(telescope, name)) for name, change in changes.items()})


PER_LEG = ("base_points", "platform_points", "directions", "leg_lengths", "initial_actuator_positions")
REFUSED = {
    "a short leg": ({"leg_lengths": lambda v: v * [1, 1, 0.1, 1, 1, 1]}, "leg 3 of 50 mm cannot span"),
    "five legs": (
        dict.fromkeys(PER_LEG, lambda v: v[:5]),
        "found 5 legs, expected at least 6",
    ),
    "no unit vector": (
        {"directions": lambda v: v + np.outer(np.eye(6)[3], [1.0, 0.0, -0.5])},
        r"direction of leg 4 has length 1\.11803, expected a unit vector",
    ),
}


@pytest.mark.parametrize(("changes", "match"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_mechanism_is_refused(changes, match):
    with pytest.raises(InputError, match=match):
        guess_home_pose(spoil(**changes))


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
        "not found in 30 Newton steps, expected one nearer home",
        "only on another assembly branch",
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
    with pytest.raises(InputError, match="tilt of 3"):
        check_home_pose(build(path, "six_ups"))
