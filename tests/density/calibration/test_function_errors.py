"""Errors that are functions of readings, of coordinates or of the order of rows, against dense normals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reading_machines import find_poses_of, sensors_of, small_posterior
from scipy.linalg import block_diag, null_space
from scipy.stats import multivariate_normal
from sliding_platforms import SETS

from bayescal.density.calibration.functions import FunctionErrors, Travel
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.terms import ErrorModel, NoiseFactor
from bayescal.density.elimination import project_out
from bayescal.density.priors import OFF, LogNormalPrior, build_kernel
from bayescal.errors import InputError

N_POSES = 9
KERNELS = [("linear", 5.0, None), ("quadratic", 2.0, None), ("smooth", 1.5, None), ("smooth", 0.6, None)]
FREE = [("smooth", 2.0, 0.3), ("quadratic", 2.0, 0.5)]
INPUTS = ["reading", "commands", "order"]


def functions_of(likelihood, kernel, length, spread, of="reading") -> FunctionErrors:
    """Return functions of the carriages with one scale, and of the first two legs' angles with one each."""
    data, places = likelihood.data, np.arange(6)
    home = data.values.mean(axis=0)
    inputs = {"reading": places, "commands": np.arange(3), "order": np.zeros(0, dtype=int)}[of]
    scale = np.array([300.0] * 4 + [0.7] * 4)
    travel = (
        Travel(of, inputs, np.zeros(1), np.full(1, float(data.n_poses)))
        if of == "order"
        else Travel(of, inputs, home[inputs], scale[inputs])
    )
    return FunctionErrors(
        kernel=kernel,
        length=length,
        lengths=None if spread is None else LogNormalPrior(length, spread),
        places=places,
        travel=travel,
        reach=float(np.abs(travel.of_rows(data)).max()),
        group=np.array([0, 0, 0, 0, 1, 2]),
        scale=np.array([4e-3, 2e-5, 3e-5]),
        spread=0.3,
        labels=("s", "phi[1]", "phi[2]"),
        scale_units=("mm", "rad", "rad"),
        rows=data if of == "commands" else None,
    )


def structured(kernel, length, spread, n_poses=N_POSES, of="reading") -> CalibrationPosterior:
    plain = small_posterior(SETS[8], n_poses, 5)
    return replace(plain, errors=ErrorModel((functions_of(plain.likelihood, kernel, length, spread, of),)))


def some_coordinates(posterior, rng, n=3):
    """Return coordinates about the best machine, the last of which has one switch off."""
    y = posterior.refine_geometry(np.zeros(posterior.n_parameters)) + 1e-3 * rng.standard_normal(
        (n, posterior.n_parameters)
    )
    y[:, posterior.n_geometry :] += 0.5 * rng.standard_normal((n, posterior.n_parameters - posterior.n_geometry))
    y[-1, posterior.n_geometry] = OFF + 0.3
    return y


def constants_of(likelihood, slope):
    """Return each pose's share of the log-density that no residual has."""
    spare = likelihood.n_spare[0]
    volume = np.log(likelihood.volume) + np.log(likelihood.sd[0]).sum() + 0.5 * spare * np.log(2 * np.pi)
    return -volume - 0.5 * np.linalg.slogdet(np.swapaxes(slope, -1, -2) @ slope)[1]


def list_of(posterior, y):
    """Return what no pose explains, in bases of each pose's own, with the dense covariance of all, and constants."""
    likelihood, functions, sensors = posterior.likelihood, posterior.errors.terms[0], sensors_of(posterior.likelihood)
    _, at = posterior.likelihood.explain(*posterior.at(y[None]))
    bases = [null_space(slope.T).T / sensors.noise for slope in at.slope[0]]
    error = np.concatenate([b @ (sensors.noise * e) for b, e in zip(bases, at.error[0], strict=True)])
    zeta = posterior.zeta(y)
    scales = functions.scales(zeta)[functions.group]
    length = float(posterior.natural(y)[-1]) if functions.lengths is not None else functions.length
    n_poses, n = likelihood.data.values.shape
    dense, z = np.zeros((n_poses, n, n_poses, n)), functions.travel.of_rows(likelihood.data)
    for f, k in enumerate(functions.places):
        own = z[:, min(f, z.shape[1] - 1)]
        dense[:, k, :, k] = scales[f] ** 2 * build_kernel(functions.kernel, length)(own, own)
    return error, bases, dense, constants_of(likelihood, at.slope[0])


