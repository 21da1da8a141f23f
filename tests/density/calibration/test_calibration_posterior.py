"""The posterior of a calibration: its gradient, its least squares, its coordinates."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import (
    LINE_CASES,
    MIXED,
    density,
    fit_jointly,
    lines_posterior,
    unknown_noise,
)
from scipy.linalg import null_space
from scipy.optimize import least_squares

from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.elimination import project_out
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.errors import NumericalError


def test_the_slope_of_the_volume_follows_the_poses(rng):
    """Coarse noise and few readings, so that what the poses' volume adds shows beside the rest."""
    posterior, y, _ = lines_posterior(rng, n_poses=8)
    likelihood = posterior.likelihood
    coarse = replace(likelihood, data=replace(likelihood.data, sd=np.full((8, 4), 20.0)))
    posterior = replace(posterior, likelihood=coarse)
    y, pose = fit_jointly(posterior, np.zeros_like(y), coarse.start)
    posterior = replace(posterior, likelihood=replace(coarse, start=pose))
    white, at = posterior.likelihood.explain(*posterior.at(y[None]))
    slope = posterior.likelihood._volume_slope(
        *posterior.around(y), posterior.errors, posterior.zeta(y), white, at.slope[0], None
    )

    def volume(at):
        """Return -½ Σ log |HᵀΣ⁻¹H| where the machine explains the readings best, by many steps."""
        theta = posterior.theta(at[None])
        white = coarse.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(at[None])))
        pose = coarse.start[None]
        for _ in range(20):
            error, rows, _ = coarse.linearise(theta, pose, white)
            pose = pose + (np.linalg.pinv(rows) @ error[..., None])[..., 0]
        _, values, _ = np.linalg.svd(coarse.linearise(theta, pose, white)[1][0])
        return -np.log(values).sum()

    for k in range(len(y)):
        move = 1e-3 * np.eye(len(y))[k]
        assert slope[k] == pytest.approx((volume(y + move) - volume(y - move)) / 2e-3, rel=0.01, abs=2e-5)


JOINT_CASES = ("as stated", "correlated", "uniform", "common", "missing", "robust", "functions", "functions, robust")
JOINT = {name: LINE_CASES[name] for name in JOINT_CASES}


