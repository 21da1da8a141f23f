"""Shares of usual causes in errors that are planted, against least squares."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.density.causes import CAUSES, Plan, share_causes

N_POSES, N = 40, 6


@pytest.fixture
def plan():
    rng = np.random.default_rng(1)
    pose = rng.uniform(-1.0, 1.0, (N_POSES, 6))
    return Plan(pose @ rng.standard_normal((6, N)), pose[:, 3:5], pose, rng.permutation(N_POSES).astype(float))


def err(plan, cause, rng):
    """Return errors (P, N) of a cause."""
    columns = CAUSES[cause].columns(plan)
    if CAUSES[cause].alike:
        return np.repeat(columns[0] @ rng.standard_normal((columns.shape[2], 1)), N, axis=1)
    each = columns if len(columns) == N else np.repeat(columns, N, axis=0)
    return np.einsum("ipk,ik->pi", each, rng.standard_normal((N, columns.shape[2])))


@pytest.mark.parametrize("cause", CAUSES)
def test_all_of_what_a_cause_does_is_its_share(plan, cause):
    errors = err(plan, cause, np.random.default_rng(2)) + 5.0  # offsets are the geometry's
    shares = share_causes(errors[None], plan)
    assert shares[cause][0][0] == pytest.approx(1.0)
    assert next(name for name, (one, _) in shares.items() if one[0] > 0.9) == cause  # no simpler one explains them


def test_shares_are_those_of_least_squares_and_of_noise_by_chance(plan):
    errors = np.random.default_rng(3).standard_normal((400, N_POSES, N))
    shares = share_causes(errors, plan)
    for share, chance in shares.values():
        assert share.mean() == pytest.approx(chance, abs=4.0 * share.std() / 20.0)
    left = 0.0
    for i in range(N):
        design = np.column_stack([plan.travel[:, i], np.ones(N_POSES)])
        left += np.linalg.lstsq(design, errors[0, :, i])[1][0]
    whole = np.sum((errors[0] - errors[0].mean(axis=0)) ** 2)
    assert shares["screws"][0][0] == pytest.approx(1.0 - left / whole)


def test_causes_that_cannot_be_are_left_out(plan):
    bare = Plan(plan.travel[:10], np.zeros((10, 0)), plan.pose[:10], None)
    assert set(share_causes(np.ones((1, 10, N)), bare)) == {"screws"}
