"""Standard deviations of errors whose size has a heavy tail are those of their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.density.calibration.model_error import RandomTerm
from bayescal.density.calibration.terms import ErrorModel, NoiseFactor
from bayescal.density.priors import HalfCauchyPrior
from bayescal.numerics.heavy_tails import HEAVY, find_equivalent, find_most, measure_tail


@pytest.fixture
def tailed(rng):
    """Draws of a size that no data have seen."""
    return HalfCauchyPrior(2.0).draw(20_000, rng)


def test_a_size_that_is_known_is_its_own_equivalent():
    assert np.isclose(find_equivalent(np.full(100, 3.0)), 3.0)
    assert np.isclose(measure_tail(np.full(100, 3.0)), 1.0)
    assert measure_tail(np.zeros(5)) == 1.0
    assert find_most(np.full(100, 3.0)) == np.inf


def test_the_equivalent_has_the_interval_of_the_error(rng, tailed):
    errors = tailed * rng.standard_normal(len(tailed))
    assert np.isclose(1.645 * find_equivalent(tailed), np.quantile(np.abs(errors), 0.9), rtol=0.05)
    assert measure_tail(tailed) > 3.0


def test_sizes_that_are_cut_off_have_the_equivalent_as_their_rms(tailed):
    cut = np.minimum(tailed, find_most(tailed))
    assert np.isclose(np.sqrt(np.mean(cut**2)), find_equivalent(tailed), rtol=1e-6)
    more = np.append(tailed, 1e9)
    assert np.isclose(find_equivalent(more), find_equivalent(tailed), rtol=0.01)


class Creep(RandomTerm):
    """A size with a heavy tail."""

    priors = (HalfCauchyPrior(1.0),)


def test_only_sizes_of_errors_that_data_do_not_determine_are_limited(rng):
    every = np.ones(2, dtype=bool)
    errors = ErrorModel((NoiseFactor("s", every, 3.0), Creep("open", every, 1.0), Creep("known", every, 1.0)))
    zeta = np.stack([rng.standard_normal(4000), rng.standard_normal(4000), 0.05 * rng.standard_normal(4000)], axis=1)
    found = errors.limit(zeta)
    assert np.array_equal(found[:, [0, 2]], zeta[:, [0, 2]])
    before, after = (errors.natural(one)[:, 1] for one in (zeta, found))
    assert np.median(after) == np.median(before)
    assert np.isclose(np.sqrt(np.mean(after**2)), find_equivalent(before), rtol=1e-3)
    assert measure_tail(before) > HEAVY
