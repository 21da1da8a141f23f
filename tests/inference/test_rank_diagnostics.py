"""Convergence diagnostics against ArviZ's own, draw for draw."""

from __future__ import annotations

import numpy as np
import pytest
from arviz_stats.base import array_stats

from bayescal.inference.diagnostics import APART, diagnose, judge_draws


def _walk(rng, shape, repeats: bool):
    """Return autocorrelated draws (E, W, S, n), some of which repeat the one before as rejected moves do."""
    draws = np.cumsum(0.3 * rng.standard_normal(shape), axis=2) + rng.standard_normal(shape)
    if repeats:
        for step in range(1, shape[2]):
            stays = rng.random(shape[:2]) < 0.4
            draws[stays, step] = draws[stays, step - 1]
    return draws


def _as_arviz_does(draws):
    n = draws.shape[-1]
    chains = np.moveaxis(draws.reshape(len(draws), -1, n), -1, 0)
    in_time = np.moveaxis(np.swapaxes(draws, 1, 2).reshape(len(draws), -1, n), -1, 0)
    tail = array_stats.ess(chains, method="tail", prob=(0.05, 0.95))
    return array_stats.rhat(in_time), array_stats.ess(chains), tail


@pytest.mark.parametrize("shape", [(4, 8, 30, 3), (2, 3, 5, 2), (3, 10, 7, 1), (2, 2, 2, 1)])
@pytest.mark.parametrize("kind", ["walks", "walks that repeat", "whole numbers, which share their ranks"])
def test_numbers_are_those_of_arviz(rng, shape, kind):
    whole = rng.integers(0, 4, shape).astype(float)
    draws = whole if "whole" in kind else _walk(rng, shape, "repeat" in kind)
    for found, expected in zip(judge_draws(draws), _as_arviz_does(draws), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=0.0)


def test_a_scale_that_is_zero_everywhere_mixes_and_ensembles_that_stand_apart_do_not(rng):
    draws = _walk(rng, (4, 6, 20, 3), True)
    draws[..., 1] = 0.0
    draws[..., 2] = np.arange(4.0)[:, None, None]
    found = diagnose(draws)
    assert (found.rhat[1], found.ess_bulk[1], found.ess_tail[1]) == (1.0, 480.0, 480.0)
    assert found.rhat[2] >= APART


def test_draws_that_are_no_numbers_are_not_called_converged(rng):
    draws = _walk(rng, (4, 6, 20, 2), True)
    draws[0, 0, 0, 0] = np.nan
    found = diagnose(draws)
    assert not found.rhat[0] < 2.0
    assert found.ess_bulk[0] == 1.0
    np.testing.assert_allclose(found.rhat[1], diagnose(draws[..., 1:]).rhat[0], rtol=1e-12)
