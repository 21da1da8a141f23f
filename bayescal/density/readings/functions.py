"""Errors of sensors that are functions of what they read: a scale that is off, an encoder that sits askew.

Beside its noise, sensor k of a self-calibration errs by a random function of its own reading,

    s_pk = h_k(v_p, d) + g_k(z_pk) + ε_pk,    g_k(z) ~ GP(0, s_k² κ(z, z')),    g_k(0) = 0,

z its travel from home in units of its range, κ as in `bayescal.density.model_error`. What is read is known, where the
pose and the true reading are not. That z is taken from the reading with its error and noise in place of the true one
changes g by g' (g + ε), of relative size s over the range: some 1e-4.

Functions of one variable are told by their values at a few nodes: between Chebyshev's they are interpolated by
polynomials, exactly for linear and quadratic ones, to `EXACT` for smooth ones. What is random is then a handful of
coefficients of each sensor, which all poses share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from bayescal.density.model_error import LENGTH, SCALE, Kernel, KernelScalePrior, LengthPrior, build_kernel
from bayescal.density.priors import Prior
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

EXACT = 1e-12  # of the kernel's largest value, what interpolation may leave out, and of its eigenvalues
MOST_NODES = 48
ENDS = 3.0  # sds of log L on either side of its median; shorter and longer ones are taken for the outermost
FEWEST = {"linear": 2, "quadratic": 3, "smooth": 4}
PROBES = 301


@dataclass(frozen=True, eq=False)
class SensorFunctions:
    """Prior of the errors of F out of K sensors, which share G scales.

    Attributes
    ----------
    kernel : str
        ``linear``, ``quadratic`` or ``smooth``.
    length : float
        In units of the sensors' ranges; the median where it is free.
    lengths : LengthPrior or None
        Of a length that is free.
    places : ndarray of int, shape (F,)
        Which of the sensors err.
    home, travel : ndarray, shape (F,)
        What they read at home, and the range that their travel is counted in, mm and rad.
    reach : float
        Largest travel of all readings, in units of the range.
    group : ndarray of int, shape (F,)
        Which scale each has.
    scale : ndarray, shape (G,)
        Median of s where there is an error: what a sensor at the end of its range errs by, one sd, mm or rad.
    spread : float
        Standard deviation of log s.
    labels, scale_units : tuple of str, length G
        Of the scales: a sensor or a kind of them, and ``mm`` or ``rad``.
    """

    kernel: str
    length: float
    lengths: LengthPrior | None
    places: np.ndarray
    home: Array
    travel: Array
    reach: float
    group: np.ndarray
    scale: Array
    spread: float
    labels: tuple[str, ...]
    scale_units: tuple[str, ...]

    def __post_init__(self) -> None:
        """Find the nodes: InputError for functions that need too many."""
        _ = self.nodes

    # --- what is free -----------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scales, ``sigma_g(phi)``, and of a length that is free."""
        scales = tuple(f"{SCALE}({label})" for label in self.labels)
        return scales if self.lengths is None else (*scales, LENGTH)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        return self.scale_units if self.lengths is None else (*self.scale_units, "1")

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of all."""
        scales = tuple(KernelScalePrior(float(scale), self.spread) for scale in self.scale)
        return scales if self.lengths is None else (*scales, self.lengths)

    # --- coefficients -----------------------------------------------------------------------------------------------

    @cached_property
    def nodes(self) -> Array:
        """Travels at which a function's values tell it all, shape (M,)."""
        shortest = self.length if self.lengths is None else self.lengths.median * np.exp(-ENDS * self.lengths.spread)
        kernel = build_kernel(self.kernel, float(shortest))
        probes = np.linspace(-self.reach, self.reach, PROBES)[:, None]
        exact = kernel(probes, probes)
        for count in range(FEWEST[self.kernel], MOST_NODES + 1):
            nodes = self.reach * chebpts1(count)
            between = self._interpolate(probes[:, 0], nodes)
            found = between @ kernel(nodes[:, None], nodes[:, None]) @ between.T
            if np.abs(found - exact).max() <= EXACT * np.abs(exact).max():
                return np.asarray(nodes)
        raise InputError(
            f"model_error.kernel_length: found {self.kernel} errors of a length down to {shortest:.2g} ranges, "
            f"expected longer ones, which {MOST_NODES} values tell"
        )

    def _interpolate(self, travel: Array, nodes: Array) -> Array:
        """Return the weights (..., M) of values at nodes in those at travels (...)."""
        last = len(nodes) - 1
        weights = np.linalg.inv(chebvander(nodes / self.reach, last))
        return np.asarray(chebvander(travel / self.reach, last) @ weights)

    def columns(self, readings: Array) -> Array:
        """Return what coefficients do to each sensor's reading, (..., F, R), for readings (..., K), mm and rad.

        With a length that is known coefficients are independent and of variance s²; else they are values at the nodes.
        """
        found = self._interpolate((readings[..., self.places] - self.home) / self.travel, self.nodes)
        return found if self.lengths is not None else np.asarray(found @ self.root(np.array([self.length]))[0])

    def evaluate(self, coefficients: Array, readings: Array) -> Array:
        """Return the functions at readings (Q, K), (T, Q, K), mm and rad, by coefficients (T, F R) of the columns."""
        columns = self.columns(readings)
        own = coefficients.reshape(len(coefficients), *columns.shape[1:])
        found = np.zeros((len(coefficients), *readings.shape))
        found[..., self.places] = np.einsum("qfr,tfr->tqf", columns, own, optimize=True)
        return found

    def _kernel_at(self, lengths: Array) -> Kernel:
        """Return the kernel of lengths (B,), those beyond the ends taken for the outermost."""
        if self.lengths is not None:
            half = ENDS * self.lengths.spread
            lengths = np.clip(lengths, *(self.lengths.median * np.exp([-half, half])))
        return build_kernel(self.kernel, lengths[:, None, None])

    def root(self, lengths: Array) -> Array:
        """Return a square root of the covariance of values at the nodes in units of s², (B, M, R), of lengths (B,)."""
        nodes = self.nodes[:, None]
        covariance = self._kernel_at(lengths)(nodes, nodes).reshape(-1, len(nodes), len(nodes))
        values, vectors = np.linalg.eigh(covariance)
        kept = (values > EXACT * values[:, -1:]).any(axis=0)
        return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])[..., kept])

    def root_slope(self, length: float) -> Array:
        """Return the derivative of that covariance by log L, (M, M), at a length."""
        nodes = self.nodes[:, None]
        assert self.lengths is not None
        inside = abs(float(self.lengths.standardise(np.array(length)))) < ENDS
        return np.asarray(self._kernel_at(np.array([length])).slope(nodes, nodes)[0] * inside)
