"""Straight coordinates: a bijection, its volume against determinants, and the funnel that it takes away."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines
from scipy import stats

from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.mode import find_modes
from bayescal.inference.peaks import GaussianMode, proposal_from_peaks
from bayescal.inference.reparameterisation import Bend, fit_bend, straighten


def sample(posterior, straight, mode, seed=1, n_steps=150):
    """Return draws of the posterior in sampling coordinates, (B, n)."""
    centre, factor = straight.x_from_y(mode.y[None])[0], np.linalg.cholesky(mode.covariance)
    proposal = proposal_from_peaks([GaussianMode(centre, factor, mode.log_density)], 20.0)
    run = run_ensemble(straight.log_density, proposal, np.random.SeedSequence(seed), 128, 100, n_steps)
    return straight.y_from_x(run.draws.reshape(-1, posterior.n_parameters))


@pytest.fixture(scope="module")
def fitted(twin):
    """Return, for a variant with ridge, funnel and skew: posterior, plain and fitted straightening, draws.

    Fifteen of the poses: the less is known of the model errors, the deeper the funnel.
    """
    found, few = {}, twin.select(np.arange(15))
    for name, model_error in {
        "none": machines.let_err(),
        "matrix": machines.let_err(),
        "shared": machines.let_err(shared=True),
    }.items():
        posterior = machines.build_posterior(
            "none" if name == "none" else "matrix", few, model_error
        ).with_pose_guesses()
        mode = find_modes(posterior)[0]
        plain = straighten(posterior, mode)
        draws = sample(posterior, plain, mode)
        found[name] = (posterior, plain, plain.fitted_to(draws), draws)
    return found


@pytest.fixture(params=["none", "matrix", "shared"])
def variant(request, fitted):
    """Return one of those."""
    return fitted[request.param]


def test_the_parts_are_there(fitted):
    assert all(f[2].bend is not None and f[2].follows_errors for f in fitted.values())
    assert all(np.abs(f[2].bend.b).max() > 1e-2 for f in fitted.values())
    assert fitted["none"][1].bend is None
    assert [f[1].conditional is not None for f in fitted.values()] == [False, True, True]


@pytest.mark.parametrize("stage", [1, 2], ids=["plain", "fitted"])
def test_bijection(variant, stage):
    straight, draws = variant[stage], variant[3][::97]
    x = straight.x_from_y(draws)
    np.testing.assert_allclose(straight.y_from_x(x), draws, atol=1e-9)
    wide = x + 0.5 * np.random.default_rng(2).standard_normal(x.shape)
    np.testing.assert_allclose(straight.x_from_y(straight.y_from_x(wide)), wide, atol=1e-8)
    assert np.max(np.abs(x - draws).max(axis=0) / draws.std(axis=0)) > 0.1  # and not the identity


@pytest.mark.parametrize("stage", [1, 2], ids=["plain", "fitted"])
def test_volume(variant, stage):
    """The density in x is that in y times |dy/dx|, the determinant taken by differences."""
    posterior, straight = variant[0], variant[stage]
    for y in variant[3][[10, 5000, 12000]]:
        x = straight.x_from_y(y[None])[0]
        jacobian = machines.central_difference(lambda z: straight.y_from_x(z[None])[0], x, np.full(len(x), 1e-5))
        sign, log_volume = np.linalg.slogdet(jacobian)
        assert sign == 1
        found = straight.log_density(x[None])[0] - posterior.log_density(y[None])[0]
        assert found == pytest.approx(log_volume, abs=1e-5)
        assert abs(log_volume) > 1e-3


def test_identity_without_model_error(twin, rng):
    posterior = machines.build_posterior("matrix", twin).with_pose_guesses()
    mode = find_modes(posterior)[0]
    straight = straighten(posterior, mode)
    x = mode.y + 0.01 * rng.standard_normal((4, len(mode.y)))
    np.testing.assert_array_equal(straight.y_from_x(x), x)
    np.testing.assert_array_equal(straight.log_density(x), posterior.log_density(x))


def funnel_correlations(posterior, values, zeta):
    """Return, leg by leg, the correlation of ζ with how far from the middle the leg's coordinates are."""
    found = []
    for leg, index in enumerate(posterior.sampling.legs):
        shifted = values[:, index] - values[:, index].mean(axis=0)
        squares = np.einsum("bi,ij,bj->b", shifted, np.linalg.inv(np.cov(shifted.T)), shifted)
        found.append(np.corrcoef(squares, zeta[:, leg])[0, 1])
    return np.abs(found)


def test_funnel_is_gone(fitted):
    posterior, plain, _, draws = fitted["matrix"]
    zeta = draws[:, posterior.n_geometry :]
    straight = plain.x_from_y(draws)
    before, after = (funnel_correlations(posterior, values, zeta) for values in (draws, straight))
    assert before.min() > 0.15
    assert after.max() < 0.2
    assert after.mean() < before.mean() / 3


def test_bend_maps_three_quantiles_to_those_of_a_normal(rng):
    zeta = np.log(rng.gamma([1.0, 3.0], size=(20_000, 2)))
    bend = fit_bend(zeta)
    eta = bend.inverse(zeta)
    np.testing.assert_allclose(
        np.quantile(eta, [0.05, 0.5, 0.95], axis=0).T, np.tile([-1.645, 0, 1.645], (2, 1)), atol=1e-3
    )
    assert np.all(np.abs(stats.skew(eta)) < 0.4 * np.abs(stats.skew(zeta)))


def test_bend_is_monotone_and_invertible():
    bend = Bend(np.array([0.3, -1.0]), np.array([1.0, 2.0]), np.array([0.95, -1.2]))
    eta = np.stack([np.linspace(-30, 30, 601)] * 2, axis=1)
    zeta = bend.forward(eta)
    assert np.all(np.diff(zeta, axis=0) > 0)
    np.testing.assert_allclose(bend.inverse(zeta), eta, atol=1e-9)
    slope = (bend.forward(eta + 1e-5) - bend.forward(eta - 1e-5)) / 2e-5
    np.testing.assert_allclose(bend.log_slope(eta), np.log(slope).sum(axis=1), atol=1e-7)


def test_bend_of_extreme_quantiles_stays_invertible(rng):
    zeta = np.exp(3 * rng.standard_normal((5000, 1)))
    bend = fit_bend(zeta)
    assert np.abs(bend.b / bend.a)[0] == pytest.approx(0.95)
    eta = np.linspace(-4, 4, 50)[:, None]
    np.testing.assert_allclose(bend.inverse(bend.forward(eta)), eta, atol=1e-9)
