"""The density against forward kinematics and scipy, its normalisation, its derivative, and machines with spare legs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import multivariate_normal

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import BATCH
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error
from bayescal.numerics.units import MICROMETRE

TAU = np.array([0.5, 1.0, 2.0, 3.0, 5.0, 8.0]) * 1e-3


def build(deformation, size, rng, batch=3, **options):
    """Return a likelihood, and parameter vectors whose pose errors are up to about ``size`` mm.

    The data are the exact poses of the machine of table 7 (a), moved by pose errors of half that size.
    """
    machine = machines.build_machine(deformation)
    truth = machines.telescope_truth(machine)
    actuators = machines.table_3_actuators()
    error = rng.uniform(-0.5, 0.5, (len(actuators), 6)) * size * np.array([1.0] * 3 + [1 / 130.0] * 3)
    poses = machines.place_poses(machine, truth, actuators, error)
    # offsets of the lengths move the pose about as much, those of the directions and κ by ρ and Δρ
    spread = {"u_x": 1 / 10.0, "u_y": 1 / 10.0, "kappa": 0.5}
    scale = np.concatenate([np.full(len(index), spread.get(s, 1.0)) for s, index in machine.layout.index.items()])
    theta = truth + 0.15 * size * scale * rng.uniform(-1, 1, (batch, machine.layout.size))
    return PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE, **options), theta


def newton_errors(likelihood, theta):
    """Return measured minus predicted poses by forward kinematics, shape (B, P, 6)."""
    poses = likelihood.poses
    exact = solve_forward_kinematics(likelihood.machine, theta[:, None], poses.actuators[None])
    return compute_pose_error(poses.position, poses.rotation, exact.position, exact.rotation)


def log_normal(error, covariance):
    """Return scipy's normal log-density of a pose error, in mm and rad; mm and mrad keep its covariance well scaled."""
    unit = np.array([1.0] * 3 + [1e3] * 3)
    scaled = covariance * np.outer(unit, unit)
    return multivariate_normal(np.zeros(6), scaled).logpdf(error * unit) + np.log(unit).sum()


def remainder_bound(likelihood, theta, error):
    """Return a bound on the error of r (B, P) in mm: the closure's curvature, and what two refinements leave over.

    Moving a joint by d turns its leg of length l and changes it by d²/(2 l) beyond the linear term; a rotation w moves
    the joint by w² b / 2 beyond its own. The iteration has the matrix M = (A - A⁰) G, so that M³ r is left over.
    """
    mechanism, poses = likelihood.machine.mechanism, likelihood.poses
    arm = np.linalg.norm(mechanism.platform_points, axis=1).max() + 5.0
    shift, turn = np.linalg.norm(error[..., :3], axis=-1), np.linalg.norm(error[..., 3:], axis=-1)
    curvature = (shift + turn * arm) ** 2 / (2 * mechanism.leg_lengths.min() - 10.0) + 0.5 * turn**2 * arm
    here = likelihood.machine.linearise(theta[:, None], poses.position, poses.rotation, poses.actuators)
    change = here.pose - likelihood._pose_jacobian
    contraction = np.linalg.norm(change @ likelihood._gain, 2, axis=(-2, -1))
    assert contraction.max() < 0.1
    leg_error = np.linalg.norm(np.einsum("pij,bpj->bpi", likelihood._pose_jacobian, error), axis=-1)
    legs = np.sqrt(mechanism.n_legs)
    return (legs * curvature + contraction**3 * leg_error) / (1 - contraction)


@pytest.mark.parametrize("deformation", machines.deformation_names())
@pytest.mark.parametrize("size", [0.0, 5e-3, 50e-3])
def test_density_is_that_of_the_forward_kinematic_error(deformation, size, rng):
    likelihood, theta = build(deformation, size, rng)
    error = newton_errors(likelihood, theta)
    covariance = likelihood.pose_covariance(TAU)
    expected = [[log_normal(e, c) for e, c in zip(row, covariance, strict=True)] for row in error]
    found = likelihood.pointwise(theta, TAU)
    smallest = np.linalg.eigvalsh(likelihood.error_covariance(TAU))[:, 0]
    white_remainder = remainder_bound(likelihood, theta, error) / np.sqrt(smallest)
    white_error = np.sqrt(np.einsum("bpi,pij,bpj->bp", error, np.linalg.inv(covariance), error))
    tolerance = 1e-6 + white_error * white_remainder + 0.5 * white_remainder**2
    assert np.all(np.abs(found - expected) <= tolerance)


