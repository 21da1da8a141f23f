"""Errors of sensors that are functions of what they read, against dense normals and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reading_machines import SETS, small_posterior
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from bayescal.density.elimination import half_log_volume
from bayescal.density.model_error import LengthPrior, build_kernel
from bayescal.density.readings.absorbed import project
from bayescal.density.readings.functions import SensorFunctions
from bayescal.density.readings.likelihood import ReadingLikelihood
from bayescal.experiments.shared.sensor_sets import null_basis
from bayescal.density.readings.structured_posterior import StructuredReadingPosterior
from bayescal.errors import InputError

N_POSES = 9
KERNELS = [("linear", 5.0, None), ("quadratic", 2.0, None), ("smooth", 1.5, None), ("smooth", 0.6, None)]
FREE = [("smooth", 2.0, 0.3), ("quadratic", 2.0, 0.5)]


def functions_of(likelihood, kernel, length, spread) -> SensorFunctions:
    """Return functions of the carriages with one scale, and of the first two legs' angles with one each."""
    readings = likelihood.measured
    places, travel = np.array([0, 1, 2, 3, 4, 5]), np.array([300.0] * 4 + [0.7] * 2)
    home = readings.mean(axis=0)[places]
    return SensorFunctions(
        kernel=kernel,
        length=length,
        lengths=None if spread is None else LengthPrior(length, spread),
        places=places,
        home=home,
        travel=travel,
        reach=float(np.abs((readings[:, places] - home) / travel).max()),
        group=np.array([0, 0, 0, 0, 1, 2]),
        scale=np.array([4e-3, 2e-5, 3e-5]),
        spread=0.3,
        labels=("s", "phi[1]", "phi[2]"),
        scale_units=("mm", "rad", "rad"),
    )


def structured(kernel, length, spread, n_poses=N_POSES) -> StructuredReadingPosterior:
    plain = small_posterior(SETS[8], n_poses, 5)
    return StructuredReadingPosterior(
        plain.likelihood, plain.priors, functions=functions_of(plain.likelihood, kernel, length, spread)
    )


def some_coordinates(posterior, rng, n=3):
    """Return coordinates about the best machine, the last of which has one switch off."""
    y = posterior.polish(np.zeros(posterior.n_parameters)) + 1e-3 * rng.standard_normal((n, posterior.n_parameters))
    y[:, posterior.n_geometry :] += 0.5 * rng.standard_normal((n, posterior.n_parameters - posterior.n_geometry))
    y[-1, posterior.n_geometry] = -20.0 + 0.3
    return y


def list_of(readings, likelihood, posterior, y):
    """Return what no pose explains, in bases of each pose's own, with the dense covariance of all, and constants."""
    functions, sensors = posterior.functions, likelihood.sensors
    left = likelihood.leave_over(posterior.theta(y[None]))
    bases = [null_basis(slope) / sensors.noise for slope in left.slope[0]]
    error = np.concatenate([b @ (sensors.noise * e) for b, e in zip(bases, left.error[0], strict=True)])
    scales = posterior.scales(y)[functions.group]
    length = float(posterior.natural(y)[-1]) if functions.lengths is not None else functions.length
    n_poses, n = readings.shape
    dense = np.zeros((n_poses, n, n_poses, n))
    for f, k in enumerate(functions.places):
        z = ((readings[:, k] - functions.home[f]) / functions.travel[f])[:, None]
        dense[:, k, :, k] = scales[f] ** 2 * build_kernel(functions.kernel, length)(z, z)
    return error, bases, dense, likelihood.constant - half_log_volume(left.slope[0])


def dense_log_density(posterior, y) -> float:
    likelihood = posterior.likelihood
    error, bases, dense, constant = list_of(likelihood.measured, likelihood, posterior, y)
    z = block_diag(*bases)
    size = dense.shape[0] * dense.shape[1]
    covariance = z @ dense.reshape(size, size) @ z.T + np.eye(len(z))
    normal = multivariate_normal(np.zeros(len(z)), covariance).logpdf(error)
    return float(constant.sum() + 0.5 * len(z) * np.log(2 * np.pi) + normal + posterior.log_prior(y[None])[0])


