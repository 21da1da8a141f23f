"""Simulated calibrations: whether the accuracy that an audit predicts is the one that calibrations reach.

Machines are drawn from the priors, read at the planned poses with all noise, and identified one by one; the errors of
what was identified are then set against the predicted posterior standard deviations. The audit's are those of the
machine linearised where it is expected. Averaged over machines drawn from the priors they are what a calibration can
expect, where the derivatives change within the tolerances.

Where only some parameters are identified the machines are off in the others all the same, which the calibration takes
for nominal: a simulation whose machines were nominal there would certify what it assumes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.limits import NINETY
from bayescal.numerics.geometry import Array

BAND = 0.99


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Simulated calibrations of B machines that were drawn from the priors, B' of which converged."""

    names: tuple[str, ...]  # of the m parameters that were identified
    # (B', m) each: estimate minus truth, and standard deviations that each calibration claims, linearised at its
    # estimate, in units of the tolerances
    errors: Array
    claimed: Array
    converged: np.ndarray  # (B,), bool
    n_redrawn: int  # draws that were no machine or could not take every planned pose, and were drawn again


# --- prediction against what happened ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PredictionCheck:
    """Predicted posterior standard deviations against the errors of calibrations."""

    names: tuple[str, ...]
    # (n,) each: posterior standard deviation and root mean square error, in units of the tolerances
    predicted: Array
    found: Array
    # (n,) each: found by predicted, and its standard error with the errors' own kurtosis
    ratio: Array
    ratio_error: Array
    # mean squared length of the errors in the metric of the predicted covariance, by n: one where all is as predicted
    chi_square: float
    chi_square_error: float  # its standard error
    # (n,): root mean square of the standard deviations that the calibrations claim, in units of the tolerances
    claimed: Array
    covered: Array  # (n,): share of the calibrations whose 90 % interval holds the truth
    z: Array  # (n,): root mean square error in units of what each calibration claims: one where the claims are true

    def by_symbol(self) -> dict[str, float]:
        """Return the ratio of root mean squares over all parameters of a symbol."""
        symbols = np.array([name.partition("[")[0] for name in self.names])
        result = {}
        for symbol in dict.fromkeys(symbols.tolist()):
            part = symbols == symbol
            result[symbol] = float(np.sqrt(np.sum(self.found[part] ** 2) / np.sum(self.predicted[part] ** 2)))
        return result


def compare_with_prediction(simulated: Calibrations, covariance: Array) -> PredictionCheck:
    """Return how calibrations' errors compare with a predicted posterior covariance (m, m), in units of the tolerances.

    That is `Information.covariance`, or a part of `Information.errors_of_reduced`. InputError where fewer than two
    calibrations converged.
    """
    errors = simulated.errors
    if len(errors) < 2:
        raise InputError(f"calibrations: found {len(errors)} converged, expected two")
    predicted = np.sqrt(np.diagonal(covariance))
    square = np.mean(errors**2, axis=0)
    kurtosis = np.mean(errors**4, axis=0) / square**2
    ratio = np.sqrt(square) / predicted
    own = errors / simulated.claimed
    variances, axes = np.linalg.eigh(covariance)
    lengths = ((errors @ axes) ** 2 / variances).mean(axis=1)
    return PredictionCheck(
        simulated.names,
        predicted,
        np.sqrt(square),
        ratio,
        ratio * np.sqrt(np.maximum(kurtosis - 1.0, 0.0) / (4.0 * len(errors))),
        float(lengths.mean()),
        float(lengths.std(ddof=1) / np.sqrt(len(lengths))),
        np.sqrt(np.mean(simulated.claimed**2, axis=0)),
        np.mean(np.abs(own) < NINETY, axis=0),
        np.sqrt(np.mean(own**2, axis=0)),
    )


# --- requirements kept ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RequirementCount:
    """How many of n calibrated machines kept a requirement in the whole workspace."""

    kept: int
    n: int
    # between which the number lies with a probability of 99 %, if the claimed probability is right
    low: int
    high: int

    @property
    def agrees(self) -> bool:
        """Whether the number is one to expect."""
        return self.low <= self.kept <= self.high


def compare_kept(kept: int, n: int, probability: float, draws: int) -> RequirementCount:
    """Return the number of machines that kept a requirement beside what a claimed probability lets expect.

    The probability was itself counted, in so many draws; its uncertainty widens the band.
    """
    from scipy.stats import betabinom  # half a second to import

    good = probability * draws
    low, high = betabinom.interval(BAND, n, good + 0.5, draws - good + 0.5)
    return RequirementCount(kept, n, int(low), int(high))