def test_error_sizes_are_those_intended(rng):
    """The tolerance above would be met by data without errors; these are not."""
    likelihood, theta = build("matrix", 50e-3, rng)
    largest = np.abs(newton_errors(likelihood, theta)[..., :3]).max()
    assert 30 * MICROMETRE < largest < 150 * MICROMETRE


def test_extra_variance_and_model_error_enter_alike(rng):
    variance = rng.uniform(1, 9, (40, 6)) * 1e-6
    likelihood, theta = build("matrix", 5e-3, rng, actuator_variance=variance)
    plain = PoseLikelihood(likelihood.machine, likelihood.poses, machines.ACTUATOR_NOISE)
    for pose in (0, 17):
        same = plain.pointwise(theta, np.sqrt(variance[pose] + TAU**2))
        np.testing.assert_allclose(likelihood.pointwise(theta, TAU)[:, pose], same[:, pose], rtol=1e-11)
        assert np.abs(same[:, pose] - plain.pointwise(theta, TAU)[:, pose]).max() > 1e-2


def test_pose_covariance_is_noise_carried_through_the_kinematics(rng):
    """C_n from the pose Jacobian by differences of forward kinematics."""
    machine = machines.build_machine("matrix")
    nominal, actuators = machine.layout.nominal, machines.table_3_actuators()[:4]
    poses = machines.place_poses(machine, nominal, actuators, np.zeros((4, 6)))
    variance = np.full((4, 6), 4e-6)
    found = PoseLikelihood(machine, poses, 2e-3, variance).pose_covariance(TAU)

    def pose(x):
        moved = solve_forward_kinematics(machine, nominal, actuators + x)
        return compute_pose_error(moved.position, moved.rotation, poses.position, poses.rotation)

    jacobian = machines.central_difference(pose, np.zeros(6), np.full(6, 1e-3))
    full = jacobian * 2e-3  # all actuators' noise, deformation included
    legs = machine.linearise(nominal, poses.position, poses.rotation, actuators)
    own = np.diagonal(legs.actuators, axis1=1, axis2=2)[:, None, :] * -np.linalg.inv(legs.pose)
    added = own * np.sqrt(variance[0] + TAU**2)
    expected = poses.covariance + full @ np.swapaxes(full, 1, 2) + added @ np.swapaxes(added, 1, 2)
    scale = np.sqrt(np.einsum("pi,pj->pij", *[np.diagonal(expected, axis1=1, axis2=2)] * 2))
    np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)


def test_density_is_normalised_over_the_data(rng):
    """The mean log-density of data drawn from the claimed density is minus its entropy: no Jacobian is missing."""
    n_draws = 20_000
    machine = machines.build_machine("matrix")
    theta = machines.telescope_truth(machine)
    actuators = np.tile(machines.table_3_actuators()[3], (n_draws, 1))
    exact = machines.place_poses(machine, theta, actuators[:1], np.zeros((1, 6)))
    covariance = PoseLikelihood(machine, exact, machines.ACTUATOR_NOISE).pose_covariance(TAU)[0]
    error = rng.standard_normal((n_draws, 6)) @ np.linalg.cholesky(covariance).T
    poses = machines.place_poses(machine, theta, actuators, error)
    density = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE).pointwise(theta[None], TAU)[0]
    entropy = 3 * np.log(2 * np.pi * np.e) + 0.5 * np.linalg.slogdet(covariance)[1]
    standard_error = np.sqrt(3.0 / n_draws)  # of half a chi-square with six degrees of freedom
    assert abs(density.mean() + entropy) < 4 * standard_error
    assert np.var(density) == pytest.approx(3.0, abs=6 * np.sqrt(36.0 / n_draws))
    # without log |A| the density would be one of leg errors in mm
    legs = machine.linearise(theta, exact.position[0], exact.rotation[0], actuators[0]).pose
    assert abs(np.linalg.slogdet(legs)[1]) > 1


