"""Beam elements against the closed forms of strength of materials, and the chain in two independent forms.

The stiffness models against finite elements, statics in closed form, and their limits.
"""

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from finite_elements import (
    FiniteElementMachine,
    compute_beam_stiffness,
    condense_chain,
    external_wrench,
    shift_nodes,
)

from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.mechanism import BeamSection, ExternalLoad, section_of_rod
from bayescal.machines.models.equilibrium import SYMBOLS, compute_chain_stiffness, differentiate_chain
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector

E, G, DIAMETER, LENGTH = 200e3, 77e3, 1.5, 37.0
SECTION = section_of_rod(DIAMETER, E, G)
X_AXIS = np.array([1.0, 0.0, 0.0])


@pytest.fixture(params=range(8))
def chain(request):
    """Return random sections of flexure and leg, the distance of the centres and l_b: slim and stout, soft and hard."""
    rng = np.random.default_rng(request.param)
    flexure, leg = (BeamSection(*(10.0 ** rng.uniform(2, 5, 3))) for _ in range(2))
    l_b = 10.0 ** rng.uniform(-1, 2)
    return flexure, leg, l_b * (1.0 + 10.0 ** rng.uniform(-1, 1.7)), l_b


def chain_elements(flexure, leg, length, l_b):
    """Return the three elements between the nodes a', c', d' and b'."""
    flexures = compute_beam_stiffness(flexure, l_b)
    return flexures, compute_beam_stiffness(leg, length - l_b), flexures


def chain_between_centres(flexure, leg, length, l_b):
    """Return the condensed chain (12, 12) seen at the flexures' centres, half a flexure inside its end nodes."""
    return shift_nodes(
        condense_chain(chain_elements(flexure, leg, length, l_b)), 0.5 * l_b * X_AXIS, -0.5 * l_b * X_AXIS
    )


def chain_values(flexure, leg, length, l_b):
    """Return the chain's parameters in the order of `SYMBOLS`."""
    return [np.array(v) for v in (flexure.k1, flexure.k2, flexure.k3, leg.k1, leg.k2, leg.k3, length, l_b)]


def assert_relative(found, expected, tolerance):
    """Compare matrices of loads (N, N mm) per displacement (mm, rad), whose entries differ by powers of a length."""
    scale = np.sqrt(np.abs(np.outer(np.diag(expected), np.diag(expected))))
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)


def test_section_of_a_rod():
    """k1 = E π d⁴ / 64, k2 = E π d² / 4, k3 = G π d⁴ / 32, by integration over the disc."""
    radius = (np.arange(20_000) + 0.5) / 20_000 * DIAMETER / 2
    ring = 2 * np.pi * radius * DIAMETER / 2 / 20_000
    assert SECTION.k2 == pytest.approx(E * ring.sum(), rel=1e-8)
    assert SECTION.k3 == pytest.approx(G * (ring * radius**2).sum(), rel=1e-8)
    assert SECTION.k1 == pytest.approx(E * (ring * radius**2).sum() / 2, rel=1e-8)  # y² is half of r² on average


# --- chains ----------------------------------------------------------------------------------------------------------


def test_closed_form_is_the_condensed_matrix(chain):
    """`compute_chain_stiffness` says of the flexures' centres what eqs. (24) to (27) say, moved there."""
    found, length = compute_chain_stiffness(*chain_values(*chain)), chain[2]
    bending = found.near + found.far
    slim = bending / length
    near = np.diag([found.axial, 2 * slim / length, 2 * slim / length, found.torsional, found.near, found.near])
    near[1, 5] = near[5, 1] = slim
    near[2, 4] = near[4, 2] = -slim
    far_end = np.diag(np.diag(near))
    far_end[1, 5] = far_end[5, 1] = -slim
    far_end[2, 4] = far_end[4, 2] = slim
    between = -np.diag([found.axial, 2 * slim / length, 2 * slim / length, found.torsional, -found.far, -found.far])
    between[1, 5], between[5, 1] = slim, -slim
    between[2, 4], between[4, 2] = -slim, slim
    expected = np.block([[near, between], [between.T, far_end]])
    assert_relative(chain_between_centres(*chain), expected, 1e-8)


