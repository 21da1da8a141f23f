"""What a posterior needs of the density of measurements at poses, whatever instrument made them."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from bayescal.density.batches import batches
from bayescal.machines.kinematics import Machine
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array


class Likelihood(ABC):
    """The density of measurements at P poses as a posterior needs it.

    At each pose the measurements err by K rows, normal with a covariance that does not depend on the parameters θ (D,):
    what is known of it, and the model errors τ_i of the N legs, C = C⁰ + W diag(w_i τ_i²) Wᵀ.

    Attributes
    ----------
    machine : Machine
    layout : ParameterLayout
        Of θ: the machine's parameters first, then those of the measurement.
    actuator_weight : ndarray, shape (P, N)
        w.
    """

    machine: Machine
    layout: ParameterLayout
    actuator_weight: Array

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.actuator_weight.shape[1]

    @property
    def n_model_errors(self) -> int:
        """Number of entries of a model error: one per leg, or several kinds of N each."""
        return self.actuator_weight.shape[1]

    @property
    @abstractmethod
    def n_poses(self) -> int:
        """Number of poses P."""

    @abstractmethod
    def errors(self, theta: Array) -> Array:
        """Return the rows for parameter vectors (B, D), shape (B, P, K); NaN where there is no machine."""

    @abstractmethod
    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return the rows (P, K) and their exact derivative (P, K, D) for one parameter vector (D,)."""

    @abstractmethod
    def error_covariance(self, model_error: Array) -> Array:
        """Return C, shape (P, K, K), for model errors (N,) in mm."""

    @abstractmethod
    def on_legs(self, rows: Array) -> Array:
        """Return Wᵀ times something of the rows, shape (P, K, ...) to (P, N, ...)."""

    @abstractmethod
    def pose_errors(self, theta: Array) -> Array:
        """Return measured minus predicted pose (mm, rad), shape (B, P, 6); NaN where it is not measured."""

    @abstractmethod
    def pose_covariance(self, model_error: Array) -> Array:
        """Return the covariance of `pose_errors`, shape (..., P, 6, 6), for model errors (..., N) in mm."""

    def parts(self) -> list[tuple[slice, Likelihood]]:
        """Return which poses are best worked on together, each with their density; by default all."""
        return [(slice(None), self)]

    @property
    def is_solved(self) -> bool:
        """Whether nothing is left out of the rows for speed that could be had."""
        return False

    def solved(self) -> Likelihood | None:
        """Return the same density without what its hot path leaves out of the rows; None where that is nothing."""
        return None

    def pointwise(self, theta: Array, model_error: Array) -> Array:
        """Return the log-density of each pose.

        Parameters
        ----------
        theta : ndarray, shape (B, D)
            Parameter vectors.
        model_error : ndarray, shape (B, N) or (N,)
            τ of each leg, mm; one vector for all is much faster.

        Returns
        -------
        ndarray, shape (B, P)
            In units of mm and rad; -inf where a parameter vector is no machine (NaN closure).
        """
        result = np.empty((len(theta), self.n_poses))
        for part in self._batches(len(theta)):
            result[part] = self._pointwise(theta[part], model_error if model_error.ndim == 1 else model_error[part])
        return result

    def _batches(self, size: int) -> list[slice]:
        """Return how many vectors to take at a time."""
        return batches(size, self.n_poses)

    @abstractmethod
    def _pointwise(self, theta: Array, model_error: Array) -> Array:
        """Return `pointwise` of a batch."""

    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood, shape (B,); arguments as in `pointwise`."""
        return self.pointwise(theta, model_error).sum(axis=1)