def test_density_integrates_to_one_along_directions(rng):
    """A line integral of the density of a pose is that of the normal density with C_n along the same line."""
    machine = machines.build_machine("matrix")
    theta, grid = machines.telescope_truth(machine), np.linspace(-9, 9, 361)
    actuators = np.tile(machines.table_3_actuators()[8], (len(grid), 1))
    exact = machines.place_poses(machine, theta, actuators[:1], np.zeros((1, 6)))
    covariance = PoseLikelihood(machine, exact, machines.ACTUATOR_NOISE).pose_covariance(TAU)[0]
    factor = np.linalg.cholesky(covariance)
    for direction in np.eye(6):
        poses = machines.place_poses(machine, theta, actuators, grid[:, None] * (factor @ direction))
        density = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE).pointwise(theta[None], TAU)[0]
        integral = np.exp(density).sum() * (grid[1] - grid[0])
        expected = (2 * np.pi) ** -2.5 / np.prod(np.diag(factor))
        assert integral == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("n_legs", [6, 8])
def test_one_model_error_for_all_equals_one_each(n_legs, rng):
    likelihood, theta = build("linear", 5e-3, rng) if n_legs == 6 else build_redundant(rng)[:2]
    tau = rng.uniform(0, 8, n_legs) * MICROMETRE
    each = np.tile(tau, (len(theta), 1))
    np.testing.assert_allclose(
        likelihood.pointwise(theta, tau), likelihood.pointwise(theta, each), rtol=1e-9, atol=1e-8
    )
    other = each.copy()
    other[1, n_legs - 1] += 1e-3
    difference = likelihood.pointwise(theta, other) - likelihood.pointwise(theta, each)
    assert np.all(difference[[0, 2]] == 0)
    assert np.all(np.abs(difference[1]) > 1e-9)


def test_more_vectors_than_a_batch(rng):
    n = 2 * BATCH + 5
    likelihood, theta = build("matrix", 5e-3, rng, batch=n)
    tau = rng.uniform(0, 8, (n, 6)) * MICROMETRE
    for model_error, pick in ((tau, lambda k: tau[k]), (tau[0], lambda k: tau[0])):
        found = likelihood.pointwise(theta, model_error)
        assert found.shape == (n, 40)
        for part in (slice(0, 3), slice(126, 131), slice(n - 2, n)):
            np.testing.assert_allclose(found[part], likelihood.pointwise(theta[part], pick(part)), rtol=1e-11)


def test_later_calls_leave_earlier_results_alone(rng):
    """The scratch arrays that calls share are none of the results."""
    likelihood, theta = build("matrix", 5e-3, rng, batch=4)
    tau = rng.uniform(0, 8, (4, 6)) * MICROMETRE
    calls = {
        "each": lambda t: likelihood.pointwise(t, tau[: len(t)]),
        "one": lambda t: likelihood.pointwise(t, tau[0]),
        "errors": likelihood.errors,
        "pose": likelihood.pose_errors,
        "slope": lambda t: likelihood.error_jacobian(t[0])[1],
        "seen": lambda t: likelihood.error_jacobian(t[0])[0],
    }
    first = {name: call(theta) for name, call in calls.items()}
    kept = {name: value.copy() for name, value in first.items()}
    for call in calls.values():
        call(theta[::-1] + 1e-3)
        call(theta[1:3])
    for name, call in calls.items():
        np.testing.assert_array_equal(first[name], kept[name])
        np.testing.assert_array_equal(call(theta), kept[name])


