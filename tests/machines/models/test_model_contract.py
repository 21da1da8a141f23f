"""One contract for every registered model with every registered deformation, for six legs and more.

A new entry in `bayescal.machines.models.MODELS` or `bayescal.machines.deformations.DEFORMATIONS` is picked up as it
stands.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import guided_machines as guided
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, check_home_pose, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.mechanism import Flexures
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector

TOLERANCE = 1e-7
STEP_SHARE = 0.1  # of the spread: rounding and what the stencil leaves out are then both below 1e-8, relative
POSE_STEPS = np.array([0.1] * 3 + [1e-3] * 3)  # mm and rad
ACTUATOR_STEP = 0.1  # mm
N_POSES = 5
DEFORMATIONS = machines.deformation_names()


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


CASES = [
    *((model, str(n), deformation) for model, n in machines.model_cases(6, 8) for deformation in DEFORMATIONS),
    *((model, kind, "linear") for model in machines.model_names() if model != "six_ups" for kind in guided.KINDS),
]


@pytest.fixture(scope="module", params=CASES, ids=", ".join)
def scene(request):
    """Return a machine with every parameter moved, near its home pose: of so many legs, or on guides of a kind."""
    model, form, deformation = request.param
    rng = np.random.default_rng(19)
    build = machines.build_random_mechanism if form.isdigit() else guided.build_guided
    machine = machines.build_machine(deformation, build(int(form) if form.isdigit() else form, seed=4), model)
    layout, home = machine.layout, check_home_pose(machine)
    spread = machines.spread_of(layout) * (1.0 if form.isdigit() else 0.2)
    theta = layout.nominal + spread * rng.standard_normal(layout.size)
    position = home.position + rng.uniform(-3, 3, (N_POSES, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.05, 0.05, (N_POSES, 3)))
    n_legs = machine.mechanism.n_legs
    actuators = machine.mechanism.initial_actuator_positions + rng.uniform(-2, 2, (N_POSES, n_legs))
    return Scene(machine, theta, position, rotation, actuators)


@pytest.fixture
def n_legs(scene):
    """Return the number of legs."""
    return scene.machine.mechanism.n_legs


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
    assert set(layout.units) <= {"mm", "1", "N", "N mm2"}
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


def move_poses(position, rotation, change):
    """Return poses (P, 3), (P, 3, 3) moved by changes (K, 6), batched (K, P, ...)."""
    return position + change[:, None, :3], matrix_from_rotation_vector(change[:, None, 3:]) @ rotation


def test_pose_derivative(scene):
    def residual(x):
        position, rotation = move_poses(scene.position, scene.rotation, x)
        return scene.linearise(position=position, rotation=rotation).residual

    assert_derivative(scene.linearise().pose, machines.stencil_derivative(residual, np.zeros(6), POSE_STEPS))


def test_pose_derivative_where_nothing_turns(scene):
    """At the nominal home pose every angle is zero: the branches for small ones."""
    machine, theta = scene.machine, scene.machine.layout.nominal
    home, rho = check_home_pose(machine), machine.mechanism.initial_actuator_positions[None]
    position, rotation = home.position[None], home.rotation[None]

    def residual(x):
        return machine.linearise(theta, *move_poses(position, rotation, x), rho).residual

    here = machine.linearise(theta, position, rotation, rho)
    assert_derivative(here.pose, machines.stencil_derivative(residual, np.zeros(6), POSE_STEPS))


def test_actuator_derivative_at_nominal_deformation(scene, n_legs):
    theta, layout = scene.theta.copy(), scene.machine.layout
    for block in scene.machine.deformation.blocks(n_legs):
        theta[layout.index[block.symbol]] = block.nominal

    def residual(x):
        return scene.linearise(theta=theta, actuators=scene.actuators + x[:, None]).residual

    expected = machines.stencil_derivative(residual, np.zeros(n_legs), np.full(n_legs, ACTUATOR_STEP))
    assert_derivative(scene.linearise(theta=theta).actuators, expected)


def test_parameter_derivative(scene):
    steps = machines.spread_of(scene.machine.layout) * STEP_SHARE
    expected = machines.stencil_derivative(lambda x: scene.linearise(theta=x[:, None]).residual, scene.theta, steps)
    assert_derivative(scene.linearise().parameters, expected)


def test_bound_closure_is_the_closure(scene, n_legs, rng):
    machine, batch = scene.machine, 4
    theta = scene.theta + 0.1 * machines.spread_of(machine.layout) * rng.standard_normal((batch, machine.layout.size))
    bound = machine.model.bind(machine.layout, scene.position, scene.rotation, machine.basis(scene.actuators))
    found = bound.evaluate(theta)
    assert found.shape == (n_legs, N_POSES, batch)
    here = scene.linearise(theta=theta[:, None])
    np.testing.assert_allclose(found.transpose(2, 1, 0), here.residual, rtol=0, atol=1e-11)


def test_bound_pose_derivative_is_linear(scene, n_legs, rng):
    """Exact for perfect joints; what the others may leave out, the likelihood's tests bound."""
    machine, batch = scene.machine, 3
    theta = scene.theta + 0.1 * machines.spread_of(machine.layout) * rng.standard_normal((batch, machine.layout.size))
    bound = machine.model.bind(machine.layout, scene.position, scene.rotation, machine.basis(scene.actuators))
    bound.evaluate(theta)
    unit = np.array([1.0] * 3 + [1e-2] * 3)[:, None, None]
    error, other = unit * rng.standard_normal((2, 6, N_POSES, batch))
    first, second = bound.along(error).copy(), bound.along(other).copy()
    assert first.shape == (n_legs, N_POSES, batch)
    np.testing.assert_allclose(bound.along(2.0 * error - other), 2.0 * first - second, rtol=0, atol=1e-12)
    if machine.model.name in machines.PERFECT_JOINTS:
        expected = np.einsum("bpij,jpb->ipb", scene.linearise(theta=theta[:, None]).pose, error)
        np.testing.assert_allclose(first, expected, rtol=0, atol=1e-11)


