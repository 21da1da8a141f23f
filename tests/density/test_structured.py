"""A model error that is a function of the pose: density, conditionals and coordinates against plain formulas."""

import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import multivariate_normal

from bayescal.density.errors import NO_MODEL_ERROR, KernelScale, LegErrors, ModelError
from bayescal.density.legs import build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.prediction import pointwise_given, predict_structured
from bayescal.density.priors import (
    OFF,
    LinearKernel,
    NormalPrior,
    QuadraticKernel,
    SmoothKernel,
    build_kernel,
)
from bayescal.density.structured import StructuredLikelihood, map_covariance
from bayescal.errors import InputError
from bayescal.inference.exploration import explore

N_POSES, N_HELD = 12, 3
KERNELS = [LinearKernel(), QuadraticKernel(2.0), SmoothKernel(1.5)]
TAU, SCALE = np.array([1e-3, 2e-3, 0.0, 3e-3, 1e-3, 2e-3]), np.array([8e-3, 5e-3, 0.0, 9e-3, 1e-2, 4e-3])


@pytest.fixture(scope="module")
def poses():
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[: N_POSES + N_HELD]
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    found = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    seen = np.arange(len(actuators)) < N_POSES
    calibration, held = (
        PoseLikelihood(machine, found.select(one), machines.ACTUATOR_NOISE).refined().refined() for one in (seen, ~seen)
    )
    return calibration, held, theta


def build(poses, kernel):
    return StructuredLikelihood(poses[0], kernel, machines.ACTUATOR_RANGE)


def stack_density(likelihood, theta, *parts):
    """Return errors, covariance (legs of all poses) and constant of some poses together, from the plain formula."""
    errors, maps, inputs, constant = [], [], [], 0.0
    mean = likelihood.base.legs_known.mean(axis=0)
    for part in parts:
        errors.append(part.errors(theta[None])[0].ravel())
        maps += list(map_covariance(mean, part.legs_known))
        inputs.append((part.poses.actuators - machines.INITIAL_POSITION) / machines.ACTUATOR_RANGE)
        constant += part.log_constant.sum()
    inputs = np.concatenate(inputs)
    weight = likelihood.base.actuator_weight.mean(axis=0)
    noise = np.kron(np.eye(len(inputs)), mean + np.diag(weight * TAU**2))
    covariance = noise + np.kron(likelihood.kernel(inputs, inputs), np.diag(weight * SCALE**2))
    change = np.zeros_like(covariance)
    for k, one in enumerate(maps):
        change[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = one
    errors = np.concatenate(errors)
    return errors, change @ covariance @ change.T, constant + 0.5 * len(errors) * np.log(2 * np.pi)


def log_normal(errors, covariance):
    return multivariate_normal(np.zeros(len(errors)), covariance).logpdf(errors)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: one.name)
def test_density_is_that_of_all_poses_together(poses, kernel):
    likelihood, theta = build(poses, kernel), poses[2]
    errors, covariance, constant = stack_density(likelihood, theta, poses[0])
    found = likelihood(theta[None], np.concatenate([TAU, SCALE])[None])
    assert found == pytest.approx(log_normal(errors, covariance) + constant, abs=1e-6)


def test_without_a_model_error_nothing_changes(poses):
    likelihood, theta = build(poses, LinearKernel()), np.stack([poses[2], poses[0].machine.layout.nominal])
    none = np.zeros(12)
    np.testing.assert_allclose(likelihood(theta, none), poses[0](theta, none[:6]), rtol=1e-9)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: one.name)
def test_pointwise_density_is_given_all_other_poses(poses, kernel):
    likelihood, theta = build(poses, kernel), poses[2]
    errors, covariance, _ = stack_density(likelihood, theta, poses[0])
    found = likelihood.pointwise(theta[None], np.concatenate([TAU, SCALE])[None])[0]
    for pose in (0, 7):
        rest = np.delete(np.arange(len(errors)), np.arange(6 * pose, 6 * pose + 6))
        rest_alone = log_normal(errors[rest], covariance[np.ix_(rest, rest)])
        expected = log_normal(errors, covariance) - rest_alone + poses[0].log_constant[pose] + 3 * np.log(2 * np.pi)
        assert found[pose] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: one.name)
def test_held_back_poses_are_predicted_given_the_calibration(poses, kernel):
    likelihood, theta = build(poses, kernel), poses[2]
    calibration, covariance, constant = stack_density(likelihood, theta, poses[0])
    errors, both, constant_both = stack_density(likelihood, theta, poses[0], poses[1])
    model_error = np.concatenate([TAU, SCALE])[None]
    single, together = pointwise_given(likelihood, poses[1], theta[None], model_error)
    expected = log_normal(errors, both) + constant_both - log_normal(calibration, covariance) - constant
    assert together[0] == pytest.approx(expected, abs=1e-5)
    n = len(calibration)
    gain = both[n:, :n] @ np.linalg.inv(covariance)
    mean, left = gain @ calibration, both[n:, n:] - gain @ both[:n, n:]
    found = likelihood.condition(poses[1], theta[None], model_error)
    np.testing.assert_allclose(found.mean[0].ravel(), mean, atol=1e-9)
    # τ acts along the legs themselves in the density of a pose by itself: alike to the poses' differences
    for pose in range(N_HELD):
        own = slice(6 * pose, 6 * pose + 6)
        alone = log_normal(errors[n:][own] - mean[own], left[own, own]) + 3 * np.log(2 * np.pi)
        assert single[0, pose] == pytest.approx(alone + poses[1].log_constant[pose], abs=0.05)


