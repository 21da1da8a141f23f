"""The density of poses whose model error is a function of the pose, as fast as that of independent poses.

In the directions of the legs the errors of P poses are

    r_n = noise_n + δ_n + g(z_n),    g_i ~ GP(0, s_i² k)    (`bayescal.density.model_error`).

Poses that are measured alike have one covariance C of noise and τ. Then the eigenvectors U of the kernel's matrix over
the poses, K = U diag(λ) Uᵀ, take the P poses to P combinations of poses that are independent of each other,

    q_k = Σ_n U_nk r_n ~ N(0, C + λ_k diag(w_i s_i²)),

each with a model error of its own: whatever the kernel and its rank, the density costs what that of independent poses
costs. Real poses differ a little, by the machine's Jacobian and by what was measured of them. With C_n the known
covariance of pose n and C its mean over the poses, r_n is first taken to T_n⁻¹ r_n, T_n C T_nᵀ = C_n with T_n the
symmetric matrix nearest to one. What is known of the noise stays exact, and the model errors act along the columns of
T_n in place of the legs. Where these differ by more than `ALIKE` the poses are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import eigh

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.batches import batches
from bayescal.density.columns import factor_by_columns
from bayescal.density.likelihood import Likelihood
from bayescal.density.local import Local, root_of
from bayescal.density.model_error import Kernel
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch

ALIKE = 0.25  # largest entry of T - 1
ALIKE_LEVELS = 1.5  # ratio of eigenvalues that count as one level
NO_LEVEL = 1e-9
FEWEST_POSES = 3
NOTHING = 1e-8  # share of the kernel's largest eigenvalue below which a direction is left out


class Conditional(NamedTuple):
    """The structured error at Q poses, given the errors at the calibration poses, for B draws.

    Attributes
    ----------
    mean : ndarray, shape (B, Q, N)
        Of g, mm along the closure of the legs.
    covariance : ndarray, shape (B, Q, N, N)
        Of g at each pose, mm².
    """

    mean: Array
    covariance: Array


def map_covariance(first: Array, second: Array) -> Array:
    """Return the symmetric T with T A Tᵀ = B for covariances A (N, N) and B (P, N, N), shape (P, N, N)."""
    root, inverse = root_of(first)
    middle, _ = root_of(root @ second @ root)
    return np.asarray(inverse @ middle @ inverse)


def factor_kernel(values: Array, vectors: Array) -> Array:
    """Return F, shape (B, P, R), from eigenvalues (B, P) and eigenvectors (B, P, P), R of which hold something."""
    kept = (values > NOTHING * values.max(axis=1, keepdims=True)).any(axis=0)
    return np.asarray(vectors[:, :, kept] * np.sqrt(values[:, None, kept]))


class StructuredLikelihood(Likelihood):
    """Log-density of poses with a structured model error, in terms of independent combinations of the poses.

    Its rows are those of combination k; model errors are vectors of 2 N entries, τ of each leg and then s.

    Parameters
    ----------
    poses : PoseLikelihood
        Density of the calibration poses without structured error.
    kernel : Kernel
    travel : float
        What the actuators' displacements are divided by, mm.

    Raises
    ------
    InputError
        For poses that are not measured alike, or too few.
    """

    def __init__(self, poses: PoseLikelihood, kernel: Kernel, travel: float) -> None:
        if poses.n_poses < FEWEST_POSES:
            raise InputError(
                f"model_error.kernel: found {poses.n_poses} calibration poses, expected {FEWEST_POSES} or more"
            )
        # where the geometry is hardly known the mode's gradient needs more digits
        self.base, self.travel = poses.refined(), travel
        self.machine, self.layout = poses.machine, poses.layout
        known = poses.legs_known
        self._mean_known = known.mean(axis=0)
        self._map = self._find_map(poses)
        self._unmap = np.linalg.inv(self._map)
        self._legs_weight = poses.actuator_weight.mean(axis=0)
        inputs = self.inputs_of(poses)
        self._inputs = inputs
        self._take_kernel(kernel, *eigh(kernel(inputs, inputs)))
        if not self.eigenvalues.max() > 0.0:
            raise InputError("model_error.kernel: found all calibration poses at home, expected actuators that move")
        self._turn: Callable[[], Array] | None = None
        self._log_constant = float(poses.log_constant.sum() - np.linalg.slogdet(self._map)[1].sum())
        self._scratch = Scratch()

    def _take_kernel(self, kernel: Kernel, values: Array, combination: Array) -> None:
        """Take a kernel, with the eigenvalues (P,) and eigenvectors (P, P) of its matrix over the poses."""
        self.kernel, self.combination, self.eigenvalues = kernel, combination, np.maximum(values, 0.0)
        own = np.broadcast_to(self._legs_weight, (self.n_poses, self.n_legs))
        self.actuator_weight = np.concatenate([own, self.eigenvalues[:, None] * own], axis=1)

    def with_kernel(self, kernel: Kernel, values: Array, combination: Array, turn: Callable[[], Array]) -> Self:
        """Return the density with another kernel, whose eigenvalues (P,) and eigenvectors (P, P) are known.

        ``turn`` finds the derivative Uᵀ K' U of the kernel's matrix by log L, shape (P, P): model errors end with the
        length L then.
        """
        other = copy(self)
        other._take_kernel(kernel, values, combination)
        other._turn = turn
        return other

    @property
    def of_poses(self) -> PoseLikelihood:
        """The density without structured error."""
        return self.base

    @property
    def structured(self) -> StructuredLikelihood:
        """Itself."""
        return self

    @property
    def closing_poses(self) -> MeasuredPoses:
        """The poses: joints are hardly known where the error may be a function of the pose."""
        return self.base.poses

    def kernel_of(self, length: Array) -> Kernel:
        """Return the kernel of a length (1,), or of none that is free (0,)."""
        del length
        return self.kernel

    def factor(self, model_error: Array) -> Array:
        """Return F with F Fᵀ the kernel's matrix over the poses, of model errors (B, ...): (1 or B, P, R).

        Without the directions that hold nothing.
        """
        return factor_kernel(self.eigenvalues[None], self.combination[None])

    def _find_map(self, poses: PoseLikelihood) -> Array:
        """Return T of poses, shape (P, N, N)."""
        found = map_covariance(self._mean_known, poses.legs_known)
        off = np.abs(found - np.eye(poses.n_legs)).max(axis=(1, 2))
        if off.max() > ALIKE:
            name = str(poses.poses.names[int(off.argmax())])
            raise InputError(
                f"model_error.kernel: pose {name!r}: found a covariance {1e2 * off.max():.0f} % off the poses' mean, "
                f"expected at most {1e2 * ALIKE:.0f} %, poses that are measured alike, or kernel 'independent'"
            )
        return found

    def inputs_of(self, poses: PoseLikelihood) -> Array:
        """Return the kernel's inputs at poses, shape (P, N): travel from home in units of the range."""
        home = poses.machine.mechanism.initial_actuator_positions
        return np.asarray((poses.poses.actuators - home) / self.travel)

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.base.n_legs

    @property
    def n_poses(self) -> int:
        """Number of poses P, and of their combinations."""
        return self.base.n_poses

    # --- rows ----------------------------------------------------------------------------------------------------

    def errors(self, theta: Array) -> Array:
        """Return the combinations q of the legs' errors for vectors (B, D), shape (B, P, N), mm."""
        return self._combine(self.base.leg_errors(theta)[..., None])[..., 0]

    def _combine(self, rows: Array) -> Array:
        """Return combinations of legs' errors or their derivatives, shape (..., P, N, D)."""
        return np.asarray(np.einsum("pk,pij,...pjd->...kid", self.combination, self._unmap, rows, optimize=True))

    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return q, shape (P, N), and its derivative (P, N, D) for one parameter vector (D,)."""
        errors, slope = self.base.leg_error_jacobian(theta)
        return self._combine(errors[..., None])[..., 0], self._combine(slope)

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of q, shape (..., P, N, N), for model errors (..., 2 N or more) in mm."""
        n = self.n_legs
        added = self.actuator_weight * model_error[..., None, : 2 * n] ** 2
        return self._mean_known + np.eye(n) * (added[..., :n] + added[..., n:])[..., None, :]

    def on_legs(self, rows: Array) -> Array:
        """Return the rows twice: τ and s act on each of them."""
        return np.concatenate([rows, rows], axis=1)

    def pose_errors(self, theta: Array) -> Array:
        """Return measured minus predicted pose (mm, rad), shape (B, P, 6), of the poses themselves."""
        return self.base.pose_errors(theta)

    def pose_covariance(self, model_error: Array) -> Array:
        """Return the covariance of a pose but for the structured error, (..., P, 6, 6), for model errors (..., 2 N)."""
        return self.base.pose_covariance(model_error[..., : self.n_legs])

    # --- density -------------------------------------------------------------------------------------------------

    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood, shape (B,), for vectors (B, D) and model errors (B, 2 N) or (2 N,)."""
        result = np.empty(len(theta))
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        for part in batches(len(theta)):
            result[part] = self._add_up(theta[part], model_error[part])
        return result

    @np.errstate(all="ignore")  # far out numbers overflow: no density in the end
    def _add_up(self, theta: Array, model_error: Array) -> Array:
        errors = self.base.leg_errors_by_leg(theta)
        n, n_poses, n_batch = errors.shape
        mapped = self._scratch.take("mapped", n_poses, n, n_batch)
        np.matmul(self._unmap, errors.transpose(1, 0, 2), out=mapped)
        rows = self._scratch.take("combined", n_poses, n, n_batch)
        np.matmul(self.combination.T, mapped.reshape(n_poses, -1), out=rows.reshape(n_poses, -1))
        variance = model_error.T**2
        weight = self.actuator_weight

        def add(leg: int) -> Array:
            return np.asarray(weight[:, leg, None] * variance[leg] + weight[:, n + leg, None] * variance[n + leg])

        known = np.broadcast_to(self._mean_known, (n_poses, n, n))
        density = factor_by_columns(known, add, rows.transpose(1, 0, 2), self._scratch)[0].sum(axis=0)
        density += self._log_constant
        density[~np.isfinite(density)] = -np.inf
        return np.asarray(density)

    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return log p(r_n | all other poses, θ, τ, s) of each pose and its squared deviation, shapes (B, P).

        With A the inverse of the covariance of all poses and α = A r the density of r_n given the others is normal with
        precision A_nn, and its deviation from its mean is A_nn⁻¹ α_n.
        """
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        precision, solved = self._solve(theta, model_error)
        u = self._combinations(model_error)
        alpha = np.einsum("...pk,...ki->...pi", u, solved)
        own = np.einsum("...pk,...kij->...pij", u**2, precision)
        deviation = np.linalg.solve(own, alpha[..., None])[..., 0]
        _, log_det = np.linalg.slogdet(own)
        constant = self.base.log_constant - np.linalg.slogdet(self._map)[1]
        square = np.einsum("bpi,bpi->bp", alpha, deviation)
        return np.asarray(constant + 0.5 * log_det - 0.5 * square), square

    def _combinations(self, model_error: Array) -> Array:
        """Return U, shape (P, P), or of each model error, (B, P, P)."""
        return self.combination

    def _solve(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return the precisions of the combinations (B, P, N, N) and these times q, shape (B, P, N)."""
        precision = np.linalg.inv(self.error_covariance(model_error))
        return precision, np.einsum("bkij,bkj->bki", precision, self.errors(theta))

    # --- derivatives and straightening ---------------------------------------------------------------------------

    def differentiate_by_errors(self, local: Local, model_error: Array) -> tuple[Array, Array]:
        """Return gradient and expected curvatures by model errors; see `Likelihood.differentiate_by_errors`.

        With A the precision of all combinations, α = A q, and E = Uᵀ K' U where the length is free:
        d log p / d log L = ½ (αᵀ (E x D) α - tr A (E x D)), D = diag(w s²).
        """
        n, rest = self.n_legs, model_error[: 2 * self.n_legs]
        by_errors, curvature = super().differentiate_by_errors(local, rest)
        if self._turn is None or len(model_error) == 2 * n:
            return by_errors, curvature
        turn, length = self._turn(), model_error[-1]
        size = self.actuator_weight[0, :n] * rest[n:] ** 2
        solved, scaled, own = local.weighted, local.precision * size, np.diagonal(turn)
        first = np.sum(turn * ((solved * size) @ solved.T)) - own @ np.trace(scaled, axis1=1, axis2=2)
        both = np.einsum("kij,lji->kl", scaled, scaled, optimize=True)
        seen = np.tile(np.einsum("kij,kji->ki", scaled, local.precision), 2)
        mixed = -(own @ (seen * self.actuator_weight)) * rest / length
        second = -0.5 * np.sum(turn**2 * both) / length**2
        return np.append(by_errors, 0.5 * first / length), np.block([[curvature, mixed[:, None]], [mixed, second]])

    def inform_by_pose(self, local: Local, pose: int) -> Array:
        """Return what one pose tells of the geometry beyond all others, shape (m, m)."""
        share = self.combination[pose]
        seen = np.einsum("k,kij,kjm->im", share, local.precision, local.slope)
        own = np.einsum("k,kij->ij", share**2, local.precision)
        return np.asarray(seen.T @ np.linalg.solve(own, seen))

    @cached_property
    def levels(self) -> np.ndarray:
        """Which level each combination of poses has, (P,): eigenvalues of the kernel that are alike are one."""
        values = self.eigenvalues
        there = values > NO_LEVEL * values.max()
        rounded = np.full(len(values), -np.inf)
        rounded[there] = np.round(np.log(values[there]) / np.log(ALIKE_LEVELS))
        return np.unique(rounded, return_inverse=True)[1]

    def errors_by_level(self, model_error: Array) -> Array:
        """Return the error of each leg in the combinations of poses of each level, shape (..., L N), mm."""
        n, level = self.n_legs, self._level_values(model_error)
        square = model_error[..., None, :n] ** 2 + level[..., None] * model_error[..., None, n : 2 * n] ** 2
        return np.asarray(np.sqrt(square).reshape(*model_error.shape[:-1], -1))

    def _level_values(self, model_error: Array) -> Array:
        """Return the mean eigenvalue of each level, (L,), or of each of model errors, (..., L)."""
        del model_error
        return np.bincount(self.levels, self.eigenvalues) / np.bincount(self.levels)

    # --- prediction ----------------------------------------------------------------------------------------------

    def condition(self, poses: PoseLikelihood, theta: Array, model_error: Array) -> Conditional:
        """Return g at poses given the errors at the calibration poses, for vectors (B, D) and model errors (B, 2 N)."""
        mean, precision, seen, scale = self._transfer(poses, theta, model_error)
        held = self._find_map(poses)
        taken = np.einsum("...qk,...kij->...qij", seen**2, precision, optimize=True)
        own = np.diagonal(self._correlate(poses, model_error), axis1=-2, axis2=-1)
        left = own[..., None, None] * (np.eye(self.n_legs) * scale[:, None, None, :])
        left = left - scale[:, None, :, None] * taken * scale[:, None, None, :]
        return Conditional(np.einsum("qij,bqj->bqi", held, mean), held @ left @ np.swapaxes(held, -1, -2))

    def joint(self, poses: PoseLikelihood, theta: Array, model_error: Array) -> Array:
        """Return the log-density of all held-back poses together, given the calibration poses, shape (B,).

        Parameters
        ----------
        poses : PoseLikelihood
            Density of Q held-back poses without structured error.
        theta : ndarray, shape (B, D)
        model_error : ndarray, shape (B, 2 N)
        """
        mean, precision, seen, scale = self._transfer(poses, theta, model_error)
        held = self._find_map(poses)
        n, n_poses = self.n_legs, poses.n_poses
        taken = np.einsum("...qk,...kij,...rk->...qirj", seen, precision, seen, optimize=True)
        taken *= scale[:, None, :, None, None] * scale[:, None, None, None, :]
        prior = np.einsum("...qr,ij,...j->...qirj", self._correlate(poses, model_error), np.eye(n), scale)
        noise = self._mean_known + np.eye(n) * (self._legs_weight * model_error[:, :n] ** 2)[:, None, :]
        total = prior - taken + np.einsum("qr,bij->bqirj", np.eye(n_poses), noise)
        errors = np.einsum("qij,bqj->bqi", np.linalg.inv(held), poses.leg_errors(theta)) - mean
        factor = np.linalg.cholesky(total.reshape(len(theta), n_poses * n, -1))
        white = np.linalg.solve(factor, errors.reshape(len(theta), -1, 1))[..., 0]
        half_log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        constant = poses.log_constant.sum() - np.linalg.slogdet(held)[1].sum()
        return np.asarray(constant - half_log_det - 0.5 * np.einsum("bi,bi->b", white, white))

    def _correlate(self, poses: PoseLikelihood, model_error: Array) -> Array:
        """Return the kernel at poses, shape (Q, Q), or of each model error, (B, Q, Q)."""
        inputs = self.inputs_of(poses)
        return self.kernel(inputs, inputs)

    def _transfer(self, poses: PoseLikelihood, theta: Array, model_error: Array) -> tuple[Array, Array, Array, Array]:
        """Return g's mean at poses (B, Q, N), the precisions, the kernel seen by combinations (Q, P), and w s²."""
        precision, solved = self._solve(theta, model_error)
        seen = self._see(poses, model_error)
        scale = self._legs_weight * model_error[:, self.n_legs : 2 * self.n_legs] ** 2
        mean = scale[:, None, :] * np.einsum("...qk,...ki->...qi", seen, solved, optimize=True)
        return mean, precision, seen, scale

    def _see(self, poses: PoseLikelihood, model_error: Array) -> Array:
        """Return the kernel of poses and combinations, shape (Q, P), or of each model error, (B, Q, P)."""
        return self.kernel(self.inputs_of(poses), self._inputs) @ self.combination

    @property
    def per_actuator(self) -> Array:
        """Closure per displacement of each leg's actuator, without its sign, shape (N,)."""
        return np.asarray(np.sqrt(self._legs_weight))