def test_the_kept_whitening_follows_the_model_error(rng):
    likelihood, theta = build("matrix", 5e-3, rng)
    tau = TAU.copy()
    first = likelihood(theta, tau)
    tau *= 2.0  # in place: what was kept must not be compared with itself
    second = likelihood(theta, tau)
    np.testing.assert_allclose(second, likelihood(theta, np.tile(2 * TAU, (3, 1))), rtol=1e-10)
    np.testing.assert_array_equal(likelihood(theta, TAU), first)
    assert np.all(np.abs(first - second) > 1)


def test_what_is_kept_of_one_machine_is_not_taken_for_anothers(rng):
    likelihood, theta = build("matrix", 5e-3, rng)
    first, second = theta[:1].copy(), theta[1:2]
    errors = likelihood.errors(theta)
    np.testing.assert_allclose(likelihood.errors(first)[0], errors[0], rtol=0, atol=1e-11)
    kept = likelihood.errors(first)
    np.testing.assert_allclose(likelihood.error_jacobian(second[0])[0], errors[1], rtol=0, atol=1e-11)
    likelihood(first, TAU)
    np.testing.assert_array_equal(likelihood.error_jacobian(first[0])[0], kept[0])
    kept *= 2.0  # what was returned is the caller's
    np.testing.assert_allclose(likelihood.errors(first)[0], errors[0], rtol=0, atol=1e-11)
    first[:] = second  # in place: what was kept must not be compared with itself
    np.testing.assert_allclose(likelihood.errors(first)[0], errors[1], rtol=0, atol=1e-11)
    for other in (likelihood.refined(), likelihood.finer()):
        assert np.any(other.errors(second) != likelihood.errors(second))
        np.testing.assert_allclose(other.errors(second)[0], other.errors(theta)[1], rtol=0, atol=1e-11)


def test_no_machine_has_no_density(rng):
    likelihood, theta = build("matrix", 5e-3, rng)
    theta[1, likelihood.machine.layout.index["u_y"][4]] = -1.5
    for tau in (TAU, np.tile(TAU, (3, 1))):
        density = likelihood(theta, tau)
        assert density[1] == -np.inf
        assert np.isfinite(density[[0, 2]]).all()


def test_selected_poses_are_those_poses(rng):
    likelihood, theta = build("matrix", 5e-3, rng)
    chosen = np.array([31, 4, 17])
    few = PoseLikelihood(likelihood.machine, likelihood.poses.select(chosen), machines.ACTUATOR_NOISE)
    assert few.poses.names == ("32", "5", "18")
    np.testing.assert_allclose(few.pointwise(theta, TAU), likelihood.pointwise(theta, TAU)[:, chosen], rtol=1e-11)


# --- refinements and derivative --------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_legs", [6, 8])
def test_refinements_left_out_are_the_third_power_of_the_change(n_legs, rng, monkeypatch):
    likelihood, theta = build("matrix", 50e-3, rng) if n_legs == 6 else build_redundant(rng)[:2]
    two = likelihood.errors(theta)
    monkeypatch.setattr(likelihood, "_refinements", 6)
    six = likelihood.errors(theta)
    poses = likelihood.poses
    here = likelihood.machine.linearise(theta[:, None], poses.position, poses.rotation, poses.actuators)
    step = (here.pose - likelihood._pose_jacobian) @ likelihood._gain
    left_over = (step @ step @ step @ six[..., None])[..., 0]
    assert np.abs(two - six).max() > 0
    np.testing.assert_allclose(two - six, left_over, rtol=0, atol=0.05 * np.abs(left_over).max() + 1e-12)
    assert np.abs(two - six).max() < 1e-3 * np.abs(six).max()
    monkeypatch.setattr(likelihood, "_refinements", 1)
    assert np.abs(likelihood.errors(theta) - six).max() > 5 * np.abs(two - six).max()


@pytest.mark.parametrize("n_legs", [6, 8])
def test_solved_errors_are_those_of_many_refinements(n_legs, rng, monkeypatch):
    likelihood, theta = build("matrix", 50e-3, rng) if n_legs == 6 else build_redundant(rng)[:2]
    solved = likelihood.finer()
    assert solved.is_solved
    assert not likelihood.is_solved
    assert solved.finer() is None
    found = solved.errors(theta)
    assert np.abs(found - likelihood.errors(theta)).max() > 1e-9
    monkeypatch.setattr(likelihood, "_refinements", 30)
    np.testing.assert_allclose(found, likelihood.errors(theta), rtol=1e-9, atol=1e-13)


