"""The density of measured poses with the covariance of the very machine whose density it is: nothing is frozen.

The likelihood's hot path takes C_n at the nominal machine (`bayescal.density.pose_likelihood`). Here the closure's
derivatives by the pose, A_n(θ), by the actuators, B_n(θ), and by the joints' deflections, Z_n(θ), are those of machine
θ at the pose that it predicts. In terms of the closure r_n = A_n e_n, with e_n measured minus predicted pose,

    r_n = Z_n T_n k + s_n,    s_n ~ N(0, A_n Σ_n A_nᵀ + σ_ρ² B_n B_nᵀ + L_n diag(τ_i² + v_ni) L_nᵀ),

where L_n is B_n but for the deflections that an actuator causes at other legs: a leg's own error does not cause them.
Closures of single legs have a diagonal L_n, those of an equilibrium any, so that what a leg's error does to the pose
depends on no choice of closure. The density is log p(X) = log N(r) + Σ_n log |det A_n|; with more legs than six half
the log-determinant of AᵀA stands for the latter, and r_n holds the closure of the redundant legs, too.

k ~ N(0, S) are errors that all poses have in common: T_n k is what an uncertain deformation matrix K leaves of the
deflections, whose variance alone, pose by pose, is v. Where K was measured in the same photographs as the poses, its
error depends on theirs, cov(k, e_n) = Γ_n: a platform that seems to stand too high has joints that seem to hang too
low. Model errors that are functions of the pose (`bayescal.density.functions`) are L_n g_n, with g_i = F_i c_i over the
poses and c_ri ~ N(0, 1). All this makes a covariance of low rank beside that of s; of Q common errors only a matrix of
Q or 2 Q rows is factorised (Woodbury). On the telescope common errors are worth 3.9 nats of the evidence of its best
variants.

The derivatives cost five to thirty times the hot path: this density corrects what was found with that one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.density.elimination import whiten_covariance
from bayescal.density.few_columns import LowRankComponents
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.machines.models.base import Linearisation, newton_step
from bayescal.numerics.geometry import Array, compute_pose_error, matrix_from_rotation_vector

BATCH, FEW_POSES = 32, 128
"""Machines at a time, at so many poses: their derivatives stay in the cache."""
AT_ONCE = 4_000_000  # numbers of the columns of functions of the pose
CLOSES = 1e-4
"""Newton step in mm and rad below which the derivatives are those at the predicted pose: to 0.001 nats of 40 poses."""
STEPS = 5
FAR = 1e4  # pose errors beyond it, mm or rad, are no machine's


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors of the joints' deflections, known minus true, that all poses have in common: T_n k with k ~ N(0, S)."""

    design: Array  # (P, N, Q): T, deflection per unit of k
    covariance: Array  # (Q, Q): S; the deflections are in mm
    # (P, Q, 6): Γ, covariance of k with the error of each measured pose (mm, rad; base frame)
    with_poses: Array | None = None

    @property
    def variance(self) -> Array:
        """Variance of each deflection by itself, shape (P, N), mm²."""
        return np.asarray(np.einsum("piq,qr,pir->pi", self.design, self.covariance, self.design))


@dataclass(frozen=True, eq=False)
class _Shared:
    """Common errors in units of their own standard deviations.

    Columns V = (Z T F, A G) of the whitened closure, with S = F Fᵀ and G_n = Γ_nᵀ F⁻ᵀ, add V H Vᵀ to its covariance,
    H = ((1, 1), (1, 0)): the first block alone, and 1, where the poses' errors are independent of k.
    """

    on_deflection: Array  # (P, N, Q)
    on_pose: Array | None  # (P, 6, Q)

    @classmethod
    def from_errors(cls, common: CommonErrors) -> _Shared:
        """Return them."""
        factor = np.linalg.cholesky(common.covariance)
        on_pose = None
        if common.with_poses is not None:
            on_pose = np.swapaxes(np.linalg.solve(factor, common.with_poses), -1, -2)
        return cls(common.design @ factor, on_pose)

    def columns(self, white: Array, here: _Here) -> Array:
        """Return V, shape (B, P, N, Q or 2 Q), for whitening matrices (B, P, N, N)."""
        own = white @ here.by_deflection @ self.on_deflection
        if self.on_pose is None:
            return own
        return np.concatenate([own, white @ here.closure.pose @ self.on_pose], axis=-1)

    @property
    def inverse(self) -> Array:
        """H⁻¹, whose determinant is one or minus one."""
        one = np.eye(self.on_deflection.shape[-1])
        return one if self.on_pose is None else np.block([[np.zeros_like(one), one], [one, -one]])


