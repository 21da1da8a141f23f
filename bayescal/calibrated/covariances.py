"""Covariances that were read from files: a damaged one would end in roots of negative numbers far from its file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

ASYMMETRY = 1e-6
"""Of the product of both standard deviations; files have all digits, those of others perhaps seven."""
LEAST_EIGENVALUE = -1e-6
"""Of the correlations: fewer draws than parameters leave eigenvalues that are zero but for rounding."""


def check_covariance(path: Path, names: Sequence[str], covariance: Array) -> None:
    """Check a covariance (n, n) of quantities of any units.

    Raises
    ------
    InputError
        Where an entry is not finite, a variance is negative, two entries across the diagonal differ, or no data can
        have such correlations.
    """
    for i, j in np.argwhere(~np.isfinite(covariance))[:1]:
        raise InputError(f"{_where(path, names, i, j)}: found {covariance[i, j]:g}, expected a finite number")
    variance = np.diagonal(covariance)
    for i in np.flatnonzero(variance < 0.0)[:1]:
        raise InputError(f"{_where(path, names, i, i)}: found {variance[i]:g}, expected a variance, zero or more")
    sd = np.sqrt(variance)
    product = sd[:, None] * sd
    unlike = np.abs(covariance - covariance.T) > ASYMMETRY * product
    for i, j in np.argwhere(unlike)[:1]:
        raise InputError(
            f"{_where(path, names, i, j)}: found {covariance[i, j]:g} and across the diagonal {covariance[j, i]:g}, "
            "expected the same"
        )
    for i, j in np.argwhere(np.abs(covariance) > (1.0 - LEAST_EIGENVALUE) * product)[:1]:
        raise InputError(
            f"{_where(path, names, i, j)}: found {covariance[i, j]:g}, expected at most {product[i, j]:g}, the product "
            "of both standard deviations"
        )
    known = np.flatnonzero(product.diagonal() > 0.0)
    correlation = covariance[np.ix_(known, known)] / product[np.ix_(known, known)]
    if len(known) and np.linalg.eigvalsh(correlation)[0] < LEAST_EIGENVALUE * len(known):
        raise InputError(f"{path}: found correlations that no data can have together, expected those of a covariance")


def _where(path: Path, names: Sequence[str], row: int, column: int) -> str:
    return f"{path}: {names[row]}, {names[column]}"