def test_prediction_without_structured_error_is_that_of_the_geometry(poses):
    likelihood, theta = build(poses, LinearKernel()), np.tile(poses[2], (40, 1))
    none = np.concatenate([np.full(6, 1e-3), np.zeros(6)])
    prediction, error = predict_structured(
        likelihood, poses[1], theta, np.tile(none, (40, 1)), np.random.default_rng(0)
    )
    np.testing.assert_allclose(prediction.summarise().error, poses[1].pose_errors(theta[:1])[0], atol=1e-12)
    assert not error.size.any()


def test_structured_error_is_found_and_interpolated(poses):
    """A function of the travel added to the errors comes back at poses that were held back."""
    machine, theta = poses[0].machine, poses[2]
    actuators = machines.table_3_actuators()[:30]
    slopes = 0.01 * np.random.default_rng(2).standard_normal((6, 6))
    false = machines.ACTUATOR_RANGE * (actuators - machines.INITIAL_POSITION) / machines.ACTUATOR_RANGE @ slopes.T
    moved = machines.place_poses(machine, theta, actuators + false, np.zeros((30, 6)))
    told = type(moved)(moved.names, moved.position, moved.rotation, moved.covariance, actuators)
    seen = np.arange(30) < 24
    calibration, held = (PoseLikelihood(machine, told.select(one), machines.ACTUATOR_NOISE) for one in (seen, ~seen))
    likelihood = StructuredLikelihood(calibration, LinearKernel(), machines.ACTUATOR_RANGE)
    model_error = np.concatenate([np.full(6, 1e-4), np.full(6, 1e-2)])
    prediction, error = predict_structured(
        likelihood, held, np.tile(theta, (20, 1)), np.tile(model_error, (20, 1)), np.random.default_rng(0)
    )
    before = np.abs(held.errors(theta[None])[0])
    assert (
        prediction.summarise().position_error.mean()
        < 0.1 * np.linalg.norm(held.pose_errors(theta[None])[0, :, :3], axis=1).mean()
    )
    assert np.abs(np.abs(error.mean) - before / likelihood.per_actuator).max() < 0.1 * before.max()


# --- posterior -------------------------------------------------------------------------------------------------------


def build_posterior(poses, kernel, shared):
    layout = poses[0].machine.layout
    names = [name for name in layout.names if name.split("[")[0] in machines.FREE_SYMBOLS["none"]]
    position = {name: k for k, name in enumerate(layout.names)}
    priors = {n: NormalPrior(layout.nominal[position[n]], machines.PRIOR_SD.get(n.split("[")[0], 2.0)) for n in names}
    scale = KernelScale(0.02, 0.3, shared)
    return build_leg_posterior(build(poses, kernel), priors, ModelError(0.01), terms=(scale,))


def test_lengths_follow_the_joints(poses):
    posterior = build_posterior(poses, LinearKernel(), True)
    coordinates, n = posterior.sampling.coordinates, posterior.n_geometry
    y = 0.4 * np.random.default_rng(4).standard_normal((3, n))
    theta = coordinates.theta_from_y(y)
    np.testing.assert_allclose(coordinates.y_from_theta(theta), y, atol=1e-10)
    expected = machines.stencil_derivative(coordinates.theta_from_y, y[0], np.full(n, 0.05))
    np.testing.assert_allclose(coordinates.jacobian(theta[0]), expected, atol=1e-7)
    own = coordinates.jacobian(theta[0])[coordinates.free]
    assert np.linalg.slogdet(own)[1] == pytest.approx(coordinates.log_scale, abs=1e-9)
    # joints a millimetre off leave the mean closure where it was
    likelihood = posterior.likelihood.base
    y[:, [k for k, name in enumerate(posterior.names[:n]) if name.startswith("l[")]] = 0.0
    y = np.vstack([np.zeros(n), y])
    moved = likelihood.errors(coordinates.theta_from_y(y)).mean(axis=1)
    plain = build_leg_posterior(likelihood, posterior.priors).sampling.theta_from_y(y)
    assert np.abs(moved - moved[0]).max() < 5e-3
    assert np.abs(likelihood.errors(plain).mean(axis=1) - moved[0]).max() > 0.1


def test_a_switch_jumps_to_its_other_place():
    errors = LegErrors.of_legs(6, (NO_MODEL_ERROR, KernelScale(0.02, 0.3)))
    for start, flipped in ((0.3, 0.0), (OFF, 0.02)):
        ((place, image),) = errors.jumps(np.array([start]))
        assert place == 0
        assert errors.natural(image) == pytest.approx([flipped])
    assert errors.deviations(np.array([[0.5], [OFF + 0.5]])) == pytest.approx(0.5)