def dense_log_density(posterior, y) -> float:
    error, bases, dense, constant = list_of(posterior, y)
    z = block_diag(*bases)
    size = dense.shape[0] * dense.shape[1]
    covariance = z @ dense.reshape(size, size) @ z.T + np.eye(len(z))
    normal = multivariate_normal(np.zeros(len(z)), covariance).logpdf(error)
    return float(constant.sum() + 0.5 * len(z) * np.log(2 * np.pi) + normal + posterior.log_prior(y[None])[0])


@pytest.mark.parametrize("of", INPUTS)
@pytest.mark.parametrize(("kernel", "length", "spread"), KERNELS + FREE)
def test_density_is_that_of_a_dense_normal(kernel, length, spread, of, rng):
    posterior = structured(kernel, length, spread, of=of)
    y = some_coordinates(posterior, rng)
    found = posterior.log_density(y)
    for one, value in zip(y, found, strict=True):
        expected = dense_log_density(posterior, one)
        assert abs(value - expected) < 1e-8 * max(1.0, abs(expected))


@pytest.mark.parametrize("of", INPUTS)
@pytest.mark.parametrize(("kernel", "length", "spread"), [KERNELS[2], FREE[0]])
def test_density_of_a_pose_given_others_is_that_of_a_dense_normal(kernel, length, spread, of, rng):
    posterior = structured(kernel, length, spread, of=of)
    y = some_coordinates(posterior, rng)
    found = posterior.pointwise(y)
    for one, values in zip(y, found, strict=True):
        error, bases, dense, constant = list_of(posterior, one)
        z, size = block_diag(*bases), dense.shape[0] * dense.shape[1]
        precision = np.linalg.inv(z @ dense.reshape(size, size) @ z.T + np.eye(len(z)))
        m = len(bases[0])
        for p in range(N_POSES):
            part = slice(p * m, (p + 1) * m)
            own = np.linalg.inv(precision[part, part])
            deviation = own @ (precision @ error)[part]
            expected = multivariate_normal(np.zeros(m), own).logpdf(deviation) + 0.5 * m * np.log(2 * np.pi)
            assert values[p] == pytest.approx(expected + constant[p], rel=1e-8)


@pytest.mark.parametrize("of", INPUTS)
def test_other_poses_are_predicted_as_a_dense_normal_does(of, rng):
    posterior = structured("smooth", 1.5, None, of=of)
    y, whole = some_coordinates(posterior, rng), posterior.likelihood
    known, others = (whole.pick(np.arange(N_POSES) < 6), whole.pick(np.arange(N_POSES) >= 6))
    part = replace(posterior, likelihood=known)
    both = replace(posterior, likelihood=whole.pick(np.isin(np.arange(N_POSES), [0, 1, 2, 3, 4, 5, 7])))
    np.testing.assert_allclose(
        part.predict_density(others, y)[:, 1], both.log_density(y) - part.log_density(y), rtol=1e-8
    )


@pytest.mark.runs
def test_the_expected_curvature_of_scales_and_noise_is_that_of_drawn_rows(rng):
    """Scores of errors that are drawn as the density says have the stated information as their covariance."""
    plain = structured("quadratic", 2.0, 0.5)
    noise = NoiseFactor("s", np.arange(8) < 4, 0.5)
    posterior = replace(plain, errors=ErrorModel((noise, *plain.errors.terms)))
    y = posterior.refine_geometry(np.zeros(posterior.n_parameters))
    m, data = posterior.n_geometry, posterior.likelihood.data
    white, at = posterior.likelihood.explain(*posterior.at(y[None]))
    columns = posterior.likelihood.columns(posterior.errors, posterior.zeta(y[None]), white, at.slope)[0]
    scores = []
    for _ in range(400):
        drawn = columns @ rng.standard_normal(columns.shape[-1]) + rng.standard_normal(data.values.shape)
        exact = posterior.likelihood.model.read(posterior.theta(y[None])[0], at.pose[0])
        likelihood = replace(
            posterior.likelihood, data=replace(data, values=exact + drawn * white.colour(drawn * 0 + 1)[0])
        )
        scores.append(replace(posterior, likelihood=likelihood).gradient(y)[0][m:])
    information = -posterior.gradient(y)[1][m:, m:] - np.eye(posterior.n_parameters - m)
    found = np.cov(np.array(scores).T)
    size = np.sqrt(np.diag(information))
    np.testing.assert_allclose(found / np.outer(size, size), information / np.outer(size, size), atol=0.35)