def test_errors_of_legs_far_from_nominal_have_to_be_solved_for(rng):
    """Flexures 1.8 times as long are as much softer, so that every refinement leaves half of what the last one left."""
    machine = machines.build_machine("none", model="stiffness")
    layout, actuators = machine.layout, machines.table_3_actuators()[:8]
    theta = layout.nominal.copy()
    theta[layout.index["l_b"]] *= 1.8
    error = rng.uniform(-0.5, 0.5, (len(actuators), 6)) * 1e-2 * np.array([1.0] * 3 + [1 / 130.0] * 3)
    poses = machines.place_poses(machine, theta, actuators, error)
    likelihood = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE)
    exact = newton_leg_errors(likelihood, theta)
    refined, solved = (one.errors(theta[None])[0] for one in (likelihood, likelihood.finer()))
    assert np.abs(refined - exact).max() > 0.05 * np.abs(exact).max()
    assert np.abs(solved - exact).max() < 1e-3 * np.abs(exact).max()


def test_a_machine_without_numbers_has_no_solved_density(rng):
    likelihood, theta = build("matrix", 5e-3, rng)
    theta[1] = np.nan
    found = likelihood.finer().pointwise(theta, TAU)
    assert np.isfinite(found[[0, 2]]).all()
    assert (found[1] == -np.inf).all()


def newton_leg_errors(likelihood, theta):
    """Return A⁰ e with e by forward kinematics, shape (P, N)."""
    return np.einsum("pij,pj->pi", likelihood._pose_jacobian, newton_errors(likelihood, theta[None])[0])


@pytest.mark.parametrize("deformation", machines.deformation_names())
@pytest.mark.parametrize("size", [1e-3, 20e-3])
def test_derivative_is_that_of_the_forward_kinematic_error(deformation, size, rng):
    likelihood, theta = build(deformation, size, rng, batch=1)
    _, found = likelihood.error_jacobian(theta[0])
    layout = likelihood.machine.layout
    steps = np.where([unit == "mm" for unit in layout.units], 1e-2, 1e-4)
    expected = machines.central_difference(lambda x: newton_leg_errors(likelihood, x), theta[0], steps)
    scale = np.abs(expected).max(axis=(0, 1))
    # left out are terms of second order in e: relative to the first, half the rotation of e, a length over 130 mm
    difference = np.abs(found - expected).max(axis=(0, 1)) / scale
    assert np.all(difference < size / 130.0)


@pytest.mark.parametrize("n_legs", [6, 8])
def test_derivative_against_differences_of_the_residual(n_legs, rng):
    likelihood, theta = build("matrix", 1e-3, rng, batch=1) if n_legs == 6 else build_redundant(rng, 1e-3)[:2]
    found_errors, found = likelihood.error_jacobian(theta[0])
    np.testing.assert_allclose(found_errors, likelihood.errors(theta[:1])[0], atol=1e-15)
    steps = np.where([unit == "mm" for unit in likelihood.machine.layout.units], 1e-3, 1e-5)
    expected = machines.central_difference(lambda x: likelihood.errors(x[None])[0], theta[0], steps)
    difference = np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))
    assert np.all(difference < 3e-5)


# --- every model -----------------------------------------------------------------------------------------------------


@pytest.fixture(params=machines.model_names())
def model(request):
    """Return the name of a model."""
    return request.param


LEVER = np.array([1.0] * 3 + [130.0] * 3)  # rotations as displacements of the platform's joints, mm


