"""What a calibration of a reduced set of parameters claims, and how far it really errs.

It takes all other parameters for nominal, claims what the measurements would leave were they so, and errs by more: the
others are off by their tolerances, and what is fitted takes up what it can of that. To first order, in units of the
tolerances, with K = (1 + Λ_ff)⁻¹ for the set f and all others o it claims K and errs by K + K Λ_fo Λ_of K.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from bayescal.identifiability.information import Information
from bayescal.limits import NINETY
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class ReducedSet:
    """A reduced set of m parameters, to first order.

    Attributes
    ----------
    free : ndarray, shape (m,)
        Positions among the audited parameters.
    claimed, error : ndarray, shape (m,)
        Standard deviation that its calibration claims, and root mean square of its true error, in tolerances.
    """

    free: np.ndarray
    claimed: Array
    error: Array

    @property
    def coverage(self) -> Array:
        """Probability that a 90 % interval holds the truth, shape (m,)."""
        return np.asarray(erf(NINETY * self.claimed / self.error / np.sqrt(2.0)))

    @property
    def rms_z(self) -> float:
        """Root mean square of the true errors in claimed standard deviations: one where the claims are true."""
        return float(np.sqrt(np.mean((self.error / self.claimed) ** 2)))


def judge_reduced(information: Information, free: tuple[int, ...]) -> ReducedSet | None:
    """Return what a calibration of some parameters claims and errs by; None where there are none, or it is all."""
    chosen = np.array(free, dtype=int)
    if not 0 < len(chosen) < information.root.shape[1]:
        return None
    part = information.matrix[np.ix_(chosen, chosen)] + np.eye(len(chosen))
    errors = information.errors_of_reduced(free)
    return ReducedSet(chosen, np.sqrt(np.diagonal(np.linalg.inv(part))), np.sqrt(np.diagonal(errors)[chosen]))
