"""Posteriors of every model: gradients, and proposals and priors of what is no machine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from shares import run_rest

from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.priors import NormalPrior, UniformPrior


@pytest.fixture(params=machines.model_names())
def model(request):
    """Return the name of a model."""
    return request.param


def build_free(model, poses, deformation="matrix", model_error=NO_ERRORS, mechanism=None):
    """Return a posterior with every parameter of a model free; the sd of a stiffness is an eighth of it."""
    machine = machines.build_machine(deformation, mechanism, model)
    layout = machine.layout
    unit = {"mm": lambda value: 1.0, "1": lambda value: 0.02}
    priors = {
        name: NormalPrior(value, unit.get(kind, lambda value: value / 8)(value))
        for name, value, kind in zip(layout.names, layout.nominal, layout.units, strict=True)
    }
    return machines.measure(machine, poses, priors, model_error)


@pytest.mark.parametrize("deformation", run_rest(["matrix", "none"], 1))
def test_gradient_of_every_model(model, deformation, rng):
    """Every parameter free, about exact poses of stout flexures that lean in every way."""
    leaning = machines.build_random_mechanism(6, seed=11)
    machine = machines.build_machine(deformation, leaning, model)
    actuators = leaning.initial_actuator_positions + rng.uniform(-1, 1, (20, 6))
    poses = machines.place_poses(machine, machine.layout.nominal, actuators, np.zeros((20, 6)))
    posterior = build_free(model, poses, deformation, machines.let_err(), leaning)
    y = 1e-3 * rng.standard_normal(posterior.n_parameters)
    found, _ = posterior.gradient(y)
    expected = machines.stencil_derivative(posterior.log_density, y, np.full(len(y), 1e-4))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@pytest.fixture(scope="module")
def few_poses():
    """Return eight of the twin's poses."""
    machine = machines.build_machine("matrix")
    truth, rng = machines.telescope_truth(machine), np.random.default_rng(7)
    return machines.simulate_poses(machine, truth, machines.table_3_actuators()[:8], np.zeros(6), rng)


NO_MACHINES = {
    "a leg of no length": {"l[3]": 0.0},
    "a leg of negative length": {"l[3]": -500.0},
    "a flexure of no length": {"l_b[1]": 0.0},
    "a flexure of negative length": {"l_b[4]": -1.0},
    "beta of a rigid flexure": {"beta[2]": 0.0},
    "beta of an ideal pivot": {"beta[2]": 0.5},
    "beta above a half": {"beta[2]": 0.6},
    "beta whose root is imaginary": {"beta[2]": 1.0},
    "beta far below zero": {"beta[6]": -1e6},
    **{f"{symbol} of nothing": {symbol: 0.0} for symbol in ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l")},
    **{f"{symbol} below zero": {symbol: -1.0} for symbol in ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l")},
}
FAR_OUT = {"far": 1e3, "very far": 1e100, "beyond squares": 1e200, "beyond anything": np.inf, "no number": np.nan}


def plain(posterior):
    """Return the same with each parameter by itself, so that any may be what is no machine's."""
    return replace(posterior, likelihood=posterior.likelihood.plain)


def propose(posterior, y, changes):
    """Return the plain coordinates y (n,) with some parameters changed by name."""
    layout = posterior.sampling.layout
    theta = posterior.theta(y[None])[0]
    for name, value in changes.items():
        theta[layout.names.index(name)] = value
    changed = y.copy()
    changed[: posterior.n_geometry] = posterior.sampling.y_from_theta(theta)
    np.testing.assert_allclose(posterior.theta(changed[None])[0], theta, rtol=1e-9, atol=1e-12)
    return changed


def assert_no_machine(posterior, bad, rng):
    """Assert that a bad proposal has no density, and that its neighbours in a batch have theirs."""
    batch = 0.1 * rng.standard_normal((6, posterior.n_parameters))
    expected = posterior.log_density(batch)
    assert np.isfinite(expected).all()
    batch[2] = bad
    found = posterior.log_density(batch)
    assert found[2] == -np.inf
    np.testing.assert_allclose(np.delete(found, 2), np.delete(expected, 2), rtol=1e-9, atol=2e-4)


@pytest.fixture
def free(model, few_poses):
    """Return a posterior with every parameter of a model free."""
    return build_free(model, few_poses, model_error=machines.let_err())


def test_parameters_of_no_machine_have_no_density(free, rng):
    free = plain(free)
    y = 0.1 * rng.standard_normal(free.n_parameters)
    cases = {what: changes for what, changes in NO_MACHINES.items() if set(changes) <= set(free.names)}
    assert len(cases) >= 2
    for changes in cases.values():
        assert_no_machine(free, propose(free, y, changes), rng)


def test_directions_off_the_sphere_have_no_density(free, rng):
    if "u_x[3]" not in free.names:
        pytest.skip("this model has no direction to leave the sphere")
    for symbol in ("u_x[3]", "u_y[5]"):
        y = 0.1 * rng.standard_normal(free.n_parameters)
        y[free.names.index(symbol)] = 1e3
        assert_no_machine(free, y, rng)


def test_proposals_far_out_have_no_density(free, rng):
    """No warning, no exception: samplers do propose them."""
    for size in FAR_OUT.values():
        assert_no_machine(free, size * rng.standard_normal(free.n_parameters), rng)
        y = 0.1 * rng.standard_normal(free.n_parameters)
        y[3] = size if not np.isfinite(size) else 1e200
        assert_no_machine(free, y, rng)


def test_far_out_in_few_parameters_is_finite_or_none(free, rng):
    """Lengths of kilometres and more: a machine after all, or none; never a number that is not one."""
    names = np.array([name.startswith("a_") for name in free.names])
    for size in (1e2, 1e4, 1e8, 1e100, 1e155):
        batch = 0.1 * rng.standard_normal((4, free.n_parameters))
        batch[1] += size * names * rng.standard_normal(len(names))
        found = free.log_density(batch)
        assert found[1] < -1e4
        assert np.isfinite(found[[0, 2, 3]]).all()


def test_no_home_pose_has_no_density(free, rng):
    """One leg too short for its joints, or all lower joints in one point; perfect joints need no home pose."""
    free = plain(free)
    names = free.sampling.layout.names
    y = 0.1 * rng.standard_normal(free.n_parameters)
    for changes in ({"l[3]": 50.0}, {name: 0.0 for name in names if name.startswith(("a_x", "a_y"))}):
        bad = propose(free, y, changes)
        if free.likelihood.model.machine.model.name not in machines.PERFECT_JOINTS:
            assert_no_machine(free, bad, rng)
        else:
            assert free.log_density(bad[None])[0] < -1e6


@pytest.mark.parametrize(("model", "name", "bounds"), [("beam", "beta[3]", (0.0, 0.5)), ("six_pus", "u_x[1]", (-1, 1))])
def test_uniform_priors_may_reach_the_bounds(model, name, bounds, few_poses):
    machine = machines.build_machine("none", model=model)
    posterior = machines.measure(machine, few_poses, {name: UniformPrior(*bounds)})
    found = posterior.log_density(np.array([[-60.0], [-0.5], [0.0], [0.5], [60.0]]))
    assert np.isfinite(found[1:4]).all()
    assert found[[0, 4]].tolist() == [-np.inf, -np.inf]  # on a bound: no machine