def test_without_flexures_the_leg_is_a_beam():
    """l_b to zero leaves the leg alone: 4 k1 / l and 2 k1 / l, k2 / l and k3 / l."""
    found = compute_chain_stiffness(*chain_values(SECTION, SECTION, LENGTH, 1e-9))
    expected = [SECTION.k2, SECTION.k3, 4 * SECTION.k1, 2 * SECTION.k1]
    np.testing.assert_allclose(
        [found.axial, found.torsional, found.near, found.far], np.array(expected) / LENGTH, rtol=1e-8
    )


def test_soft_flexures_bend_alone():
    """On a rigid leg: moments k1 / l_b about the own centre, and little about the other one: a spring at each end."""
    flexure, leg, l_b, length = SECTION, BeamSection(1e15, 1e15, 1e15), 10.0, 5000.0
    found = compute_chain_stiffness(*chain_values(flexure, leg, length, l_b))
    assert found.near == pytest.approx(flexure.k1 / l_b, rel=1e-6)
    assert abs(found.far) < 1e-4 * found.near
    assert found.axial == pytest.approx(flexure.k2 / (2 * l_b), rel=1e-6)
    assert found.torsional == pytest.approx(flexure.k3 / (2 * l_b), rel=1e-6)


def test_derivatives_of_the_chain(chain):
    values = np.array(chain_values(*chain))
    found = differentiate_chain([np.array(v) for v in values])

    def quantities(x):
        return np.stack(list(vars(compute_chain_stiffness(*x.T)).values()), axis=-1)

    # l only just above l_b would make a step in either a large one in the leg between
    steps = 3e-3 * np.where(np.arange(8) < 6, values, values[6] - values[7])
    steps[7] = min(steps[7], 3e-3 * values[7])
    expected = machines.stencil_derivative(quantities, values, steps)
    assert found.shape == (len(SYMBOLS), 4)
    computed = found.T
    size = np.abs(quantities(values[None])[0])[:, None] / values  # an elasticity of one
    np.testing.assert_allclose(computed / size, expected / size, rtol=1e-7, atol=1e-9)


MODELS = ("stiffness", "stiffness_fixed")
GRAVITY, MASS = 9.80665, 10.0  # m/s² and kg
PULL = ExternalLoad(
    force=(20.0, -35.0, 15.0),
    moment=(4000.0, -2500.0, 3000.0),
    weight=(0.0, 0.0, -MASS * GRAVITY),
    centre_of_mass=(10.0, -20.0, 60.0),
)
N_MM_PER_N_M = 1e3


@pytest.fixture(params=MODELS)
def model(request):
    """Return the name of a stiffness model."""
    return request.param


def soften(mechanism, factor):
    """Return the mechanism with flexures that bend and twist more easily, and pull as before."""
    section = mechanism.flexures.section
    softer = replace(section, k1=factor * section.k1, k3=factor * section.k3)
    return replace(mechanism, flexures=replace(mechanism.flexures, section=softer))


def wrench_of(machine, *arguments):
    """Return W of eq. (33), shape (..., 6), in N and N mm, at given parameters, poses and actuator positions."""
    to_wrench = machine.model.objective(machine.mechanism)
    return machine.linearise(*arguments).residual @ to_wrench.T * np.repeat([1.0, N_MM_PER_N_M], 3)


def wrench_slope(machine, *arguments):
    """Return dW/dX, shape (..., 6, 6), in N and N mm per mm and rad."""
    to_wrench = machine.model.objective(machine.mechanism) * np.repeat([1.0, N_MM_PER_N_M], 3)[:, None]
    return to_wrench @ machine.linearise(*arguments).pose


# --- equilibrium -----------------------------------------------------------------------------------------------------


@pytest.fixture(params=["telescope", "random"])
def mechanism(request):
    """Return the telescope, or a machine of stout flexures that leans in every way, both under load."""
    if request.param == "telescope":
        return machines.build_telescope(load=PULL)
    return replace(machines.build_random_mechanism(6, seed=4), load=PULL)