def compare_errors(machine, about, sizes, rng):
    """Return the largest exact pose error and the largest misfit of the likelihood's, mm, for offsets of every size.

    The data are the exact poses of the machine ``about``; offsets of size one are 1 mm, 0.02, a tenth of a stiffness.
    """
    actuators = machines.table_3_actuators()
    poses = machines.place_poses(machine, about, actuators, np.zeros((len(actuators), 6)))
    likelihood = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE)
    offset = machines.spread_of(machine.layout) * rng.standard_normal((4, machine.layout.size))
    results = []
    for size in sizes:
        theta = about + size * offset
        exact = newton_errors(likelihood, theta)
        misfit = (likelihood.pose_errors(theta) - exact) * LEVER
        results.append((np.abs(exact * LEVER).max(), np.abs(misfit).max()))
    return np.array(results).T


@pytest.mark.parametrize("deformation", machines.deformation_names())
def test_errors_of_every_model_are_exact_to_second_order(model, deformation, rng):
    """About the nominal machine, whatever a bound closure leaves out of its pose derivative: a tenth, a hundredth."""
    machine = machines.build_machine(deformation, model=model)
    exact, misfit = compare_errors(machine, machine.layout.nominal, (1e-1, 1e-2, 1e-3), rng)
    np.testing.assert_allclose(exact[:-1] / exact[1:], 10.0, rtol=0.05)
    np.testing.assert_allclose(misfit[:-1] / misfit[1:], 100.0, rtol=0.05)
    assert misfit[1] < 1e-4


@pytest.mark.parametrize("deformation", machines.deformation_names())
def test_errors_of_every_model_far_from_nominal(model, deformation, rng):
    """About the machine of table 7 (a), 2 mm off: what is left out of the derivative has changed, by parts in 1000."""
    machine = machines.build_machine(deformation, model=model)
    exact, misfit = compare_errors(machine, machines.telescope_truth(machine), (2e-3, 2e-4), rng)
    assert 5 * MICROMETRE < exact[0] < 30 * MICROMETRE
    assert np.all(misfit < 5e-3 * exact)
    assert misfit[0] < 1e-4


def test_derivative_of_every_model(model, rng):
    """Off nominal, `leg_error_jacobian` against forward kinematics; stout flexures, so that every parameter counts."""
    machine = machines.build_machine("matrix", machines.build_random_mechanism(6, seed=3), model)
    layout, actuators = machine.layout, machine.mechanism.initial_actuator_positions + rng.uniform(-2, 2, (8, 6))
    spread = machines.spread_of(layout)
    theta = layout.nominal + 0.5 * spread * rng.standard_normal(layout.size)
    poses = machines.place_poses(machine, theta, actuators, np.zeros((8, 6)))
    likelihood = PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE)
    _, found = likelihood.error_jacobian(theta)

    def leg_errors(x):
        return np.einsum("pij,bpj->bpi", likelihood._pose_jacobian, newton_errors(likelihood, x))

    expected = machines.stencil_derivative(leg_errors, theta, 0.1 * spread)
    scale = np.abs(expected).max(axis=(0, 1))
    assert np.all(scale * spread > 1e-6)
    np.testing.assert_array_less(np.abs(found - expected).max(axis=(0, 1)), 1e-6 * scale)


# --- machines with spare legs ----------------------------------------------------------------------------------------


def build_redundant(rng, size=5e-3, order=None):
    """Return likelihood and parameter vectors of an eight-leg machine, legs in the given order; and the order."""
    order = np.arange(8) if order is None else order
    mechanism = machines.build_random_mechanism(8, seed=8)
    fields = ("base_points", "platform_points", "directions", "leg_lengths", "initial_actuator_positions")
    permuted = {field: getattr(mechanism, field)[order] for field in fields}
    machine = machines.build_machine("linear", replace(mechanism, **permuted))
    layout = machine.layout
    stream = np.random.default_rng(88)
    offset = {symbol: stream.uniform(-1, 1, 8) for symbol in layout.symbols}
    spread = {"u_x": 0.02, "u_y": 0.02, "kappa": 0.02}
    theta = np.tile(layout.nominal, (3, 1))
    for symbol, value in offset.items():
        theta[:, layout.index[symbol]] += spread.get(symbol, 1.0) * value[order]
    home = check_home_pose(machines.build_machine("linear", mechanism))
    position = home.position + stream.uniform(-2, 2, (12, 3))
    rotation = machines.matrix_from_rotation_vector(stream.uniform(-0.01, 0.01, (12, 3))) @ home.rotation
    actuators = (
        closing_actuators(machine, theta[0], position, rotation) + size * stream.uniform(-1, 1, (12, 8))[:, order]
    )
    names = tuple(map(str, range(12)))
    poses = MeasuredPoses(names, position, rotation, machines.measurement_covariance(12), actuators)
    for symbol in layout.symbols:
        change = stream.uniform(-1, 1, (2, 8))[:, order]
        theta[1:, layout.index[symbol]] += size * spread.get(symbol, 1.0) * change
    return PoseLikelihood(machine, poses, machines.ACTUATOR_NOISE), theta, order


