"""How the end of a bent flexure moves: the curves of RR-8096 figure 9.

A beam of length l_b bent to a circular arc moves its end by Δy across and by Δx along its axis (eqs. 11 and 12). An
ideal pivot at half its length and the circle of eq. (13) are the two ways to stand in for it.
"""

from __future__ import annotations

import numpy as np

from bayescal.numerics.geometry import Array

SERIES_BELOW = 0.05  # rad; the closed form of eq. (12) cancels, the series is exact to 1e-13 of its value there
CIRCLE = 0.75  # radius of eq. (13) as a share of l_b
PIVOT = 0.5


def compute_beam_shift(angle: Array, length: float) -> tuple[Array, Array]:
    """Return Δx and Δy of eq. (12), mm, for bending angles δ in radians and a length l_b in mm, shapes of the angles.

    Below 0.05 rad Δx is summed as a series in δ², l_b (δ²/6 - δ⁴/40 + δ⁶/112 - 5 δ⁸/1152 + …).
    """
    square = angle * angle
    series = square * (1 / 6 - square * (1 / 40 - square * (1 / 112 - square * (5 / 1152 - square * 7 / 2816))))
    safe = np.maximum(np.abs(angle), SERIES_BELOW)
    closed = (safe * np.sqrt(1 + safe * safe) + np.arcsinh(safe)) / (2 * safe) - 1
    return length * np.where(np.abs(angle) < SERIES_BELOW, series, closed), 0.5 * length * angle


def compute_circle_shift(across: Array, radius: float) -> Array:
    """Return Δx of a point that moved by Δy on a circle about (radius, 0), mm."""
    square = across * across
    return square / (radius + np.sqrt(radius * radius - square))
