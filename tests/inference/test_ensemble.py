"""Draws against known moments, in error bars from their own effective sizes, and step by step against emcee's."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayescal.errors import NumericalError
from bayescal.inference.ensemble import JUMP_SHARE, run_ensemble, run_ensembles
from bayescal.inference.proposal import MixtureProposal

N_ENSEMBLES, N_WALKERS, N_BURN_IN, N_STEPS = 4, 160, 60, 125  # a step costs as much with many walkers as with few
LIMIT = 4.0
PRECISION = np.linalg.inv(np.array([[1.0, 0.9, 0.0], [0.9, 1.0, -0.3], [0.0, -0.3, 4.0]]))
BEND = 0.5


def gaussian(y):
    """Return a correlated normal log-density, centred on (1, 2, 3)."""
    shifted = y - np.array([1.0, 2.0, 3.0])
    return -0.5 * np.einsum("bi,ij,bj->b", shifted, PRECISION, shifted)


def banana(y):
    """Return a normal density sheared by BEND (y_0² - 1) in its second coordinate."""
    straight = y[:, 1] - BEND * (y[:, 0] ** 2 - 1.0)
    return -0.5 * (y[:, 0] ** 2 + straight**2 + y[:, 2] ** 2)


TARGETS = {
    "gaussian": (gaussian, np.array([1.0, 2.0, 3.0]), np.linalg.inv(PRECISION)),
    "banana": (banana, np.zeros(3), np.diag([1.0, 1.0 + 2 * BEND**2, 1.0])),
}


@pytest.fixture(scope="module")
def proposal():
    """Return a proposal that is wide and off centre: the sampler has to do the work."""
    return MixtureProposal(np.ones(1), np.array([[0.5, 1.0, 1.5]]), 2.0 * np.eye(3)[None], 6.0)


def z_scores(chains, mean, covariance):
    """Return the errors of means and second moments in their own standard errors; chains (ensembles, draws, n)."""
    shifted = chains - mean
    products = [shifted[..., i] * shifted[..., j] - covariance[i, j] for i in range(3) for j in range(i + 1)]
    scores = []
    for values in [*np.moveaxis(shifted, -1, 0), *products]:
        effective = array_stats.ess(values, method="mean")
        assert effective > 200
        scores.append(values.mean() / (values.std() / np.sqrt(effective)))
    return np.array(scores)


def draw(log_density, proposal, seed):
    """Return the chains of several ensembles, (ensembles, draws, n)."""
    seeds = np.random.SeedSequence(seed).spawn(N_ENSEMBLES)
    runs = [run_ensemble(log_density, proposal, s, N_WALKERS, N_BURN_IN, N_STEPS) for s in seeds]
    return np.stack([run.draws.reshape(-1, 3) for run in runs])


@pytest.fixture(scope="module")
def chains(proposal):
    """Return the chains of each target."""
    return {name: draw(target[0], proposal, seed=11) for name, target in TARGETS.items()}


@pytest.mark.parametrize("name", TARGETS)
def test_moments(name, chains):
    _, mean, covariance = TARGETS[name]
    assert np.abs(z_scores(chains[name], mean, covariance)).max() < LIMIT


def test_a_wrong_moment_is_found_out(chains):
    """Negative control: the scores see variances that are ten per cent off."""
    _, mean, covariance = TARGETS["gaussian"]
    assert np.abs(z_scores(chains["gaussian"], mean, covariance * (1 + 0.1 * np.eye(3)))).max() > LIMIT


def run_with_emcee(log_density, proposal, seed, n_walkers, n_burn_in, n_steps):
    """Return chain, densities and acceptance of one ensemble that emcee runs, from the same random numbers."""
    seed_start, seed_moves = seed.spawn(2)

    def jump(coordinates, random):
        own = np.random.default_rng(random.randint(2**32, size=4, dtype=np.uint64))
        drawn = proposal.draw(len(coordinates), own)
        return drawn, proposal.log_density(coordinates) - proposal.log_density(drawn)

    moves = [(emcee.moves.MHMove(jump), JUMP_SHARE), (emcee.moves.DEMove(), 1.0 - JUMP_SHARE)]
    sampler = emcee.EnsembleSampler(n_walkers, proposal.means.shape[1], log_density, moves=moves, vectorize=True)
    start = proposal.draw(n_walkers, np.random.default_rng(seed_start))
    random = np.random.RandomState(seed_moves.generate_state(8)).get_state()
    state = sampler.run_mcmc(emcee.State(start, random_state=random), n_burn_in, store=False)
    sampler.reset()
    sampler.run_mcmc(state, n_steps)
    return np.swapaxes(sampler.get_chain(), 0, 1), sampler.get_log_prob().T, sampler.acceptance_fraction.mean()


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("n_walkers", [20, 33])
def test_ensembles_abreast_are_those_that_emcee_runs_one_by_one(name, n_walkers, proposal):
    log_density = TARGETS[name][0]
    abreast = run_ensembles(log_density, proposal, np.random.SeedSequence(5).spawn(3), n_walkers, 7, 40)
    for run, seed in zip(abreast, np.random.SeedSequence(5).spawn(3), strict=True):
        chain, density, acceptance = run_with_emcee(log_density, proposal, seed, n_walkers, 7, 40)
        np.testing.assert_allclose(run.draws, chain, rtol=1e-12)
        np.testing.assert_allclose(run.log_density, density, rtol=1e-12)
        assert run.acceptance == pytest.approx(acceptance, rel=1e-12)


def test_a_density_that_is_no_number_is_an_error(proposal):
    for bad in (np.nan, np.inf):
        calls = iter([*[0.0] * 3, *[bad] * 100])
        with pytest.raises(NumericalError, match="not finite"):
            run_ensemble(lambda y, c=calls: gaussian(y) + next(c), proposal, np.random.SeedSequence(5), 20, 0, 20)


def test_walkers_that_span_too_little_are_an_error(proposal):
    def draw_flat(n, rng):
        return np.column_stack([rng.standard_normal((n, 2)), np.zeros(n)])

    for n_walkers, starts in ((20, draw_flat), (5, None)):
        with pytest.raises(NumericalError, match="span 3 coordinates"):
            run_ensemble(gaussian, proposal, np.random.SeedSequence(5), n_walkers, 0, 20, starts)


def test_same_seed_gives_the_same_bits_whatever_runs_in_between(proposal):
    first = run_ensemble(gaussian, proposal, np.random.SeedSequence(5), 20, 10, 15)
    np.random.seed(1)  # noqa: NPY002, the legacy global state is what must not matter
    other = run_ensemble(gaussian, proposal, np.random.SeedSequence(6), 20, 10, 15)
    second = run_ensemble(gaussian, proposal, np.random.SeedSequence(5), 20, 10, 15)
    np.testing.assert_array_equal(first.draws, second.draws)
    np.testing.assert_array_equal(first.log_density, second.log_density)
    assert first.acceptance == second.acceptance
    assert not np.any(first.draws[:, 0] == other.draws[:, 0])


def test_walkers_start_where_the_density_is_finite(proposal):
    def half(y):
        return np.where(y[:, 0] > 1.0, gaussian(y), -np.inf)

    run = run_ensemble(half, proposal, np.random.SeedSequence(5), 20, 0, 20)
    assert run.draws[..., 0].min() > 1.0
    with pytest.raises(NumericalError, match="0 of 20 walkers"):
        run_ensemble(lambda y: np.full(len(y), -np.inf), proposal, np.random.SeedSequence(5), 20, 0, 20)
