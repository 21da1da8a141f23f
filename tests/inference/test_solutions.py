"""Draws of separate modes are told apart, and modes that a ridge joins are one."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.inference.mode import Mode
from bayescal.inference.solutions import find_solutions

SHAPE = (4, 16, 100)


def as_modes(centres, sd=1.0):
    n = len(centres[0])
    return [Mode(np.asarray(one, dtype=float), 0.0, sd**2 * np.eye(n), True) for one in centres]


def draw(rng, centres, weights):
    label = rng.choice(len(centres), SHAPE, p=weights)
    return np.asarray(centres, dtype=float)[label] + rng.normal(size=(*SHAPE, len(centres[0]))), label


@pytest.mark.parametrize("weights", [(0.7, 0.3), (0.5, 0.3, 0.2), (0.97, 0.03)])
def test_probabilities_are_those_of_the_mixture(rng, weights):
    centres = [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 9.0)][: len(weights)]
    draws, label = draw(rng, centres, weights)
    found = find_solutions(draws, as_modes(centres), 3)
    assert found.n_shown == len(weights)
    assert np.all(np.abs(found.probability - weights) < 4.0 * found.standard_error + 1e-12)
    assert np.mean(found.label == label) > 0.999
    assert found.of_modes.tolist() == list(range(len(weights)))


def test_the_most_probable_one_is_the_first(rng):
    centres = [(0.0, 0.0), (0.0, -12.0)]
    draws, label = draw(rng, centres, (0.2, 0.8))
    found = find_solutions(draws, as_modes(centres), 2)
    assert np.mean(found.label == 1 - label) > 0.999
    assert found.of_modes.tolist() == [1, 0]


@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_modes_without_a_valley_between_them_are_one(rng, distance):
    centres = [(0.0, 0.0), (distance, 0.0)]
    assert find_solutions(draw(rng, centres, (0.5, 0.5))[0], as_modes(centres), 2).n_shown == 1


def test_modes_that_differ_in_errors_alone_are_one(rng):
    centres = [(0.0, 0.0), (0.0, 20.0)]
    assert find_solutions(draw(rng, centres, (0.5, 0.5))[0], as_modes(centres), 1).n_shown == 1


def test_ends_of_a_bent_ridge_are_one(rng):
    along = rng.uniform(-np.pi / 2, np.pi / 2, SHAPE)
    draws = 20.0 * np.stack([np.cos(along), np.sin(along)], axis=-1) + rng.normal(size=(*SHAPE, 2))
    assert find_solutions(draws, as_modes([(0.0, -20.0), (0.0, 20.0)]), 2).n_shown == 1


def test_a_small_one_is_counted_and_not_shown(rng):
    centres = [(0.0, 0.0), (15.0, 0.0)]
    found = find_solutions(draw(rng, centres, (0.995, 0.005))[0], as_modes(centres), 2)
    assert found.n_shown == 1
    assert 0.002 < found.probability[1] < 0.009


def test_a_mode_in_which_no_draw_is_does_not_count(rng):
    draws, _ = draw(rng, [(0.0, 0.0)], (1.0,))
    found = find_solutions(draws, as_modes([(0.0, 0.0), (40.0, 0.0)]), 2)
    assert found.probability.tolist() == [1.0]
