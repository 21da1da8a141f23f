"""Priors of single parameters, and of functions: what is known of a machine before it is measured.

What a channel errs by may be a random function of a travel z, the same every time,

    g(z) ~ GP(0, s² k(z, z')),    g(0) = 0,

zero at home, since an error that does not change is an offset of the geometry. At the end of its range a channel errs
by s, one standard deviation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import erf, erfcinv, erfinv, log_ndtr, ndtr, ndtri, ndtri_exp

from bayescal.numerics.geometry import Array

HALF_LOG_TWO_PI = 0.5 * float(np.log(2 * np.pi))
CURVATURE_STEP = 1e-4  # of a coordinate, for curvatures by differences


class Prior(ABC):
    """A proper density of one free parameter."""

    @abstractmethod
    def log_density(self, value: Array) -> Array:
        """Return the normalised log-density, -inf outside the support."""

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n independent draws, shape (n,)."""
        return self.value(rng.standard_normal(n))

    @abstractmethod
    def standardise(self, value: Array) -> Array:
        """Return the values whose standard normal has the probability that the prior has below these."""

    # --- the coordinate that is sampled: standard normal about its place ------------------------------------------

    off: ClassVar[float | None] = None
    """A second place of the coordinate, as probable as zero, about which the value is zero: a switch."""

    @abstractmethod
    def value(self, zeta: Array) -> Array:
        """Return values of coordinates."""

    def slope(self, zeta: Array) -> Array:
        """Return the derivative of the value by its coordinate."""
        return np.exp(-0.5 * zeta**2 - HALF_LOG_TWO_PI - self.log_density(self.value(zeta)))

    def curvature(self, zeta: Array) -> Array:
        """Return the second derivative, by differences where a prior does not know it."""
        return np.asarray(
            (self.slope(zeta + CURVATURE_STEP) - self.slope(zeta - CURVATURE_STEP)) / (2.0 * CURVATURE_STEP)
        )

    # --- moments -----------------------------------------------------------------------------------------------------

    @property
    def bounds(self) -> tuple[float, float]:
        """Ends of the range in which all values are alike, infinite where there is no such range."""
        return -np.inf, np.inf

    @property
    @abstractmethod
    def mean(self) -> float:
        """Mean of the prior."""

    @property
    @abstractmethod
    def sd(self) -> float:
        """Standard deviation of the prior."""


@dataclass(frozen=True)
class NormalPrior(Prior):
    """A manufacturing tolerance: normal about ``centre`` with standard deviation ``scale``."""

    centre: float
    scale: float

    def log_density(self, value: Array) -> Array:
        """Return the normal log-density."""
        return -0.5 * ((value - self.centre) / self.scale) ** 2 - np.log(self.scale) - HALF_LOG_TWO_PI

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n normal draws."""
        return rng.normal(self.centre, self.scale, n)

    def standardise(self, value: Array) -> Array:
        """Return the distance from the centre in standard deviations."""
        return (value - self.centre) / self.scale

    def value(self, zeta: Array) -> Array:
        """Return values by their standard deviations off the centre."""
        return self.centre + self.scale * zeta

    @property
    def mean(self) -> float:
        """The centre."""
        return self.centre

    @property
    def sd(self) -> float:
        """The scale."""
        return self.scale


@dataclass(frozen=True)
class UniformPrior(Prior):
    """All values between two bounds alike."""

    lower: float
    upper: float

    def log_density(self, value: Array) -> Array:
        """Return -log(upper - lower) inside, -inf outside."""
        inside = (value >= self.lower) & (value <= self.upper)
        return np.where(inside, -np.log(self.upper - self.lower), -np.inf)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n draws between the bounds."""
        return rng.uniform(self.lower, self.upper, n)

    def standardise(self, value: Array) -> Array:
        """Return the normal quantile of the share of the width below each value."""
        return ndtri((value - self.lower) / (self.upper - self.lower))

    def value(self, zeta: Array) -> Array:
        """Return values by their share of the width."""
        return self.lower + (self.upper - self.lower) * ndtr(zeta)

    @property
    def bounds(self) -> tuple[float, float]:
        """The two bounds."""
        return self.lower, self.upper

    @property
    def mean(self) -> float:
        """The middle."""
        return 0.5 * (self.lower + self.upper)

    @property
    def sd(self) -> float:
        """Width over the square root of twelve."""
        return (self.upper - self.lower) / np.sqrt(12.0)