@pytest.mark.parametrize(("kernel", "length", "spread"), KERNELS + FREE)
def test_density_is_that_of_a_dense_normal(kernel, length, spread, rng):
    posterior = structured(kernel, length, spread)
    y = some_coordinates(posterior, rng)
    found = posterior.log_density(y)
    for one, value in zip(y, found, strict=True):
        expected = dense_log_density(posterior, one)
        assert abs(value - expected) < 1e-9 * max(1.0, abs(expected))


@pytest.mark.parametrize(("kernel", "length", "spread"), [KERNELS[2], FREE[0]])
def test_density_of_a_pose_given_others_is_that_of_a_dense_normal(kernel, length, spread, rng):
    posterior = structured(kernel, length, spread)
    y = some_coordinates(posterior, rng)
    likelihood, found = posterior.likelihood, posterior.pointwise(y)
    for one, values in zip(y, found, strict=True):
        error, bases, dense, constant = list_of(likelihood.measured, likelihood, posterior, one)
        z, size = block_diag(*bases), dense.shape[0] * dense.shape[1]
        precision = np.linalg.inv(z @ dense.reshape(size, size) @ z.T + np.eye(len(z)))
        m = len(bases[0])
        for p in range(N_POSES):
            part = slice(p * m, (p + 1) * m)
            own = np.linalg.inv(precision[part, part])
            deviation = own @ (precision @ error)[part]
            expected = multivariate_normal(np.zeros(m), own).logpdf(deviation) + 0.5 * m * np.log(2 * np.pi)
            assert values[p] == pytest.approx(expected + constant[p], rel=1e-9)


def test_other_poses_are_predicted_as_a_dense_normal_does(rng):
    posterior = structured("smooth", 1.5, None)
    y, whole = some_coordinates(posterior, rng), posterior.likelihood
    known, others = (whole.select(np.arange(N_POSES) < 6), whole.select(np.arange(N_POSES) >= 6))
    part = StructuredReadingPosterior(known, posterior.priors, functions=posterior.functions)
    pair = whole.select(np.isin(np.arange(N_POSES), [0, 1, 2, 3, 4, 5, 7]))
    both = StructuredReadingPosterior(pair, posterior.priors, functions=posterior.functions)
    np.testing.assert_allclose(
        part.predict_density(others, y)[:, 1], both.log_density(y) - part.log_density(y), rtol=1e-9
    )


@pytest.mark.parametrize(("kernel", "length", "spread"), [KERNELS[0], KERNELS[2], FREE[0]])
def test_gradient_is_that_of_differences(kernel, length, spread, rng):
    posterior = structured(kernel, length, spread, 14)
    y = some_coordinates(posterior, rng, 1)[0]
    y[posterior.n_geometry] = 0.4
    sd = np.sqrt(np.diagonal(posterior.covariance(y)))
    steps = np.diag(1e-2 * np.minimum(sd, 1.0))
    differences = (posterior.log_density(y + steps) - posterior.log_density(y - steps)) / (2 * np.diagonal(steps))
    gradient = posterior.gradient(y)[0]
    np.testing.assert_allclose(gradient * sd, differences * sd, rtol=1e-3, atol=2e-3)


def test_log_prior_of_parameters_is_finite_where_errors_are_off(rng):
    posterior = structured("smooth", 2.0, 0.3)
    y = posterior.draw_prior(200, rng)
    found, scales = posterior.log_parameters(y), posterior.scales(y)
    m = posterior.n_geometry
    assert 0.3 < np.mean(scales == 0.0) < 0.7
    np.testing.assert_allclose(found[:, m : m + 3][scales == 0.0], -np.log(2.0))
    for k in range(3):
        there = scales[:, k] > 0.0
        by_coordinate = posterior.log_coordinates(y)[there, m + k] - np.log(0.3 * scales[there, k])
        np.testing.assert_allclose(found[there, m + k], by_coordinate, rtol=1e-9)
    np.testing.assert_allclose(posterior.log_coordinates(y).sum(axis=1), posterior.log_prior(y))


