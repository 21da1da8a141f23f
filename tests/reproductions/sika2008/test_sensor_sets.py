"""Poses from readings, and what readings say of the parameters when no pose is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reading_machines import LinearModel
from sika_problems import NOISE, make_problem
from sliding_platforms import SETS, WORKSPACE, sliding_star, star_of

from bayescal.errors import InputError, NumericalError
from sika2008.sensors import (
    SensorSet,
    compute_calibrability,
    eliminate_poses,
    find_poses,
    null_basis,
    solve_least_squares,
)
from sika2008.setup import build_sensors

DEGREE = np.pi / 180


def setting(names=("s", "phi"), model=None):
    model = model or sliding_star()
    sensors = build_sensors(model, NOISE, names)
    return model, sensors, WORKSPACE.draw(model, np.random.default_rng(4))


@pytest.mark.parametrize("names", [*SETS.values(), ("s[1]", "s[2]", "phi[2]", "psi[4]"), ("psi",)])
def test_exact_readings_lead_back_to_their_poses_from_home(names, rng):
    model, sensors, pose = setting(names)
    theta = model.layout.nominal * (1 + 1e-4 * rng.standard_normal((3, 1, model.layout.size)))
    found = find_poses(sensors, theta, sensors.read(theta, pose), np.tile(model.home_pose, (len(pose), 1)))
    assert found.converged.all()
    np.testing.assert_allclose(found.pose, np.broadcast_to(pose, found.pose.shape), rtol=0, atol=1e-8)
    assert np.abs(found.error).max() < 1e-5


@pytest.mark.parametrize("n_legs", [3, 5, 6])
def test_any_number_of_legs(n_legs):
    model = star_of(n_legs)
    sensors = build_sensors(model, NOISE, ("s", "psi[1]"))
    pose = replace(WORKSPACE, angle_deg=10.0).draw(model, np.random.default_rng(4))
    start = np.tile(model.home_pose, (len(pose), 1))
    found = find_poses(sensors, model.layout.nominal, sensors.read(model.layout.nominal, pose), start)
    np.testing.assert_allclose(found.pose, pose, rtol=0, atol=1e-8)


def test_noisy_readings_give_the_least_squares_pose(rng):
    """No step away from it explains the readings better."""
    model, sensors, pose = setting()
    nominal = model.layout.nominal
    measured = sensors.read(nominal, pose) + sensors.noise * rng.standard_normal((len(pose), 8))
    found = find_poses(sensors, nominal, measured, pose)
    best = (found.error**2).sum(axis=1)
    for move in 1e-4 * np.concatenate([np.eye(3), -np.eye(3)]):
        other = (measured - sensors.read(nominal, found.pose + move)) / sensors.noise
        assert ((other**2).sum(axis=1) > best).all()


def test_readings_of_no_pose_are_named_or_flagged():
    model, sensors, pose = setting()
    measured = sensors.read(model.layout.nominal, pose)
    measured[4, :2] += 5000.0
    with pytest.raises(NumericalError, match="pose 5: "):
        find_poses(sensors, model.layout.nominal, measured, pose)
    found = find_poses(sensors, model.layout.nominal, measured, pose, check=False)
    assert found.converged.tolist() == [k != 4 for k in range(len(pose))]


@pytest.mark.parametrize("names", SETS.values())
def test_null_basis_is_orthonormal_and_sees_no_pose(names):
    model, sensors, pose = setting(names)
    here = sensors.linearise(model.layout.nominal, pose)
    basis = null_basis(here.by_pose)
    assert basis.shape == (len(pose), sensors.redundancy, len(sensors.chosen))
    identity = basis @ np.swapaxes(basis, 1, 2)
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(sensors.redundancy), identity.shape), atol=1e-12)
    scale = np.abs(here.by_pose).max()
    assert np.abs(basis @ here.by_pose).max() < 1e-12 * scale


@pytest.mark.parametrize("names", SETS.values())
def test_eliminated_rows_are_what_re_found_poses_leave(names, rng):
    """The machine moves, every pose follows: what is left of its readings is what the rows say."""
    model, sensors, pose = setting(names)
    nominal = model.layout.nominal
    rows = eliminate_poses(sensors.linearise(nominal, pose))
    basis = null_basis(sensors.linearise(nominal, pose).by_pose)
    for _ in range(5):
        move = rng.standard_normal(model.layout.size) * np.where(np.array(model.layout.units) == "mm", 1e-3, 1e-6)
        left = [find_poses(sensors, nominal + sign * move, sensors.read(nominal, pose), pose).error for sign in (1, -1)]
        change = np.einsum("pzk,pk->pz", basis, 0.5 * (left[0] - left[1]))
        np.testing.assert_allclose(change, -rows @ move, rtol=1e-5, atol=1e-6 * np.abs(rows @ move).max())


def test_a_singular_jacobian_has_no_solution(rng):
    jacobian = rng.standard_normal((4, 5, 3))
    jacobian[1, :, 2] = 2.0 * jacobian[1, :, 0]
    jacobian[2, 0, 0] = np.nan
    right = rng.standard_normal((4, 5))
    found = solve_least_squares(jacobian, right)
    assert np.isnan(found).all(axis=1).tolist() == [False, True, True, False]
    for k in (0, 3):
        np.testing.assert_allclose(found[k], np.linalg.lstsq(jacobian[k], right[k], rcond=None)[0], rtol=1e-9)


def test_too_few_equations_are_counted():
    _, sensors, _ = setting(("s",))
    sensors.check(18, 18)
    with pytest.raises(InputError, match=r"17 equations .*17 poses .*4 readings.*3 unknowns"):
        sensors.check(17, 18)
    three = sensors.select(np.arange(3))
    with pytest.raises(InputError, match="found 0 equations"):
        three.check(1000, 1)
    with pytest.raises(InputError, match="found 0 equations"):
        sensors.select(np.arange(2)).check(1000, 1)


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, np.inf])
def test_noise_must_be_above_zero(noise):
    model = LinearModel(np.eye(2), np.eye(2))
    with pytest.raises(InputError, match=r"sensor s\[2\]:"):
        SensorSet(model, np.arange(2), np.array([1.0, noise]))


def schur_condition(sensors, free, pose, length, angle, scale):
    """Condition of the information on the parameters, poses eliminated from the normal equations instead."""
    unit = np.where(np.array([sensors.model.channels[k].unit for k in sensors.chosen]) == "mm", length, angle)
    found = sensors.model.linearise(free.centre, pose)
    h = found.by_pose[:, sensors.chosen] / unit[:, None]
    a = found.by_parameters[:, sensors.chosen][..., free.places] / unit[:, None] * scale
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    information = np.zeros((a.shape[-1],) * 2)
    for one, by in zip(h, a, strict=True):
        information += by.T @ by - by.T @ one @ np.linalg.solve(one.T @ one, one.T @ by)
    values = np.linalg.eigvalsh(information)
    return values[-1] / values[0]


@pytest.mark.parametrize("n_sensors", [4, 8, 12])
def test_agrees_with_the_schur_complement(n_sensors):
    sensors, free, pose = make_problem(n_sensors, 60)
    found = compute_calibrability(sensors, free, pose)
    mm = np.array(sensors.model.layout.units)[free.places] == "mm"
    wanted = {
        "metres_radians": (1e3, 1.0, np.where(mm, 1e3, 1.0)),
        "millimetres_degrees": (1.0, DEGREE, np.where(mm, 1.0, DEGREE)),
    }
    for unit, arguments in wanted.items():
        # the eigenvalues of a squared matrix lose digits as C grows
        value = schur_condition(sensors, free, pose, *arguments)
        assert getattr(found, unit) == pytest.approx(value, rel=1e-14 * value + 1e-6)
    scaled = schur_condition(sensors, free, pose, 1e-3, sensors.noise[-1], free.scale)
    assert found.scaled == pytest.approx(scaled, rel=1e-5)


def test_documented_machine_has_the_published_order():
    for n_sensors, published in ((4, 3e8), (8, 3e4), (12, 4e4)):
        sensors, free, pose = make_problem(n_sensors, 100)
        found = compute_calibrability(sensors, free, pose).metres_radians
        assert published / 3.2 < found < published * 3.2


def test_more_noise_of_all_sensors_changes_nothing():
    """C says nothing of how well parameters are known."""
    sensors, free, pose = make_problem(8, 30)
    worse = type(sensors)(sensors.model, sensors.chosen, 10.0 * sensors.noise)
    one, two = (compute_calibrability(s, free, pose) for s in (sensors, worse))
    assert two.scaled == pytest.approx(one.scaled, rel=1e-9)
    assert two.metres_radians == one.metres_radians
    uneven = type(sensors)(sensors.model, sensors.chosen, sensors.noise * np.where(sensors.chosen < 4, 10.0, 1.0))
    assert compute_calibrability(uneven, free, pose).scaled != pytest.approx(one.scaled, rel=0.1)


def test_units_of_the_tolerances_change_only_the_scaled_one():
    sensors, free, pose = make_problem(8, 30)
    other = replace(free, scale=free.scale * np.where(np.arange(len(free.scale)) == 3, 20.0, 1.0))
    one, two = (compute_calibrability(sensors, f, pose) for f in (free, other))
    assert two.millimetres_radians == one.millimetres_radians
    assert two.scaled != pytest.approx(one.scaled, rel=0.01)


def test_what_no_sensor_sees_makes_it_infinite():
    sensors, free, pose = make_problem(8, 30)
    tool = sensors.model.layout.names.index("xi_V")
    unseen = replace(free, places=np.append(free.places, tool), scale=np.append(free.scale, 0.3))
    assert compute_calibrability(sensors, unseen, pose).scaled == np.inf
    few = compute_calibrability(sensors, free, pose[:3])  # 15 rows for 22 parameters
    assert few.metres_radians == np.inf