@dataclass(frozen=True)
class HalfNormalPrior(Prior):
    """A scale parameter that may well be zero: the right half of a normal density about zero."""

    scale: float

    def log_density(self, value: Array) -> Array:
        """Return the half-normal log-density."""
        inside = 0.5 * np.log(2 / np.pi) - np.log(self.scale) - 0.5 * (value / self.scale) ** 2
        return np.where(value >= 0, inside, -np.inf)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n absolute values of normal draws."""
        return np.abs(rng.normal(0.0, self.scale, n))

    def standardise(self, value: Array) -> Array:
        """Return the normal quantile of the prior probability of a smaller value."""
        return ndtri(erf(value / self.scale / np.sqrt(2.0)))

    def value(self, zeta: Array) -> Array:
        """Return values of coordinates, without loss where Φ(ζ) is close to one."""
        tail = ndtr(-np.abs(zeta))
        return self.scale * np.sqrt(2.0) * np.where(zeta > 0, erfcinv(tail), erfinv(tail))

    def slope(self, zeta: Array) -> Array:
        """Return the derivative of the value."""
        return 0.5 * self.scale * np.exp(0.5 * ((self.value(zeta) / self.scale) ** 2 - zeta**2))

    def curvature(self, zeta: Array) -> Array:
        """Return the second derivative."""
        slope = self.slope(zeta)
        return slope * (self.value(zeta) * slope / self.scale**2 - zeta)

    @property
    def mean(self) -> float:
        """The scale times sqrt(2 / π)."""
        return self.scale * float(np.sqrt(2 / np.pi))

    @property
    def sd(self) -> float:
        """The scale times sqrt(1 - 2 / π)."""
        return self.scale * float(np.sqrt(1.0 - 2.0 / np.pi))


LARGEST = 1e3  # scales, up to which a half-Cauchy density goes: its moments are finite then


@dataclass(frozen=True)
class HalfCauchyPrior(Prior):
    """A scale of which hardly anything is known: half-Cauchy, cut at `LARGEST` times its scale.

    Half of it lies below the scale, and its tail gives way to data that want more (Gelman 2006).
    """

    scale: float

    def log_density(self, value: Array) -> Array:
        """Return the log-density, -inf outside of the support."""
        inside = (value >= 0.0) & (value <= LARGEST * self.scale)
        density = -np.log(np.arctan(LARGEST) * self.scale) - np.log1p((value / self.scale) ** 2)
        return np.where(inside, density, -np.inf)

    def standardise(self, value: Array) -> Array:
        """Return the normal quantile of the prior probability of a smaller value."""
        return np.asarray(ndtri(np.arctan(value / self.scale) / np.arctan(LARGEST)))

    def value(self, zeta: Array) -> Array:
        """Return values of coordinates."""
        return np.asarray(self.scale * np.tan(np.arctan(LARGEST) * ndtr(zeta)))

    @property
    def mean(self) -> float:
        """Of the cut density."""
        return 0.5 * self.scale * float(np.log1p(LARGEST**2) / np.arctan(LARGEST))

    @property
    def sd(self) -> float:
        """Of the cut density."""
        return float(np.sqrt(self.scale**2 * (LARGEST / np.arctan(LARGEST) - 1.0) - self.mean**2))


@dataclass(frozen=True)
class SharePrior(Prior):
    """The share of outliers, Beta(1, b) with b = 1 / m - 1: the fewer the likelier."""

    expected: float

    @property
    def exponent(self) -> float:
        """Return b."""
        return 1.0 / self.expected - 1.0

    def log_density(self, value: Array) -> Array:
        """Return the log-density, -inf outside of zero to one."""
        inside = (value >= 0.0) & (value < 1.0)
        left = np.log1p(-np.where(inside, value, 0.0))
        return np.where(inside, np.log(self.exponent) + (self.exponent - 1.0) * left, -np.inf)

    def standardise(self, value: Array) -> Array:
        """Return ζ."""
        return np.asarray(-ndtri_exp(self.exponent * np.log1p(-value)))

    @property
    def mean(self) -> float:
        """The share that is expected."""
        return self.expected

    @property
    def sd(self) -> float:
        """Of Beta(1, b)."""
        b = self.exponent
        return float(np.sqrt(b / ((1.0 + b) ** 2 * (2.0 + b))))

    def value(self, zeta: Array) -> Array:
        """Return shares of coordinates."""
        return np.asarray(-np.expm1(log_ndtr(-zeta) / self.exponent))

    def slope(self, zeta: Array) -> Array:
        """Return the derivative of the share."""
        hazard = np.exp(-0.5 * zeta**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-zeta))
        return np.asarray((1.0 - self.value(zeta)) / self.exponent * hazard)


@dataclass(frozen=True)
class LogNormalPrior(Prior):
    """A factor or a length: its logarithm is normal about that of ``median``, with standard deviation ``spread``."""

    median: float
    spread: float

    def log_density(self, value: Array) -> Array:
        """Return the log-normal log-density."""
        return np.asarray(-0.5 * self.standardise(value) ** 2 - np.log(value * self.spread) - HALF_LOG_TWO_PI)

    def standardise(self, value: Array) -> Array:
        """Return coordinates."""
        return np.asarray(np.log(value / self.median) / self.spread)

    def value(self, zeta: Array) -> Array:
        """Return values of coordinates."""
        return np.asarray(self.median * np.exp(self.spread * zeta))

    def slope(self, zeta: Array) -> Array:
        """Return the derivative of the value."""
        return self.spread * self.value(zeta)

    def curvature(self, zeta: Array) -> Array:
        """Return the second derivative."""
        return self.spread * self.slope(zeta)

    @property
    def mean(self) -> float:
        """Of the log-normal."""
        return self.median * float(np.exp(0.5 * self.spread**2))

    @property
    def sd(self) -> float:
        """Standard deviation."""
        return self.mean * float(np.sqrt(np.expm1(self.spread**2)))


SCALE = "sigma_g"  # name of s among the free parameters
LENGTH = "L_g"  # of the kernel's length, in units of the actuators' range
FUNCTIONS = ("sigma_linear", "sigma_positioning", "sigma_smooth", "sigma_drift")  # of several sorts at once
LENGTHY = ("quadratic", "smooth")  # kernels with a length

OFF = -20.0  # where the switch of a scale stands when there is no error; when there is one, about zero
BORDER = 0.5 * OFF


def is_model_error(name: str) -> bool:
    """Whether a free parameter's name is that of a model error: τ, or the scale or length of a function."""
    return name.split("[")[0] in ("tau", SCALE, LENGTH, *FUNCTIONS)


