"""The pose to measure next: the one that makes the predicted poses surest, or that best tells variants apart.

What is known of m parameters is their covariance in units of the tolerances. A candidate with the rows B, in units of
noise and tolerances, takes its inverse A to A + BᵀB, whatever is measured there; all candidates are judged at once by
updates of rank k (see `bayescal.pose_selection.criteria.updates`).

Variants k and l with probabilities p predict the measured pose of a candidate as N(μ, Σ) each. What measuring it is
expected to tell of which of them is right is at most Σ p_k p_l (KL(k, l) + KL(l, k)) nats over the pairs (Box and Hill
1967).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.pose_selection.criteria.trace import BayesianTrace


@dataclass(frozen=True, eq=False)
class Step:
    """A pose to measure, and what will be known then.

    Attributes
    ----------
    candidate : int
    covariance : ndarray, shape (m, m)
        Of the parameters after it, in units of the tolerances.
    value : float
        Of the criterion, after it.
    """

    candidate: int
    covariance: Array
    value: float


def look_ahead(criterion: BayesianTrace, covariance: Array, blocks: Array, allowed: np.ndarray) -> Iterator[Step]:
    """Yield the best candidate, then the best one after it, and so on; none twice.

    Parameters
    ----------
    criterion : BayesianTrace
    covariance : ndarray, shape (m, m)
        What is known so far, in units of the tolerances.
    blocks : ndarray, shape (C, k, m)
        Rows of the candidates; see `BayesianTrace.rows`.
    allowed : ndarray of bool, shape (C,)
        Which may be measured.
    """
    precision = np.linalg.inv(covariance)
    scorer = criterion.scorer(blocks, np.linalg.cholesky(precision).T, 0)
    scorer.start([])
    left = allowed.copy()
    while left.any():
        chosen, value = scorer.best_added(left)
        left[chosen] = False
        scorer.add(chosen)
        precision = precision + blocks[chosen].T @ blocks[chosen]
        yield Step(chosen, np.linalg.inv(precision), value)


def find_unmeasured(candidates: Array, measured: Array, apart: float) -> np.ndarray:
    """Return which candidates (C, N) differ from all measured poses (P, N) by more than ``apart`` in an actuator, mm.

    The same pose measured twice would average the instrument's noise, not what the model leaves out there.

    Raises
    ------
    InputError
        Where there is none.
    """
    distance = np.abs(candidates[:, None] - measured).max(axis=-1).min(axis=1, initial=np.inf)
    new: np.ndarray = distance > apart
    if not new.any():
        raise InputError(f"candidates: found all {len(candidates)} measured already, expected one that is not")
    return new


def compare_variants(probabilities: Array, differences: Array, covariances: Array) -> Array:
    """Return what each candidate is expected to tell of which variant is right, at most, in nats, shape (C,).

    Parameters
    ----------
    probabilities : ndarray, shape (K,)
        Of the variants.
    differences : ndarray, shape (K, C, 6)
        Poses that each variant predicts against those of the first one, mm and rad.
    covariances : ndarray, shape (K, C, 6, 6)
        Of the measured poses.
    """
    precisions = np.linalg.inv(covariances)
    total = np.zeros(differences.shape[1])
    for k in range(len(probabilities)):
        for m in range(k):
            apart = differences[k] - differences[m]
            both = precisions[k] + precisions[m]
            spread = np.einsum("cij,cji->c", precisions[k], covariances[m])
            spread += np.einsum("cij,cji->c", precisions[m], covariances[k])
            moved = np.einsum("ci,cij,cj->c", apart, both, apart)
            divergence = 0.5 * (spread + moved) - DEGREES_OF_FREEDOM
            total += probabilities[k] * probabilities[m] * divergence
    return total