@dataclass(frozen=True, eq=False)
class _Function:
    """Model errors that are functions of the pose: columns W L_n F_inr e_i add V Vᵀ, F_i F_iᵀ that of leg i's."""

    likelihood: FunctionLikelihood

    @property
    def n_numbers(self) -> int:
        """How many numbers V of one machine has."""
        n_rows, functions = self.likelihood.n_poses * self.likelihood.n_legs, self.likelihood.components
        return n_rows * (functions.n_columns if isinstance(functions, LowRankComponents) else n_rows)

    def columns(self, white: Array, here: _Here, model_error: Array) -> Array:
        """Return V, shape (B, P, N, N R), for whitening matrices (B, P, N, N) and model errors (B, ...)."""
        legs, factors = white @ here.legs, self.likelihood.factor_functions(model_error)
        spread = legs[..., None] * np.swapaxes(factors, 1, 2)[:, :, None]
        return np.asarray(spread.reshape(*legs.shape[:3], -1))


@dataclass(frozen=True, eq=False)
class _Here:
    """The closure of B machines at the P poses that they predict; NaN where there is no machine."""

    error: Array  # (B, P, 6), measured minus predicted pose
    closure: Linearisation  # its derivatives there
    by_deflection: Array  # (B, P, N, N), Z; empty where nobody needs it
    legs: Array  # (B, P, N, N), L


