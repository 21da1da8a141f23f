"""One contract for every registered model with every registered deformation, for six legs and more.

A new entry in `bayescal.models.MODELS` or `bayescal.deformations.DEFORMATIONS` is picked up as it stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import machines
import numpy as np
import pytest

from bayescal.geometry import matrix_from_rotation_vector
from bayescal.kinematics import Machine, check_home_pose

TOLERANCE = 1e-7
LENGTH_STEP, ANGLE_STEP = 1e-3, 1e-5  # mm; rad or dimensionless: rounding and curvature both below 1e-9, relative
N_POSES = 5


@dataclass(frozen=True)
class Scene:
    """A machine off its nominal parameters, at poses that need not close."""

    machine: Machine
    theta: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    actuators: np.ndarray

    def linearise(self, **changes):
        """Return the linearisation, with arguments replaced by name."""
        names = ("theta", "position", "rotation", "actuators")
        return self.machine.linearise(*(changes.get(name, getattr(self, name)) for name in names))


@pytest.fixture(params=[6, 8], ids=lambda n: f"{n} legs")
def n_legs(request):
    """Return the number of legs."""
    return request.param


@pytest.fixture(params=machines.deformation_names())
def deformation(request):
    """Return the name of a deformation."""
    return request.param


@pytest.fixture(params=machines.model_names())
def scene(request, deformation, n_legs, rng):
    """Return a machine with every parameter moved, near its home pose."""
    machine = machines.build_machine(deformation, machines.build_random_mechanism(n_legs, seed=3), request.param)
    layout, home = machine.layout, check_home_pose(machine)
    spread = np.where([unit == "mm" for unit in layout.units], 1.0, 0.02)
    theta = layout.nominal + spread * rng.standard_normal(layout.size)
    position = home.position + rng.uniform(-3, 3, (N_POSES, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.05, 0.05, (N_POSES, 3)))
    actuators = machine.mechanism.initial_actuator_positions + rng.uniform(-2, 2, (N_POSES, n_legs))
    return Scene(machine, theta, position, rotation, actuators)


def assert_derivative(found, expected):
    """Compare derivatives (..., n) column by column, relative to each column's largest entry."""
    assert found.shape == expected.shape
    scale = np.abs(expected).reshape(-1, expected.shape[-1]).max(axis=0)
    difference = np.abs(found - expected).reshape(-1, expected.shape[-1]).max(axis=0)
    assert np.all(scale > 0)
    np.testing.assert_array_less(difference, TOLERANCE * scale)


def test_shapes(scene, n_legs):
    here, size = scene.linearise(), scene.machine.layout.size
    assert here.residual.shape == (N_POSES, n_legs)
    assert here.pose.shape == (N_POSES, n_legs, 6)
    assert here.actuators.shape == (N_POSES, n_legs, n_legs)
    assert here.parameters.shape == (N_POSES, n_legs, size)
    many = scene.linearise(theta=np.tile(scene.theta, (3, 1, 1)))
    assert many.parameters.shape == (3, N_POSES, n_legs, size)
    np.testing.assert_allclose(many.residual[1], here.residual, atol=1e-12)


def test_parameters_are_named_and_described(scene, n_legs):
    layout = scene.machine.layout
    assert len(set(layout.names)) == layout.size == len(layout.units)
    assert set(layout.units) <= {"mm", "1"}
    assert all(len(block.nominal) == (n_legs if block.per_leg else 1) for block in layout.blocks)
    assert scene.machine.model.name in machines.model_names()
    assert scene.machine.model.title


def test_nominal_machine_closes_at_its_home_pose(scene):
    machine = scene.machine
    home = check_home_pose(machine)
    nominal = machine.linearise(
        machine.layout.nominal, home.position, home.rotation, machine.mechanism.initial_actuator_positions
    )
    assert np.abs(nominal.residual).max() < 1e-9
    assert np.abs(scene.linearise().residual).min() > 1e-9


