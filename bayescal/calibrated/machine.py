"""A calibrated machine: where its parameters stand, how sure they are, and what moves its legs besides.

Its geometry is the nominal one of a mechanism of its own (see `settle`), so that whatever takes a mechanism takes it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.calibrated.settle import express_parameters, find_hindrance, settle_machine
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array

LEAST_SPREAD = 1e-13  # of a parameter's size, below which draws of it differ by rounding alone


@dataclass(frozen=True)
class Source:
    """Where a calibrated machine comes from.

    Attributes
    ----------
    experiment, variant : str
        Names of the experiment and of its variant.
    data : str
        What its data are, in words.
    problems : tuple of str
        What speaks against its convergence; none of what is exported without force.
    """

    experiment: str
    variant: str
    data: str
    problems: tuple[str, ...] = ()

    @property
    def stem(self) -> str:
        """Name of a directory for the machine."""
        return f"{self.experiment}-{self.variant.replace('/', '-').replace(' ', '_')}"

    def describe(self) -> list[str]:
        """Return lines for the head of a file."""
        lines = [f"Calibrated machine: experiment {self.experiment}, variant {self.variant}", f"Data: {self.data}"]
        if self.problems:
            lines.append(f"NOT CONVERGED, written by force: {'; '.join(self.problems)}")
        return lines


class LegErrors(ABC):
    """What moves the legs besides the geometry: errors of the closure, mm, as functions of the actuators' displacement.

    A structured model error is another class of these two methods: it has a mean that is not zero, and its covariance
    changes over the workspace.
    """

    @abstractmethod
    def mean(self, displacement: Array) -> Array:
        """Return the mean error by displacements Δρ of the actuators, shapes (P, N), mm."""

    @abstractmethod
    def covariance(self, displacement: Array, actuators: Array) -> Array:
        """Return the covariance (P, N, N) in mm² by displacements (P, N) and the closure's slopes dF/dρ (P, N, N)."""


@dataclass(frozen=True, eq=False)
class IndependentErrors(LegErrors):
    """Errors of mean zero, independent from pose to pose: those of a pose's density (see `density.pose_likelihood`).

    Attributes
    ----------
    actuator_noise : float
        σ_ρ, mm.
    model_variance : ndarray, shape (N,)
        Posterior mean of τ_i², mm².
    matrix_covariance : ndarray, shape (N, N, N), or None
        Covariance of each row of a measured deformation matrix K, whose diagonal is a parameter and counts as known.
    """

    actuator_noise: float
    model_variance: Array
    matrix_covariance: Array | None = None

    def mean(self, displacement: Array) -> Array:
        """Return zeros."""
        return np.zeros_like(displacement)

    def covariance(self, displacement: Array, actuators: Array) -> Array:
        """Return σ_ρ² A Aᵀ + diag(A_ii² (τ_i² + v_i)), where v_i is the variance of Δb_z that K's rest leaves."""
        variance = self.model_variance + self._deflection_variance(displacement)
        weight = np.diagonal(actuators, axis1=-2, axis2=-1) ** 2
        noise = self.actuator_noise**2 * actuators @ np.swapaxes(actuators, -1, -2)
        return np.asarray(noise + np.eye(displacement.shape[-1]) * (weight * variance)[..., None, :])

    def _deflection_variance(self, displacement: Array) -> Array:
        if self.matrix_covariance is None:
            return np.zeros_like(displacement)
        others = displacement[..., None, :] * (1.0 - np.eye(displacement.shape[-1]))
        return np.einsum("...ij,ijk,...ik->...i", others, self.matrix_covariance, others)


@dataclass(frozen=True, eq=False)
class CalibratedMachine:
    """A machine by its posterior.

    Attributes
    ----------
    machine : Machine
        Mechanism, model and deformation.
    theta : ndarray, shape (D,)
        Posterior mean in the machine's layout; its nominal vector where drawings hold the kinematics.
    free : ndarray of int, shape (n,)
        Which of its entries are uncertain.
    covariance : ndarray, shape (n, n), or None
        Of those; None where the results hold no draws.
    draws : ndarray, shape (S, n), or None
        Of the posterior.
    errors : LegErrors
    source : Source
    measured : ndarray, shape (P, N), or None
        Actuator positions of the poses that calibrated it, mm; None where they are not known.
    """

    machine: Machine
    theta: Array
    free: np.ndarray
    covariance: Array | None
    draws: Array | None
    errors: LegErrors
    source: Source
    measured: Array | None = None

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.machine.mechanism.n_legs

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the uncertain parameters."""
        return tuple(self.machine.layout.names[k] for k in self.free)

    @property
    def is_settled(self) -> bool:
        """Whether its geometry is the nominal one of its mechanism."""
        return bool(np.array_equal(self.theta, self.machine.layout.nominal))

    def thin(self, n: int) -> Array:
        """Return full parameter vectors of at most n draws, shape (n, D), evenly from all."""
        assert self.draws is not None
        chosen = np.linspace(0, len(self.draws) - 1, min(n, len(self.draws))).astype(int)
        theta = np.broadcast_to(self.theta, (len(chosen), len(self.theta))).copy()
        theta[:, self.free] = self.draws[chosen]
        return theta


def build_calibrated(
    machine: Machine,
    theta: Array,
    draws: Array | None,
    errors: LegErrors,
    source: Source,
    measured: Array | None = None,
) -> CalibratedMachine:
    """Return a calibrated machine from its posterior, settled where drawings hold its kinematics.

    Parameters
    ----------
    machine : Machine
        The nominal one.
    theta : ndarray, shape (D,)
        Posterior mean.
    draws : ndarray, shape (S, D), or None
    errors : LegErrors
    source : Source
    measured : ndarray, shape (P, N), or None
        Actuator positions of the poses that calibrated it, mm.
    """
    if not find_hindrance(machine):
        settled = settle_machine(machine, theta)
        draws = None if draws is None else express_parameters(machine, settled, draws)
        machine, theta = settled, settled.layout.nominal
    if draws is None:
        return CalibratedMachine(machine, theta, np.empty(0, dtype=int), None, None, errors, source, measured)
    free = np.flatnonzero(np.ptp(draws, axis=0) > LEAST_SPREAD * (1.0 + np.abs(theta)))
    covariance = np.atleast_2d(np.cov(draws[:, free], rowvar=False))
    return CalibratedMachine(machine, theta, free, covariance, draws[:, free], errors, source, measured)