def closing_actuators(machine, theta, position, rotation):
    """Return the actuator positions at which the closure of every leg vanishes, by Newton's method leg by leg."""
    actuators = np.tile(machine.mechanism.initial_actuator_positions, (len(position), 1))
    for _ in range(30):
        here = machine.linearise(theta, position, rotation, actuators)
        actuators = actuators - np.linalg.solve(here.actuators, here.residual[..., None])[..., 0]
    assert np.abs(machine.linearise(theta, position, rotation, actuators).residual).max() < 1e-10
    return actuators


def test_order_of_the_legs_does_not_matter(rng):
    order = np.array([3, 0, 7, 5, 1, 6, 2, 4])
    tau = np.arange(1, 9) * MICROMETRE
    first, theta, _ = build_redundant(rng)
    second, permuted, _ = build_redundant(rng, order=order)
    np.testing.assert_allclose(second.errors(permuted), first.errors(theta)[..., order], atol=1e-11)
    np.testing.assert_allclose(
        second.pointwise(permuted, tau[order]), first.pointwise(theta, tau), rtol=1e-8, atol=1e-6
    )
    assert np.abs(second.pointwise(permuted, tau) - first.pointwise(theta, tau)).max() > 0.1


def test_spare_legs_report_the_closure_that_no_pose_explains(rng):
    """Of r, the part along the pose Jacobian is a pose error; the rest is what the spare legs disagree about."""
    likelihood, theta, _ = build_redundant(rng)
    exact = solve_forward_kinematics(likelihood.machine, theta[:, None], likelihood.poses.actuators[None])
    left = likelihood.machine.linearise(theta[:, None], exact.position, exact.rotation, likelihood.poses.actuators)
    found = likelihood.errors(theta)
    pose, gain = likelihood._pose_jacobian, likelihood._gain
    rest = found - np.einsum("pij,pjk,bpk->bpi", pose, gain, found)
    # least squares leaves a closure across the pose Jacobian where it stands
    np.testing.assert_allclose(np.linalg.norm(rest, axis=-1), np.linalg.norm(left.residual, axis=-1), rtol=0.1)
    assert np.linalg.norm(left.residual, axis=-1).min() > 1e-4


def test_spare_legs_density_is_normalised(rng):
    """Eight leg errors drawn from their covariance have minus the entropy as mean log-density, in units of the legs."""
    likelihood, _, _ = build_redundant(rng)
    tau = np.arange(1, 9) * MICROMETRE
    covariance, n_draws = likelihood.error_covariance(tau), 4000
    draws = rng.standard_normal((n_draws, 12, 8, 1))
    errors = (np.linalg.cholesky(covariance) @ draws)[..., 0].transpose(2, 1, 0)
    density = (likelihood._density_fixed(errors, tau)[0] + likelihood._constant[:, None]).mean(axis=1)
    volume = 0.5 * np.linalg.slogdet(np.swapaxes(likelihood._pose_jacobian, 1, 2) @ likelihood._pose_jacobian)[1]
    entropy = 4 * np.log(2 * np.pi * np.e) + 0.5 * np.linalg.slogdet(covariance)[1] - volume
    assert np.abs(density + entropy).max() < 4.5 * np.sqrt(4.0 / n_draws)
