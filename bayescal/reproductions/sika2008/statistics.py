"""Root mean squares, ratios and shares over simulated calibrations, each with its standard error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Estimate:
    """A number with its standard error over calibrations; NaN where there are none, and of one the error."""

    value: float
    error: float


NOTHING = Estimate(float("nan"), float("nan"))


def rms_of(squares: Array) -> Estimate:
    """Return the root mean square from the mean squares of single calibrations (C,), those without one left out."""
    kept = squares[np.isfinite(squares)]
    if not len(kept):
        return NOTHING
    value = float(np.sqrt(np.mean(kept)))
    return Estimate(value, _error_of_mean(kept) / (2.0 * value))


def ratio_of(before: Array, after: Array) -> Estimate:
    """Return how many times smaller the root mean square is after, from mean squares of the same machines (C,)."""
    kept = np.isfinite(before) & np.isfinite(after)
    if not kept.any():
        return NOTHING
    one, two = before[kept] / np.mean(before[kept]), after[kept] / np.mean(after[kept])
    value = float(np.sqrt(np.mean(before[kept]) / np.mean(after[kept])))
    return Estimate(value, 0.5 * value * _error_of_mean(one - two))


def _error_of_mean(values: Array) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")


@dataclass(frozen=True)
class Coverage:
    """How often intervals hold the truth.

    Attributes
    ----------
    share : Estimate
        Over calibrations and quantities; the error counts a calibration once, whose quantities go together.
    lowest, highest : float
        Of single quantities over the calibrations.
    binomial_error : float
        Standard error of a single quantity's share.
    """

    share: Estimate
    lowest: float
    highest: float
    binomial_error: float


def cover(error: Array, spread: Array, quantile: float, level: float) -> Coverage:
    """Return how often errors (C, ...) lie within ``quantile`` stated standard deviations (C, ...).

    Calibrations with an error that is not finite are left out; ``level`` is the share that ought to lie within.
    """
    error, spread = error.reshape(len(error), -1), spread.reshape(len(error), -1)
    kept = np.isfinite(error).all(axis=1)
    inside = np.abs(error[kept]) < quantile * spread[kept]
    by_calibration, by_quantity = inside.mean(axis=1), inside.mean(axis=0)
    n = len(inside)
    share = Estimate(float(inside.mean()), _error_of_mean(by_calibration))
    binomial = float(np.sqrt(level * (1.0 - level) / n))
    return Coverage(share, float(by_quantity.min()), float(by_quantity.max()), binomial)
