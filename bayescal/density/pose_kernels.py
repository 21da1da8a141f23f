"""Sorts of functions of the pose: their covariances, and the few columns that they are made of where poses are many.

Functions of the travel z = (ρ - ρ_home) / range and of the place in measuring order t in [0, 1), k at two poses:

    linear       z_p · z_q                       every actuator moves every leg: a coupling
    positioning  z_ip z_iq + w², length ¼ range  each leg by its own actuator: a lead error, a scale, a wave
    smooth       k(z_p, z_q), length one range   anything smooth: joints, gravity, waves
    drift        min(t_p, t_q) + 0.02            a session's drift: temperature

Of the own position the wave is a squared exponential of a quarter of the range, L² exp(-(z_ip - z_iq)² / (2 L²)): an
eccentric encoder or a screw errs by one or two periods over the range, which functions of length one do not follow. It
has a value at home, as eccentric encoders have. Smooth functions of all actuators have none.

With many poses k is replaced by φ_p · φ_q, φ of few entries. Those of linear functions leave nothing out. Smooth ones
are made of the principal components over the poses of what values at some poses, chosen by a pivoted Cholesky factor,
tell of all (Nyström's approximation: Williams and Seeger 2001). Waves are made of their Fourier series. A drift is a
random walk, made of the leading functions of its Karhunen-Loève expansion, √2 sin(ω t) / ω with ω = π / 2, 3 π / 2 ...,
and of its value at the first pose. The variance that is left out is that of errors which are independent from pose to
pose.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from bayescal.density.priors import SmoothKernel
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

FEWEST_POSES: Final = 3
TAU: Final = "tau"
OF_SORT: Final = "sigma_"
"""Before the name of a sort: that of its unknown size."""
DRIFT: Final = "drift"
OWN: Final = "positioning"
START: Final = 0.02  # of a drift, that is there at the first pose
MOST_SMOOTH, MOST_DRIFT = 30, 12  # columns
MOST_CHOSEN = 200  # poses whose values tell of smooth functions everywhere
MIN_VARIANCE = 1e-12  # of a variance, which is taken for zero
WAVE = 0.25  # ranges: length L of waves of the own position
PERIOD = 2.5  # ranges in which waves of few columns repeat: those of two poses are at most one range apart
N_RATES = 9
OWN_COLUMNS: Final = 2 + 2 * N_RATES
AT_ONCE = 2048  # poses at which smooth functions are evaluated together


class KernelInput(NamedTuple):
    """Where functions are evaluated: P poses."""

    travel: Array  # (P, N): z, ranges
    time: Array | None  # (P,): place in measuring order, 0 to 1; None where there is no order

    def join(self, other: KernelInput) -> KernelInput:
        """Return the poses of both, one behind the other."""
        time = None if self.time is None or other.time is None else np.concatenate([self.time, other.time])
        return KernelInput(np.concatenate([self.travel, other.travel]), time)


class PoseKernel(ABC):
    """A sort of functions, k; of each of N legs, or the same of all, where the first axis is of length one."""

    @abstractmethod
    def between(self, first: KernelInput, second: KernelInput) -> Array:
        """Return k between P and Q poses, (N or 1, P, Q)."""

    @abstractmethod
    def variance(self, place: KernelInput) -> Array:
        """Return k of poses with themselves, (N or 1, P)."""

    @abstractmethod
    def truncate(self, place: KernelInput) -> Callable[[KernelInput], Array]:
        """Return φ as a function of P poses, (N or 1, P, A), that suits some poses."""

    def without(self, covered: np.ndarray) -> PoseKernel:
        """Return the same without the functions z_j of leg i that parameters are, (N, N), where it is made of such."""
        del covered
        return self


@dataclass(frozen=True, eq=False)
class LinearPoseKernel(PoseKernel):
    """z_p · z_q, of each leg over the channels that ``free`` (N, N) leaves it; over all where nothing is said."""

    free: Array | None = None

    def between(self, first: KernelInput, second: KernelInput) -> Array:
        """Return k."""
        mine = first.travel[None] if self.free is None else first.travel * self.free[:, None]
        return np.asarray(mine @ second.travel.T)

    def variance(self, place: KernelInput) -> Array:
        """Return |z|²."""
        square = place.travel**2
        return np.asarray(square.sum(axis=1)[None] if self.free is None else self.free @ square.T)

    def truncate(self, place: KernelInput) -> Callable[[KernelInput], Array]:
        """Return z."""
        del place
        return lambda other: other.travel[None] if self.free is None else other.travel * self.free[:, None]

    def without(self, covered: np.ndarray) -> PoseKernel:
        """Return the same without z_j of leg i where that is covered."""
        return LinearPoseKernel(1.0 - covered)


@dataclass(frozen=True, eq=False)
class PositioningKernel(PoseKernel):
    """z_ip z_iq of the legs that ``free`` (N,) leaves it, of all where nothing is said, and a wave."""

    free: Array | None = None

    def between(self, first: KernelInput, second: KernelInput) -> Array:
        """Return k."""
        own, other = first.travel.T[:, :, None], second.travel.T[:, None, :]
        return np.asarray(self._free * own * other + WAVE**2 * np.exp(-0.5 * ((own - other) / WAVE) ** 2))

    def variance(self, place: KernelInput) -> Array:
        """Return z_i² + L²."""
        return np.asarray(self._free[..., 0] * place.travel.T**2 + WAVE**2)

    def truncate(self, place: KernelInput) -> Callable[[KernelInput], Array]:
        """Return z_i, and the constant, cosines and sines of it that waves are made of."""
        del place
        rates = 2.0 * np.pi / PERIOD * np.arange(1, N_RATES + 1)
        series = 2.0 * np.exp(-0.5 * (WAVE * rates) ** 2)
        sizes = np.sqrt(WAVE**3 * np.sqrt(2.0 * np.pi) / PERIOD * np.concatenate([[1.0], series, series]))

        def evaluate(other: KernelInput) -> Array:
            z = other.travel.T[:, :, None]
            waves = np.concatenate([np.ones_like(z), np.cos(rates * z), np.sin(rates * z)], axis=2)
            return np.concatenate([np.sqrt(self._free) * z, sizes * waves], axis=2)

        return evaluate

    @property
    def _free(self) -> Array:
        return np.ones((1, 1, 1)) if self.free is None else self.free[:, None, None]

    def without(self, covered: np.ndarray) -> PoseKernel:
        """Return the same without z_i of the legs where that is covered."""
        return PositioningKernel(1.0 - covered.diagonal())


class SmoothPoseKernel(PoseKernel):
    """A squared exponential of length one range, held to zero at home."""

    def between(self, first: KernelInput, second: KernelInput) -> Array:
        """Return k."""
        return SmoothKernel(1.0)(first.travel, second.travel)[None]

    def variance(self, place: KernelInput) -> Array:
        """Return 2 (1 - exp(-|z|² / 2))."""
        return np.asarray(-2.0 * np.expm1(-0.5 * (place.travel**2).sum(axis=1)))[None]

    def truncate(self, place: KernelInput) -> Callable[[KernelInput], Array]:
        """Return principal components over the poses of k between poses and chosen ones."""
        kernel, travel = SmoothKernel(1.0), place.travel
        left = self.variance(place)[0]
        factor, chosen, least = (
            np.zeros((len(travel), min(MOST_CHOSEN, len(travel)))),
            list[int](),
            MIN_VARIANCE * left.max(),
        )
        while len(chosen) < factor.shape[1] and left.max() > least:
            k, pivot = len(chosen), int(left.argmax())
            column = kernel(travel, travel[pivot : pivot + 1])[:, 0] - factor[:, :k] @ factor[pivot, :k]
            factor[:, k] = column / np.sqrt(column[pivot])
            left = np.maximum(left - factor[:, k] ** 2, 0.0)
            chosen.append(pivot)
        factor = factor[:, : len(chosen)]
        axes = np.linalg.eigh(factor.T @ factor)[1][:, ::-1][:, :MOST_SMOOTH]
        change, nodes = solve_triangular(factor[chosen], axes, lower=True, trans="T"), travel[chosen]

        def evaluate(other: KernelInput) -> Array:
            parts = [other.travel[k : k + AT_ONCE] for k in range(0, len(other.travel), AT_ONCE)]
            return np.concatenate([kernel(one, nodes) @ change for one in parts])[None]

        return evaluate


class DriftKernel(PoseKernel):
    """min(t_p, t_q) + 0.02."""

    def between(self, first: KernelInput, second: KernelInput) -> Array:
        """Return k."""
        return (np.minimum.outer(_time(first), _time(second)) + START)[None]

    def variance(self, place: KernelInput) -> Array:
        """Return t + 0.02."""
        return (_time(place) + START)[None]

    def truncate(self, place: KernelInput) -> Callable[[KernelInput], Array]:
        """Return what is there at the first pose, and the leading functions of the random walk."""
        del place
        rate = np.pi * (np.arange(MOST_DRIFT - 1) + 0.5)

        def evaluate(other: KernelInput) -> Array:
            waves = np.sqrt(2.0) * np.sin(_time(other)[:, None] * rate) / rate
            return np.concatenate([np.full((len(waves), 1), np.sqrt(START)), waves], axis=1)[None]

        return evaluate


def _time(place: KernelInput) -> Array:
    assert place.time is not None
    return place.time


POSE_KERNELS: Final[Mapping[str, PoseKernel]] = {
    "linear": LinearPoseKernel(),
    OWN: PositioningKernel(),
    "smooth": SmoothPoseKernel(),
    "drift": DriftKernel(),
}


def rescale(sizes: Mapping[str, float], before: KernelInput, after: KernelInput) -> dict[str, float]:
    """Return root mean squares over other poses of functions whose root mean squares over some poses are known."""
    norms = [{name: POSE_KERNELS[name].variance(place).mean() for name in sizes} for place in (before, after)]
    return {name: size * float(np.sqrt(norms[1][name] / norms[0][name])) for name, size in sizes.items()}


@dataclass(frozen=True, eq=False)
class PoseFunctions:
    """Sorts of functions, normalised over the calibration poses."""

    sorts: tuple[str, ...]  # names in `POSE_KERNELS`
    place: KernelInput  # of the calibration poses
    # poses whose functions are made of few columns, and so are those at all others; by default nothing is left out
    of_few: KernelInput | None = None
    # (N, N): whether the function z_j of leg i is a parameter, and no second unknown
    covered: np.ndarray | None = None

    @cached_property
    def _own(self) -> list[PoseKernel]:
        """What is unknown of each sort."""
        covered, found = self.covered, [POSE_KERNELS[name] for name in self.sorts]
        return found if covered is None or not covered.any() else [one.without(covered) for one in found]

    @cached_property
    def norms(self) -> Array:
        """c_t of each sort, shape (C,)."""
        found = np.array([one.variance(self.place).mean() for one in self._own])
        if not (found > 0.0).all():
            raise InputError("model_error: found all poses at home, expected motion")
        return found

    @cached_property
    def _truncated(self) -> list[Callable[[KernelInput], Array]]:
        assert self.of_few is not None
        return [one.truncate(self.of_few) for one in self._own]

    def list_bases(self, place: KernelInput) -> list[Array]:
        """Return the columns φ of each sort, where there are few, (N or 1, P, A_t) each."""
        pairs = zip(self._truncated, self.norms, strict=True)
        return [basis(place) / np.sqrt(norm) for basis, norm in pairs]

    def between(self, first: KernelInput, second: KernelInput) -> list[Array]:
        """Return k_t / c_t of each sort between poses, (N or 1, P, Q) each."""
        if self.of_few is None:
            return [one.between(first, second) / norm for one, norm in zip(self._own, self.norms, strict=True)]
        pairs = zip(self.list_bases(first), self.list_bases(second), strict=True)
        return [one @ np.swapaxes(other, -1, -2) for one, other in pairs]

    def variances(self, place: KernelInput) -> list[Array]:
        """Return the same of poses with themselves, (N or 1, P) each."""
        if self.of_few is None:
            return [one.variance(place) / norm for one, norm in zip(self._own, self.norms, strict=True)]
        return [(one**2).sum(axis=-1) for one in self.list_bases(place)]

    @cached_property
    def left(self) -> Array:
        """What few columns leave out of each sort's variance on average over the poses they suit, shape (C,)."""
        if self.of_few is None:
            return np.zeros(len(self.sorts))
        whole = replace(self, of_few=None).variances(self.of_few)
        pairs = zip(whole, self.variances(self.of_few), strict=True)
        return np.array([max(0.0, float(one.mean() - other.mean())) for one, other in pairs])
