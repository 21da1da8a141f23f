"""The Jacobian model against RR-8096's equations (8) and (9) written out, and what ρ^0 can never tell in it."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.machines.models.home import solve_home
from bayescal.numerics.geometry import matrix_from_rotation_vector

REPORTED = ("a_x", "a_y", "u_x", "l", "b_x", "b_y")


def inverse_jacobian(base, joints, directions, home):
    """Return J_0⁻¹ of eq. (8), shape (6, 6), of lower joints, platform joints and directions (6, 3) at a home pose."""
    rows = []
    for lower, joint, u in zip(base, joints, directions, strict=True):
        arm = home.rotation @ joint
        z = home.position + arm - lower
        z = z / np.linalg.norm(z)
        rows.append(np.concatenate([z, np.cross(arm, z)]) / (u @ z))
    return np.array(rows)


def test_deflection_counts_by_its_velocity_along_the_leg(rng):
    """A machine that leans in every way, off nominal, with K: Δb_z e_z of the home platform, seen along u."""
    mechanism = machines.build_random_mechanism(6, seed=9)
    machine = machines.build_machine("matrix", mechanism, "jacobian")
    layout = machine.layout
    theta = layout.nominal + machines.spread_of(layout) * rng.standard_normal(layout.size)
    perfect = machines.build_machine("matrix", mechanism)
    home = solve_forward_kinematics(perfect, theta, mechanism.initial_actuator_positions)
    u = np.stack([layout.take(theta, "u_x"), layout.take(theta, "u_y"), np.zeros(6)], axis=1)
    u[:, 2] = np.sqrt(1 - np.sum(u**2, axis=1))
    lower = layout.take_vector(theta, "a") + layout.take(theta, "rho0")[:, None] * u
    joints = layout.take_vector(theta, "b")
    travel = rng.uniform(-2, 2, (4, 6))
    position = home.position + rng.uniform(-3, 3, (4, 3))
    phi = rng.uniform(-0.05, 0.05, (4, 3))
    inverse = inverse_jacobian(lower, joints, u, home)
    rho = mechanism.initial_actuator_positions + travel
    deflection = machine.basis(rho).deflection(layout, theta)
    expected = travel - np.concatenate([position - home.position, phi], axis=1) @ inverse.T
    expected -= deflection * (inverse[:, :3] @ home.rotation[:, 2])
    found = machine.linearise(theta, position, matrix_from_rotation_vector(phi) @ home.rotation, rho).residual
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    assert np.abs(deflection).max() > 1e-2


def test_difference_from_the_6_pus_is_quadratic():
    """Halving the displacements quarters it; over table 3 it is tens of micrometres."""
    machine, perfect = (machines.build_machine("matrix", model=model) for model in ("jacobian", "six_pus"))
    sizes, differences = (1.0, 0.5, 0.25, 0.125), []
    for size in sizes:
        rho = machines.INITIAL_POSITION + size * (machines.table_3_actuators() - machines.INITIAL_POSITION)
        pose = [solve_forward_kinematics(m, m.layout.nominal, rho) for m in (machine, perfect)]
        differences.append(np.linalg.norm(pose[0].position - pose[1].position, axis=1).max())
    np.testing.assert_allclose(np.array(differences[:-1]) / differences[1:], 4.0, rtol=0.05)
    assert 0.01 < differences[0] < 0.1


@pytest.mark.parametrize("where", ["nominal", "identified"])
@pytest.mark.parametrize(("symbols", "n_null"), [(REPORTED, 0), ((*REPORTED, "rho0"), 6)])
def test_initial_positions_are_told_by_nothing(where, symbols, n_null):
    """With ρ^0 free, one exact null direction per leg: the model knows of the lower joint at home only."""
    machine = machines.build_machine("none", model="jacobian")
    layout = machine.layout
    theta = layout.nominal if where == "nominal" else machines.telescope_truth(machine)
    data = machines.place_poses(machine, theta, machines.table_3_actuators(), np.zeros((40, 6)))
    posterior = machines.measure(machine, data, {})
    columns = np.concatenate([layout.index[s] for s in symbols])
    change = np.eye(layout.size)[:, columns]
    slope = posterior.likelihood.reduced_rows(theta, change, posterior.errors, np.zeros(0))[1].reshape(-1, len(columns))
    values = np.linalg.svd(slope / np.linalg.norm(slope, axis=0), compute_uv=False)
    assert (values < 1e-12 * values[0]).sum() == n_null
    assert values[len(columns) - n_null - 1] > 1e-4 * values[0]


def test_spare_legs_keep_their_closure(rng):
    """At the home pose of eight legs f is what is left of l - |g|, per actuator displacement."""
    mechanism = machines.build_random_mechanism(8, seed=8)
    machine, perfect = (machines.build_machine("none", mechanism, model) for model in ("jacobian", "six_pus"))
    layout = machine.layout
    theta = layout.nominal + 0.3 * machines.spread_of(layout) * rng.standard_normal(layout.size)
    home = solve_home(layout, theta)
    here = (theta, home.position, home.rotation, mechanism.initial_actuator_positions)
    left = perfect.linearise(*here).residual
    found = machine.linearise(*here).residual
    gain = np.einsum("ik,ik->i", home.legs.direction, home.legs.axis)
    np.testing.assert_allclose(found, left / gain, rtol=0, atol=1e-11)
    assert np.abs(left).max() > 0.05
