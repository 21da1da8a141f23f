"""Bands of uniform ranks: as often left as they say, and by ranks that are not uniform nearly always."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, norm

from bayescal.experiments.selftest.compute import distribute, find_band, find_uneven, judge_ranks, measure_coverage
from bayescal.limits import FEWEST_SETS


@pytest.mark.parametrize(("n", "level"), [(50, 0.05), (60, 0.01), (200, 0.05)])
def test_uniform_ranks_leave_the_band_as_often_as_it_says(n, level):
    rng, band = np.random.default_rng(1), find_band(n, level)
    left = np.mean([not band.holds(rng.random(n)) for _ in range(2000)])
    assert left < level + 4 * np.sqrt(level / 2000)
    assert left > 0.3 * level  # a binomial's steps make the band a little wider


def test_ranks_of_intervals_too_narrow_leave_it():
    rng = np.random.default_rng(2)
    names = ("a", "b")
    narrow = norm.cdf(1.8 * rng.standard_normal((100, 1)))
    rank = np.hstack([rng.random((100, 1)), narrow])
    assert find_uneven(names, rank) == ["b"]
    assert find_uneven(names, np.hstack([rank[:, :1], beta(2.0, 1.0).rvs((100, 1), random_state=1)])) == ["b"]
    found = judge_ranks("prior", names, rank, norm.ppf(rank), np.zeros((100, 2)), 100)
    assert (found.fault, found.level) == ("calibration", "bad")
    assert "ranks of b " in found.text


def test_uniform_ranks_pass_and_their_coverage_has_an_error():
    rank = np.random.default_rng(3).random((80, 12))
    found = judge_ranks("posterior", tuple("abcdefghijkl"), rank, norm.ppf(rank), np.zeros((80, 2)), 80)
    assert (found.fault, found.level) == ("", "good")
    held, error = measure_coverage(rank)
    assert held == pytest.approx(0.9, abs=4 * error)
    assert error == pytest.approx(np.sqrt(0.09 / 960), rel=0.3)


@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("n", [4, FEWEST_SETS - 1])
def test_few_data_sets_are_no_verdict(n, outside):
    """Neither a fault nor a pass, wherever the truths lie."""
    rank = np.full((n, 8), 0.999) if outside else np.random.default_rng(4).random((n, 8))
    found = judge_ranks("prior", tuple("abcdefgh"), rank, norm.ppf(rank), np.zeros((n, 2)), n)
    assert (found.fault, found.level) == ("", "warning")
    assert str(FEWEST_SETS) in found.action


def test_as_many_as_needed_are_one():
    """Of twenty data sets intervals a third as wide as they should be are mostly found, right ones are not blamed."""
    rng, names, n = np.random.default_rng(4), tuple("abcdefgh"), FEWEST_SETS

    def blame(width):
        ranks = norm.cdf(rng.standard_normal((80, n, 8)) / width)
        return np.mean([judge_ranks("prior", names, one, one, np.zeros((n, 2)), n).level == "bad" for one in ranks])

    assert blame(1.0) < 0.03
    assert blame(1.0 / 3.0) > 0.9


def test_data_sets_without_a_posterior_are_a_fault_however_few():
    rank = np.full((1, 2), 0.5)
    assert judge_ranks("prior", ("a", "b"), rank, rank, rank, 4).level == "bad"


def test_too_few_posteriors_are_a_fault():
    rank = np.full((9, 2), 0.5)
    assert judge_ranks("prior", ("a", "b"), rank, rank, rank, 20).fault == "calibration"


def test_the_distribution_is_that_of_the_ranks():
    assert distribute(np.array([0.1, 0.5, 0.5, 0.9]), np.array([0.1, 0.5, 0.6])) == pytest.approx([0.25, 0.75, 0.75])


@pytest.mark.parametrize(("repeats", "level"), [(1, "warning"), (5, "bad")])
def test_few_data_sets_tell_little_of_their_own_scatter(repeats, level):
    """Shares held of 67, 75, 75 and 83 %: 4.5 of their own standard errors below 90 %, by four sets and by twenty."""
    names, rng = tuple(f"p{k}" for k in range(24)), np.random.default_rng(3)
    rank = rng.uniform(0.06, 0.94, (4 * repeats, len(names)))
    for row, n in zip(rank, [8, 6, 6, 4] * repeats, strict=True):
        row[rng.choice(len(names), n, replace=False)] = rng.choice([0.02, 0.98], n)
    held, error = measure_coverage(rank)
    assert (0.9 - held) / error > 4.4
    assert judge_ranks("posterior", names, rank, norm.ppf(rank), np.zeros((len(rank), 2)), len(rank)).level == level
