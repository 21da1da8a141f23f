"""Budgets against Monte Carlo of an own, and figures of the standards against cycles worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import calibrated_machines as made
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.calibrated.accuracy import (
    FEWEST,
    GEOMETRY,
    box_about_home,
    compute_budget,
    coverage_factor,
    draw_cycles,
    enclose_measured,
    find_largest_cube,
    fit_cube,
    judge_axis,
    judge_poses,
    list_axis_poses,
    list_cube_poses,
    measure_beyond,
    place_lengths,
    propagate,
    sample_range,
    sample_region,
)
from bayescal.calibrated.machine import MODEL, NOISE, CommandErrors
from bayescal.calibrated.predict import predict_poses
from bayescal.errors import InputError
from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics


@pytest.fixture(scope="module")
def calibrated():
    """Return a made-up calibrated telescope, 1,500 draws."""
    return made.build_made_up(machines.build_machine("none"), np.random.default_rng(4), 1500)


@pytest.fixture(scope="module")
def workspace(calibrated):
    """Return actuator positions of its workspace."""
    return sample_range(calibrated, 32, 0)


def test_the_workspace_is_within_reach_and_the_same_for_a_seed(calibrated, workspace):
    mechanism = calibrated.legs.mechanism
    apart = workspace - mechanism.initial_actuator_positions
    assert np.all(np.abs(apart) <= mechanism.actuator_range)
    assert np.ptp(apart, axis=0).min() > 1.8 * mechanism.actuator_range
    np.testing.assert_array_equal(workspace, sample_range(calibrated, 32, 0))


def test_the_parts_of_a_budget_make_up_its_whole(calibrated, workspace):
    budget = compute_budget(calibrated, workspace)
    assert list(budget.parts) == [GEOMETRY, NOISE, MODEL]
    np.testing.assert_allclose(budget.combined, predict_poses(calibrated, workspace).covariance, rtol=1e-9, atol=1e-16)
    still = replace(calibrated, errors=CommandErrors(np.zeros((6, 6)), np.zeros(6)))
    np.testing.assert_allclose(budget.parts[GEOMETRY], predict_poses(still, workspace).covariance, atol=1e-16)
    double = replace(calibrated, errors=replace(calibrated.errors, noise=4e-6 * np.eye(6)))
    np.testing.assert_allclose(compute_budget(double, workspace).sd(NOISE), 2 * budget.sd(NOISE), rtol=1e-6, atol=1e-15)


def test_expanded_uncertainty_agrees_with_monte_carlo(calibrated, workspace):
    """Within 2 % over the workspace; 1,500 draws know a 95 % interval to 2.5 % at each pose."""
    assert coverage_factor(0.95) == pytest.approx(1.959964, abs=1e-6)
    stated = coverage_factor(0.95) * compute_budget(calibrated, workspace).sd()
    found = propagate(calibrated, workspace, 0.95, 1500, 1)
    ratio = np.sqrt((stated**2).mean(axis=0) / (found.half_width**2).mean(axis=0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)
    assert np.all(found.radius >= found.half_width[:, :3].max(axis=1))
    assert found.n_draws == 1500


def test_without_draws_there_is_no_budget(calibrated, workspace):
    with pytest.raises(InputError, match="posterior draws"):
        compute_budget(replace(calibrated, covariance=None, draws=None), workspace)


def test_iso_9283_by_hand():
    """Barycentre (1, 0, 0); distances 1, 1, 1, 1 from it, then with one cycle that is the barycentre itself."""
    cycles = np.array([[1.0, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1]])
    found = judge_poses(cycles)
    assert found.accuracy == pytest.approx(1.0)
    assert found.repeatability == pytest.approx(1.0)
    found = judge_poses(np.vstack([cycles, [[1.0, 0, 0]]]))
    assert found.repeatability == pytest.approx(0.8 + 3 * np.sqrt(4 * 0.04 + 0.64) / 2)


def test_iso_230_2_by_hand():
    """Means 0, 2 and -1, sds 1, 0 and 0.5: A from 2 or 2 s to -2 s, whichever is farther."""
    unit = np.array([-1.0, 0.0, 1.0])
    found = judge_axis(np.array([unit, np.full(3, 2.0), -1 + 0.5 * unit]))
    assert (found.accuracy, found.systematic, found.repeatability) == pytest.approx((4.0, 3.0, 4.0))


def test_cube_and_its_poses(calibrated):
    home = calibrated.model.home_pose
    edge = fit_cube(calibrated, home)
    poses = list_cube_poses(edge)
    np.testing.assert_allclose(np.ptp(poses, axis=0), 0.8 * edge)
    np.testing.assert_allclose(np.ptp(list_axis_poses(edge, 2), axis=0), [0, 0, edge], atol=1e-9)
    with pytest.raises(InputError, match="cube: "):
        draw_cycles(calibrated, place_lengths(calibrated, home, list_cube_poses(20 * edge)), 3, 10, 0)


def test_what_repeats_is_noise_alone(calibrated):
    poses = place_lengths(calibrated, calibrated.model.home_pose, list_cube_poses(0.2))
    cycles = draw_cycles(calibrated, poses, 200, 50, 3)
    quiet = replace(calibrated, errors=calibrated.errors.without_noise())
    assert np.ptp(draw_cycles(quiet, poses, 5, 50, 3), axis=2).max() == pytest.approx(0.0, abs=1e-12)
    noise = compute_budget(calibrated, calibrated.legs.mechanism.initial_actuator_positions[None]).sd(NOISE)
    np.testing.assert_allclose(cycles.std(axis=2).mean(axis=(0, 1)), noise[0, :3], rtol=0.03)
    bias = cycles.mean(axis=2).std(axis=0)
    still = compute_budget(quiet, calibrated.legs.mechanism.initial_actuator_positions[None]).sd()
    np.testing.assert_allclose(bias.mean(axis=0), still[0, :3], rtol=0.2)


@pytest.fixture(scope="module")
def inner():
    """Return a made-up calibrated telescope that was measured in the inner half of its actuators' range."""
    machine = made.build_made_up(machines.build_machine("none"), np.random.default_rng(4), 300)
    mechanism = machine.legs.mechanism
    moved = np.random.default_rng(5).uniform(-0.5, 0.5, (40, 6)) * mechanism.actuator_range
    return replace(machine, measured=mechanism.initial_actuator_positions + moved)


