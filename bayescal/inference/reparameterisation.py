"""Coordinates around a mode in which the posterior with free model errors is close to a Gaussian.

Three things keep it from being one. The posterior of a group of coordinates is the wider the larger the group's model
error: a funnel. Around a mode the information of group i is close to P + q B, with P the prior precision, B the
information of the data at the mode and q = (m + τ̂²) / (m + τ²), m the rest of the group's variance. In the basis that
makes both diagonal each axis is stretched by sqrt((1 + λ) / (1 + q λ)): in the stretched coordinates the funnel is a
cylinder. Where several model errors govern the same coordinates, q λ is the sum of their parts. The coordinate ζ of a
model error is skewed, the more the smaller the model error: ζ = c + A η + B sqrt(1 + η²) takes three quantiles of its
draws to those of a standard normal η. Last, where the data see a curved function of one coordinate u that others make
up for, these have to follow it: a shear of unit volume along the ridge, traced to its ends, straightens it. The mass
along it need not be normal either, and is made so by its quantiles.

The telescope's variants with free directions need the stretch: without it the quantiles of six_pus/none are 0.66
standard deviations off, unreported, and the evidence of stiffness/none is 0.65 nats low (`benchmarks/ablation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebvander
from scipy.linalg import eigh
from scipy.special import ndtri

from bayescal.inference.conditional import ConditionalMap, ExactConditional, fit_conditional
from bayescal.inference.loose import LooseShear
from bayescal.inference.mode import Mode
from bayescal.inference.quantile_transform import QuantileTransform
from bayescal.inference.target import LogDensity
from bayescal.numerics.geometry import Array

QUANTILES = (0.05, 0.5, 0.95)
TAIL = float(ndtri(QUANTILES[-1]))
DIFFERENCE = 1e-3  # posterior sds
BATCH = 256  # vectors whose matrices stay in the cache
STEEPEST = 0.95  # |B| / A; the bend stays invertible with a slope that is not lost to rounding


@dataclass(frozen=True, eq=False)
class Bend:
    """The monotone map ζ = c + A η + B sqrt(1 + η²), its three coefficients of shape (k,)."""

    c: Array
    a: Array
    b: Array

    def forward(self, eta: Array) -> Array:
        """Return ζ."""
        return self.c + self.a * eta + self.b * np.sqrt(1.0 + eta * eta)

    def inverse(self, zeta: Array) -> Array:
        """Return η."""
        shifted, square = zeta - self.c, self.a**2 - self.b**2
        return (self.a * shifted - self.b * np.sqrt(shifted**2 + square)) / square

    def log_slope(self, eta: Array) -> Array:
        """Return log dζ/dη summed over the coordinates."""
        return np.log(self.slope(eta)).sum(axis=-1)

    def slope(self, eta: Array) -> Array:
        """Return dζ/dη of each coordinate."""
        return self.a + self.b * eta / np.sqrt(1.0 + eta * eta)


def fit_bend(zeta: Array) -> Bend:
    """Return the bend that maps the 5, 50 and 95 % quantiles of draws (B, k) to those of a standard normal."""
    return bend_from_quantiles(*np.quantile(zeta, QUANTILES, axis=0))


def bend_from_quantiles(low: Array, middle: Array, high: Array) -> Bend:
    """Return the bend that maps given 5, 50 and 95 % quantiles, shapes (k,), to those of a standard normal."""
    a = (high - low) / (2 * TAIL)
    b = 0.5 * (high + low - 2 * middle) / (np.sqrt(1 + TAIL**2) - 1)
    b = np.clip(b, -STEEPEST * a, STEEPEST * a)
    return Bend(middle - b, a, b)


@dataclass(frozen=True, eq=False)
class Ridges:
    """The shear y_k = w_k + Σ_i g_ik(w_i) along traced ridges i, g Chebyshev series that go on straight beyond."""

    bases: np.ndarray  # (r,): the coordinates i
    # (r,): the middle of each ridge, and how far it goes to either side
    centres: Array
    halves: Array
    series: Array  # (r, D, n): coefficients of g by (w_i - centre) / half; zero for coordinates that do not follow

    @cached_property
    def _slopes(self) -> Array:
        return np.asarray(chebder(self.series, axis=1), dtype=np.float64)

    def add_to(self, w: Array, sign: float) -> None:
        """Add the shear to vectors (B, n) in place, or take it away."""
        place = (w[:, self.bases] - self.centres) / self.halves
        inside = np.clip(place, -1.0, 1.0)
        move = _sum_series(inside, self.series)
        beyond = place - inside
        if beyond.any():
            move += _sum_series(inside, self._slopes, beyond)
        w += sign * move


def _sum_series(place: Array, series: Array, factor: Array | None = None) -> Array:
    """Return the sum over r of Chebyshev series (r, D, n) at places (B, r), each times its factor, shape (B, n)."""
    terms = chebvander(place, series.shape[1] - 1)
    if factor is not None:
        terms *= factor[..., None]
    return np.asarray(terms.reshape(len(place), -1) @ series.reshape(-1, series.shape[-1]))


@dataclass(frozen=True, eq=False)
class Block:
    """One group's coordinates and the generalised eigenbasis of its information against its prior.

    ``shares`` (N, k) say what of the k eigenvalues each model error governs.
    """

    index: np.ndarray
    basis: Array
    inverse: Array
    shares: Array

    def stretch(self, q: Array) -> Array:
        """Return by how much each axis is stretched, (B, N) to (B, k)."""
        return np.asarray(np.sqrt((1.0 + self.shares.sum(axis=0)) / (1.0 + q @ self.shares)))


@dataclass(frozen=True, eq=False)
class Reparameterisation:
    """Bijection between straight coordinates x and the sampling coordinates y of a posterior, both (B, n)."""

    posterior: LogDensity
    centre: Array  # (n,): the mode
    blocks: tuple[Block, ...]  # empty without free model errors: then x is y
    # (N,): m and τ̂ of each group
    rest: Array
    tau: Array
    bend: Bend | None = None  # bend of the model errors' coordinates
    # shears along curved ridges that were traced; what they follow is moved by none, so that the order does not matter
    ridges: Ridges | None = None
    skew: QuantileTransform | None = None  # bend of what they follow
    loose: LooseShear | None = None  # how what data hold follows what they leave loose; where there are no such ridges
    # instead of the blocks, where the geometry given the errors is known in closed form
    conditional: ConditionalMap | ExactConditional | None = None

    @property
    def follows_errors(self) -> bool:
        """Whether the geometry's coordinates are stretched by the errors."""
        return bool(self.blocks) or self.conditional is not None

    def _stretches(self, y: Array) -> list[Array]:
        """Return the stretch of every block; needs only the model errors of y."""
        if not self.blocks:
            return []
        q = (self.rest + self.tau**2) / (self.rest + self.posterior.funnel_errors(y) ** 2)
        return [block.stretch(q) for block in self.blocks]

    def _stretch(self, result: Array, stretches: list[Array]) -> Array:
        for block, stretch in zip(self.blocks, stretches, strict=True):
            centre = self.centre[block.index]
            local = (result[:, block.index] - centre) @ block.inverse.T
            result[:, block.index] = centre + (local * stretch) @ block.basis.T
        return result

    def _spread_out(self, y: Array) -> Array:
        """Turn straight geometry into stretched one in place, and return the log of what volumes gain, shape (B,)."""
        if self.conditional is not None:
            m = self.posterior.n_geometry
            factor, shift, gain = self.conditional.open(y[:, m:])
            y[:, :m] = self.conditional.forward(y[:, :m], factor, shift)
            return gain
        stretches = self._stretches(y)
        self._stretch(y, stretches)
        return sum((np.log(stretch).sum(axis=-1) for stretch in stretches), np.zeros(len(y)))

    def _draw_in(self, x: Array) -> None:
        """Turn stretched geometry into straight one in place."""
        if self.conditional is not None:
            m = self.posterior.n_geometry
            factor, shift, _ = self.conditional.open(x[:, m:])
            x[:, :m] = self.conditional.backward(x[:, :m], factor, shift)
            return
        self._stretch(x, [1.0 / stretch for stretch in self._stretches(x)])

    def _unbend(self, x: Array) -> Array:
        y, n = x.copy(), self.posterior.n_geometry
        if self.bend is not None:
            y[:, n:] = self.bend.forward(x[:, n:])
        return y

    def _curve(self, v: Array) -> Array | float:
        """Turn stretched coordinates into sampling coordinates in place, and return the log of what volumes gain."""
        gain = 0.0 if self.skew is None else self.skew.forward(v)
        self._shear(v, 1.0)
        return gain

    def _shear(self, w: Array, sign: float) -> None:
        """Add the shears along all ridges to vectors (B, n) in place, or take them away."""
        for shear in (self.ridges, self.loose):
            if shear is not None:
                shear.add_to(w, sign)

    def _uncurve(self, y: Array) -> None:
        """Turn sampling coordinates into stretched ones in place."""
        self._shear(y, -1.0)
        if self.skew is not None:
            self.skew.inverse(y)

    def y_from_x(self, x: Array) -> Array:
        """Return sampling coordinates; of many vectors in batches, for each has a matrix of its own."""
        y = self._unbend(x)
        for k in range(0, len(y), BATCH):
            part = y[k : k + BATCH]
            self._spread_out(part)
            self._curve(part)
        return y

    def x_from_y(self, y: Array) -> Array:
        """Return straight coordinates."""
        x, n = y.copy(), self.posterior.n_geometry
        self._uncurve(x)
        self._draw_in(x)
        if self.bend is not None:
            x[:, n:] = self.bend.inverse(y[:, n:])
        return x

    def log_density(self, x: Array) -> Array:
        """Return the posterior log-density in x, shape (B,): that in y plus log |dy/dx|."""
        y = self._unbend(x)
        total = self._spread_out(y)
        if self.bend is not None:
            total = total + self.bend.log_slope(x[:, self.posterior.n_geometry :])
        total = total + self._curve(y) + self.posterior.log_density(y)
        return np.where(np.isnan(total), -np.inf, total)  # so far out that coordinates overflow there is no machine

    def fitted_to(self, y: Array) -> Reparameterisation:
        """Return the straightening with its bend fitted to draws (B, n)."""
        return replace(self, bend=fit_bend(y[:, self.posterior.n_geometry :]) if self.follows_errors else None)

    def exactly(self) -> Reparameterisation | None:
        """Return the same with geometry given the errors as in closed form; None where no fit to that is there."""
        exact = None if self.conditional is None else self.conditional.exact
        return None if exact is None else replace(self, conditional=exact)

    def carry(self, y: Array, covariance: Array, *, follow: bool = True) -> Array:
        """Return a covariance (n, n) around y, shape (n,), as it is in straight coordinates, to first order.

        That the geometry follows the model errors, about the centre of a mode that may be another one, may be left out.
        """
        steps = DIFFERENCE * np.diag(np.sqrt(np.diag(covariance)))
        ahead, behind = np.split(self.x_from_y(np.concatenate([y + steps, y - steps])), 2)
        slopes = (ahead - behind).T / (2.0 * np.diag(steps))
        if not follow:
            slopes[: self.posterior.n_geometry, self.posterior.n_geometry :] = 0.0
        return np.asarray(slopes @ covariance @ slopes.T)


def straighten(posterior: LogDensity, mode: Mode) -> Reparameterisation:
    """Return the stretch that belongs to a mode; the identity where there is no model error to stretch for."""
    conditional = fit_conditional(posterior, mode.y)
    if conditional is not None:
        nothing = np.empty(0)
        return Reparameterisation(
            posterior, mode.y, (), nothing, nothing, bend=fit_bend(conditional.errors), conditional=conditional
        )
    funnel = posterior.scale_dependence(mode.y)
    if funnel is None:
        return Reparameterisation(posterior, mode.y, (), np.empty(0), np.empty(0))
    blocks = []
    for group, index in enumerate(posterior.groups()):
        local = np.ix_(index, index)
        eigenvalues, basis = eigh(funnel.information[local], funnel.prior[local])
        if funnel.parts is None:
            shares = np.zeros((len(funnel.tau), len(index)))
            shares[group] = eigenvalues
        else:
            shares = np.array([np.diag(basis.T @ part[local] @ basis) for part in funnel.parts])
        blocks.append(Block(index, basis, np.linalg.inv(basis), np.maximum(shares, 0.0)))
    return Reparameterisation(posterior, mode.y, tuple(blocks), funnel.rest, funnel.tau)
