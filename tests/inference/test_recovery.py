"""Known truths found again: coverage for the telescope of table 7 (a), and ranks of truths drawn from the prior.

All draws are importance-weighted draws of the explored proposal, so that a chain's autocorrelation has no part in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import telescope_machines as machines
from calibration_problems import judge_ranks
from scipy import stats

from bayescal.inference.exploration import explore
from bayescal.inference.importance import evaluate_in_batches, resample

pytestmark = pytest.mark.slow

SCALE = 0.01
N_DRAWS = 6000
N_RANKS = 99
TRUE_TAU = np.array([1.0, 2.0, 3.0, 4.0, 2.0, 1.0]) * 1e-3


@dataclass(frozen=True, eq=False)
class Fit:
    """Truth and posterior draws in natural units, with the share of effective draws."""

    names: tuple[str, ...]
    truth: np.ndarray
    draws: np.ndarray
    rank_of_density: int
    efficiency: float

    @property
    def z(self):
        """Return truth minus posterior mean in posterior standard deviations."""
        return (self.truth - self.draws.mean(axis=0)) / self.draws.std(axis=0)

    def covered(self, level):
        """Return whether the central interval of a level holds the truth, parameter by parameter."""
        low, high = np.quantile(self.draws, [0.5 - level / 2, 0.5 + level / 2], axis=0)
        return (low < self.truth) & (self.truth < high)


def fit(theta, tau, seed):
    """Simulate a data set of the telescope and return its fit."""
    sequence = np.random.SeedSequence(seed)
    data_seed, explore_seed, draw_seed = sequence.spawn(3)
    machine, actuators = machines.build_machine("matrix"), machines.table_3_actuators()
    poses = machines.simulate_poses(machine, theta, actuators, tau, np.random.default_rng(data_seed))
    posterior = machines.build_posterior("matrix", poses, machines.let_err(SCALE), machine=machine).with_pose_guesses()
    found, rng = explore(posterior, explore_seed), np.random.default_rng(draw_seed)
    drawn = resample(found.straight.log_density, found.proposal, rng, N_DRAWS, 2000)
    y = found.straight.y_from_x(drawn.draws)
    truth = np.concatenate([theta[posterior.sampling.free], tau])
    likelihoods = evaluate_in_batches(posterior.log_density, y) - posterior.log_prior(y)
    zeta = posterior.errors.priors[0].standardise(tau)
    true_likelihood = posterior.likelihood.density(theta[None], posterior.errors, zeta[None])[0]
    rank = int(np.sum(likelihoods[:N_RANKS] < true_likelihood))
    return Fit(posterior.names, truth, posterior.natural(y), rank, drawn.efficiency)


@pytest.fixture(scope="module")
def telescope():
    """Return fits of fifty data sets of the machine of table 7 (a)."""
    theta = machines.telescope_truth(machines.build_machine("matrix"))
    return [fit(theta, TRUE_TAU, seed) for seed in range(50)]


@pytest.fixture(scope="module")
def drawn():
    """Return fits of data sets whose truths are drawn from the prior."""
    machine, rng, fits = machines.build_machine("matrix"), np.random.default_rng(99), []
    for seed in range(100):
        theta = machine.layout.nominal.copy()
        for symbol in machines.FREE_SYMBOLS["matrix"]:
            theta[machine.layout.index[symbol]] += machines.PRIOR_SD.get(symbol, 2.0) * rng.standard_normal(6)
        fits.append(fit(theta, np.abs(SCALE * rng.standard_normal(6)), 1000 + seed))
    return fits


def test_every_parameter_is_recovered(telescope):
    """Of 36 normal parameters, 0.002 are expected beyond four standard deviations: none may be."""
    geometry = telescope[0].z[:36]
    assert np.abs(geometry).max() < 4
    assert np.std(geometry) > 0.4  # nor are the standard deviations far too large


def test_deviations_are_those_of_a_normal(telescope):
    """Pooled over the data sets, deviations beyond four sd are as rare as they must be: 0.1 of 1800 are expected."""
    z = np.concatenate([f.z[:36] for f in telescope])
    assert np.sum(np.abs(z) > 4) <= stats.poisson.isf(1e-4, len(z) * 2 * stats.norm.sf(4))
    assert np.sum(np.abs(z) > 2) > 0.01 * len(z)


def test_ninety_percent_intervals_cover_ninety_percent(telescope):
    coverage = np.mean([f.covered(0.9)[:36] for f in telescope])
    assert 0.85 < coverage < 0.95
    half = np.mean([f.covered(0.5)[:36] for f in telescope])
    assert 0.42 < half < 0.58


def test_data_tell_what_the_prior_did_not(telescope):
    """Posterior standard deviations are well below the prior's: coverage is earned from the data."""
    sd = np.mean([f.draws.std(axis=0)[:36] for f in telescope], axis=0)
    prior = np.array([machines.PRIOR_SD.get(name.split("[")[0], 2.0) for name in telescope[0].names[:36]])
    assert np.max(sd / prior) < 0.5


def ranks(fits):
    """Return the rank of each truth among draws of its posterior, shape (data sets, n), 0 to N_RANKS."""
    return np.array([np.sum(f.draws[:N_RANKS] < f.truth, axis=0) for f in fits])


def test_ranks_of_truths_from_the_prior_are_uniform(drawn):
    """Parameter by parameter (data sets are independent, parameters of one are not)."""
    found = ranks(drawn)
    p_values = {name: judge_ranks(found[:, k], N_RANKS) for k, name in enumerate(drawn[0].names)}
    assert min(p_values.values()) > 1e-4
    assert judge_ranks(np.array([f.rank_of_density for f in drawn]), N_RANKS) > 1e-4


def test_ranks_pooled_over_the_legs_are_uniform(drawn):
    """With 600 ranks a symbol, dependent within a data set, the bound is looser: it is on mean and spread."""
    found = ranks(drawn) / N_RANKS
    symbols = np.array([name.split("[")[0] for name in drawn[0].names])
    for symbol in np.unique(symbols):
        pooled = found[:, symbols == symbol]
        # the mean of a data set's six ranks has at most the standard deviation of one
        assert abs(pooled.mean() - 0.5) < 4 / np.sqrt(12 * len(drawn))
        assert 0.06 < pooled.var() < 0.11


def test_wrong_widths_would_show(drawn):
    """Negative control: draws a third too narrow or too wide about their mean have ranks that are not uniform."""
    for stretch in (2 / 3, 3 / 2):
        p_values = []
        for k in range(len(drawn[0].names)):
            moved = []
            for f in drawn:
                centre = f.draws[:, k].mean()
                moved.append(np.sum(centre + stretch * (f.draws[:N_RANKS, k] - centre) < f.truth[k]))
            p_values.append(judge_ranks(np.array(moved), N_RANKS))
        assert min(p_values) < 1e-4


def test_proposals_are_worth_drawing_from(telescope, drawn):
    efficiencies = np.array([f.efficiency for f in (*telescope, *drawn)])
    assert np.median(efficiencies) > 0.2
    assert np.mean(efficiencies < 0.05) < 0.05
