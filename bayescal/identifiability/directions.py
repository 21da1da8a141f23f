"""Directions of the parameter space and parameters by what is learnt of them, the unlearnt ones made readable.

The generalised eigenvectors of information against prior precision are eigenvectors of Λ in units of the tolerances.
They mix what is alike, so the ridges, those that contract too little, get another basis of the same space: one
parameter moves by its tolerance, the others left to be fixed stay, and what is free follows as far as the measurements
want it to. Followers that hardly matter are then left out one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import qr

from bayescal.identifiability.information import Information, complement_of, nats_from_contraction
from bayescal.limits import IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION
from bayescal.numerics.geometry import Array

type Kind = Literal["structural", "practical", "informed"]
type Verdict = Literal["identifiable", "weak", "not"]

SMALLEST_FOLLOWER = 1e-3  # of the largest loading, or change of readings; what follows by less is left out at once
ALLOWED_RISE = 0.01  # of the contraction, for a follower to be left out
SEEN_SHARE = 0.02  # of a direction's square, for a loading of an informed direction to be named
ROUNDS = 40
SHARPNESS = 0.5  # of the norm that is made least: between counting (0) and summing (1)
FLOOR = 1e-6  # where the weights end; they start without any, so that the first guess does not decide
ZERO = 1e-6  # of the largest loading
INDEPENDENT = 1e-6


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction of the parameter space."""

    # ``structural``: no measurement of this kind sees it; ``practical``: the planned ones hardly do; ``informed``
    kind: Kind
    vector: Array  # (n,): a move by one prior standard deviation along it, in units of the tolerances
    contraction: float
    nats: float
    pivot: int | None = None  # the parameter that a ridge is named after


def find_directions(
    information: Information, null_space: Array, fixed: tuple[int, ...], gauges: tuple[int, ...] = ()
) -> list[Direction]:
    """Return n directions that span the parameter space: structural, practical, informed ones.

    Parameters
    ----------
    information : Information
        Of n parameters.
    null_space : ndarray, shape (n, k)
        Structural null space, orthonormal, in units of the tolerances.
    fixed : tuple of int
        Parameters that one would rather fix, the first of them most: ridges are named after them where possible.
    gauges : tuple of int
        Parameters of frames, which structural directions are named after first.
    """
    matrix = information.matrix
    values, vectors = information.spectrum(complement_of(null_space))
    weak = vectors[:, values / (1.0 + values) < IDENTIFIABLE_CONTRACTION]
    preferred = np.full(len(matrix), 1e-3)
    preferred[list(fixed)] = 1.0
    structural, pivots = find_sparse_basis(null_space, fixed)
    pivots = _rename(structural, pivots, gauges)
    preferred[pivots] = 0.0
    found = [Direction("structural", _unit(x), 0.0, 0.0, p) for x, p in zip(structural.T, pivots, strict=True)]
    found += _name_ridges(information, weak, null_space, preferred, pivots)
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        if value / (1.0 + value) >= IDENTIFIABLE_CONTRACTION:
            main = np.where(vector**2 >= SEEN_SHARE * np.max(vector**2), vector, 0.0)
            main *= np.sign(main[np.argmax(np.abs(main))])
            found.append(Direction("informed", _unit(main), value / (1.0 + value), 0.5 * float(np.log1p(value))))
    return found


def _rename(basis: Array, pivots: np.ndarray, gauges: tuple[int, ...]) -> np.ndarray:
    """Return the parameters that vectors (n, k) are named after, frames' where they move most and tell them apart."""
    renamed = pivots.copy()
    for k in np.argsort(np.count_nonzero(basis[list(gauges)], axis=0), kind="stable"):  # those with no choice first
        vector = basis[:, k]
        moving = [g for g in gauges if vector[g] and g not in renamed]
        if moving:
            trial = renamed.copy()
            trial[k] = max(moving, key=lambda g: abs(vector[g]))
            if np.linalg.matrix_rank(basis[trial]) == len(trial):
                renamed = trial
    return renamed


def _name_ridges(
    information: Information, weak: Array, null_space: Array, preferred: Array, gauges: np.ndarray
) -> list[Direction]:
    """Return one ridge per weak eigenvector, named after a parameter each."""
    k = weak.shape[1]
    if not k:
        return []
    both = np.concatenate([null_space, weak], axis=1)
    # what is left of the weak space once the gauges' own parameters stay put
    rest = both - both @ np.linalg.pinv(both[gauges]) @ both[gauges] if len(gauges) else weak
    space = np.linalg.svd(rest, full_matrices=False)[0][:, :k]
    pivots = qr(space.T * preferred, mode="r", pivoting=True)[1][:k]
    held = np.concatenate([gauges, pivots])
    found = []
    for pivot in pivots:
        vector = _follow(information.matrix, pivot, held)
        contraction = information.contraction_along(vector[:, None])[0]
        nats = float(nats_from_contraction(contraction))
        found.append(Direction("practical", _unit(vector), float(contraction), nats, pivot))
    return sorted(found, key=lambda direction: direction.contraction)


