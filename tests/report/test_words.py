"""Numbers as text, in the one place where they are rounded; symbols of parameters as figures set them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser

from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_odds,
    format_percent,
    format_plain,
    format_power,
    format_scientific,
    format_significant,
)
from bayescal.report.symbols import set_mathematics, set_parameter, split_name, write_symbol


def test_numbers_are_rounded_as_the_report_shows_them():
    assert format_estimate(-1.6204, 0.0873) == "−1.620 ± 0.087"
    assert format_estimate(1.0, 0.0996) == "1.00 ± 0.10"
    assert format_fixed(-0.0004, 2, sign=True) == "0.00"
    assert format_fixed(np.nan, 2) == "–"
    assert format_fixed(-np.inf, 2) == "−∞"
    assert format_significant(0.012345) == "0.0123"
    assert format_significant(1234.5) == "1234"
    assert format_odds(math.log(20)) == "20 to 1"
    assert format_odds(358.0) == "10¹⁵⁵ to 1"
    assert format_percent(-0.0421, 1) == "−4.2 %"
    assert format_plain(-0.5) == "−0.5"


def test_numbers_of_any_size_are_written_with_powers_of_ten():
    assert format_scientific(31415.9) == "3.1e4"
    assert format_scientific(-0.00012346, 4) == "−1.235e−4"
    assert format_scientific(math.inf) == "∞"
    assert format_power(31415.9) == "3.1·10⁴"
    assert format_power(-0.004) == "−4.0·10⁻³"
    assert format_power(1e5, 1) == "10⁵"
    assert format_power(12.345) == "12"
    assert format_power(0.0) == "0"
    assert format_power(math.nan) == "–"


@pytest.mark.parametrize("name", ["a_x[3]", "rho0[1]", "k1_d[2]", "wear_of_2[1]", "c", "x y[2]", "__"])
def test_any_name_of_a_parameter_can_be_set(name):
    for text in (set_parameter(name), set_mathematics(split_name(name)[0])):
        width, height, *_ = MathTextParser("path").parse(text)
        assert min(width, height) > 0.0


def test_known_forms_have_their_marks():
    assert [set_parameter(name) for name in ("a_x[3]", "rho0[1]", "s0[2]", "theta0", "k12_d", "wear_of_2[1]")] == [
        "$a_{x,3}$",
        "$ρ_{1}^{0}$",
        "$s_{0,2}$",
        "$theta_{0}$",
        "$k_{12d}$",
        "wear_of_2[1]",
    ]
    assert [write_symbol(one) for one in ("rho0", "s0", "k1_d", "beta_max", "wear_of_2")] == [
        "ρ0",
        "s0",
        "k1_d",
        "β_max",
        "wear_of_2",
    ]