def test_log_prior_is_normalised_over_the_switch(poses):
    posterior = build_posterior(poses, LinearKernel(), True)
    c = np.linspace(OFF - 8.0, 8.0, 4001)
    y = np.zeros((len(c), posterior.n_parameters))
    y[:, -1] = c
    ratio = np.exp(posterior.log_prior(y) - posterior.log_prior(y[-1:] * 0.0)) * np.exp(
        posterior.log_prior(y[:1] * 0.0)
    )
    without = posterior.log_prior(np.zeros((1, posterior.n_parameters)))[0] + 0.5 * np.log(2 * np.pi) + np.log(2.0)
    assert np.log(np.trapezoid(ratio, c)) == pytest.approx(without, abs=1e-6)


# --- kernels and bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda one: one.name)
def test_kernel_vanishes_at_home_and_is_a_covariance(kernel):
    inputs = np.vstack([np.zeros(6), np.random.default_rng(6).uniform(-1, 1, (30, 6))])
    matrix = kernel(inputs, inputs)
    assert np.abs(matrix[0]).max() < 1e-15
    assert np.linalg.eigvalsh(matrix).min() > -1e-12


@pytest.mark.parametrize("name", ["quadratic", "smooth"])
def test_long_kernels_are_linear(name):
    inputs = np.random.default_rng(7).uniform(-1, 1, (9, 6))
    long, short = (build_kernel(name, length)(inputs, inputs) for length in (1e4, 1.0))
    np.testing.assert_allclose(long, LinearKernel()(inputs, inputs), atol=1e-6)
    assert np.abs(short - long).max() > 0.1


def test_too_few_poses_and_poses_not_measured_alike_are_refused(poses):
    machine, found = poses[0].machine, poses[0].poses
    few = PoseLikelihood(machine, found.select(np.arange(N_POSES) < 2), machines.ACTUATOR_NOISE)
    with pytest.raises(InputError, match="2 calibration poses, expected 3 or more"):
        StructuredLikelihood(few, LinearKernel(), 1.3)
    covariance = found.covariance.copy()
    covariance[4] *= 9.0
    uneven = type(found)(found.names, found.position, found.rotation, covariance, found.actuators)
    with pytest.raises(InputError, match=r"pose '5': found a covariance .* measured alike"):
        StructuredLikelihood(PoseLikelihood(machine, uneven, machines.ACTUATOR_NOISE), LinearKernel(), 1.3)


# --- straightening ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wrong():
    """A posterior of poses that an unknown linear error moves, its scale hardly known, at a start near its mode."""
    machine, actuators = machines.build_machine("none"), machines.table_3_actuators()[:24]
    slopes = 0.01 * np.random.default_rng(2).standard_normal((6, 6)) / machines.ACTUATOR_RANGE
    false = (actuators - machines.INITIAL_POSITION) @ slopes.T
    moved = machines.place_poses(machine, machines.telescope_truth(machine), actuators + false, np.zeros((24, 6)))
    told = type(moved)(moved.names, moved.position, moved.rotation, moved.covariance, actuators)
    likelihood = PoseLikelihood(machine, told, machines.ACTUATOR_NOISE)
    posterior = build_posterior((likelihood,), LinearKernel(), True)
    y = posterior.approach()
    y[posterior.n_geometry : -1] = -1.5
    return posterior, posterior.polish(y)


@pytest.mark.slow
def test_proposal_holds_a_scale_that_is_hardly_known(wrong):
    """The joint mode with the geometry that makes up for it is not where the scale's mass is: 1 % otherwise."""
    found = explore(wrong[0], np.random.SeedSequence(0), max_pilots=0)
    assert found.efficiency > 0.3
    scale = wrong[0].scales(found.straight.y_from_x(found.proposal.draw(400, np.random.default_rng(1))))[:, 0]
    assert np.median(scale) > 1.2 * wrong[0].scales(found.modes[0].y[None])[0, 0]


def test_information_of_a_pose_is_what_is_lost_without_it(wrong):
    """Against all poses' covariance written out, and without the pose's rows and columns."""
    posterior, y = wrong
    likelihood, u = posterior.likelihood, posterior.likelihood.combination
    local = likelihood.linearise(*posterior.around(y), posterior.errors, posterior.zeta(y))
    covariance = np.einsum("pk,qk,kij->piqj", u, u, np.linalg.inv(local.precision)).reshape(24 * 6, 24 * 6)
    slope = np.einsum("pk,kim->pim", u, local.slope).reshape(24 * 6, -1)
    rest = np.delete(np.arange(24 * 6), np.arange(6 * 5, 6 * 6))
    whole, without = (
        slope[k].T @ np.linalg.solve(covariance[np.ix_(k, k)], slope[k]) for k in (np.arange(24 * 6), rest)
    )
    found = posterior.row_information(y, 5)
    assert np.abs(found - (whole - without)).max() < 1e-7 * np.abs(whole).max()
    assert np.abs(found).max() > 1e-3 * np.abs(whole).max()
