"""Walkers that stand still: those that show missing mass count, visits to a tail do not."""

from __future__ import annotations

import numpy as np
import pytest
from test_chain_checks import MISSED, N, explored, gaussian, normal, two_modes

from bayescal.inference.chain_checks import draw_tails, find_rare_ratio
from bayescal.inference.diagnostics import list_stand_problems, measure_longest_stand
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.sampling import sample_posterior

DOF = 5.0
WALKERS = 128


def heavy_tail(y):
    """Student t in the first coordinate, of variance DOF / (DOF - 2); a normal proposal has too light a tail for it."""
    return -0.5 * (DOF + 1.0) * np.log1p(y[:, 0] ** 2 / DOF) + normal(y[:, 1:])


def spike(y):
    """A tenth of the mass in a spike far out: no gradient leads from it to the rest, nor there from it."""
    narrow = np.log(0.1) + normal((y - 12.0 * np.eye(N)[0]) / 0.05) - N * np.log(0.05)
    return np.logaddexp(np.log(0.9) + normal(y), narrow)


def sample(density, proposal, n_steps, seed):
    """Return draws of a density by ensembles that start from a proposal and jump by it."""
    return sample_posterior(
        explored(density, proposal), np.random.SeedSequence(seed), 4, WALKERS, n_steps // 2, n_steps
    )


def measure_any_stand(log_density):
    """Return the longest stand wherever it is: that of a density raised to nearly nothing, of which no jump is."""
    return measure_longest_stand(1e-9 * log_density, np.full(log_density.shape, np.inf))


def judge(density, proposal, found, rare_ratio=np.inf):
    """Return what is said of the stands of a sample, hardly any of the posterior lying beyond a ratio."""
    points, log_density = found.straight.reshape(-1, N), found.log_density
    weighed = estimate_by_importance(density, proposal, np.random.default_rng(1), 5000)
    ratio = log_density - proposal.log_density(points).reshape(log_density.shape) - weighed.log_evidence
    return list_stand_problems(measure_longest_stand(log_density, ratio, rare_ratio), log_density.shape[2])


@pytest.fixture(scope="module")
def visits():
    """Samples of a heavy tail in which a walker stood still for longer than the limit."""
    runs = [(80, 3), *((80, seed) for seed in range(20, 40))]
    found = [sample(heavy_tail, gaussian(), *run) for run in runs]
    return [one for one in found if list_stand_problems(measure_any_stand(one.log_density), one.log_density.shape[2])]


def test_visits_to_a_tail_are_seldom_an_alarm(visits):
    """Where neither argument is clear by itself the alarm stays."""
    assert len(visits) > 3
    said = [problem for one in visits for problem in judge(heavy_tail, gaussian(), one)]
    assert len(said) <= len(visits) // 2


def find_rare(density, proposal):
    """Return the ratio beyond which, by the weights of draws from farther out, hardly any of the posterior lies."""
    found = explored(density, proposal)
    return find_rare_ratio(draw_tails(found, np.random.SeedSequence(7)), found)


def test_no_visit_to_a_tail_is_an_alarm_where_weights_say_what_it_holds(visits):
    rare = find_rare(heavy_tail, gaussian())
    assert np.isfinite(rare)
    assert any(judge(heavy_tail, gaussian(), one) for one in visits)
    assert not any(judge(heavy_tail, gaussian(), one, rare) for one in visits)


@pytest.mark.parametrize("name", ["minor mode", "bend"])
def test_missing_mass_is_an_alarm_by_weights_as_well(name):
    assert judge(*MISSED[name], sample(*MISSED[name], 80, 4), find_rare(*MISSED[name]))


def test_a_visit_that_is_still_an_alarm_is_none_with_more_steps():
    assert judge(heavy_tail, gaussian(), sample(heavy_tail, gaussian(), 80, 21))
    assert not judge(heavy_tail, gaussian(), sample(heavy_tail, gaussian(), 800, 21))


def test_the_moments_of_what_was_condemned_are_right(visits):
    """By error bars of the effective size, kurtosis 3 + 6 / (DOF - 4) making that of a variance wide."""
    variance = DOF / (DOF - 2.0)
    for one in visits:
        first, size = one.straight[..., 0], float(one.diagnostics.ess_bulk[0])
        assert first.mean() == pytest.approx(0.0, abs=4.0 * np.sqrt(variance / size))
        assert first.var() == pytest.approx(variance, abs=4.0 * variance * np.sqrt(8.0 / size))


@pytest.mark.parametrize("name", ["minor mode", "bend"])
def test_walkers_where_mass_is_missing_are_an_alarm(name):
    (said,) = judge(*MISSED[name], sample(*MISSED[name], 80, 4))
    assert "stuck walker" in said
    assert "increase `steps`" in said


def test_a_second_far_mode_is_an_alarm():
    """Half the mass in either; walkers by chance get to the one that the proposal does not lead to."""
    found = sample(two_modes, gaussian(2.5), 80, 1)
    assert found.straight[..., 0].mean() < 4.0  # not half of the draws
    assert judge(two_modes, gaussian(2.5), found)


def test_a_walker_that_begins_in_a_spike_is_an_alarm():
    log_density = sample(normal, gaussian(), 80, 1).log_density.copy()
    inside = spike(12.0 * np.eye(N)[:1])
    seldom = np.full(log_density.shape, 50.0)
    log_density[0, 0] = inside  # it never leaves, since all around is lower by 20 nats and more
    (said,) = list_stand_problems(measure_longest_stand(log_density, seldom), 80)
    assert "79 of 80" in said


def test_many_walkers_that_stand_still_at_a_low_density_are_an_alarm():
    """One of 128 in each ensemble may, eleven may not: that is more than moves no interval."""
    log_density = sample(normal, gaussian(), 80, 1).log_density.copy()
    seldom = np.full(log_density.shape, 50.0)
    for n, expected in ((1, 0), (11, 1)):
        log_density[:, :n] = -40.0 - np.arange(float(n))[:, None]
        stood = list_stand_problems(measure_longest_stand(log_density, seldom), 80)
        assert len(stood) == expected, n


@pytest.mark.runs
def test_the_cure_cures():
    """The minor mode has a tenth of the mass, at 15: variance 9 + 0.09 * 15² with more steps, and no alarm."""
    density, proposal = MISSED["minor mode"]
    assert judge(density, proposal, sample(density, proposal, 80, 4))
    cured = sample(density, proposal, 2000, 4)
    assert not judge(density, proposal, cured)
    assert cured.straight[..., 0].var() == pytest.approx(29.25, rel=0.1)
