"""Products of white rows, which is all that log-densities of rows and gains of causes ask of them.

White rows X = [known, columns, errors] count by XᵀX alone: with A the columns of what is known, standard normal under
the prior, C those of a cause and e the errors, -2 log-density = const - tᵀ (τ⁻² + S)⁻¹ t + log |1 + τ² S| where S and t
are CᵀC and Cᵀe, what is known integrated. Products of rows in several sizes of their errors stand in one stack.

Where errors common to all rows are amplitudes times known columns (`ScaledErrors`), products by other amplitudes
are the same ones times these; as many columns as rows are known covariances, which are added up instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.density.linear_gaussian import factorise, half_log_det, solve_factor
from bayescal.numerics.geometry import Array

SIZES = np.geomspace(1.0, 1e5, 11)
"""τ in units of a column's rms of one stated noise."""


@dataclass(frozen=True, eq=False)
class RowProducts:
    """Products XᵀX (B, m + N + c + 1, m + N + c + 1) of white rows in B sizes of errors."""

    gram: Array
    constant: Array  # (B,): of the log-densities
    known: int  # m + N
    size: Array  # (m + N + c,) or (B, m + N + c): rms of the columns in noise

    @cached_property
    def _factor(self) -> Array:
        return factorise(np.eye(self.known) + self.gram[:, : self.known, : self.known])

    def _reduce(self, columns: np.ndarray) -> Array:
        """Return products (B, k + 1, k + 1) of columns (k,) and errors, what is known integrated."""
        which = np.append(columns, self.gram.shape[-1] - 1)
        white = solve_factor(self._factor, self.gram[:, : self.known, which])
        return np.asarray(self.gram[:, which[:, None], which] - np.swapaxes(white, -1, -2) @ white)

    def weigh(self) -> Array:
        """Return the log-densities without any cause, (B,)."""
        square = self._reduce(np.zeros(0, dtype=int))[:, 0, 0]
        return np.asarray(self.constant - 0.5 * square - half_log_det(self._factor))

    def gain(self, columns: np.ndarray, most: float = np.inf) -> tuple[Array, Array]:
        """Return by how much columns raise the log-density, (B,), and their τ, at most so large, (B,)."""
        reduced, scale = self._reduce(columns), scale_columns(self.size[..., columns])
        scale = np.broadcast_to(scale, (len(reduced), len(columns)))
        return choose_size(reduced[:, :-1, :-1], reduced[:, :-1, -1], scale, most)

    def gain_by_factor(self, parameters: np.ndarray, factors: Sequence[float]) -> tuple[Array, Array]:
        """Return by how much another factor on the tolerances of parameters raises the log-density, and the best one.

        A tolerance f times as large is its parameter's column once more, of the variance f² - 1, which may be negative.
        """
        reduced = self._reduce(parameters)
        return choose_factor(reduced[:, :-1, :-1], reduced[:, :-1, -1], factors)


def scale_columns(size: Array) -> Array:
    """Return factors by which columns of some rms have one of one."""
    return np.where(size > 0.0, 1.0 / np.maximum(size, 1e-300), 0.0)


def choose_size(square: Array, side: Array, scale: Array, most: float) -> tuple[Array, Array]:
    """Return what columns gain by the best of the sizes τ, at most so large, and that.

    Parameters
    ----------
    square, side : ndarray, shapes (..., k, k) and (..., k)
        Products of the columns, and with the errors, what is known integrated.
    scale : ndarray, shape (..., k)
        By which columns have an rms of one.
    most : float

    Returns
    -------
    ndarray, ndarray, shapes (...)
    """
    allowed = SIZES * scale.max(axis=-1, initial=0.0)[..., None] <= most
    allowed[..., 0] = True
    gains = np.where(allowed, gain_columns(square, side, scale, SIZES**2), -np.inf)
    return gains.max(axis=-1) - np.log(allowed.sum(axis=-1)), SIZES[gains.argmax(axis=-1)]


def choose_factor(square: Array, side: Array, factors: Sequence[float]) -> tuple[Array, Array]:
    """Return what the best of some factors on tolerances gains, and that; products as of `choose_size`.

    What rows tell of a column that is known already is no more than there was to know.
    """
    gains = gain_columns(square, side, np.ones_like(side), np.array(factors) ** 2 - 1.0, most=1.0)
    return gains.max(axis=-1) - np.log(len(factors)), np.array(factors)[gains.argmax(axis=-1)]


def gain_columns(square: Array, side: Array, scale: Array, variance: Array, most: float = np.inf) -> Array:
    """Return by how much columns of some scale and each of some variances (T,) raise the log-density, (..., T).

    What rows tell of a column is at most so much.
    """
    values, axes = np.linalg.eigh(scale[..., :, None] * square * scale[..., None, :])
    along = (np.swapaxes(axes, -1, -2) @ (scale * side)[..., None])[..., 0]
    values, along = np.clip(values, 0.0, most)[..., None, :], along[..., None, :]
    some = variance[:, None]
    return np.asarray(0.5 * np.sum(some * along**2 / (1.0 + some * values) - np.log1p(some * values), axis=-1))


@dataclass(frozen=True, eq=False)
class ScaledErrors:
    """Errors common to all rows, each an amplitude times known columns."""

    shape: tuple[int, ...]  # (Q, R): of rows
    acts: tuple[Array, ...]  # C of (Q, R, N_c): what amplitudes of one do to rows, zero of rows that do not stand
    amplitudes: Callable[[Array], Array]  # from ζ (B, n) to (B, C)

    @cached_property
    def widths(self) -> np.ndarray:
        """How many columns each has, (C,)."""
        return np.array([one.shape[-1] for one in self.acts], dtype=int)

    @cached_property
    def parts(self) -> Array:
        """Covariances of all rows by an amplitude of one, (C, Q R, Q R)."""
        flat = [one.reshape(-1, one.shape[-1]) for one in self.acts]
        return np.stack([one @ one.T for one in flat])

    def size_columns(self, zeta: Array) -> Array:
        """Return the amplitude of each column, (B, N)."""
        return np.repeat(self.amplitudes(zeta), self.widths, axis=-1) if self.acts else np.zeros((len(zeta), 0))

    def list_columns(self, zeta: Array) -> Array:
        """Return the columns of one ζ (n,), (Q, R, N)."""
        sizes = self.amplitudes(zeta[None])[0] if self.acts else ()
        scaled = (size * act for size, act in zip(sizes, self.acts, strict=True))
        return np.concatenate([np.zeros((*self.shape, 0)), *scaled], axis=-1)

    def pick(self, some: slice) -> ScaledErrors:
        """Return them of some of the rows."""
        acts = tuple(act[some] for act in self.acts)
        return ScaledErrors((len(range(self.shape[0])[some]), *self.shape[1:]), acts, self.amplitudes)
