"""Sharpened peaks: exact for Gaussians, better than Laplace where a density is skewed, and mixtures of several."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import multivariate_normal, skewnorm

from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import explore
from bayescal.inference.mode import find_modes
from bayescal.inference.peaks import GaussianMode, bend_at, proposal_from_peaks, refine_peak
from bayescal.inference.reparameterisation import straighten


def random_gaussian(rng, n):
    """Return a Gaussian of n dimensions with correlations."""
    factor = np.tril(rng.standard_normal((n, n)), -1) + np.diag(rng.uniform(0.5, 2.0, n))
    return multivariate_normal(rng.standard_normal(n), factor @ factor.T)


def test_gaussian_is_found_from_a_poor_start(rng):
    target = random_gaussian(rng, 6)
    found = refine_peak(lambda x: np.atleast_1d(target.logpdf(x)), GaussianMode(np.zeros(6), 0.5 * np.eye(6), 0.0))
    np.testing.assert_allclose(found.centre, target.mean, atol=1e-6)
    np.testing.assert_allclose(found.factor @ found.factor.T, target.cov, atol=1e-6)
    assert found.log_evidence == pytest.approx(0.0, abs=1e-6)


def test_skewed_peak_moves_towards_its_mass():
    shape = skewnorm(6.0)

    def density(x):
        return shape.logpdf(x).sum(axis=1)

    mode = 0.2
    found = refine_peak(density, GaussianMode(np.full(2, mode), 0.3 * np.eye(2), 0.0))
    assert np.all(np.abs(found.centre - shape.mean()) < np.abs(mode - shape.mean()))
    spread = np.sqrt(np.diag(found.factor @ found.factor.T))
    assert np.all(np.abs(spread - shape.std()) < abs(0.3 - shape.std()))


def test_peak_beside_a_cliff_stays():
    def density(x):
        return np.where(x[:, 0] > 0.1, -np.inf, -0.5 * np.sum(x * x, axis=1))

    start = GaussianMode(np.zeros(2), np.eye(2), 0.0)
    assert refine_peak(density, start) is start


def test_mixture_weights_are_the_masses(rng):
    first, second = random_gaussian(rng, 3), random_gaussian(rng, 3)
    peaks = [
        GaussianMode(g.mean, np.linalg.cholesky(g.cov), g.logpdf(g.mean) + np.log(share))
        for g, share in ((first, 0.9), (second, 0.1))
    ]
    np.testing.assert_allclose(proposal_from_peaks(peaks, 50.0).weights, [0.9, 0.1], rtol=1e-9)


@pytest.fixture(scope="module")
def ridge():
    """Return a posterior with both components of u free, no κ and a model error: the strongest ridge."""
    rng = np.random.default_rng(5)
    machine = machines.build_machine("none")
    truth = machine.layout.nominal.copy()
    truth[machine.layout.index["l"]] += rng.normal(0, 1.0, 6)
    poses = machines.simulate_poses(machine, truth, machines.table_3_actuators(), np.full(6, 5e-3), rng)
    symbols = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l", "u_x", "u_y", "rho0")
    return machines.build_posterior("none", poses, machines.let_err(), symbols).with_pose_guesses()


def test_ridge_needs_no_pilot(ridge):
    found = explore(ridge, np.random.SeedSequence(1))
    assert len(found.modes) == 1
    assert found.efficiency > 0.3


def test_bends_keep_the_point_of_the_peak(ridge):
    modes = find_modes(ridge)
    straight = straighten(ridge, modes[0])
    peak = GaussianMode(straight.x_from_y(modes[0].y[None])[0], np.linalg.cholesky(modes[0].covariance), 0.0)
    bent, bent_peak = bend_at(straight, peak)
    assert bent.bend is not None
    np.testing.assert_allclose(bent.y_from_x(bent_peak.centre[None])[0], modes[0].y, atol=1e-8)


def test_bridge_over_separate_modes():
    """One Gaussian for modes 200 sds apart would leave a standard error near one nat."""
    n, far, share = 5, 200.0, 0.01
    main, other = multivariate_normal(np.zeros(n)), multivariate_normal(np.full(n, far))

    def density(x):
        return np.logaddexp(np.log(1 - share) + main.logpdf(x), np.log(share) + other.logpdf(x))

    peaks = [GaussianMode(np.full(n, at), np.eye(n), float(density(np.full((2, n), at))[0])) for at in (0.0, far)]
    proposal = proposal_from_peaks(peaks, 50.0)
    ensembles = [run_ensemble(density, proposal, seed, 64, 10, 40) for seed in np.random.SeedSequence(2).spawn(4)]
    draws, densities = np.stack([e.draws for e in ensembles]), np.stack([e.log_density for e in ensembles])
    found = estimate_by_bridge(density, draws, densities, np.random.default_rng(3), 5000, proposal)
    assert found.converged
    assert found.standard_error < 0.02
    assert abs(found.log_evidence) < 5 * found.standard_error
    blind = estimate_by_bridge(density, draws, densities, np.random.default_rng(3), 5000)
    assert blind.standard_error > 5 * found.standard_error