@pytest.mark.parametrize("case", JOINT.values(), ids=JOINT)
def test_fit_is_least_squares_over_parameters_and_poses_together(case, rng):
    posterior, _, pose = lines_posterior(rng, **{**case, "n_poses": 12})
    likelihood, n, errors = posterior.likelihood, posterior.n_parameters, posterior.errors
    columns = errors.columns(np.zeros((1, errors.n_parameters)), likelihood.data)
    poses = n + 24
    white = likelihood.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(np.zeros((1, n)))))
    outliers, spare = posterior.errors.outliers, likelihood.n_readings - 2

    def residual(x):
        y, at, common = x[:n], x[n:poses].reshape(1, -1, 2), columns @ x[poses:]
        read = likelihood.model.read(posterior.theta(y[None])[:, None], at)
        rest = white.vector(np.where(likelihood.data.present, likelihood.data.values - read - common, 0.0))[0]
        if outliers.expected:  # a residual whose square is what the density has in its place
            square = (rest**2).sum(axis=1)
            rest = np.sqrt(outliers.penalise(square, spare) / square)[:, None] * rest
        return np.concatenate([rest.ravel(), y, x[poses:]])

    start = np.concatenate([np.zeros(n), pose.ravel(), np.zeros(columns.shape[-1])])
    joint = least_squares(residual, start, "3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    y, at = fit_jointly(posterior, np.zeros(n), likelihood.start)
    np.testing.assert_allclose(y, joint[:n], rtol=0, atol=1e-6)
    np.testing.assert_allclose(at, joint[n:poses].reshape(-1, 2), rtol=0, atol=1e-6)
    away = y + np.where(np.arange(n) < posterior.n_geometry, 0.1, 0.0)
    np.testing.assert_allclose(posterior.refine_geometry(away), y, rtol=0, atol=1e-6)


def test_fit_finds_poses_beside_a_constraint(rng):
    """One line's length is known exactly: poses run on its circle, and the projection must not lose the rest."""
    posterior, _, pose = lines_posterior(rng, n_poses=12)
    likelihood = posterior.likelihood
    sd = likelihood.data.sd.copy()
    exact, near = sd.copy(), sd.copy()
    exact[:, 0], near[:, 0] = 0.0, 1e-3
    found, limit = (
        replace(posterior, likelihood=replace(likelihood, data=replace(likelihood.data, sd=one)))
        for one in (exact, near)
    )
    y, at = fit_jointly(found, np.zeros(found.n_parameters), pose)
    other, _ = fit_jointly(limit, np.zeros(found.n_parameters), pose)
    np.testing.assert_allclose(y, other, rtol=0, atol=1e-3)
    left = likelihood.model.read(found.theta(y[None])[0], at)[:, 0] - likelihood.data.values[:, 0]
    assert np.abs(left).max() < 1e-6
    gradient, _ = found.gradient(y)
    assert np.abs(gradient).max() < 0.1


def test_fit_goes_on_where_a_constraint_makes_the_valley_narrow(rng):
    """All anchors free, so that the frame is loose, and a line known exactly: 200 straight steps ended halfway."""
    posterior, *_, pose = lines_posterior(rng, n_poses=12)
    likelihood, layout = posterior.likelihood, posterior.likelihood.model.layout
    sd = np.where(np.arange(4) == 0, 0.0, likelihood.data.sd)
    found = replace(
        posterior,
        likelihood=replace(likelihood, data=replace(likelihood.data, sd=sd)),
        priors={name: NormalPrior(value, 10.0) for name, value in zip(layout.names, layout.nominal, strict=True)},
    )
    y, _ = fit_jointly(found, np.zeros(found.n_parameters), pose)
    gradient, hessian = found.gradient(y)
    assert gradient @ np.linalg.solve(-hessian, gradient) < 1e-4


@pytest.mark.parametrize("weight", [1.0, 1e4])
def test_projections_hold_beside_constraints(weight, rng):
    """Six coordinates, one reading 10⁴ times as sharp as the others: HᵀH would be singular to rounding."""
    slope = rng.standard_normal((5, 9, 6)) * np.array([1.0, 300.0, 0.01, 1.0, 1.0, 1.0])
    slope[:, 4] *= weight
    projection = project_out(slope)
    for one, across in zip(slope, projection, strict=True):
        left = null_space((one / np.linalg.norm(one, axis=0)).T)
        np.testing.assert_allclose(across, left @ left.T, rtol=0, atol=1e-9)


def test_fit_says_where_there_is_no_machine(rng):
    posterior, _, pose = lines_posterior(rng)
    with pytest.raises(NumericalError, match="no reading"):
        fit_jointly(posterior, np.zeros(posterior.n_parameters), np.full_like(pose, np.nan))


@pytest.mark.parametrize("correlation", [None, MIXED], ids=["random", "correlated"])
def test_each_noise_governs_its_share_of_the_information(correlation, rng):
    """The information of the first group's readings grows with their precision, that of the others stays.

    It does by q = (m + τ̂²) / (m + τ²), m being the noise of readings that they are compared with where that is known.
    """
    posterior, y, _ = lines_posterior(rng, terms=unknown_noise(4), correlation=correlation)
    m, step = posterior.n_geometry, 1e-3
    funnel = posterior.scale_dependence(y)
    assert funnel.parts.shape == (2, m, m)
    information = -posterior.gradient(y)[1][:m, :m] - np.eye(m)
    np.testing.assert_allclose(funnel.parts.sum(axis=0), information, rtol=0, atol=1e-9 * information.max())
    if correlation is None:  # with correlated noise what is white belongs to no group alone
        first = int(np.flatnonzero(posterior.errors.groups(4)[:, 0])[0])
        ahead, behind = (posterior.gradient(y + sign * step * np.eye(len(y))[m])[1][:m, :m] for sign in (1.0, -1.0))
        speed = 2.0 * 0.4 * funnel.tau[first] ** 2 / (funnel.rest[first] + funnel.tau[first] ** 2)
        np.testing.assert_allclose(
            (ahead - behind) / (2.0 * step), speed * funnel.parts[first], rtol=0, atol=0.01 * information.max()
        )
        assert 0.01 < funnel.rest[first] < 100.0


def test_the_noise_of_each_group_is_counted_by_itself(rng):
    posterior, y, _ = lines_posterior(rng, terms=unknown_noise(4, True, True, 0.1))
    tau, own = posterior.funnel_errors(y[None])[0], posterior.errors.natural(y[posterior.n_geometry :])
    sd = posterior.likelihood.sd[0, 0]
    expected = {
        (1, 0, 0, 0): own[0],
        (0, 1, 1, 0): np.hypot(own[0], own[1] / sd),
        (0, 0, 0, 1): np.hypot(1.0, own[1] / sd),
    }
    found = {tuple(group.astype(int)): value for group, value in zip(posterior.errors.groups(4), tau, strict=True)}
    assert found == pytest.approx(expected)


def test_what_is_common_deviates_alike(rng):
    posterior, _, _ = lines_posterior(rng, common=True)
    y = rng.standard_normal((3, posterior.n_parameters))
    theta = posterior.theta(y) - posterior.likelihood.model.layout.nominal
    zero = posterior.likelihood.model.layout.index["zero"]
    np.testing.assert_array_equal(theta[:, zero[0]], theta[:, zero[1]])
    np.testing.assert_allclose(theta[:, zero[0]], y[:, posterior.names.index("zero[1,2,3]")], rtol=1e-12)
    assert np.ptp(theta[:, zero[3]] - theta[:, zero[0]]) > 0.1


def test_outside_its_bounds_there_is_no_machine(rng):
    posterior, y, pose = lines_posterior(rng)
    model = posterior.likelihood.model
    blocks = tuple(replace(one, lower=-1.0) if one.symbol == "zero" else one for one in model.layout.blocks)
    machine = copy(model.machine)
    machine.parameters = blocks
    bounded = replace(model, machine=machine)
    likelihood = density(bounded, posterior.likelihood.data, pose)
    limited = Posterior(likelihood, posterior.priors, NO_ERRORS)
    k = limited.names.index("zero[1]")
    beyond = np.tile(0.0 * y, (2, 1))
    beyond[:, k] = [-0.9, -1.1]
    assert list(np.isfinite(limited.log_density(beyond))) == [True, False]
