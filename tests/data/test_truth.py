"""Files of the truth behind simulated data: what is written is read back, every fault is one line with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.data.truth import format_true_parameters, format_true_poses, read_true_parameters, round_as_written
from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock, ParameterLayout

LAYOUT = ParameterLayout(
    (
        ParameterBlock("l", (100.0, 200.0, 300.0), "mm", True),
        ParameterBlock("beta", (0.25,), "1", False, 0.0, 0.5),
    )
)
THETA = np.array([100.1, 200.0 / 3.0, 1e8 + 0.1, 0.123456789012])


@pytest.fixture
def path(tmp_path) -> Path:
    """Return a file with four parameters; the first stands on line 3."""
    file = tmp_path / "truth.csv"
    file.write_text(format_true_parameters(["made up"], LAYOUT, THETA))
    return file


def test_what_is_written_is_read_back_to_the_last_bit(path):
    found = read_true_parameters(path, LAYOUT)
    np.testing.assert_array_equal(found, round_as_written(THETA))
    np.testing.assert_allclose(found, THETA, rtol=0, atol=5e-13)
    assert format_true_parameters(["made up"], LAYOUT, found) == path.read_text()
    assert found[1] != THETA[1]  # it has more digits than are written


def test_numbers_are_rounded_as_their_texts_are(rng):
    """Of all sizes, and next to the middle of two numbers that a text can hold."""
    sizes = 10.0 ** rng.uniform(-15.0, 20.0, 2000) * rng.choice([-1.0, 1.0], 2000)
    middles = (np.arange(-500, 500) + 0.5) * 1e-12 + np.array([[0.0], [0.1], [300.0], [4000.0]])
    values = np.concatenate([sizes, middles.ravel(), np.arange(-500, 500) / 2.0**13, [0.0, -0.0, np.inf, np.nan]])
    found, expected = round_as_written(values), np.array([float(f"{x:.12f}") for x in values])
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))


def test_poses_have_a_column_for_each_coordinate():
    text = format_true_poses(["made up"], ("x_mm", "phi_rad"), ["C1", "V1"], np.array([[1.0, 0.5], [-2.0, 0.25]]))
    assert text.splitlines() == [
        "# made up",
        "pose,x_mm,phi_rad",
        "C1,1.000000000000,0.500000000000",
        "V1,-2.000000000000,0.250000000000",
    ]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("l[2],mm", "l[2],m", r"line 4: unit of l\[2\]: found 'm', expected 'mm'"),
        ("beta,1", "beta,mm", r"line 6: unit of beta: found 'mm', expected '1'"),
        ("l[2],", "k[2],", r"line 4: parameter: found 'k\[2\]', did you mean 'l\[2\]'\?, expected those of l, beta"),
        ("l[2],", "l[1],", r"line 4: parameter 'l\[1\]' is already on line 3, expected once"),
        ("beta,1,0.123456789012\n", "", "line 5: found 3 parameters without beta, expected 4"),
        ("0.123456789012", "0.75", r"parameter beta: found 0\.75, expected above 0 and below 0\.5"),
        ("0.123456789012", "nan", r"line 6: value: found nan, expected a finite number"),
        ("unit", "units", r"line 2: found column 'units', did you mean 'unit'\?"),
    ],
)
def test_faults_are_one_line_with_their_place(path, old, new, expected):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=expected) as caught:
        read_true_parameters(path, LAYOUT)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
