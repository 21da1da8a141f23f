"""Rows in several sizes of errors at once weigh what they weigh one after the other, and sizes found are the best."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.experiments.shared.slip_rows import RowReadings
from bayescal.experiments.shared.slip_sizes import integrate_sizes
from bayescal.experiments.shared.slip_splice import weigh_spliced

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks" / "slips"))
from machines import read_subject, write_project


@pytest.fixture(scope="module")
def readings(tmp_path_factory):
    return read_subject(write_project("linear delta", tmp_path_factory.mktemp("products") / "delta")).measured.readings


@pytest.fixture(params=["together", "by row"])
def seen(readings, request):
    """Return rows about the machine as expected, with errors as a covariance of all of them, or as columns."""
    found = readings.see(readings.table, readings.begin, None, 3)
    if request.param == "by row":
        found = replace(found, shared=replace(found.shared, acts=tuple(one[..., :4] for one in found.shared.acts)))
    assert found.is_dense == (request.param == "together")
    return found


def test_many_sizes_weigh_what_each_weighs(readings, seen, rng):
    n, k = readings.posterior.errors.n_parameters, len(readings.channels)
    zeta, factor = rng.standard_normal((5, n)), np.exp(rng.standard_normal((5, k)))
    together = seen.multiply(zeta, factor)
    found = together.weigh()
    for i in range(len(zeta)):
        # columns that are kept for other errors are those of these
        one = replace(seen, kept={}).whiten(zeta[i], factor[i], common=seen.shared.list_columns(zeta[i]))
        assert found[i] == pytest.approx(one.weigh(), rel=1e-9)
        alone = seen.multiply(zeta[i : i + 1], factor[i : i + 1])
        pairs = (one.gain_by_factor(np.arange(2), (2.0, 5.0)) for one in (together, alone))
        for many, single in zip(*pairs, strict=True):
            assert many[i] == pytest.approx(single[0], rel=1e-9, abs=1e-9)


def test_tables_are_spliced_as_their_rows_are(readings, seen):
    values = readings.values + 0.01 * np.arange(len(readings.values))[:, None]
    chosen = np.arange(len(values) - 1)
    other = readings.see(RowReadings(values[chosen], chosen), readings.begin, seen.pose, 3)
    if not seen.is_dense:
        other = replace(other, shared=replace(other.shared, acts=tuple(one[..., :4] for one in other.shared.acts)))
    zeta, slops = np.zeros(readings.posterior.errors.n_parameters), np.array([1.0, 10.0])
    found = weigh_spliced(seen, other, zeta, slops, chosen, 1)
    assert found[0] == pytest.approx(
        other.weigh(np.tile(zeta, (2, 1)), np.outer(slops, np.ones(values.shape[1]))).max()
    )
    assert np.isneginf(found[-1])


def test_sizes_are_integrated_about_their_optimum(readings, seen, rng):
    factor = np.ones((1, len(readings.channels)))

    def weigh(zeta):
        return seen.weigh(zeta, np.repeat(factor, len(zeta), axis=0))

    _, mode = integrate_sizes(weigh, np.zeros(readings.posterior.errors.n_parameters))
    others = mode + 0.01 * rng.standard_normal((200, len(mode)))
    best = weigh(mode[None])[0] - 0.5 * mode @ mode
    assert (weigh(others) - 0.5 * np.sum(others**2, axis=1) < best + 1e-5).all()
