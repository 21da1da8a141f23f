"""Positions that the actuators cannot have are refused, with what was perhaps written in their place."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.data.actuators import check_range
from bayescal.errors import InputError

HOME = np.array([10.0, 12.0, 14.0])
RANGE = 1.3
POSITIONS = HOME + np.random.default_rng(5).uniform(-RANGE, RANGE, (20, 3))
NAMES = [f"P{k}" for k in range(20)]


def test_positions_within_the_range():
    check_range(POSITIONS, HOME, RANGE, NAMES)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        (POSITIONS - HOME, "; displacements instead of positions?"),
        (1e-3 * POSITIONS, "; metres?"),
        (1e3 * POSITIONS, "; micrometres?"),
        (1e-3 * (POSITIONS - HOME), "; displacements in metres?"),
        (POSITIONS + 5.0 * np.eye(20, 3), "at most 1.3 mm"),
        (np.zeros((20, 3)), "at most 1.3 mm"),
    ],
)
def test_what_was_perhaps_written(written, said):
    with pytest.raises(InputError) as caught:
        check_range(written, HOME, RANGE, NAMES)
    assert str(caught.value).endswith(said)
    assert str(caught.value).startswith("pose 'P")