def reach(inner, actuators):
    found = solve_forward_kinematics(inner.legs, inner.theta, actuators)
    return found.position - check_home_pose(inner.legs).position


def test_by_default_poses_lie_where_the_machine_was_measured(inner):
    region = enclose_measured(inner)
    measured = reach(inner, inner.measured)
    np.testing.assert_allclose(region.low[:3], measured.min(axis=0))
    sampled = sample_region(inner, region, 64, 1)
    found = reach(inner, sampled)
    assert found.shape == (64, 3)
    assert np.all(found >= region.low[:3] - 1e-9)
    assert np.all(found <= region.high[:3] + 1e-9)
    assert measure_beyond(inner, sampled, region) == 0.0
    np.testing.assert_array_equal(sample_region(inner, region, 64, 1), sample_region(inner, region, 64, 1))


def test_the_whole_range_lies_beyond_what_was_measured(inner):
    everywhere = sample_range(inner, 64, 0)
    assert measure_beyond(inner, everywhere, enclose_measured(inner)) > 0.1
    assert enclose_measured(replace(inner, measured=None)) is None
    assert measure_beyond(inner, everywhere, None) == 0.0


def test_the_largest_cube_of_a_box_is_twice_its_nearest_side(inner):
    box = box_about_home(np.array([3.0, 2.0, 5.0, 0.0, 0.0, 0.0]))
    assert find_largest_cube(inner, box, np.zeros((0, 6))) == 4.0
    assert find_largest_cube(inner, replace(box, low=np.full(6, 1.0)), np.zeros((0, 6))) == 0.0


def test_a_box_out_of_reach_is_refused(inner):
    far = box_about_home(np.array([1e4, 1e4, 1e4, 0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match=f"expected {FEWEST}"):
        sample_region(inner, far, 16, 0)
