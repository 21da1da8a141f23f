"""Turns of the platform since home: of single poses, and of fixed poses for batches of home poses."""

from __future__ import annotations

import numpy as np

from bayescal.numerics.geometry import Array, rotation_vector_of_turn
from bayescal.numerics.scratch import Scratch

SMALLEST_VERSINE = 2.0**-53  # for which angle and sine are not yet zero


def compute_turn(rotation: Array, home: Array) -> Array:
    """Return φ = Log(R R^0ᵀ), shape (..., 3); zero where there is no home pose."""
    turned = rotation @ np.swapaxes(home, -1, -2)
    good = np.isfinite(turned).all(axis=(-1, -2), keepdims=True)
    return rotation_vector_of_turn(turned if good.all() else np.where(good, turned, np.eye(3)))


class BatchTurns:
    """Turns since home, φ = Log(R R^0ᵀ), of fixed poses and batches of home poses; below half a turn.

    Both the trace of R R^0ᵀ, 1 + 2 cos|φ|, and its skew part, of size sin|φ|, are linear in the entries of R^0.
    """

    def __init__(self, rotation: Array) -> None:
        self._half_trace = -0.5 * rotation.reshape(-1, 9)
        skew = np.zeros((3, len(rotation), 3, 3))
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            skew[k, :, m] += 0.5 * rotation[:, n]
            skew[k, :, n] -= 0.5 * rotation[:, m]
        self._skew = skew.reshape(3, -1, 9)
        self._scratch = Scratch()
        self._back: Array | None = None

    def evaluate(self, home_rotation: Array) -> Array:
        """Return φ, shape (3, P, B), for home rotations (3, 3, B); keeps ``stretch``, |φ| / sin|φ|, shape (P, B)."""
        shape, entries = (len(self._half_trace), home_rotation.shape[-1]), home_rotation.reshape(9, -1)
        versine, sine = (self._scratch.take(name, *shape) for name in ("versine", "sine"))
        angle, stretch = (self._scratch.take(name, *shape) for name in ("angle", "stretch"))
        np.matmul(self._half_trace, entries, out=versine)
        versine += 1.5
        np.maximum(versine, SMALLEST_VERSINE, out=versine)
        np.arccos(np.subtract(1.0, versine, out=angle), out=angle)
        np.subtract(2.0, versine, out=sine)
        sine *= versine
        np.divide(angle, np.sqrt(sine, out=sine), out=stretch)
        self._versine, self._angle, self.stretch, self._back = versine, angle, stretch, None
        self._turn = np.matmul(self._skew, entries, out=self._scratch.take("turn", 3, *shape))
        self._turn *= stretch
        return self._turn

    def turn_back(self, rotation_vector: Array) -> Array:
        """Return Jl⁻¹(φ) ω, how φ changes with small turns ω of the platform, shapes (3, P, B)."""
        if self._back is None:
            self._back = self._find_back()
        result = self._scratch.take("turned back", *rotation_vector.shape)
        return np.einsum("kmpb,mpb->kpb", self._back, rotation_vector, out=result)

    def _find_back(self) -> Array:
        """Return Jl⁻¹ = 1 - [φ]/2 + c (φ φᵀ - |φ|²), c = (1 - |φ| / 2 cot(|φ| / 2)) / |φ|², shape (3, 3, P, B)."""
        turn, take = self._turn, self._scratch.take
        back, diagonal = take("back", 3, *turn.shape), take("diagonal", *turn.shape[1:])
        square = np.multiply(self._angle, self._angle, out=take("square", *turn.shape[1:]))
        np.subtract(2.0, self._versine, out=diagonal)
        diagonal *= self.stretch
        diagonal *= 0.5  # |φ| / 2 cot(|φ| / 2)
        factor = np.divide(np.subtract(1.0, diagonal), square, out=square)
        scaled = np.multiply(turn, factor, out=take("scaled", *turn.shape))
        half = np.multiply(turn, 0.5, out=take("half", *turn.shape))
        for k, (m, n) in enumerate(((1, 2), (2, 0), (0, 1))):
            np.multiply(scaled[k], turn[k], out=back[k, k])
            back[k, k] += diagonal
            np.multiply(scaled[m], turn[n], out=back[m, n])
            np.subtract(back[m, n], half[k], out=back[n, m])
            back[m, n] += half[k]
        return back