def test_a_switched_off_error_is_none(rng):
    posterior = structured("smooth", 1.5, None)
    plain = small_posterior(SETS[8], N_POSES, 5)
    y = some_coordinates(posterior, rng, 1)
    y[:, posterior.n_geometry :] = -20.0
    alone = plain.log_density(y[:, : posterior.n_geometry]) - 3.0 * np.log(2.0 * np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(posterior.log_density(y), alone, rtol=1e-12)


def test_coefficients_tell_the_functions(rng):
    """Readings that have functions of the prior give these back, within what the geometry imitates."""
    posterior = structured("quadratic", 2.0, None, 40)
    likelihood, functions = posterior.likelihood, posterior.functions
    functions = replace(functions, scale=10.0 * functions.scale)  # well above the noise
    posterior, absorber = replace(posterior, functions=functions), posterior.absorber
    drawn = rng.standard_normal(absorber.columns.shape[1:]) * functions.scale[functions.group][:, None]
    added = absorber.act(drawn.reshape(1, -1))[0] * likelihood.sensors.noise
    start = likelihood.find_poses(posterior.centre[None])[0][0]
    spoilt = ReadingLikelihood(likelihood.sensors, likelihood.measured + added, start, 1.0)
    other = StructuredReadingPosterior(spoilt, posterior.priors, functions=functions)
    assert 0.5 < measure_deviation(other, drawn.ravel(), rng) < 1.6
    assert prefer_errors(other) > 10.0
    assert prefer_errors(posterior) < 0.0  # these have none


def prefer_errors(posterior) -> float:
    """Return by how much the best machine with errors is denser than the best one without, all switches alike."""
    on, off = np.zeros(posterior.n_parameters), np.zeros(posterior.n_parameters)
    off[posterior.n_geometry :] = -20.0
    best = [posterior.log_density(posterior.polish(y)[None])[0] for y in (on, off)]
    return float(best[0] - best[1])


def measure_deviation(posterior, coefficients, rng) -> float:
    """Return how far coefficients are from what is found of them, in standard deviations, rms."""
    mode = posterior.polish(np.zeros(posterior.n_parameters))
    y = mode + rng.standard_normal((400, len(mode))) @ np.linalg.cholesky(posterior.covariance(mode)).T
    y[:, posterior.n_geometry :] = mode[posterior.n_geometry :]
    draws = posterior.absorb(y).draw(rng)
    off = np.linalg.solve(np.linalg.cholesky(np.cov(draws.T)), draws.mean(axis=0) - coefficients)
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.parametrize(("n", "of_one", "of_an_encoder"), [(8, 0.16, 0.20), (12, 0.31, 0.67)])
def test_what_the_geometry_imitates_of_scales_that_are_off(n, of_one, of_an_encoder):
    """All carriages' scales alike are a larger machine; of one sensor's scale some is left."""
    posterior = small_posterior(SETS[n], 40, 5)
    likelihood, sensors = posterior.likelihood, posterior.likelihood.sensors
    slope = likelihood.leave_over(posterior.centre[None]).slope[0]
    geometry = (likelihood.linearise(posterior.centre)[1] @ posterior.moves.T).reshape(-1, posterior.n_geometry)
    travel = likelihood.measured - sensors.read(sensors.model.layout.nominal, np.array(sensors.model.home))

    def left_of(some) -> float:
        seen = np.einsum("pij,pj->pi", project(slope), np.where(some, travel, 0.0) / sensors.noise).ravel()
        rest = seen - geometry @ np.linalg.lstsq(geometry, seen, rcond=None)[0]
        return float(np.linalg.norm(rest) / np.linalg.norm(seen))

    places = np.arange(n)
    assert left_of(places < 4) < 2e-3
    assert left_of(places == 0) == pytest.approx(of_one, abs=0.01)
    assert left_of(places == 4) == pytest.approx(of_an_encoder, abs=0.01)


def test_a_length_that_needs_too_many_values_is_refused():
    likelihood = small_posterior(SETS[8], N_POSES, 5).likelihood
    with pytest.raises(InputError, match=r"model_error.kernel_length: found smooth errors of a length down to 0.02"):
        functions_of(likelihood, "smooth", 0.02, None)
