"""Symbols of parameters, those of somebody else's model too, as figures set them."""

from __future__ import annotations

import pytest
from matplotlib.mathtext import MathTextParser

from bayescal.report.symbols import set_mathematics, set_parameter, split_name


@pytest.mark.parametrize("name", ["a_x[3]", "rho0[1]", "k1_d[2]", "wear_of_2[1]", "c", "x y[2]", "__"])
def test_any_name_of_a_parameter_can_be_set(name):
    for text in (set_parameter(name), set_mathematics(split_name(name)[0])):
        width, height, *_ = MathTextParser("path").parse(text)
        assert min(width, height) > 0.0


def test_known_forms_have_their_marks():
    assert [set_parameter(name) for name in ("a_x[3]", "rho0[1]", "wear_of_2[1]")] == [
        "$a_{x,3}$",
        "$ρ_{1}^{0}$",
        "wear_of_2[1]",
    ]
