"""Where a machine is certified: the box of its measured poses, a stated one, and what lies beyond."""

from dataclasses import replace

import calibrated_machines as made
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.calibrated.accuracy import (
    FEWEST,
    box_about_home,
    enclose_measured,
    find_largest_cube,
    measure_beyond,
    sample_range,
    sample_region,
)
from bayescal.errors import InputError
from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics


@pytest.fixture(scope="module")
def calibrated():
    """Return a made-up calibrated telescope that was measured in the inner half of its actuators' range."""
    machine = made.build_made_up(machines.build_machine("none"), np.random.default_rng(4), 300)
    mechanism = machine.legs.mechanism
    moved = np.random.default_rng(5).uniform(-0.5, 0.5, (40, 6)) * mechanism.actuator_range
    return replace(machine, measured=mechanism.initial_actuator_positions + moved)


def reach(calibrated, actuators):
    found = solve_forward_kinematics(calibrated.legs, calibrated.theta, actuators)
    return found.position - check_home_pose(calibrated.legs).position


def test_by_default_poses_lie_where_the_machine_was_measured(calibrated):
    region = enclose_measured(calibrated)
    measured = reach(calibrated, calibrated.measured)
    np.testing.assert_allclose(region.low[:3], measured.min(axis=0))
    sampled = sample_region(calibrated, region, 64, 1)
    found = reach(calibrated, sampled)
    assert found.shape == (64, 3)
    assert np.all(found >= region.low[:3] - 1e-9)
    assert np.all(found <= region.high[:3] + 1e-9)
    assert measure_beyond(calibrated, sampled, region) == 0.0
    np.testing.assert_array_equal(sample_region(calibrated, region, 64, 1), sample_region(calibrated, region, 64, 1))


def test_the_whole_range_lies_beyond_what_was_measured(calibrated):
    everywhere = sample_range(calibrated, 64, 0)
    assert measure_beyond(calibrated, everywhere, enclose_measured(calibrated)) > 0.1
    assert enclose_measured(replace(calibrated, measured=None)) is None
    assert measure_beyond(calibrated, everywhere, None) == 0.0


def test_the_largest_cube_of_a_box_is_twice_its_nearest_side(calibrated):
    box = box_about_home(np.array([3.0, 2.0, 5.0, 0.0, 0.0, 0.0]))
    assert find_largest_cube(calibrated, box, np.zeros((0, 6))) == 4.0
    assert find_largest_cube(calibrated, replace(box, low=np.full(6, 1.0)), np.zeros((0, 6))) == 0.0


def test_a_box_out_of_reach_is_refused(calibrated):
    far = box_about_home(np.array([1e4, 1e4, 1e4, 0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match=f"in reach of the actuators, expected {FEWEST} at least"):
        sample_region(calibrated, far, 16, 0)
