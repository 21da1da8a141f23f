"""A cause about rows of readings: their log-density by errors' sizes, and what is solved for, machine and cause."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bayescal.experiments.shared.slip_causes import FACTORS, Cause
from bayescal.experiments.shared.slip_products import scale_columns
from bayescal.experiments.shared.slip_rows import LinearisedTable, WhitenedRows
from bayescal.numerics.geometry import Array

BESIDE = 2  # how many factors on either side of the best one are tried as errors change
NO_FACTOR = -1e9  # log-density of errors with which the rows' covariance has no factor
USUAL_FACTOR = 1.5  # sd of the logarithm of a factor on the noise
CANCELLED = 1e-6  # of a sum of squares that is left by a difference, below which the rows are summed
STEEP = 100.0  # nats by the square of a coordinate beyond what errors are allowed


class SearchOptions(Protocol):
    """What is asked of a search: how many parameters, the largest errors."""

    m: int

    @property
    def most(self) -> Array:
        """Coordinates of errors that are not exceeded, (n,)."""


@dataclass(eq=False)
class CauseLikelihood:
    """Rows of readings about a machine, by errors ζ, where a cause has happened; the cause's last size."""

    search: SearchOptions
    cause: Cause
    seen: LinearisedTable
    size: float = 0.0
    limited: bool = True  # whether errors as large as no machine has them are next to impossible

    def __post_init__(self) -> None:
        self.factors = FACTORS

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep a noise's factor as it is while errors are searched: about their optimum it moves nothing."""
        before, self.factors = self.factors, (self.size,) if self.cause.noise else self.factors
        yield
        self.factors = before

    def weigh(self, zeta: Array) -> float:
        """Return the log-density of one ζ (n,); see `weigh_each`."""
        return float(self.weigh_each(zeta[None])[0])

    def weigh_each(self, zeta: Array) -> Array:
        """Return the log-densities (B,) of ζ (B, n); next to none of errors as large as no machine has them.

        None where the rows' covariance has no factor: errors beside a noise that is lost in their rounding. The size is
        the last one's.
        """
        values = self._weigh(zeta)
        if not self.limited:
            return values
        return values - STEEP * np.sum(np.maximum(zeta - self.search.most, 0.0) ** 2, axis=1)

    def _weigh(self, zeta: Array) -> Array:
        if len(zeta) > 1 and (self.cause.without or (self.cause.noise and len(self.factors) > 1)):
            return np.concatenate([self._weigh(one[None]) for one in zeta])  # factors follow the last one's
        if len(zeta) > (most := self.seen.at_once):
            return np.concatenate([self._weigh(zeta[k : k + most]) for k in range(0, len(zeta), most)])
        try:
            return self._weigh_together(zeta)
        except np.linalg.LinAlgError:
            if len(zeta) == 1:
                return np.array([NO_FACTOR])
            return np.concatenate([self._weigh(one[None]) for one in zeta])

    def _weigh_together(self, zeta: Array) -> Array:
        cause = self.cause
        if cause.noise:
            values, sizes = weigh_noises(self.seen, cause, zeta, self.factors)
            self.size = float(sizes[-1])
            if len(self.factors) > 1:
                place = int(np.searchsorted(FACTORS, self.size))
                self.factors = FACTORS[max(place - BESIDE, 0) : place + BESIDE + 1]
            return values
        if cause.without:
            return np.array([leave_out(self.seen.whiten(one), self._without) for one in zeta])
        products = self.seen.multiply(zeta, columns=cause.columns)
        values = products.weigh()
        if cause.toleranced:
            gains, sizes = products.gain_by_factor(np.array(cause.toleranced), cause.factors)
        elif cause.columns is not None:
            gains, sizes = products.gain(products.known + np.arange(cause.columns.shape[-1]), cause.most)
        else:
            return values
        self.size = float(sizes[-1])
        return values + gains

    def solve(self, zeta: Array) -> tuple[Array, Array]:
        """Return machine (m,) and unknowns (k,) of columns."""
        y, unknown, _ = self._solve(zeta)
        return y, unknown

    def measure_misfit(self, zeta: Array) -> float:
        """Return the rms that is left in noise as stated and such errors, but for a noise that is another one."""
        return self._solve(zeta)[2]

    def _solve(self, zeta: Array) -> tuple[Array, Array, float]:
        cause, m = self.cause, self.search.m
        factor = raise_noise(cause, self.size, self.seen.linear.left.shape[-1]) if cause.noise else 1.0
        white = self.seen.whiten(zeta, factor, cause.columns)
        if cause.without:
            kept = np.setdiff1d(np.arange(len(white.rows)), self._without)
            white = replace(white, rows=white.rows[kept], constant=white.constant[kept])
        if cause.toleranced:
            white = white.scale_tolerances(np.array(cause.toleranced), self.size)
        which = self._find_columns(white)
        known, unknown, misfit = white.solve(which, scale_columns(white.size[which]) * self.size)
        y = known[:m].copy()
        if cause.toleranced:
            y[np.array(cause.toleranced)] *= self.size
        return y, unknown, misfit

    @property
    def _without(self) -> np.ndarray:
        return np.flatnonzero(np.isin(self.seen.rows, self.cause.without))

    def _find_columns(self, white: WhitenedRows) -> np.ndarray:
        """Return where the cause's columns stand among the white ones."""
        width = 0 if self.cause.columns is None else self.cause.columns.shape[-1]
        return white.known + np.arange(width)


def leave_out(white: WhitenedRows, rows: np.ndarray) -> float:
    """Return the log-density where some rows may be anything."""
    kept = np.ones(len(white.rows), dtype=bool)
    kept[rows] = False
    n = white.rows.shape[1]
    size = np.sqrt(np.mean(white.rows[rows, :, -1] ** 2, axis=1))
    broad = white.constant[rows] - n * (np.log(np.maximum(size, 1.0)) + 0.5)
    left = white.total - white.gram(rows)
    # nearly all of the sum: no digits are left
    if (np.diagonal(left) < CANCELLED * np.diagonal(white.total)).any():
        left = white.gram(kept)
    return white.weigh(left, float(white.constant[kept].sum() + broad.sum()))


def weigh_noises(seen: LinearisedTable, cause: Cause, zeta: Array, sizes: tuple[float, ...]) -> tuple[Array, Array]:
    """Return the log-densities of ζ (B, n) by the best of some factors on some channels' noise, and these, (B,).

    The prior of a factor is log-normal.
    """
    more = -0.5 * (np.log(sizes) / USUAL_FACTOR) ** 2 - np.log(len(FACTORS))
    factors = np.stack([raise_noise(cause, size, seen.linear.left.shape[-1]) for size in sizes])
    values = seen.weigh(np.repeat(zeta, len(sizes), axis=0), np.tile(factors, (len(zeta), 1)))
    values = values.reshape(len(zeta), len(sizes)) + more
    return values.max(axis=1), np.array(sizes)[values.argmax(axis=1)]


def raise_noise(cause: Cause, size: float, n_channels: int) -> Array:
    """Return factors on the channels' noise, (K,)."""
    factor = np.ones(n_channels)
    factor[list(cause.noise)] = size
    return factor