def move_about(machine, rng, n_poses=4):
    """Return actuator positions within their range, shape (P, 6)."""
    mechanism = machine.mechanism
    return mechanism.initial_actuator_positions + mechanism.actuator_range * rng.uniform(-1, 1, (n_poses, 6))


def test_wrench_is_that_of_the_finite_elements(model, mechanism, rng):
    """At poses out of equilibrium, with K."""
    machine = machines.build_machine("matrix", mechanism, model)
    elements, theta = FiniteElementMachine(machine), machine.layout.nominal
    rho = move_about(machine, rng)
    pose = solve_forward_kinematics(machine, theta, rho)
    position = pose.position + rng.uniform(-0.5, 0.5, (4, 3))
    rotation = matrix_from_rotation_vector(rng.uniform(-0.01, 0.01, (4, 3))) @ pose.rotation
    found = wrench_of(machine, theta, position, rotation, rho)
    for k in range(4):
        (_, upper), force, moment = elements.loads(position[k], rotation[k], rho[k])
        pull, torque = external_wrench(mechanism.load, rotation[k])
        levers = np.cross(upper - position[k], force[1])
        expected = np.concatenate([pull - force[1].sum(axis=0), torque - (moment[1] + levers).sum(axis=0)])
        size = np.repeat([np.abs(force).max(), np.abs(levers).max()], 3)
        np.testing.assert_allclose(found[k] / size, expected / size, rtol=0, atol=1e-9)
        assert np.abs(expected / size).max() > 1e-2


# --- small displacements ---------------------------------------------------------------------------------------------


def test_stiffness_at_home_is_that_of_the_finite_elements(model, mechanism):
    """-dW/dX: symmetric and positive definite at home without load."""
    machine = machines.build_machine("none", replace(mechanism, load=ExternalLoad()), model)
    elements = FiniteElementMachine(machine)
    rho = mechanism.initial_actuator_positions
    found = -wrench_slope(machine, machine.layout.nominal, elements.home.position, elements.home.rotation, rho)
    unit = np.sqrt(np.diag(found))
    scaled = found / np.outer(unit, unit)
    np.testing.assert_allclose(scaled, scaled.T, rtol=0, atol=1e-10)
    assert np.linalg.eigvalsh(scaled)[0] > 1e-4
    np.testing.assert_allclose(scaled, elements.stiffness() / np.outer(unit, unit), rtol=0, atol=1e-9)


def test_moving_base_and_platform_alike_loads_nothing(model):
    """Parallel actuators carry the whole machine along."""
    direction = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    mechanism = machines.build_telescope(directions=np.tile(direction, (6, 1)))
    machine = machines.build_machine("none", mechanism, model)
    theta, home, far = machine.layout.nominal, check_home_pose(machine), 7.0
    rho = mechanism.initial_actuator_positions + far
    carried = machine.linearise(theta, home.position + far * direction, home.rotation, rho).residual
    assert np.abs(carried).max() < 1e-10
    left_behind = machine.linearise(theta, home.position, home.rotation, rho).residual
    assert np.abs(left_behind).max() > 1.0
    found = solve_forward_kinematics(machine, theta, rho)
    np.testing.assert_allclose(found.position, home.position + far * direction, atol=1e-9)
    np.testing.assert_allclose(found.rotation, home.rotation, atol=1e-11)


# --- loads -----------------------------------------------------------------------------------------------------------


def weigh(mass):
    """Return the weight of a mass in kg, acting at the platform's origin."""
    return ExternalLoad(weight=(0.0, 0.0, -mass * GRAVITY))


def sink(mechanism, model):
    """Return how far the platform goes down under its load, mm, and how far it goes aside or turns."""
    loaded = machines.build_machine("none", mechanism, model)
    free = check_home_pose(machines.build_machine("none", mechanism))
    pose = solve_forward_kinematics(loaded, loaded.layout.nominal, mechanism.initial_actuator_positions)
    aside = compute_pose_error(pose.position, pose.rotation, free.position, free.rotation)
    return -aside[2], np.abs(np.delete(aside, 2)).max()


