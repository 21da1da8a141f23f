"""The free matrix: the matrix deformation whose entries are parameters."""

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.calibrated.machine import find_export_obstacle
from bayescal.density.outliers import Contaminated
from bayescal.density.priors import NormalPrior, SharePrior
from bayescal.machines.coordinates import ClosingCoordinates
from bayescal.machines.kinematics import solve_forward_kinematics

SD = 0.02 / machines.ACTUATOR_RANGE


@pytest.fixture(scope="module")
def machine():
    return machines.build_machine("free_matrix")


def fill(machine, theta, matrix):
    """Return a machine's parameters with the entries of K."""
    theta = theta.copy()
    for j in range(6):
        theta[machine.layout.index[f"K_{j + 1}"]] = matrix[:, j]
    return theta


def test_is_the_matrix_deformation_with_its_entries(machine):
    known, actuators = machines.build_machine("matrix"), machines.table_3_actuators()[:5]
    theta = machines.telescope_truth(known)
    matrix = machines.TELESCOPE_MATRIX.copy()
    np.fill_diagonal(matrix, theta[known.layout.index["kappa"]])
    own = np.concatenate([theta[: machines.build_machine("none").layout.size], np.zeros(36)])
    expected = solve_forward_kinematics(known, theta, actuators)
    found = solve_forward_kinematics(machine, fill(machine, own, matrix), actuators)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    rigid = solve_forward_kinematics(machine, own, actuators)
    assert np.abs(rigid.position - expected.position).max() > 1e-3


@pytest.fixture(scope="module")
def poses(machine):
    actuators = machines.table_3_actuators()[:14]
    theta = machines.telescope_truth(machine)
    return machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), np.random.default_rng(1))


def build_priors(machine):
    layout = machine.layout
    symbols = (*machines.FREE_SYMBOLS["none"], *(f"K_{j + 1}" for j in range(6)))
    sd = dict(machines.PRIOR_SD) | dict.fromkeys((f"K_{j + 1}" for j in range(6)), SD)
    return {
        name: NormalPrior(value, sd.get(name.split("[")[0], 2.0))
        for name, value in zip(layout.names, layout.nominal, strict=True)
        if name.split("[")[0] in symbols
    }


def test_derivatives_by_the_entries(machine, poses):
    plain = machines.measure(machine, poses, build_priors(machine), machines.let_err()).with_pose_guesses()
    assert isinstance(plain.sampling.coordinates, ClosingCoordinates)
    y = plain.refine_geometry(plain.least_squares_start())
    y += np.random.default_rng(3).standard_normal(len(y)) / np.sqrt(-np.diag(plain.gradient(y)[1]))
    gradient, hessian = plain.gradient(y)
    expected = machines.stencil_derivative(plain.log_density, y, np.full(len(y), 1e-3))
    off = (gradient - expected) / np.sqrt(-np.diag(hessian))
    assert np.abs(off).max() < 0.05


def find_sds(posterior, y):
    """Return the sds of the free parameters to first order, in their own units."""
    change = posterior.sampling.jacobian(posterior.theta(y[None])[0])[posterior.sampling.free]
    return np.sqrt(np.diagonal(change @ np.linalg.inv(sum(posterior.information(y))) @ change.T))


def test_explicit_entries_leave_of_the_geometry_what_linear_errors_leave(machine, poses):
    """The information on the geometry with the entries marginalised, against that of linear errors as large."""
    rigid, priors, errors = machines.build_machine("none"), build_priors(machine), machines.let_err()
    plain = machines.measure(machine, poses, priors, errors).with_pose_guesses()
    y = plain.refine_geometry(plain.least_squares_start())
    linear = machines.let_functions_err(rigid, poses, ("linear",))
    rest = {name: prior for name, prior in priors.items() if not name.startswith("K_")}
    other = machines.measure(rigid, poses, rest, replace(errors, terms=(*errors.terms, *linear)))
    travel = (poses.actuators - machines.INITIAL_POSITION) / machines.ACTUATOR_RANGE
    size = 0.02 * np.sqrt(np.mean(np.sum(travel**2, axis=1)))  # rms of slopes of 20 µm over the range
    zeta = other.errors.priors[-1].standardise(np.array([size]))
    start = np.concatenate([other.refine_geometry(other.least_squares_start())[: len(rest)], y[len(priors) :], zeta])
    expected = find_sds(other, start)
    assert np.abs(find_sds(plain, y)[: len(rest)] / expected - 1.0).max() < 0.02
    assert (expected / find_sds(machines.measure(rigid, poses, rest, errors), start[:-1])).max() > 2.0


def test_stands_beside_blunders(machine, poses):
    plain = machines.measure(machine, poses, build_priors(machine), machines.let_err()).with_pose_guesses()
    robust = replace(plain, errors=replace(plain.errors, outliers=Contaminated(SharePrior(0.02))))
    assert isinstance(robust.sampling.coordinates, ClosingCoordinates)
    y = robust.refine_geometry(robust.least_squares_start())
    assert np.isfinite(robust.log_density(y[None])).all()


def test_no_file_of_a_machine_holds_it(machine):
    assert "free_matrix" in find_export_obstacle(machine)
    assert "K_1" in machine.layout.symbols