class ExactDensity:
    """Log-density of measured poses with C_n(θ), for batches of machines and of model errors.

    Parameters
    ----------
    likelihood : PoseLikelihood
        Of the machine and the poses; finds the predicted poses but for second orders.
    actuator_noise : float
        σ_ρ, mm.
    common : CommonErrors, optional
    actuator_variance : ndarray, shape (P, N), optional
        v_ni, mm²: extra variance of each leg at each pose by itself.
    functions : FunctionLikelihood, optional
        Of the same poses: model errors have its entries then, τ of each leg, and what its functions have.
    """

    def __init__(
        self,
        likelihood: PoseLikelihood,
        actuator_noise: float,
        common: CommonErrors | None = None,
        actuator_variance: Array | None = None,
        functions: FunctionLikelihood | None = None,
    ) -> None:
        self._likelihood, self._noise = likelihood, actuator_noise
        self._function = None if functions is None else _Function(functions)
        self._variance = 0.0 if actuator_variance is None else actuator_variance
        self._shared = None if common is None else _Shared.from_errors(common)
        gain = likelihood.machine.basis(likelihood.poses.actuators).actuator_gain
        self._mixes = bool(np.any(_leave_diagonal(gain)))

    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood in units of mm and rad, shape (B,), -inf where there is no machine.

        Parameters
        ----------
        theta : ndarray, shape (B, D)
            Parameter vectors.
        model_error : ndarray, shape (B, N) or (N,)
            τ of each leg, mm; and the scales of functions where there are any.
        """
        result = np.empty(len(theta))
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        with np.errstate(all="ignore"):  # far out numbers overflow: no density in the end
            size = max(1, BATCH * FEW_POSES // max(self._likelihood.n_poses, FEW_POSES))
            if self._function is not None:
                size = max(1, min(size, AT_ONCE // self._function.n_numbers))
            for start in range(0, len(theta), size):
                part = slice(start, start + size)
                result[part] = self._evaluate(theta[part], model_error[part])
        return np.where(np.isfinite(result), result, -np.inf)

    # --- geometry ------------------------------------------------------------------------------------------------

    def _predict(self, theta: Array) -> _Here:
        """Return the closure at the predicted poses: the hot path leads there, Newton's method goes the rest."""
        machine, poses = self._likelihood.machine, self._likelihood.poses
        closure = machine.model.prepare(machine.layout, theta[:, None])
        basis = machine.basis_at(theta[:, None], poses.actuators)
        error = self._likelihood.pose_errors(theta)
        error[~(np.isfinite(error).all(axis=-1) & (np.abs(error).max(axis=-1) < FAR))] = np.nan
        deflects = self._shared is not None or self._mixes
        if deflects:  # with actuators that deflect their own joints as well as without
            gain = basis.actuator_gain
            basis = replace(basis, actuator_gain=np.stack([gain, gain + np.eye(gain.shape[-1])]))
        known = np.nan_to_num(error)
        position = poses.position - known[..., :3]
        rotation = matrix_from_rotation_vector(-known[..., 3:]) @ poses.rotation
        for _ in range(STEPS):
            here = closure(position, rotation, basis, with_parameters=False)
            step = np.where(np.isnan(error), 0.0, newton_step(here))
            position = position + step[..., :3]
            rotation = matrix_from_rotation_vector(step[..., 3:]) @ rotation
            if not np.any(np.abs(step) > CLOSES):
                break
        left = here.residual + np.einsum("bpij,bpj->bpi", here.pose, step)  # redundant legs do not close
        exact = compute_pose_error(poses.position, poses.rotation, position, rotation)
        by_deflection, legs = np.empty(0), here.actuators
        if deflects:
            actuators, more = np.broadcast_to(legs, (2, *left.shape, left.shape[-1]))
            by_deflection, here = more - actuators, replace(here, actuators=actuators)
            legs = actuators - by_deflection @ _leave_diagonal(gain)
        return _Here(np.where(np.isnan(error), np.nan, exact), replace(here, residual=left), by_deflection, legs)

    # --- density -------------------------------------------------------------------------------------------------

    def _evaluate(self, theta: Array, model_error: Array) -> Array:
        here = self._predict(theta)
        pose = here.closure.pose
        seen = here.closure.residual + np.einsum("bpij,bpj->bpi", pose, here.error)
        covariance = self._cover(here, model_error)
        good = (np.isfinite(seen).all(axis=-1) & np.isfinite(covariance).all(axis=(-1, -2))).all(axis=-1)
        seen[~good], covariance[~good] = 0.0, np.eye(seen.shape[-1])
        white, log_det = whiten_covariance(covariance)
        seen = (white @ seen[..., None])[..., 0]
        total = -0.5 * np.einsum("bpi,bpi->b", seen, seen) + log_det.sum(axis=-1) + self._log_volume(pose)
        columns = self._columns(white, here, model_error)
        if columns is not None:
            total += _add_columns(seen, *self._factorise(columns))
        return np.where(good, total - 0.5 * seen[0].size * np.log(2.0 * np.pi), -np.inf)

    def _cover(self, here: _Here, model_error: Array) -> Array:
        """Return the covariance of s, shape (B, P, N, N), mm², for τ (B, N)."""
        pose, actuators = here.closure.pose, here.closure.actuators
        covariance = pose @ self._likelihood.poses.covariance @ np.swapaxes(pose, -1, -2)
        covariance += self._noise**2 * actuators @ np.swapaxes(actuators, -1, -2)
        tau = model_error if self._function is None else self._function.likelihood.of_single_poses(model_error)
        own = here.legs * np.sqrt(tau[:, None] ** 2 + self._variance)[..., None, :]
        return np.asarray(covariance + own @ np.swapaxes(own, -1, -2))

    def _columns(self, white: Array, here: _Here, model_error: Array) -> Array | None:
        """Return V of all that poses have in common, shape (B, P, N, R), whitened; None where there is nothing."""
        if self._shared is None and self._function is None:
            return None
        parts = [] if self._shared is None else [self._shared.columns(white, here)]
        if self._function is not None:
            parts.append(self._function.columns(white, here, model_error))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)

    def _factorise(self, columns: Array) -> tuple[Array, Array]:
        """Return M = H⁻¹ + VᵀV, shape (B, R, R), and V as (B, P N, R); |det H| is one."""
        columns = columns.reshape(len(columns), -1, columns.shape[-1])
        inverse = np.eye(columns.shape[-1])
        if self._shared is not None:
            own = self._shared.inverse
            inverse[: len(own), : len(own)] = own
        return inverse + np.swapaxes(columns, -1, -2) @ columns, columns

    def information(self, theta: Array, model_error: Array) -> Array:
        """Return what the poses tell of the parameters of one machine (D,) at model errors (N,), shape (D, D)."""
        machine, poses = self._likelihood.machine, self._likelihood.poses
        here = self._predict(theta[None])
        position = poses.position - here.error[0, :, :3]
        rotation = matrix_from_rotation_vector(-here.error[0, :, 3:]) @ poses.rotation
        slope = machine.linearise(theta, position, rotation, poses.actuators).parameters
        white, _ = whiten_covariance(self._cover(here, model_error[None]))
        rows = (white @ slope).reshape(-1, slope.shape[-1])
        total = rows.T @ rows
        columns = self._columns(white, here, model_error[None])
        if columns is not None:
            inner, columns = self._factorise(columns)
            seen = columns[0].T @ rows
            total -= seen.T @ np.linalg.solve(inner[0], seen)
        return np.asarray(total)

    @staticmethod
    def _log_volume(pose: Array) -> Array:
        """Return Σ log |det A| of pose derivatives (B, P, N, 6), shape (B,)."""
        if pose.shape[-2] == pose.shape[-1]:
            return np.asarray(np.linalg.slogdet(pose)[1].sum(axis=-1))
        return np.asarray(0.5 * np.linalg.slogdet(np.swapaxes(pose, -1, -2) @ pose)[1].sum(axis=-1))


def _add_columns(white: Array, inner: Array, columns: Array) -> Array:
    """Return what common errors add to the log-density, shape (B,), for whitened residuals (B, P, N), M and V."""
    seen = np.swapaxes(columns, -1, -2) @ white.reshape(len(white), -1, 1)
    square = (seen * np.linalg.solve(inner, seen)).sum(axis=(-1, -2))
    return np.asarray(0.5 * square - 0.5 * np.linalg.slogdet(inner)[1])


def _leave_diagonal(matrix: Array) -> Array:
    """Return matrices (..., N, N) with zeros on their diagonals."""
    return matrix * ~np.eye(matrix.shape[-1], dtype=bool)
