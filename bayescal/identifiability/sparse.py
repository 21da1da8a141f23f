"""A basis of a space with as few parameters in each vector as can be found.

For every parameter the sparsest vector of the space in which it moves by one is sought, by reweighted least squares;
from all these the shortest independent ones are taken. A gauge freedom then comes out as what it is, a frame and the
joints that move with it, and not as a mixture of all of them.
"""

from __future__ import annotations

import numpy as np

from bayescal.numerics.geometry import Array

ROUNDS = 40
SHARPNESS = 0.5  # of the norm that is made least: between counting (0) and summing (1)
FLOOR = 1e-6  # where the weights end; they start without any, so that the first guess does not decide
ZERO = 1e-6  # of the largest loading
INDEPENDENT = 1e-6


def find_sparse_basis(space: Array, preferred: tuple[int, ...]) -> tuple[Array, np.ndarray]:
    """Return a sparse basis of a space and the parameter each vector is named after.

    Parameters
    ----------
    space : ndarray, shape (n, k)
        Orthonormal.
    preferred : tuple of int
        Parameters to name vectors after where possible, the best first.

    Returns
    -------
    basis : ndarray, shape (n, k)
        Each vector is one at its own parameter, which differ from each other.
    pivots : ndarray of int, shape (k,)
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
        basis, left = np.concatenate([basis, vector[:, None]], axis=1), _remove(left, outside)
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


def _remove(space: Array, direction: Array) -> Array:
    """Return an orthonormal basis of a space without one of its directions."""
    unit = direction / np.linalg.norm(direction)
    rest = space - np.outer(unit, unit @ space)
    left, values, _ = np.linalg.svd(rest, full_matrices=False)
    return np.asarray(left[:, : np.sum(values > 0.5)])
