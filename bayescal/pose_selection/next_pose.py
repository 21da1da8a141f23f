"""The pose to measure next: the one that makes the predicted poses surest, or that best tells variants apart.

What is known of m parameters of any machine is their covariance C. A candidate has the rows R, white and with its pose
eliminated, and takes C⁻¹ to C⁻¹ + RᵀR, whatever is measured there; all candidates are judged at once, by updates of
rank k.

Variants k and l with probabilities p predict what is measured at a candidate as N(μ, Σ) each. What measuring it is
expected to tell of which of them is right is at most Σ p_k p_l (KL(k, l) + KL(l, k)) nats over the pairs (Box and Hill
1967).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from bayescal.errors import InputError
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class NextPoseStep:
    """A pose to measure, and what will be known then."""

    candidate: int
    covariance: Array  # (m, m): of the parameters after it, in their units
    mean_square: float  # tr(W C), the weighted error that is left


def look_ahead(weight: Array, covariance: Array, rows: Array, allowed: np.ndarray) -> Iterator[NextPoseStep]:
    """Yield the candidate that lowers tr(W C) most, then the best one after it, and so on; none twice.

    W (m, m) is what an error of the parameters costs, C (m, m) what is known so far; rows (c, k, m) are of the
    candidates, in units of the noise, their poses eliminated, and a mask (c,) says which may be measured.
    """
    left = allowed.copy()
    while left.any():
        gains = compute_gains(rows, covariance, weight)
        chosen = int(np.where(left, gains, -np.inf).argmax())
        left[chosen] = False
        covariance = learn(covariance, rows[chosen])
        yield NextPoseStep(chosen, covariance, float(np.trace(weight @ covariance)))


def compute_gains(rows: Array, covariance: Array, weight: Array) -> Array:
    """Return by what part tr(W C) falls with the readings of each pose: tr(W C Rᵀ (1 + R C Rᵀ)⁻¹ R C) / tr(W C).

    R (c, k, m) are white rows, poses eliminated.
    """
    seen = rows @ covariance
    inner = np.eye(rows.shape[1]) + seen @ np.swapaxes(rows, -1, -2)
    fall = np.einsum("cki,ij,clj->ckl", seen, weight, seen, optimize=True)
    gain = np.trace(np.linalg.solve(inner, fall), axis1=-2, axis2=-1) / np.trace(weight @ covariance)
    return np.asarray(gain)


def learn(covariance: Array, rows: Array) -> Array:
    """Return C - C Rᵀ (1 + R C Rᵀ)⁻¹ R C, what remains unknown after the readings of one pose, R (k, m)."""
    seen = rows @ covariance
    result = covariance - seen.T @ np.linalg.solve(np.eye(len(rows)) + seen @ rows.T, seen)
    return np.asarray(0.5 * (result + result.T))


def learn_all(covariance: Array, rows: Array, times: float) -> Array:
    """Return what remains unknown (m, m) after every pose was measured so many times, R (c, k, m)."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    seen = (rows @ root).reshape(-1, root.shape[1])
    result = root @ np.linalg.solve(np.eye(len(root)) + times * seen.T @ seen, root.T)
    return np.asarray(0.5 * (result + result.T))


def add_poses(
    rows: Array, weight: Array, count: int, places: np.ndarray, covariance: Array | None = None
) -> tuple[list[int], list[Array]]:
    """Return candidates, among those at some places, in the order in which they lower tr(W C) most, and each C then.

    They start from a covariance C (m, m), that of the priors where none is given.
    """
    covariance = np.eye(rows.shape[-1]) if covariance is None else covariance
    steps = list(islice(look_ahead(weight, covariance, rows, np.isin(np.arange(len(rows)), places)), count))
    return [one.candidate for one in steps], [one.covariance for one in steps]


def learn_in_turn(rows: Array, places: np.ndarray, covariance: Array | None = None) -> list[Array]:
    """Return what remains unknown after each of the candidates at some places, C (m, m), as in `add_poses`."""
    covariance, left = np.eye(rows.shape[-1]) if covariance is None else covariance, []
    for place in places:
        covariance = learn(covariance, rows[place])
        left.append(covariance)
    return left


def find_unmeasured(candidates: Array, measured: Array, apart: float | Array) -> np.ndarray:
    """Return which candidates (C, N) differ from all measured poses (P, N) by more than ``apart`` in a coordinate.

    The same pose measured twice would average the instrument's noise, not what the model leaves out there. InputError
    where there is none.
    """
    distance = (np.abs(candidates[:, None] - measured) / apart).max(axis=-1).min(axis=1, initial=np.inf)
    new: np.ndarray = distance > 1.0
    if not new.any():
        raise InputError(f"candidates: found all {len(candidates)} measured, expected a new one")
    return new


def compare_variants(probabilities: Array, differences: Array, covariances: Array) -> Array:
    """Return what each candidate is expected to tell of which variant is right, at most, in nats, shape (C,).

    Variants have probabilities (K,), predict differences (K, C, d) against the same one of them, and measurements of
    covariances (K, C, d, d).
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
            divergence = 0.5 * (spread + moved) - differences.shape[-1]
            total += probabilities[k] * probabilities[m] * divergence
    return total
