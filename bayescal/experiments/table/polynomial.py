"""A look-up table as a few terms: sines and cosines of angles, and what else changes as it is, fitted to the posterior.

Every term is less its value at the reference, where the table is zero. Each machine of the posterior has its own least
squares over the places of the table, so that the coefficients' covariance is that of the posterior.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array

DEGREES = "_deg"


@dataclass(frozen=True, eq=False)
class Polynomial:
    """Terms of a table's corrections.

    Attributes
    ----------
    terms : tuple of str
        F of them, as formulas of the columns.
    mean : ndarray, shape (F, n)
        Coefficients, in the actuators' units.
    covariance : ndarray, shape (F n, F n)
        Of the coefficients, those of a term's actuators beside one another.
    misfit : ndarray, shape (n,)
        By how much at most the terms miss the table's mean.
    """

    terms: tuple[str, ...]
    mean: Array
    covariance: Array
    misfit: Array

    @property
    def sd(self) -> Array:
        """Standard deviations of the coefficients, shape (F, n)."""
        return np.sqrt(np.diagonal(self.covariance)).reshape(self.mean.shape)


def build_terms(axes: Sequence[str], reference: Mapping[str, float], cells: Array) -> dict[str, Array]:
    """Return the terms by their formulas, each at places (G, A), shape (G,)."""
    terms: dict[str, Array] = {}
    for k, name in enumerate(axes):
        at, zero = cells[:, k], reference[name]
        if not name.endswith(DEGREES):
            terms[f"{name} - {zero:g}"] = at - zero
            continue
        for word, function in (("sin", np.sin), ("cos", np.cos)):
            terms[f"{word}({name}) - {word}({zero:g} deg)"] = function(np.deg2rad(at)) - function(np.deg2rad(zero))
    return terms


def fit_polynomial(terms: Mapping[str, Array], correction: Array) -> Polynomial:
    """Return the terms' coefficients for corrections (T, G, n) of draws of a posterior."""
    basis = np.stack(list(terms.values()), axis=1)
    drawn = np.linalg.pinv(basis) @ correction
    mean = drawn.mean(axis=0)
    covariance = np.atleast_2d(np.cov(drawn.reshape(len(drawn), -1), rowvar=False))
    misfit = np.abs(correction.mean(axis=0) - basis @ mean).max(axis=0)
    return Polynomial(tuple(terms), mean, covariance, misfit)


def format_polynomial(found: Polynomial, actuators: Sequence[str], units: Sequence[str]) -> str:
    """Return a polynomial as JSON."""
    content = {
        "about": "correction of an actuator = sum of coefficient times term; angles of columns in degrees",
        "terms": list(found.terms),
        "actuators": list(actuators),
        "units": list(units),
        "coefficients": found.mean.tolist(),
        "covariance_order": [f"{term}; {name}" for term in found.terms for name in actuators],
        "covariance": found.covariance.tolist(),
        "largest_misfit": found.misfit.tolist(),
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