class Kernel(ABC):
    """Covariance k of a function of the travel, in units of s², zero at home.

    Lengths of shape (B, 1, 1) are taken all at once: then k is of shape (B, P, Q).
    """

    name: str

    @abstractmethod
    def __call__(self, first: Array, second: Array) -> Array:
        """Return k of travels (P, N) and (Q, N) in units of the actuators' range, shape (P, Q)."""

    @abstractmethod
    def slope(self, first: Array, second: Array) -> Array:
        """Return the derivative of k by the logarithm of its length, shape (P, Q)."""


@dataclass(frozen=True)
class LinearKernel(Kernel):
    """Every actuator adds to the error in proportion to its travel: k = z · z'."""

    name = "linear"

    def __call__(self, first: Array, second: Array) -> Array:
        """Return k."""
        return first @ second.T

    def slope(self, first: Array, second: Array) -> Array:
        """Return zeros: there is no length."""
        return np.zeros((len(first), len(second)))


@dataclass(frozen=True)
class QuadraticKernel(Kernel):
    """Linear and quadratic functions, k = z · z' + (z · z')² / (2 L²): the second is of relative size 1 / L."""

    length: float | Array
    name = "quadratic"

    def __call__(self, first: Array, second: Array) -> Array:
        """Return k."""
        linear = first @ second.T
        return np.asarray(linear + 0.5 * (linear / self.length) ** 2)

    def slope(self, first: Array, second: Array) -> Array:
        """Return dk / d log L."""
        return np.asarray(-((first @ second.T / self.length) ** 2))


