"""The pose to measure next: against every candidate judged again, and against divergences in closed form."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pose_problems
import pytest

from bayescal.errors import InputError
from bayescal.pose_selection import random_candidates
from bayescal.pose_selection.next_pose import compare_variants, find_unmeasured, look_ahead


@pytest.fixture(scope="module")
def choice():
    """Return a weight, what is known after five poses, and the rows of forty candidates."""
    domain = pose_problems.yu_domain(("l", "b_z"))
    criterion = pose_problems.build_criterion("I", domain)
    candidates = random_candidates(domain, 45, np.random.default_rng(3))
    rows = criterion.rows(candidates.seen)
    known = rows[40:].reshape(-1, rows.shape[-1])
    covariance = np.linalg.inv(np.eye(rows.shape[-1]) + known.T @ known)
    root = criterion.weight_root(rows.shape[-1])
    return root.T @ root, covariance, rows[:40]


def test_each_step_is_the_best_of_all_candidates(choice):
    weight, covariance, rows = choice
    left = set(range(len(rows)))
    for step in islice(look_ahead(weight, covariance, rows, np.ones(len(rows), dtype=bool)), 4):
        after = {k: np.linalg.inv(np.linalg.inv(covariance) + rows[k].T @ rows[k]) for k in left}
        values = {k: float(np.trace(weight @ one)) for k, one in after.items()}
        best = min(values.values())
        assert values[step.candidate] == pytest.approx(best, rel=1e-6)
        assert step.mean_square == pytest.approx(best, rel=1e-6)
        np.testing.assert_allclose(step.covariance, after[step.candidate], rtol=1e-6, atol=1e-12)
        covariance = step.covariance
        left.remove(step.candidate)


def test_only_what_is_allowed_is_chosen(choice):
    weight, covariance, rows = choice
    allowed = np.zeros(len(rows), dtype=bool)
    allowed[[5, 9]] = True
    assert {step.candidate for step in look_ahead(weight, covariance, rows, allowed)} == {5, 9}


def test_measured_poses_are_not_candidates():
    candidates = np.array([[0.0, 1.0], [2.0, 2.0], [3.0, 0.1]])
    assert list(find_unmeasured(candidates, np.array([[0.0, 1.05], [3.0, 0.0]]), 0.1)) == [False, True, False]
    assert find_unmeasured(candidates, np.empty((0, 2)), 0.1).all()
    with pytest.raises(InputError, match="all 3 measured"):
        find_unmeasured(candidates, candidates, 0.1)


def test_what_tells_variants_apart_is_their_divergence():
    """Two normal predictions: p q (KL + KL), by scipy's densities and draws."""
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(6)
    shift = rng.standard_normal(6)
    covariances = np.stack([a @ a.T + np.eye(6) for a in rng.standard_normal((2, 6, 6))])
    found = compare_variants(np.array([0.3, 0.7]), np.stack([np.zeros((1, 6)), shift[None]]), covariances[:, None])
    one, other = multivariate_normal(np.zeros(6), covariances[0]), multivariate_normal(shift, covariances[1])
    draws = [density.rvs(40_000, random_state=rng) for density in (one, other)]
    terms = [one.logpdf(draws[0]) - other.logpdf(draws[0]), other.logpdf(draws[1]) - one.logpdf(draws[1])]
    error = 0.21 * np.sqrt(sum(term.var() / len(term) for term in terms))
    assert found[0] == pytest.approx(0.21 * sum(term.mean() for term in terms), abs=4.0 * error)


def test_alike_variants_are_told_apart_nowhere():
    covariance = np.broadcast_to(np.eye(6), (2, 3, 6, 6))
    np.testing.assert_allclose(compare_variants(np.array([0.5, 0.5]), np.zeros((2, 3, 6)), covariance), 0.0, atol=1e-12)
