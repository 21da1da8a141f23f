"""What a calibrated machine predicts and commands, against draws and against another way to the same number."""

from __future__ import annotations

import re
from dataclasses import replace

import calibrated_machines as calibrated
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.calibrated.drawn_machines import draw_poses
from bayescal.calibrated.machine import build_calibrated
from bayescal.calibrated.predict import compensate_poses, predict_poses
from bayescal.errors import InputError
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.readings import Legs


@pytest.mark.parametrize("deformation", ["none", "matrix"])
def test_errors_of_the_legs_are_carried_to_the_pose(deformation, rng):
    """Noise moves the actuators, and bends the other legs; the model error moves each leg by itself."""
    machine = machines.build_machine(deformation)
    made_up = calibrated.build_made_up(machine, rng, scale=1e-9)
    actuators = calibrated.measurable_actuators(machine, 6, rng)
    legs, basis = made_up.legs, made_up.legs.basis(actuators)
    exact = solve_forward_kinematics(legs, made_up.theta, actuators)
    expected = np.zeros((6, 6, 6))
    for one, size in ((basis, 1e-3), (replace(basis, actuator_gain=basis.actuator_gain * np.eye(6)), 2e-3)):
        at = legs.model.linearise(legs.layout, made_up.theta, exact.position, exact.rotation, one)
        moved = size * np.linalg.solve(at.pose, at.actuators)
        expected += moved @ np.swapaxes(moved, 1, 2)
    np.testing.assert_allclose(predict_poses(made_up, actuators).covariance, expected, rtol=1e-6, atol=1e-16)


def test_poses_out_of_reach_say_why(rng):
    made_up = calibrated.build_made_up(machines.build_machine("none"), rng)
    home = predict_poses(made_up, made_up.legs.mechanism.initial_actuator_positions[None])
    moves = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [900.0, 0.0, 0.0]])
    command = compensate_poses(made_up, home.tool + np.pad(moves, ((0, 0), (0, 3))))
    assert command.reached.tolist() == [True, False, False]
    assert re.match(r"rho\[1\] .*12\.\d* mm.* 8\.7 to 11\.3$", command.faults[1])
    assert re.match(r"rho\[1\] \D*$", command.faults[2])
    assert np.isnan(command.commands[2]).all()
    assert np.isfinite(command.commands[:2]).all()


@pytest.mark.parametrize("values", [np.zeros(6), np.zeros((3, 5)), np.zeros((0, 6))])
def test_other_shapes_are_refused(values, rng):
    made_up = calibrated.build_made_up(machines.build_machine("none"), rng, n_draws=20)
    with pytest.raises(InputError, match="commands: found"):
        predict_poses(made_up, values)


def test_same_random_numbers_same_draws(rng):
    made_up = calibrated.build_made_up(machines.build_machine("none"), rng, n_draws=50)
    actuators = calibrated.measurable_actuators(made_up.legs, 3, rng)
    first, second = (draw_poses(made_up, actuators, 20, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert first.shape == (20, 3, 6)
    with pytest.raises(InputError, match="posterior draws"):
        draw_poses(replace(made_up, draws=None), actuators, 20, rng)


def test_along_a_bent_ridge_draws_tell_mean_and_covariance(rng):
    """Directions that lean to either side by 0.05 shorten every travel alike: the mean direction would lean nowhere."""
    machine = machines.build_machine("none")
    layout = machine.layout
    draws = np.tile(layout.nominal, (2000, 1))
    draws[:, layout.index["u_x"]] += 0.05 * rng.standard_normal((2000, 6))
    draws[:, layout.index["a_x"]] -= machines.INITIAL_POSITION * (draws[:, layout.index["u_x"]])  # joints stay at home
    made_up = build_calibrated(
        Legs(machine),
        draws.mean(axis=0),
        draws,
        calibrated.build_leg_errors(machine, draws[0], 0.0, np.zeros(6)),
        calibrated.SOURCE,
    )
    actuators = machines.INITIAL_POSITION + np.full((1, 6), machines.ACTUATOR_RANGE)
    found = predict_poses(made_up, actuators)
    position = draw_poses(made_up, actuators, 2000, rng)[..., :3]
    tangent = predict_poses(replace(made_up, draws=None), actuators)
    sd, z = position.std(axis=0)[0], position[:, 0, 2]
    assert abs(found.position[0, 2] - z.mean()) < 0.1 * z.std() < 0.2 * abs(tangent.position[0, 2] - z.mean())
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.covariance[0]))[:3] / sd, 1.0, atol=0.17)
