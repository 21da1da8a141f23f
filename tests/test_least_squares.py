"""Least squares as in RR-8096 section 7: tables 5 (a) and 6 (a) come back from the twin of table 7 (a)."""

from __future__ import annotations

import numpy as np
import pytest
import studies

from bayescal.least_squares import identify
from bayescal.tables import read_table

LEGS = [f"leg{k}" for k in range(1, 7)]
LENGTHS = ("a_x", "a_y", "b_x", "b_y", "l")
INITIAL_POSITION = 10.0


def read_published(name: str) -> dict[str, np.ndarray]:
    """Return the offsets of a published table by symbol; mm, dimensionless."""
    table = read_table(studies.TELESCOPE / "published" / f"{name}.csv", ("parameter", "unit", *LEGS))
    factor = {"mm": 1.0, "1": 1.0, "1e-3": 1e-3}
    values = table.numbers(LEGS)
    return {
        symbol: values[row] * factor[unit]
        for row, (symbol, unit) in enumerate(zip(table.text("parameter"), table.text("unit"), strict=True))
    }


@pytest.fixture(scope="module")
def inputs():
    return studies.load_study(studies.TELESCOPE / "study.toml")


@pytest.fixture(scope="module")
def fits(inputs):
    """Return the identified offsets by symbol and the fit, for every variant."""
    result = {}
    for variant in inputs.config.variants:
        machine = inputs.machine(variant)
        fit = identify(machine, inputs.poses(verification=False), tuple(variant.free))
        offset = fit.theta - machine.layout.nominal
        result[variant.deformation] = ({s: machine.layout.take(offset, s) for s in variant.free}, fit)
    return result


def rms_of_lengths(found: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> float:
    difference = np.concatenate([found[symbol] - published[symbol] for symbol in LENGTHS])
    return float(np.sqrt(np.mean(difference**2)))


@pytest.mark.parametrize(("deformation", "table"), [("none", "table5a"), ("linear", "table6a")])
def test_published_lengths_come_back(fits, deformation, table):
    found, fit = fits[deformation]
    assert fit.converged
    assert rms_of_lengths(found, read_published(table)) < 0.35


def test_other_tables_fail_the_same_bound(fits):
    assert rms_of_lengths(fits["none"][0], read_published("table7a")) > 0.35
    assert rms_of_lengths({s: np.zeros(6) for s in LENGTHS}, read_published("table5a")) > 0.35


def test_published_directions_come_back(fits):
    found, published = fits["none"][0]["u_x"], read_published("table5a")["u_x"]
    np.testing.assert_array_equal(np.sign(found), np.sign(published))
    np.testing.assert_allclose(found, published, atol=0.03, rtol=0)


def test_directions_move_the_attachment_to_keep_the_home_joint(fits):
    difference = fits["none"][0]["a_x"] - fits["linear"][0]["a_x"]
    np.testing.assert_allclose(difference, -INITIAL_POSITION * fits["none"][0]["u_x"], atol=0.1)
    five, six = read_published("table5a"), read_published("table6a")
    np.testing.assert_allclose(five["a_x"] - six["a_x"], -INITIAL_POSITION * five["u_x"], atol=0.1)


def test_truth_of_the_twin_comes_back_where_the_model_is_right(fits):
    found, fit = fits["matrix"]
    assert rms_of_lengths(found, read_published("table7a")) < 0.15
    np.testing.assert_allclose(found["kappa"], read_published("table7a")["kappa"], atol=1e-3)
    assert fit.residual_rms.max() < 5e-3
    assert fits["none"][1].residual_rms.min() > 2 * fit.residual_rms.max()
