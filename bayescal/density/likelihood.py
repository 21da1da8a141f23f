"""What a posterior needs of the density of measurements at poses, whatever instrument made them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.batches import batches
from bayescal.density.local import Local
from bayescal.machines.kinematics import Machine
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.density.pose_likelihood import PoseLikelihood
    from bayescal.density.structured import StructuredLikelihood


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

    # --- what it is, where it matters ----------------------------------------------------------------------------

    @property
    def of_poses(self) -> PoseLikelihood | None:
        """The density of the poses each by itself, where whole poses were measured in known frames; None elsewhere."""
        return None

    @property
    def structured(self) -> StructuredLikelihood | None:
        """Itself where poses depend on each other by errors that are a function of the pose; None elsewhere."""
        return None

    @property
    def closing_poses(self) -> MeasuredPoses | None:
        """Poses at whose mean the legs' lengths follow the joints, where these are hardly known; None elsewhere."""
        return None

    @property
    def n_rows(self) -> np.ndarray:
        """How many rows each pose has, shape (P,)."""
        return np.full(self.n_poses, self.n_legs)

    @property
    def is_solved(self) -> bool:
        """Whether nothing is left out of the rows for speed that could be had."""
        return False

    def solved(self) -> Likelihood | None:
        """Return the same density without what its hot path leaves out of the rows; None where that is nothing."""
        return None

    # --- densities -----------------------------------------------------------------------------------------------

    def evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return `pointwise` and eᵀ C⁻¹ e of each pose, shapes (B, P); infinite where there is no machine."""
        density, square = np.empty((2, len(theta), self.n_poses))
        for part in self._batches(len(theta)):
            some = model_error if model_error.ndim == 1 else model_error[part]
            density[part], square[part] = self._evaluate(theta[part], some)
        square[~np.isfinite(square)] = np.inf
        return density, square

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

    def _pointwise(self, theta: Array, model_error: Array) -> Array:
        """Return `pointwise` of a batch."""
        return self._evaluate(theta, model_error)[0]

    @abstractmethod
    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return `evaluate` of a batch."""

    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood, shape (B,); arguments as in `pointwise`."""
        return self.pointwise(theta, model_error).sum(axis=1)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def views(self, model_error: Array) -> list[tuple[float, Likelihood]]:
        """Return the densities, with their shares, whose log-densities it interpolates at model errors (K,)."""
        del model_error
        return [(1.0, self)]

    def nearest(self, model_error: Array) -> Likelihood:
        """Return the one of them with the largest share."""
        return max(self.views(model_error), key=lambda one: one[0])[1]

    def differentiate_by_errors(self, local: Local, model_error: Array) -> tuple[Array, Array]:
        """Return the log-likelihood's gradient by model errors (K,) around a point, and expected curvatures (K, K).

        The log-determinant of a pose counts in full, however little the pose does.
        """
        square, precision = self.on_legs(local.weighted) ** 2, self.see_by_legs(local.precision)
        if local.counts is not None:
            square, precision = square / local.counts[:, None], precision / local.counts[:, None, None]
        scaled = self.actuator_weight * model_error
        by_errors = np.sum(scaled * (square - np.diagonal(precision, axis1=1, axis2=2)), axis=0)
        return by_errors, -2.0 * np.einsum("pi,pij,pj->ij", scaled, precision**2, scaled)

    def curve_by_errors(self, local: Local, model_error: Array) -> tuple[Array, Array, Array]:
        """Return second derivatives of the log-likelihood, exact in the model errors, and its gradient by these.

        Fisher's information has geometry and model errors independent of each other and takes squared errors by their
        expectation: a search for the mode of a model that does not fit takes tens of steps with it. With
        C = C₀ + W diag(w τ²) Wᵀ, g = Wᵀ C⁻¹ e and Q = Wᵀ C⁻¹ W of a pose, ∂C/∂τ_i = 2 w_i τ_i W_i W_iᵀ gives

            ∂²/∂y ∂τ_i = 2 w_i τ_i g_i (W_iᵀ C⁻¹ ∂e/∂y),
            ∂²/∂τ_i ∂τ_j = 2 w_i τ_i w_j τ_j (Q_ij² - 2 g_i Q_ij g_j) + δ_ij w_i (g_i² - Q_ii).

        Returns
        -------
        by_geometry : ndarray, shape (m, K)
        by_errors : ndarray, shape (K, K)
        gradient : ndarray, shape (K,)
        """
        told = self.on_legs(local.weighted)
        steered = self.on_legs(local.precision @ local.slope)
        seen = self.see_by_legs(local.precision)
        weight = self.actuator_weight
        scaled, surplus = weight * model_error, told**2 - np.diagonal(seen, axis1=1, axis2=2)
        across = 2.0 * np.einsum("pi,pim->mi", scaled * told, steered)
        pulled = scaled * told
        own = 2.0 * np.einsum("pi,pij,pj->ij", scaled, seen**2, scaled)
        own -= 4.0 * np.einsum("pi,pij,pj->ij", pulled, seen, pulled)
        own += np.diag(np.sum(weight * surplus, axis=0))
        return across, own, np.sum(scaled * surplus, axis=0)

    def see_by_legs(self, precision: Array) -> Array:
        """Return Wᵀ C⁻¹ W, what the rows tell of each leg's error, shape (P, K, K) to (P, N, N)."""
        return np.swapaxes(self.on_legs(np.swapaxes(self.on_legs(precision), 1, 2)), 1, 2)

    def inform_by_pose(self, local: Local, pose: int) -> Array:
        """Return what one pose tells of the geometry around a point beyond all others, shape (m, m)."""
        return np.asarray(local.slope[pose].T @ local.precision[pose] @ local.slope[pose])

    # --- straightening -------------------------------------------------------------------------------------------

    @property
    def levels(self) -> np.ndarray | None:
        """Which of L levels of the error's variance each combination of poses has, (P,); None where all have one."""
        return None

    def errors_by_level(self, model_error: Array) -> Array:
        """Return the error of each leg at each level, shape (..., L N), mm."""
        return model_error[..., : self.n_legs]
