"""Geometry that is normal given the errors, functions of the pose among them: how good its proposal is."""

from dataclasses import replace

import numpy as np
import pytest
import studies
import telescope_machines as machines

from bayescal.density.calibration.model_error import GPTerm
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.components import LinearGeometry, LinearRows
from bayescal.density.pose_kernels import POSE_KERNELS
from bayescal.density.priors import NormalPrior
from bayescal.inference.conditional import ExactConditional
from bayescal.inference.exploration import explore

N_POSES = 12


@pytest.fixture(scope="module")
def posterior():
    """Return a telescope whose joints, lengths and four sorts of functions are unknown."""
    machine = machines.build_machine("none")
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    actuators = machines.table_3_actuators()[:N_POSES]
    found = machines.simulate_poses(machine, theta, actuators, np.full(6, 5e-3), rng)
    priors = {
        name: NormalPrior(value, 0.3)
        for name, value in zip(machine.layout.names, machine.layout.nominal, strict=True)
        if name.startswith(("b_x", "b_y", "l"))
    }
    functions = machines.let_functions_err(machine, found, tuple(POSE_KERNELS))
    return machines.measure(
        machine, found, priors, ErrorModel((*machines.let_err(shared=True).terms, *functions))
    ).with_pose_guesses()


def test_proposal_needs_no_sharpening(posterior):
    found = explore(posterior, np.random.SeedSequence(4))
    assert found.straight.conditional is not None
    assert found.efficiency > 0.2  # 0.4; with fixed axes 0.08


def test_errors_at_once_give_what_each_gives_by_itself(pytestconfig):
    """Of rows without functions, whose errors are weighed together."""
    path = pytestconfig.rootpath / "examples/own_machine/study.toml"
    posterior = studies.load_study(path).variants["all"].posterior()
    scatter = tuple(one for one in posterior.errors.terms if not isinstance(one, GPTerm))
    steady = replace(posterior, errors=replace(posterior.errors, terms=scatter)).with_pose_guesses()
    linear = steady.linear_geometry(steady.least_squares_start())
    zeta = np.random.default_rng(5).standard_normal((7, steady.n_parameters - steady.n_geometry))
    every = *linear.given(zeta), linear.log_mass(zeta)
    for k, one in enumerate(zeta[:, None]):
        for found, alone in zip(every, (*linear.given(one), linear.log_mass(one)), strict=True):
            np.testing.assert_allclose(found[k], alone[0], rtol=1e-9, atol=1e-9 * np.abs(found[k]).max())


def test_exact_conditional_is_the_normal_given_the_errors():
    """Of rows linear in the geometry, y = x for N(0, 1) has their mean and covariance, and back, at any errors."""
    rng = np.random.default_rng(3)
    slope, residual, centre = rng.standard_normal((8, 3)), rng.standard_normal(8), rng.standard_normal(3)

    def square(zeta):
        white = np.column_stack([slope, residual]) / np.sqrt(1.0 + np.exp(zeta[..., None]) * np.arange(8)[:, None])
        return np.swapaxes(white, 1, 2) @ white, np.zeros(len(zeta))

    nothing = np.zeros((3, 3)), np.zeros(3)
    rows = LinearRows(*nothing, square)
    linear = LinearGeometry(centre, rows, np.eye(3), np.ones(3), lambda zeta: np.zeros(len(zeta)), np.exp)
    zeta = np.array([[-30.0], [0.5], [4.0]])
    found = ExactConditional(linear, zeta)
    factor, shift, volume = found.open(zeta)
    mean, covariance = linear.given(zeta)
    np.testing.assert_allclose(factor @ np.swapaxes(factor, 1, 2), covariance, atol=1e-12)
    assert volume == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])
    np.testing.assert_allclose(found.forward(np.zeros((3, 3)), factor, shift), mean)
    x = rng.standard_normal((3, 3))
    np.testing.assert_allclose(found.backward(found.forward(x, factor, shift), factor, shift), x, atol=1e-10)