def test_a_switched_off_error_is_none_and_a_jump_switches_it(rng):
    posterior = structured("smooth", 1.5, None)
    plain = small_posterior(SETS[8], N_POSES, 5)
    y, m = some_coordinates(posterior, rng, 1), posterior.n_geometry
    y[:, m:] = OFF
    alone = plain.log_density(y[:, :m]) - 3.0 * np.log(2.0 * np.sqrt(2.0 * np.pi))
    np.testing.assert_allclose(posterior.log_density(y), alone, rtol=1e-12)
    for jump, image in posterior.mode_candidates(y[0]):
        assert list(np.flatnonzero(image != y[0])) == [jump]
        np.testing.assert_array_equal(dict(posterior.mode_candidates(image))[jump], y[0])


def test_coefficients_tell_the_functions(rng):
    """Readings that have functions of the prior give these back, within what the geometry imitates."""
    posterior = structured("quadratic", 2.0, None, 40)
    likelihood, term = posterior.likelihood, posterior.errors.terms[0]
    term = replace(term, scale=10.0 * term.scale)  # well above the noise
    columns = term.columns(np.zeros((1, 3)), likelihood.data)[0]
    drawn = rng.standard_normal(columns.shape[-1])
    start = find_poses_of(likelihood, posterior.sampling.start[None])[0]
    spoilt = replace(
        likelihood, data=replace(likelihood.data, values=likelihood.data.values + columns @ drawn), start=start
    )
    without = replace(posterior, errors=ErrorModel((term,)))
    other = replace(without, likelihood=spoilt)
    assert 0.5 < measure_deviation(other, drawn, rng) < 1.6
    assert prefer_errors(other) > 10.0
    assert prefer_errors(without) < 0.0  # these have none


def prefer_errors(posterior) -> float:
    """Return by how much the best machine with errors is denser than the best one without, all switches alike."""
    on, off = np.zeros(posterior.n_parameters), np.zeros(posterior.n_parameters)
    off[posterior.n_geometry :] = OFF
    best = [posterior.log_density(posterior.refine_geometry(y)[None])[0] for y in (on, off)]
    return float(best[0] - best[1])


def measure_deviation(posterior, coefficients, rng) -> float:
    """Return how far coefficients are from what is found of them, in standard deviations, rms."""
    mode = posterior.refine_geometry(np.zeros(posterior.n_parameters))
    covariance = np.linalg.inv(-posterior.gradient(mode)[1])
    y = mode + rng.standard_normal((400, len(mode))) @ np.linalg.cholesky(covariance).T
    y[:, posterior.n_geometry :] = mode[posterior.n_geometry :]
    draws = np.concatenate([drawn for _, drawn in posterior.likelihood.draw_common(*posterior.at(y), rng).parts])
    off = np.linalg.solve(np.linalg.cholesky(np.cov(draws.T)), draws.mean(axis=0) - coefficients)
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.parametrize(("n", "of_one", "of_an_encoder"), [(8, 0.16, 0.20), (12, 0.31, 0.67)])
def test_what_the_geometry_imitates_of_scales_that_are_off(n, of_one, of_an_encoder):
    """All carriages' scales alike are a larger machine; of one sensor's scale some is left."""
    posterior = small_posterior(SETS[n], 40, 5)
    sensors, y = sensors_of(posterior.likelihood), np.zeros(posterior.n_parameters)
    white, at = posterior.likelihood.explain(*posterior.at(y[None]))
    _, slope, rows = posterior.likelihood.rows(*posterior.around(y), white, at.pose)
    geometry = (project_out(slope) @ rows).reshape(-1, posterior.n_geometry)
    model = sensors.model
    travel = posterior.likelihood.data.values - model.read(model.layout.nominal, model.home_pose)

    def left_of(some) -> float:
        seen = np.einsum("pij,pj->pi", project_out(slope), np.where(some, travel, 0.0) / sensors.noise).ravel()
        rest = seen - geometry @ np.linalg.lstsq(geometry, seen, rcond=None)[0]
        return float(np.linalg.norm(rest) / np.linalg.norm(seen))

    places = np.arange(n)
    assert left_of(places < 4) < 2e-3
    assert left_of(places == 0) == pytest.approx(of_one, abs=0.01)
    assert left_of(places == 4) == pytest.approx(of_an_encoder, abs=0.01)


def test_a_length_that_needs_too_many_values_is_refused():
    likelihood = small_posterior(SETS[8], N_POSES, 5).likelihood
    with pytest.raises(InputError, match=r"length 0\.02"):
        functions_of(likelihood, "smooth", 0.02, None)
