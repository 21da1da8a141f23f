"""Functions that a complex step can go through: analytic where NumPy's own are not, or take no complex numbers.

A derivative by complex step is Im f(x + ih) / h, exact to rounding, since nothing is subtracted. ``numpy.abs``,
``numpy.linalg.norm`` and ``numpy.arctan2`` are no functions of a complex variable; these are, and equal them on the
reals.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from bayescal.numerics.geometry import compute_left_inverse_jacobian, rotation_vector_from_matrix

SERIES_TERMS = 16  # π³²/33! is less than rounding


def sqrt(value: np.ndarray) -> np.ndarray:
    """Return the root; of a complex number to first order in its imaginary part, several times as fast as NumPy's.

    NaN where the real part is negative: there a step goes no way that is one of real numbers.
    """
    if not np.iscomplexobj(value):
        return np.sqrt(value)
    found = np.empty_like(value)
    found.real = np.sqrt(np.real(value))
    found.imag = 0.5 * np.imag(value) / found.real
    return found


def norm(vector: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the length sqrt(Σ x²) of vectors along an axis."""
    return np.sqrt((np.asarray(vector) ** 2).sum(axis=axis))


def absolute(value: np.ndarray) -> np.ndarray:
    """Return x or -x, whichever has no negative real part."""
    return np.where(np.real(value) < 0.0, -np.asarray(value), value)


def atan2(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the angle of (x, y), in (-π, π]: that of the real parts, to first order with what imaginary ones add."""
    real = np.arctan2(np.real(y), np.real(x))
    if not (np.iscomplexobj(y) or np.iscomplexobj(x)):
        return real
    square = np.real(x) ** 2 + np.real(y) ** 2
    return real + 1j * (np.real(x) * np.imag(y) - np.real(y) * np.imag(x)) / square


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the rotations of rotation vectors (..., 3), at most half a turn, shape (..., 3, 3).

    R = 1 + A K + B K² with A = sin t / t and B = (1 - cos t) / t², both power series of t², which need no other branch
    at t = 0 and keep what a complex step adds.
    """
    square = (vector**2).sum(axis=-1)
    first, second = (_sum_series(square, start) for start in (1, 2))
    x, y, z = (vector[..., k] for k in range(3))
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)
    return np.eye(3) + first[..., None, None] * skew + second[..., None, None] * (skew @ skew)


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Return the rotation vectors of rotations (..., 3, 3): of their real parts, to first order with imaginary ones.

    NaN where there is no rotation: far beyond half a turn `rotation_matrix` makes none.
    """
    there = np.isfinite(matrix).all(axis=(-1, -2))
    real = np.where(there[..., None, None], np.real(matrix), np.eye(3))
    there &= np.abs(np.linalg.det(real) - 1.0) < 0.5
    real = np.where(there[..., None, None], real, np.eye(3))
    vector = np.where(there[..., None], rotation_vector_from_matrix(real), np.nan)
    if not np.iscomplexobj(matrix):
        return vector
    skew = np.imag(matrix) @ np.swapaxes(real, -1, -2)
    turn = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    return vector + 1j * (compute_left_inverse_jacobian(vector) @ turn[..., None])[..., 0]


def _sum_series(square: np.ndarray, start: int) -> np.ndarray:
    """Return Σ (-t²)^k / (2k + start)!, by Horner's rule."""
    found = np.zeros_like(square)
    for k in reversed(range(SERIES_TERMS)):
        found = 1.0 / factorial(2 * k + start) - square * found
    return found