def _follow(matrix: Array, pivot: int, held: np.ndarray) -> Array:
    """Return the move in which one parameter goes by its tolerance and those not held follow, as few as will do."""
    others = np.setdiff1d(np.arange(len(matrix)), held)
    vector = _solve(matrix, pivot, others)
    # a wide tolerance, as of a frame that is found, makes a move small that readings see well
    move, seen = np.abs(vector), np.abs(vector) * np.sqrt(np.diagonal(matrix))
    follows = (move > SMALLEST_FOLLOWER * move.max()) | (seen > SMALLEST_FOLLOWER * seen.max())
    others = others[follows[others]]
    vector = _solve(matrix, pivot, others)
    allowed = _contract(matrix, vector) + ALLOWED_RISE
    while len(others):
        order = np.argsort(np.abs(vector[others]))
        for k in order:
            fewer = np.delete(others, k)
            trial = _solve(matrix, pivot, fewer)
            if _contract(matrix, trial) <= allowed:
                others, vector = fewer, trial
                break
        else:
            break
    return vector


def _solve(matrix: Array, pivot: int, others: np.ndarray) -> Array:
    vector = np.zeros(len(matrix))
    vector[pivot] = 1.0
    if len(others):
        inner = matrix[np.ix_(others, others)] + np.eye(len(others))
        vector[others] = -np.linalg.solve(inner, matrix[others, pivot])
    return vector


def _contract(matrix: Array, vector: Array) -> float:
    """Return the contraction of a direction were it alone unknown; at least that of the posterior."""
    quotient = float(vector @ matrix @ vector) / float(vector @ vector)
    return quotient / (1.0 + quotient)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


# --- sparse bases -----------------------------------------------------------------------------------------------------


def find_sparse_basis(space: Array, preferred: tuple[int, ...]) -> tuple[Array, np.ndarray]:
    """Return a sparse basis (n, k) of an orthonormal space (n, k), and the parameter each vector is named after, (k,).

    For every parameter the sparsest vector of the space in which it moves by one is sought, by reweighted least
    squares; from all these the shortest independent ones are taken. A gauge freedom then comes out as what it is, a
    frame and the joints that move with it, and not as a mixture of all of them.

    Each vector is one at its own parameter, which differ from each other: preferred ones where possible, the best
    first.
    """
    n, k = space.shape
    if not k:
        return space, np.empty(0, dtype=int)
    reachable = np.flatnonzero(np.linalg.norm(space, axis=1) > INDEPENDENT)
    candidates = _sharpen(space, reachable)
    rank = np.full(n, len(preferred))
    rank[list(preferred)] = np.arange(len(preferred))
    order = sorted(range(len(reachable)), key=lambda c: (np.count_nonzero(candidates[c]), rank[reachable[c]]))
    basis, pivots, left = np.empty((n, 0)), [], space
    for c in order:
        pivot, vector = int(reachable[c]), candidates[c]
        outside = left @ (left.T @ vector)
        if pivot in pivots or np.linalg.norm(outside) <= INDEPENDENT * np.linalg.norm(vector):
            continue
        basis = np.concatenate([basis, vector[:, None]], axis=1)
        unit = outside / np.linalg.norm(outside)
        rest, values, _ = np.linalg.svd(left - np.outer(unit, unit @ left), full_matrices=False)
        left = rest[:, : np.sum(values > 0.5)]
        pivots.append(pivot)
        if len(pivots) == k:
            break
    if len(pivots) < k:  # pivots ran out: complete with what is left, not sparse but right
        rest = np.setdiff1d(reachable, pivots)
        for vector in left.T:
            pivot = int(rest[np.argmax(np.abs(vector[rest]))])
            basis = np.concatenate([basis, (vector / vector[pivot])[:, None]], axis=1)
            pivots.append(pivot)
            rest = rest[rest != pivot]
    return basis, np.array(pivots)


def _sharpen(space: Array, places: np.ndarray) -> Array:
    """Return for each place the vector of the space that is one there and has few other entries, (places, n)."""
    vectors = space[places] @ space.T
    vectors /= vectors[np.arange(len(places)), places][:, None]
    for floor in np.geomspace(1.0, FLOOR, ROUNDS):
        scale = np.abs(vectors).max(axis=1, keepdims=True)
        weight = ((vectors / scale) ** 2 + floor**2) ** (0.5 * SHARPNESS - 1.0)
        normal = np.einsum("ik,ci,im->ckm", space, weight, space, optimize=True)
        normal += 1e-14 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(space.shape[1])
        coefficients = np.linalg.solve(normal, space[places][..., None])[..., 0]
        vectors = coefficients @ space.T
        vectors /= vectors[np.arange(len(places)), places][:, None]
    small = np.abs(vectors) < ZERO * np.abs(vectors).max(axis=1, keepdims=True)
    return np.asarray(np.where(small, 0.0, vectors))


# --- parameters -------------------------------------------------------------------------------------------------------


def judge_parameters(information: Information, null_space: Array) -> tuple[Verdict, ...]:
    """Return the verdict on each parameter.

    ``identifiable``: its tolerance is at least halved. ``not``: most of the remaining uncertainty lies along directions
    of which nothing is learnt. ``weak``: it lies along directions of which too little is learnt.
    """
    values, vectors = information.spectrum(complement_of(null_space))
    remaining = vectors**2 / (1.0 + values)
    dead = (null_space**2).sum(axis=1) + remaining[:, values / (1.0 + values) < UNIDENTIFIABLE_CONTRACTION].sum(axis=1)
    verdicts: list[Verdict] = []
    for contraction, lost in zip(information.contraction, dead, strict=True):
        if contraction >= IDENTIFIABLE_CONTRACTION:
            verdicts.append("identifiable")
        else:
            verdicts.append("not" if lost > 0.5 * (1.0 - contraction) else "weak")
    return tuple(verdicts)