def test_platform_sinks_by_the_axial_compliance_of_its_legs(model):
    """A symmetric machine on soft joints: m g / Σ k_a cos², k_a the flexures and the leg in a row."""
    mechanism = soften(machines.build_telescope(load=weigh(MASS)), 1e-9)
    flexures = mechanism.flexures
    compliance = 2 * 10.0 / flexures.section.k2 + (500.0 - 10.0) / flexures.leg_section.k2
    home = check_home_pose(machines.build_machine("none", mechanism)).position[2]
    cosine = (home - machines.INITIAL_POSITION) / 500.0
    found, aside = sink(mechanism, model)
    assert found == pytest.approx(MASS * GRAVITY * compliance / (6 * cosine**2), rel=1e-4)
    assert aside < 1e-6 * found


@pytest.mark.parametrize("deformation", machines.deformation_names())
def test_forward_and_inverse_kinematics_under_load(model, mechanism, deformation, rng):
    machine = machines.build_machine(deformation, mechanism, model)
    theta, rho = machine.layout.nominal, move_about(machine, rng, 50)
    pose = solve_forward_kinematics(machine, theta, rho)
    assert pose.converged.all()
    found = solve_inverse_kinematics(machine, theta, pose.position, pose.rotation)
    assert found.converged.all()
    np.testing.assert_allclose(found.actuators, rho, rtol=0, atol=1e-9)
    free = machines.build_machine(deformation, replace(mechanism, load=ExternalLoad()), model)
    other = solve_inverse_kinematics(free, theta, pose.position, pose.rotation)
    assert np.abs(other.actuators - rho).max() > 1e-3  # the load matters


# --- limits ----------------------------------------------------------------------------------------------------------


def test_soft_flexures_make_the_6_pus():
    """Over table 3, by the first power of the flexures' stiffness."""
    rho, distances = machines.table_3_actuators(), []
    perfect = machines.build_machine("matrix")
    expected = solve_forward_kinematics(perfect, perfect.layout.nominal, rho)
    factors = (1.0, 1e-1, 1e-2, 1e-3, 1e-6)
    for factor in factors:
        machine = machines.build_machine("matrix", soften(machines.build_telescope(), factor), "stiffness")
        pose = solve_forward_kinematics(machine, machine.layout.nominal, rho)
        error = compute_pose_error(pose.position, pose.rotation, expected.position, expected.rotation)
        distances.append(np.linalg.norm(error * [1, 1, 1, 130, 130, 130], axis=1).max())
    np.testing.assert_allclose(distances / (distances[3] / 1e-3 * np.array(factors)), 1.0, rtol=0.02)
    assert distances[-1] < 1e-6
    assert 1e-4 < distances[0] < 1e-2


def test_without_load_only_ratios_of_stiffnesses_count(model, rng):
    """Legs of another material, no load: the same poses, and the same f, which is a length."""
    machine = machines.build_machine("matrix", model=model)
    layout, rho = machine.layout, move_about(machine, rng)
    stiffer = layout.nominal.copy()
    for symbol in ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l"):
        stiffer[layout.index[symbol]] *= 3.0
    pose = solve_forward_kinematics(machine, layout.nominal, rho)
    position = pose.position + rng.uniform(-0.5, 0.5, (4, 3))
    first, second = (machine.linearise(x, position, pose.rotation, rho).residual for x in (layout.nominal, stiffer))
    np.testing.assert_allclose(second, first, rtol=0, atol=1e-11)
    assert np.abs(first).max() > 0.1


def test_chain_of_the_telescope():
    """What the telescope's steel rods come to, by hand: 6.3 N/µm along a leg, 1 N m per radian at a joint."""
    flexures = machines.build_telescope().flexures
    d, leg = flexures.section, flexures.leg_section
    chain = compute_chain_stiffness(*(np.array(v) for v in (d.k1, d.k2, d.k3, leg.k1, leg.k2, leg.k3, 500.0, 10.0)))
    assert chain.axial == pytest.approx(1 / (20 / (200e3 * np.pi / 4) + 490 / (200e3 * 25 * np.pi)), rel=1e-12)
    assert chain.near == pytest.approx(200e3 * np.pi / 64 / 10.0, rel=0.01)