def test_pose_derivative(scene):
    def residual(x):
        rotation = matrix_from_rotation_vector(x[3:]) @ scene.rotation
        return scene.linearise(position=scene.position + x[:3], rotation=rotation).residual

    steps = np.array([LENGTH_STEP] * 3 + [ANGLE_STEP] * 3)
    assert_derivative(scene.linearise().pose, machines.central_difference(residual, np.zeros(6), steps))


def test_actuator_derivative_at_nominal_deformation(scene, n_legs):
    theta, layout = scene.theta.copy(), scene.machine.layout
    for block in scene.machine.deformation.blocks(n_legs):
        theta[layout.index[block.symbol]] = block.nominal

    def residual(x):
        return scene.linearise(theta=theta, actuators=scene.actuators + x).residual

    expected = machines.central_difference(residual, np.zeros(n_legs), np.full(n_legs, LENGTH_STEP))
    assert_derivative(scene.linearise(theta=theta).actuators, expected)


def test_parameter_derivative(scene):
    steps = np.where([unit == "mm" for unit in scene.machine.layout.units], LENGTH_STEP, ANGLE_STEP)
    expected = machines.central_difference(lambda theta: scene.linearise(theta=theta).residual, scene.theta, steps)
    assert_derivative(scene.linearise().parameters, expected)


def test_bound_closure_is_the_closure(scene, n_legs, rng):
    machine, batch = scene.machine, 4
    theta = scene.theta + 1e-2 * rng.standard_normal((batch, machine.layout.size))
    bound = machine.model.bind(machine.layout, scene.position, scene.rotation, machine.basis(scene.actuators))
    here = scene.linearise(theta=theta[:, None])
    found = bound.evaluate(theta)
    assert found.shape == (n_legs, N_POSES, batch)
    np.testing.assert_allclose(found.transpose(2, 1, 0), here.residual, rtol=0, atol=1e-11)
    error = rng.standard_normal((6, N_POSES, batch)) * np.array([1.0] * 3 + [1e-2] * 3)[:, None, None]
    expected = np.einsum("bpij,jpb->ipb", here.pose, error)
    np.testing.assert_allclose(bound.along(error), expected, rtol=0, atol=1e-11)


def test_direction_off_the_unit_sphere_is_nan_for_its_leg_only(scene):
    machine, theta = scene.machine, scene.theta.copy()
    if "u_x" not in machine.layout.index:
        pytest.skip("this model has no direction to leave the sphere")
    theta[machine.layout.index["u_x"][2]] = 1.01
    expected = np.arange(machine.mechanism.n_legs) == 2
    here = scene.linearise(theta=theta)
    np.testing.assert_array_equal(np.isnan(here.residual).all(axis=0), expected)
    np.testing.assert_array_equal(np.isnan(here.residual).any(axis=0), expected)
    bound = machine.model.bind(machine.layout, scene.position, scene.rotation, machine.basis(scene.actuators))
    np.testing.assert_array_equal(np.isnan(bound.evaluate(theta[None])).all(axis=(1, 2)), expected)


def actuators_of(scene, theta):
    """Return the actuator positions of the scene's poses; the deflection follows the actuators, so by iteration."""
    machine, rho = scene.machine, scene.actuators
    for _ in range(60):
        deflection = np.broadcast_to(machine.basis(rho).deflection(machine.layout, theta), rho.shape)
        rho = machine.model.inverse_kinematics(machine.layout, theta, scene.position, scene.rotation, deflection)
    return rho


def test_inverse_kinematics_closes(scene):
    """With every parameter off nominal, ρ^0 too: actuator positions are read from the nominal one."""
    rho = actuators_of(scene, scene.theta)
    assert np.abs(scene.linearise(actuators=rho).residual).max() < 1e-9
    assert np.abs(scene.linearise().residual).max() > 1e-3
