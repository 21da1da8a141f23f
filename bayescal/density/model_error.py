"""Structured model error: what a wrong model does to a leg is the same function of the pose every time.

Beside τ, which is drawn anew at every pose, each leg i has a random function of the actuators' travel z,

    g_i(z) ~ GP(0, s_i² k(z, z')),    g_i(0) = 0,

zero at the home pose, since an error that does not change with the pose is an offset of the geometry. One actuator at
the end of its range makes a leg err by s_i, one standard deviation, in the unit of the actuators.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.density.priors import Prior
from bayescal.numerics.geometry import Array

INDEPENDENT: Final = "independent"
SCALE = "sigma_g"  # name of s among the free parameters
LENGTH = "L_g"  # of the kernel's length, in units of the actuators' range
type KernelName = Literal["independent", "linear", "quadratic", "smooth"]
LENGTHY = ("quadratic", "smooth")  # kernels with a length

OFF = -20.0  # where the switch of a scale stands when there is no structured error; when there is one, about zero
BORDER = 0.5 * OFF


def is_model_error(name: str) -> bool:
    """Whether a free parameter's name is that of a model error: τ, or the scale or length of a structured one."""
    return name.split("[")[0] in ("tau", SCALE, LENGTH)


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
    """With probability one half there is no structured error, s = 0; else s is log-normal.

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
