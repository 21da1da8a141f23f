"""Covariances as files hold them: damaged ones are refused where they stand, those of few draws are taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.calibrated.exported import check_covariance
from bayescal.errors import InputError

NAMES, PATH = ["l[1]", "l[2]", "k"], Path("covariance.csv")
SD = np.array([1e-3, 2e-3, 1e5])
CORRELATION = np.array([[1.0, 0.5, -0.3], [0.5, 1.0, 0.1], [-0.3, 0.1, 1.0]])
FAULTS = {
    "not a number": ((0, 1), np.nan, r"l\[1\], l\[2\]: found nan, expected a finite number"),
    "negative": ((2, 2), -1.0, "k, k: found -1, expected a variance"),
    "one side": ((1, 2), 1e6, r"l\[2\], k: found 1e\+06 and across the diagonal 20, expected the same"),
    "no variance": ((0, 0), 0.0, r"l\[1\], l\[2\]: found 1e-06, expected at most 0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_damaged_entries_are_named(fault):
    place, value, said = FAULTS[fault]
    covariance = CORRELATION * np.outer(SD, SD)
    covariance[place] = value
    with pytest.raises(InputError, match=f"^covariance.csv: {said}"):
        check_covariance(PATH, NAMES, covariance)


def test_correlations_that_cannot_be_together_are_refused():
    correlation = np.array([[1.0, 0.9, 0.9], [0.9, 1.0, -0.9], [0.9, -0.9, 1.0]])
    with pytest.raises(InputError, match="correlations that no data can have together"):
        check_covariance(PATH, NAMES, correlation * np.outer(SD, SD))


def test_covariances_of_few_draws_and_of_constants_are_taken(rng):
    draws = rng.standard_normal((5, 20)) * np.geomspace(1e-6, 1e8, 20)
    covariance = np.cov(draws, rowvar=False)
    covariance[3] = covariance[:, 3] = 0.0
    check_covariance(PATH, [str(k) for k in range(20)], covariance)
