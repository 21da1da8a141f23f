"""Single rows that are wrong: the density of a row's residual, of unit covariance, by its square r².

A normal density has exp(-r²/2). A robust one lets each row have a precision w of its own that all its readings share:
what went wrong at a row spoils it as a whole. With w Gamma(ν/2, ν/2) distributed and m readings more than the pose has
coordinates, residuals are t distributed,

    t_ν(r) = Γ((ν + m)/2) / Γ(ν/2) (νπ)^(-m/2) (1 + r²/ν)^(-(ν + m)/2),

and (ν + m) / (ν + r²), the mean of w given r, says how much a row counts. That the mean of w is one makes the stated
noise the t's scale, which is less than what normal residuals scatter by: for ν = 4 an unknown noise of clean rows comes
out 0.83 to 0.90 times as large as it is, m being 1 to 6. So rows have the stated noise times factors 1/√w whose
*logarithm* has mean zero: w is Gamma(ν/2, c²ν/2), residuals are c t_ν distributed, with

    c² = exp(ψ(ν/2)) / (ν/2),

0.874² for ν = 4; the scale that fits normal residuals is then within 5 % of them. It is the same for rows of any number
of readings: some of a row's are distributed as those of a row that has no more.

A contaminated normal density (Tukey 1960; its weights are those of Box and Tiao 1968) has a share ε of such rows, but
for κ instead of c, among others that are as stated,

    p(r) = (1 - ε) N(r) + ε κ^-m t_ν(r / κ),    ε ~ Beta(1, 1/μ - 1),

μ the share that is expected, ν = 1 and κ = 3: so heavy a tail holds outliers of ten and of a thousand deviations alike.
The probability that a row is one is averaged over the posterior. Outliers have nothing to do with a model error, which
all rows have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.special import digamma, gammaln

from bayescal.density.priors import Prior, SharePrior
from bayescal.numerics.geometry import Array

STEPS = np.arange(-16.0, 8.1, 0.5)  # of log w, in its standard deviations about its mode
ITERATIONS = 20
FREEDOM, WIDER = 1.0, 3.0  # ν and κ of a contaminated density
SHARE = "epsilon"


class Outliers:
    """The density of rows of which none is expected to be wrong: normal.

    ``spare`` is m of each row, shape (P,), and ``square`` r², shape (..., P).
    """

    expected: ClassVar[bool] = False
    names: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of what is unknown of it."""
        return ()

    def at(self, zeta: Array) -> Outliers:
        """Return the density at coordinates (B, n) of what is unknown of it."""
        del zeta
        return self

    def pick(self, some: np.ndarray | slice) -> Outliers:
        """Return that of some of the B."""
        del some
        return self

    def weigh(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals, (..., P)."""
        return np.asarray(-0.5 * square - 0.5 * spare * np.log(2.0 * np.pi))

    def penalise(self, square: Array, spare: np.ndarray) -> Array:
        """Return minus twice the log-density but for constants."""
        del spare
        return square

    def trust(self, square: Array, spare: np.ndarray) -> Array:
        """Return how much each row counts, the mean of its precision w."""
        del spare
        return np.ones_like(square)

    def soften(self, square: Array, spare: np.ndarray) -> Array:
        """Return c in the curvature w 1 - c r rᵀ of minus the log-density."""
        del spare
        return np.zeros_like(square)

    def suspect(self, square: Array, spare: np.ndarray) -> Array:
        """Return how probable it is that a row is an outlier; zero where no share of them is."""
        del spare
        return np.zeros_like(square)

    def slopes(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density's derivative by what is unknown of it, (..., P, n)."""
        del spare
        return np.zeros((*square.shape, 0))

    def draw_widening(self, square: Array, spare: np.ndarray, rng: np.random.Generator) -> Array:
        """Return draws of 1/w given the residuals."""
        del spare, rng
        return np.ones_like(square)

    def draw_wide(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Return draws of 1/w of rows that nobody has seen, their number of machines first."""
        del rng
        return np.ones(shape)

    def weigh_spread(self, size: Array, variance: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals that have a known covariance beside the noise.

        Parameters
        ----------
        size : ndarray, shape (..., P, K)
            Residuals along the axes of that covariance.
        variance : ndarray, shape (..., P, K)
            It, in units of the noise's; zero along axes that a pose takes up.
        spare : ndarray, shape (P,)
        """
        inside = np.log1p(variance) + size**2 / (1.0 + variance)
        return np.asarray(-0.5 * inside.sum(axis=-1) - 0.5 * spare * np.log(2.0 * np.pi))


NORMAL = Outliers()


@dataclass(frozen=True)
class StudentT(Outliers):
    """Each row may be wrong: t distributed with ν degrees of freedom, c wide in units of the stated noise."""

    freedom: float
    width: float = 1.0
    expected = True

    @classmethod
    def centred(cls, freedom: float) -> StudentT:
        """Return that of rows which scatter about the stated noise: by factors whose logarithm has mean zero."""
        half = 0.5 * freedom
        return cls(freedom, float(np.exp(0.5 * (digamma(half) - np.log(half)))))

    @property
    def _rate(self) -> float:
        """c²ν: w is Gamma(ν/2, c²ν/2) distributed."""
        return self.freedom * self.width**2

    def weigh(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals, (..., P)."""
        m, nu = spare, self.freedom
        constant = gammaln(0.5 * (nu + m)) - gammaln(0.5 * nu) - 0.5 * m * np.log(self._rate * np.pi)
        return np.asarray(constant - 0.5 * (nu + m) * np.log1p(square / self._rate))

    def penalise(self, square: Array, spare: np.ndarray) -> Array:
        """Return minus twice the log-density but for constants."""
        return np.asarray((self.freedom + spare) * np.log1p(square / self._rate))

    def trust(self, square: Array, spare: np.ndarray) -> Array:
        """Return how much each row counts."""
        return np.asarray((self.freedom + spare) / (self._rate + square))

    def soften(self, square: Array, spare: np.ndarray) -> Array:
        """Return c in the curvature w 1 - c r rᵀ of minus the log-density."""
        return np.asarray(2.0 * self.trust(square, spare) ** 2 / (self.freedom + spare))

    def draw_widening(self, square: Array, spare: np.ndarray, rng: np.random.Generator) -> Array:
        """Return draws of 1/w given the residuals."""
        shape = np.broadcast_to(0.5 * (self.freedom + spare), square.shape)
        return np.asarray(0.5 * (self._rate + square) / rng.standard_gamma(shape))

    def draw_wide(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Return draws of 1/w of rows that nobody has seen."""
        return np.asarray(self._rate / rng.chisquare(self.freedom, shape))

    def weigh_spread(self, size: Array, variance: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals that have a known covariance beside the noise."""
        nu, m, rate = self.freedom, spare, self._rate
        best = self.trust((size**2 / (1.0 + variance)).sum(axis=-1), m)
        for _ in range(ITERATIONS):  # to the mode of log w given the row
            part = 1.0 / (1.0 + best[..., None] * variance)
            best = (nu + m - (1.0 - part).sum(axis=-1)) / (rate + ((size * part) ** 2).sum(axis=-1))
        width, parts = np.sqrt(2.0 / (nu + m)), []
        for step in STEPS:  # the trapezium rule in log w
            w = best * np.exp(width * step)
            inside = np.log1p(w[..., None] * variance) + w[..., None] * size**2 / (1.0 + w[..., None] * variance)
            parts.append(0.5 * ((nu + m) * np.log(w) - rate * w - inside.sum(axis=-1)))
        constant = 0.5 * nu * np.log(0.5 * rate) - gammaln(0.5 * nu) - 0.5 * m * np.log(2.0 * np.pi)
        return np.asarray(np.logaddexp.reduce(parts, axis=0) + np.log(width * (STEPS[1] - STEPS[0])) + constant)


TAIL = StudentT(FREEDOM)


def _weigh_wrong(square: Array, spare: np.ndarray) -> Array:
    """Return the log-density of rows that are outliers of a contaminated density."""
    return TAIL.weigh(square / WIDER**2, spare) - spare * np.log(WIDER)


@dataclass(frozen=True, eq=False)
class Contaminated(Outliers):
    """A share ε of the rows is wrong, which is inferred."""

    prior: SharePrior  # of ε, whose coordinate is standard normal under the prior
    # (B, 1): ε and its derivative by the coordinate; as the prior expects where nothing else is said
    share: Array | float = 0.0
    speed: Array | float = 0.0  # (B, 1)
    expected = True
    names = (SHARE,)
    units = ("1",)

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Of the share."""
        return (self.prior,)

    def at(self, zeta: Array) -> Outliers:
        """Return the density at coordinates (B, 1) of the share."""
        return replace(self, share=self.prior.value(zeta), speed=self.prior.slope(zeta))

    def pick(self, some: np.ndarray | slice) -> Outliers:
        """Return that of some of the B."""
        assert isinstance(self.share, np.ndarray)
        assert isinstance(self.speed, np.ndarray)
        return replace(self, share=self.share[some], speed=self.speed[some])

    def _join(self, clean: Array, wrong: Array) -> Array:
        """Return the log-density of rows that are clean or wrong with these log-densities."""
        return np.logaddexp(np.log1p(-self.share) + clean, np.log(self.share) + wrong)

    def weigh(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals, (B, P)."""
        return self._join(super().weigh(square, spare), _weigh_wrong(square, spare))

    def penalise(self, square: Array, spare: np.ndarray) -> Array:
        """Return minus twice the log-density but for constants."""
        return 2.0 * (self.weigh(np.zeros_like(square), spare) - self.weigh(square, spare))

    def suspect(self, square: Array, spare: np.ndarray) -> Array:
        """Return how probable it is that a row is an outlier, (B, P)."""
        more = _weigh_wrong(square, spare) - super().weigh(square, spare)
        odds = np.log(self.share) - np.log1p(-self.share) + more
        return np.asarray(1.0 / (1.0 + np.exp(-odds)))

    def trust(self, square: Array, spare: np.ndarray) -> Array:
        """Return how much each row counts."""
        outlier = self.suspect(square, spare)
        return np.asarray(1.0 - outlier + outlier * TAIL.trust(square / WIDER**2, spare) / WIDER**2)

    def soften(self, square: Array, spare: np.ndarray) -> Array:
        """Return c in the curvature w 1 - c r rᵀ of minus the log-density."""
        outlier, tail = self.suspect(square, spare), TAIL.trust(square / WIDER**2, spare) / WIDER**2
        softer = outlier * TAIL.soften(square / WIDER**2, spare) / WIDER**4
        return np.asarray(outlier * (1.0 - outlier) * (1.0 - tail) ** 2 + softer)

    def slopes(self, square: Array, spare: np.ndarray) -> Array:
        """Return the log-density's derivative by the share's coordinate, (B, P, 1)."""
        outlier = self.suspect(square, spare)
        by_share = outlier / self.share - (1.0 - outlier) / (1.0 - self.share)
        return np.asarray((by_share * self.speed)[..., None])

    def draw_widening(self, square: Array, spare: np.ndarray, rng: np.random.Generator) -> Array:
        """Return draws of 1/w given the residuals."""
        wrong = rng.random(square.shape) < self.suspect(square, spare)
        return np.where(wrong, WIDER**2 * TAIL.draw_widening(square / WIDER**2, spare, rng), 1.0)

    def draw_wide(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Return draws of 1/w of rows that nobody has seen."""
        share = np.reshape(self.share, (-1, *[1] * (len(shape) - 1)))
        return np.where(rng.random(shape) < share, WIDER**2 * TAIL.draw_wide(shape, rng), 1.0)

    def weigh_spread(self, size: Array, variance: Array, spare: np.ndarray) -> Array:
        """Return the log-density of residuals that have a known covariance beside the noise."""
        wrong = TAIL.weigh_spread(size / WIDER, variance / WIDER**2, spare) - spare * np.log(WIDER)
        return self._join(super().weigh_spread(size, variance, spare), wrong)
