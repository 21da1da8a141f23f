"""Simulation-based calibration of legs: ranks of truths of the prior among draws as a study leaves them.

Four models, two of them with a small free set. The data come by forward kinematics, the deformation matrix uncertain;
in Σ τ² a density whose covariance is another machine's shows first.
"""

from __future__ import annotations

import exact_problems as problems
import numpy as np
import pytest
from calibration_problems import judge_ranks
from scipy import stats

pytestmark = pytest.mark.slow

N_MACHINES = 120
N_RANKS = 99
CASES = [
    ("six_pus", "none", False),
    ("jacobian", "linear", True),
    ("beam", "linear", True),
    ("stiffness", "matrix", False),
]


def rank_truth(model, deformation, small, seed):
    """Return the ranks of a machine's parameters, model errors and Σ τ² among moved draws, and their share that counts.

    Draws are of one round of weights, so that their number does not hide what the move misses.
    """
    rng = np.random.default_rng([seed, 11])
    problem = problems.draw_problem(model, deformation, problems.list_free(deformation, small), rng)
    _, moved, correction = problems.solve(problem, [seed, 12])
    chosen = rng.choice(len(moved), N_RANKS, replace=False)
    below = problems.measure(problem, moved[chosen]) < problems.measure_truth(problem)
    return below.sum(axis=0), correction.efficiency


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(str(part) for part in case))
def calibration(request):
    """Return the ranks, shape (machines, quantities), and the shares of draws that count."""
    found = [rank_truth(*request.param, seed) for seed in range(N_MACHINES)]
    return np.array([ranks for ranks, _ in found]), np.array([share for _, share in found])


def test_ranks_of_every_quantity_are_uniform(calibration):
    """The smallest of n p-values is below 1e-3 / n in one of a thousand calibrations."""
    ranks, _ = calibration
    p_values = [judge_ranks(ranks[:, k], N_RANKS) for k in range(ranks.shape[1])]
    assert min(p_values) > 1e-3 / len(p_values)


def test_the_sum_of_model_errors_is_covered(calibration):
    """Ninety percent intervals of Σ τ², within three standard errors; outermost ranks are as rare as they must be."""
    total = calibration[0][:, -1]
    covered = np.mean((total >= 5) & (total < 95))
    assert abs(covered - 0.9) < 3 * np.sqrt(0.09 / len(total))
    outermost = int(np.sum((total == 0) | (total == N_RANKS)))
    assert outermost <= stats.binom.isf(1e-3, len(total), 2 / (N_RANKS + 1))


def test_moved_draws_count_almost_in_full(calibration):
    _, share = calibration
    assert np.median(share) > 0.9
    assert np.mean(share < 0.5) < 0.02