@dataclass(frozen=True)
class SmoothKernel(Kernel):
    """Smooth functions, a squared exponential of length L held to zero at home; linear as L grows.

    k = L² (e(z - z') - e(z) - e(z') + 1) with e(d) = exp(-|d|² / (2 L²)).
    """

    length: float | Array
    name = "smooth"

    def __call__(self, first: Array, second: Array) -> Array:
        """Return k."""
        own, other, between = _square_distances(first, second)
        # 1 - e, which keeps its digits where L is large
        a, b, c = (-np.expm1(-0.5 * d / self.length**2) for d in (own, other, between))
        return np.asarray(self.length**2 * (a + b - c))

    def slope(self, first: Array, second: Array) -> Array:
        """Return dk / d log L."""
        own, other, between = _square_distances(first, second)
        a, b, c = (d * np.exp(-0.5 * d / self.length**2) for d in (own, other, between))
        return np.asarray(2.0 * self(first, second) - a - b + c)


def _square_distances(first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Return the squared distances of travels (P, N) and (Q, N) from home, (P, 1) and (1, Q), and from each other."""
    own, other = (np.sum(z**2, axis=-1) for z in (first, second))
    return own[:, None], other[None], np.sum((first[:, None] - second[None]) ** 2, axis=-1)


def build_kernel(name: str, length: float | Array) -> Kernel:
    """Return the kernel of a name, its length, or lengths (B, 1, 1), in units of the actuators' range."""
    known: Mapping[str, Kernel] = {
        one.name: one for one in (LinearKernel(), QuadraticKernel(length), SmoothKernel(length))
    }
    return known[name]


@dataclass(frozen=True)
class KernelScalePrior(Prior):
    """With probability one half there is no error, s = 0; else s is log-normal.

    The coordinate is a switch and a magnitude in one: about `OFF` s is zero, about zero it is scale · exp(spread · c).
    """

    scale: float
    spread: float
    off = OFF

    def log_density(self, value: Array) -> Array:
        """Return the log-density of a scale that is not zero, probability one half included; that half where it is."""
        there = value > 0.0
        size = np.where(there, value, self.scale)
        z = (np.log(size) - np.log(self.scale)) / self.spread
        density = -0.5 * z**2 - np.log(size * self.spread) - 0.5 * np.log(2.0 * np.pi)
        return np.where(there, density, 0.0) - np.log(2.0)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n draws, half of them zero."""
        size = self.scale * np.exp(self.spread * rng.standard_normal(n))
        return np.where(rng.random(n) < 0.5, 0.0, size)

    def standardise(self, value: Array) -> Array:
        """Return the normal quantile of the prior probability of at most these values."""
        with np.errstate(divide="ignore"):
            below = ndtr(np.log(np.maximum(value, 0.0) / self.scale) / self.spread)
        return np.asarray(ndtri(0.5 + 0.5 * below))

    def value(self, zeta: Array) -> Array:
        """Return scales of coordinates."""
        return np.where(zeta > BORDER, self.scale * np.exp(self.spread * np.maximum(zeta, BORDER)), 0.0)

    def slope(self, zeta: Array) -> Array:
        """Return the derivative of the scale."""
        return self.spread * self.value(zeta)

    def curvature(self, zeta: Array) -> Array:
        """Return the second derivative."""
        return self.spread * self.slope(zeta)

    @property
    def mean(self) -> float:
        """Half the mean of the log-normal."""
        return 0.5 * self.scale * float(np.exp(0.5 * self.spread**2))

    @property
    def sd(self) -> float:
        """Standard deviation, the zeros counted."""
        return float(np.sqrt(0.5 * self.scale**2 * np.exp(2.0 * self.spread**2) - self.mean**2))