def test_direction_off_the_unit_sphere_is_nan(scene):
    """For its leg, or for all where the model refers to the home pose; never for some, and alike in batches."""
    machine, theta = scene.machine, scene.theta.copy()
    if "u_x" not in machine.layout.index:
        pytest.skip("this model has no direction to leave the sphere")
    theta[machine.layout.index["u_x"][2]] = 1.01
    here = scene.linearise(theta=theta)
    lost = np.isnan(here.residual)
    only, every = np.arange(machine.mechanism.n_legs) == 2, np.ones(machine.mechanism.n_legs, dtype=bool)
    expected = only if machine.model.name == "six_pus" else every
    np.testing.assert_array_equal(lost, np.tile(expected, (N_POSES, 1)))
    bound = machine.model.bind(machine.layout, scene.position, scene.rotation, machine.basis(scene.actuators))
    both = np.isnan(bound.evaluate(np.stack([theta, scene.theta])))
    np.testing.assert_array_equal(both[..., 0].T, lost)
    assert not both[..., 1].any()


def test_poses_are_found_again(scene, rng):
    """By the actuators that hold them; and the actuators again from these poses."""
    machine, theta = scene.machine, scene.machine.layout.nominal
    home = check_home_pose(machine)
    position = home.position + rng.uniform(-3, 3, (20, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.02, 0.02, (20, 3)))
    actuators = solve_inverse_kinematics(machine, theta, position, rotation).actuators
    found = solve_forward_kinematics(machine, theta, actuators)
    error = compute_pose_error(found.position, found.rotation, position, rotation)
    assert np.abs(error[:, :3]).max() < 1e-9
    assert np.abs(error[:, 3:]).max() < 1e-11
    again = solve_inverse_kinematics(machine, theta, found.position, found.rotation)
    np.testing.assert_allclose(again.actuators, actuators, rtol=0, atol=1e-9)


def test_inverse_kinematics_closes(scene):
    """With every parameter off nominal, ρ^0 too: actuator positions are read from the nominal one."""
    rho = solve_inverse_kinematics(scene.machine, scene.theta, scene.position, scene.rotation).actuators
    assert np.abs(scene.linearise(actuators=rho).residual).max() < 1e-9
    assert np.abs(scene.linearise().residual).max() > 1e-3


@pytest.mark.parametrize("model", machines.model_names())
def test_models_take_any_number_of_legs_but_for_the_equilibrium(model):
    mechanism = machines.build_random_mechanism(8, seed=3)
    if model not in machines.SIX_LEGS_ONLY:
        assert machines.build_model(model, mechanism).name == model
        return
    with pytest.raises(InputError, match=rf"^mechanism 'random 8': .*\b8 legs.* 6 .*\b{model} model$"):
        machines.build_model(model, mechanism)


@pytest.mark.parametrize("model", machines.model_names())
def test_models_say_what_they_need_of_flexures(model):
    bare = replace(machines.build_telescope(), flexures=None)
    no_sections = replace(bare, flexures=Flexures(np.full(6, 10.0), np.full(6, 0.25)))
    missing = {"beam": [bare], "stiffness": [bare, no_sections], "stiffness_fixed": [bare, no_sections]}.get(model, [])
    for mechanism, section in zip(missing, ("flexures", "stiffness"), strict=False):
        with pytest.raises(InputError) as caught:
            machines.build_model(model, mechanism).blocks(mechanism)
        found = str(caught.value)
        assert re.fullmatch(rf"mechanism 'telescope': found no \[{section}\], expected (it|them) for {model}", found)
    for mechanism in (bare, no_sections):
        if mechanism not in missing:
            assert machines.build_model(model, mechanism).blocks(mechanism)
