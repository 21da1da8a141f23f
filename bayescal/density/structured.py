"""The density of poses whose model error is a function of the pose, as fast as that of independent poses.

In the directions of the legs the errors of P poses are

    r_n = noise_n + δ_n + g(z_n),    g_i ~ GP(0, s_i² k)    (`bayescal.density.priors`).

Poses that are measured alike have one covariance C of noise and τ. Then the eigenvectors U of the kernel's matrix over
the poses, K = U diag(λ) Uᵀ, take the P poses to P combinations of poses that are independent of each other,

    q_k = Σ_n U_nk r_n ~ N(0, C + λ_k diag(w_i s_i²)),

each with a model error of its own: whatever the kernel and its rank, the density costs what that of independent poses
costs. Real poses differ a little, by the machine's Jacobian and by what was measured of them. With C_n the known
covariance of pose n and C its mean over the poses, r_n is first taken to T_n⁻¹ r_n, T_n C T_nᵀ = C_n with T_n the
symmetric matrix nearest to one. What is known of the noise stays exact, and the model errors act along the columns of
T_n in place of the legs. Where these differ by more than `ALIKE` the poses are refused.

With a free length L the eigenvectors turn, and with them the combinations that are independent of each other. They are
found beforehand at `NODES` lengths, a hundredth of the prior's standard deviation of log L apart. Between two of them
the log-density is interpolated along log L: it is that of the dense kernel but for h² / 8 times its second derivative,
h the distance of the nodes, and batched over vectors that each have a length of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import eigh

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import Likelihood, Local, batches, root_of
from bayescal.density.low_rank import factor_by_columns
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import Kernel, LogNormalPrior, build_kernel
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array
from bayescal.numerics.scratch import Scratch

ALIKE = 0.25  # largest entry of T - 1
ALIKE_LEVELS = 1.5  # ratio of eigenvalues that count as one level
NO_LEVEL = 1e-9
FEWEST_POSES = 3
NOTHING = 1e-8  # share of the kernel's largest eigenvalue below which a direction is left out
REACH = 4.5  # sds of log L on either side of its median; shorter and longer ones are taken for the outermost
NODES, FEWEST_NODES = 901, 91
MOST_BYTES = 128e6
AT_ONCE = 64  # nodes, while they are found


def count_nodes(n_poses: int) -> int:
    """Return at how many lengths the eigenvectors are kept, an odd number: at fewer where poses are very many."""
    return int(np.clip(MOST_BYTES / (8.0 * n_poses**2), FEWEST_NODES, NODES)) | 1


class Conditional(NamedTuple):
    """The structured error at Q poses, given the errors at the calibration poses, for B draws."""

    mean: Array  # (B, Q, N): of g, mm along the closure of the legs
    covariance: Array  # (B, Q, N, N): of g at each pose, mm²


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

    Its rows are those of combination k; model errors are vectors of 2 N entries, τ of each leg and then s, and of one
    more where the length is free: that, in units of the actuators' range. What has no model errors to go by is then
    that of the prior's median.

    Parameters
    ----------
    poses : PoseLikelihood
        Density of the calibration poses without structured error.
    kernel : Kernel
        Where the length is free, that of its median.
    travel : float
        What the actuators' displacements are divided by, mm.
    lengths : LogNormalPrior, optional
        Prior of a length that is free: where the nodes are.

    Raises
    ------
    InputError
        For poses that are not measured alike, or too few.
    """

    def __init__(
        self, poses: PoseLikelihood, kernel: Kernel, travel: float, lengths: LogNormalPrior | None = None
    ) -> None:
        if poses.n_poses < FEWEST_POSES:
            raise InputError(
                f"model_error.kernel: found {poses.n_poses} calibration poses, expected {FEWEST_POSES} or more"
            )
        # where the geometry is hardly known the mode's gradient needs more digits
        self.base, self.travel = poses.refined(), travel
        self.machine, self.layout = poses.machine, poses.layout
        self._mean_known = poses.legs_known.mean(axis=0)
        self._map = self._find_map(poses)
        self._unmap = np.linalg.inv(self._map)
        self._legs_weight = poses.actuator_weight.mean(axis=0)
        self._inputs, self._name = self.inputs_of(poses), kernel.name
        self.log_nodes, half = np.zeros(1), 0.0 if lengths is None else REACH * lengths.spread
        if lengths is not None:
            self.log_nodes = np.log(lengths.median) + np.linspace(-half, half, count_nodes(poses.n_poses))
        self._find_eigenvectors(kernel)
        self._take(kernel, len(self.log_nodes) // 2)
        if not self.eigenvalues.max() > 0.0:
            raise InputError("model_error.kernel: found all calibration poses at home, expected actuators that move")
        self._turn: Callable[[], Array] | None = None
        self._log_constant = float(poses.log_constant.sum() - np.linalg.slogdet(self._map)[1].sum())
        self._scratch = Scratch()

    def _find_eigenvectors(self, kernel: Kernel) -> None:
        """Find eigenvalues (G, P) and the rows of Uᵀ (G, P, P) of the kernel's matrix over the poses at all nodes."""
        if not self.is_free:
            values, vectors = eigh(kernel(self._inputs, self._inputs))
            self.values, self._rows = np.maximum(values, 0.0)[None], np.ascontiguousarray(vectors.T)[None]
            return
        parts = [self.log_nodes[k : k + AT_ONCE] for k in range(0, len(self.log_nodes), AT_ONCE)]
        found = [np.linalg.eigh(self._kernels(np.exp(part))(self._inputs, self._inputs)) for part in parts]
        self.values = np.maximum(np.concatenate([one.eigenvalues for one in found]), 0.0)
        vectors = np.concatenate([one.eigenvectors for one in found])
        self._rows = np.ascontiguousarray(np.swapaxes(vectors, -1, -2))

    def _take(self, kernel: Kernel, node: int) -> None:
        """Take what has no model errors to go by from a node, with its kernel."""
        self.kernel, self.combination, self.eigenvalues = kernel, self._rows[node].T, self.values[node]
        own = np.broadcast_to(self._legs_weight, (self.n_poses, self.n_legs))
        self.actuator_weight = np.concatenate([own, self.eigenvalues[:, None] * own], axis=1)

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

    # --- lengths -------------------------------------------------------------------------------------------------

    @property
    def is_free(self) -> bool:
        """Whether the length is free."""
        return len(self.log_nodes) > 1

    def _kernels(self, lengths: Array) -> Kernel:
        """Return the kernel of lengths (B,), all at once."""
        return build_kernel(self._name, lengths[:, None, None])

    def place(self, length: Array) -> tuple[np.ndarray, Array]:
        """Return the node at or below lengths (B,), and how far it is from there to the next one, 0 to 1."""
        step = self.log_nodes[1] - self.log_nodes[0]
        along = np.clip((np.log(length) - self.log_nodes[0]) / step, 0.0, len(self.log_nodes) - 1.0)
        lower = np.minimum(along.astype(int), len(self.log_nodes) - 2)
        return lower, along - lower

    def find_node(self, model_error: Array) -> np.ndarray:
        """Return the node nearest to the length of model errors (..., 2 N + 1)."""
        lower, share = self.place(model_error[..., -1])
        return np.asarray(lower + (share > 0.5))

    def kernel_at(self, node: int) -> Kernel:
        """Return the kernel at the length of a node."""
        return build_kernel(self._name, float(np.exp(self.log_nodes[node])))

    def kernel_of(self, length: Array) -> Kernel:
        """Return the kernel of a length (1,), that of the node nearest to it; of none that is free (0,)."""
        return self.kernel_at(int(self.find_node(length))) if self.is_free else self.kernel

    def at_node(self, node: int) -> Self:
        """Return the density at the length of a node; model errors' derivatives by the length are those there."""
        other, kernel, only = copy(self), self.kernel_at(node), slice(node, node + 1)
        for name in ("levels", "_levels_by_node"):
            other.__dict__.pop(name, None)
        other.log_nodes, other.values, other._rows = np.zeros(1), self.values[only], self._rows[only]
        other._take(kernel, 0)
        rows = self._rows[node]
        other._turn = lambda: np.asarray(rows @ kernel.slope(self._inputs, self._inputs) @ rows.T)
        return other

    def views(self, model_error: Array) -> list[tuple[float, Likelihood]]:
        """Return the densities at the nodes beside the length of model errors (2 N + 1,); one and none at the ends.

        Beyond the ends the density does not depend on the length.
        """
        if not self.is_free:
            return super().views(model_error)
        lower, share = (one[0] for one in self.place(model_error[-1:]))
        inside = self.log_nodes[0] < np.log(model_error[-1]) < self.log_nodes[-1]
        found = [(1.0 - share, self.at_node(int(lower))), (share, self.at_node(int(lower) + 1))]
        if not inside:
            for _, one in found:
                one._turn = lambda: np.zeros((self.n_poses, self.n_poses))
        return list(found)

    def nearest(self, model_error: Array) -> Likelihood:
        """Return the density at the node nearest to the length of model errors (2 N + 1,)."""
        return self.at_node(int(self.find_node(model_error))) if self.is_free else self

    def _values_at(self, model_error: Array) -> Array:
        """Return the eigenvalues (P,), or of each model error's nearest node, (..., P)."""
        return self.values[self.find_node(model_error)] if self.is_free else self.values[0]

    def _rows_at(self, model_error: Array) -> Array:
        """Return Uᵀ, shape (P, P), or that of each model error's nearest node, (..., P, P)."""
        return self._rows[self.find_node(model_error)] if self.is_free else self._rows[0]

    def factor(self, model_error: Array) -> Array:
        """Return F with F Fᵀ the kernel's matrix over the poses, of model errors (B, ...): (1 or B, P, R).

        Without the directions that hold nothing.
        """
        shape = (-1, self.n_poses, self.n_poses)
        vectors = np.swapaxes(self._rows_at(model_error).reshape(shape), -1, -2)
        return factor_kernel(self._values_at(model_error).reshape(shape[:2]), vectors)

    def factor_functions(self, model_error: Array) -> Array:
        """Return F_i with F_i F_iᵀ the covariance of leg i's function over the poses, mm along the actuators.

        Shape (B, N, P, R), of model errors (B, ...).
        """
        scales = model_error[:, self.n_legs : 2 * self.n_legs, None, None]
        return np.asarray(scales * self.factor(model_error)[:, None])

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
    def n_model_errors(self) -> int:
        """2 N, and one more where the length is free."""
        return super().n_model_errors + self.is_free

    @property
    def n_poses(self) -> int:
        """Number of poses P, and of their combinations."""
        return self.base.n_poses

    # --- rows ----------------------------------------------------------------------------------------------------

    def errors(self, theta: Array) -> Array:
        """Return the combinations q of the legs' errors for vectors (B, D), shape (B, P, N), mm."""
        return self._combine(self.base.errors(theta)[..., None])[..., 0]

    def _combine(self, rows: Array) -> Array:
        """Return combinations of legs' errors or their derivatives, shape (..., P, N, D)."""
        return np.asarray(np.einsum("pk,pij,...pjd->...kid", self.combination, self._unmap, rows, optimize=True))

    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return q, shape (P, N), and its derivative (P, N, D) for one parameter vector (D,)."""
        errors, slope = self.base.error_jacobian(theta)
        return self._combine(errors[..., None])[..., 0], self._combine(slope)

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of q, shape (..., P, N, N), for model errors (..., 2 N or more), at nearest nodes."""
        n = self.n_legs
        own, function = (self._legs_weight * model_error[..., None, k : k + n] ** 2 for k in (0, n))
        added = own + self._values_at(model_error)[..., None] * function
        return np.asarray(self._mean_known + np.eye(n) * added[..., None, :])

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
        if self.is_free:
            by_vector = np.ascontiguousarray(mapped.transpose(2, 0, 1))
            lower, share = self.place(model_error[:, -1])
            density = (1.0 - share) * self._evaluate_at(lower, by_vector, model_error)
            density += share * self._evaluate_at(lower + 1, by_vector, model_error)
        else:
            rows = self._scratch.take("combined", n_poses, n, n_batch)
            np.matmul(self._rows[0], mapped.reshape(n_poses, -1), out=rows.reshape(n_poses, -1))
            density = self._weigh_rows(rows.transpose(1, 0, 2), self.values[0][:, None], model_error)
        density += self._log_constant
        density[~np.isfinite(density)] = -np.inf
        return np.asarray(density)

    def _evaluate_at(self, nodes: np.ndarray, mapped: Array, model_error: Array) -> Array:
        """Return the log-density at nodes (B,) but for its constant, shape (B,), from T⁻¹ r (B, P, N)."""
        n_batch, n_poses, n = mapped.shape
        rows = self._scratch.take("combined", n, n_poses, n_batch)
        rows[:] = (self._rows[nodes] @ mapped).transpose(2, 1, 0)
        return self._weigh_rows(rows, self.values[nodes].T, model_error)

    def _weigh_rows(self, rows: Array, values: Array, model_error: Array) -> Array:
        """Return the log-density of combinations (N, P, B), with eigenvalues (P, 1 or B), but for its constant."""
        n, n_poses, _ = rows.shape
        variance, weight = model_error.T**2, self._legs_weight

        def add(leg: int) -> Array:
            return np.asarray(weight[leg] * (variance[leg] + values * variance[n + leg]))

        known = np.broadcast_to(self._mean_known, (n_poses, n, n))
        return np.asarray(factor_by_columns(known, add, rows, self._scratch)[0].sum(axis=0))

    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return log p(r_n | all other poses, θ, τ, s) of each pose and its squared deviation, shapes (B, P).

        With A the inverse of the covariance of all poses and α = A r the density of r_n given the others is normal with
        precision A_nn, and its deviation from its mean is A_nn⁻¹ α_n.
        """
        model_error = np.broadcast_to(model_error, (len(theta), model_error.shape[-1]))
        precision, solved = self._solve(theta, model_error)
        u = np.swapaxes(self._rows_at(model_error), -1, -2)
        alpha = np.einsum("...pk,...ki->...pi", u, solved)
        own = np.einsum("...pk,...kij->...pij", u**2, precision)
        deviation = np.linalg.solve(own, alpha[..., None])[..., 0]
        _, log_det = np.linalg.slogdet(own)
        constant = self.base.log_constant - np.linalg.slogdet(self._map)[1]
        square = np.einsum("bpi,bpi->bp", alpha, deviation)
        return np.asarray(constant + 0.5 * log_det - 0.5 * square), square

    def _solve(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return the precisions of the combinations (B, P, N, N) and these times q, shape (B, P, N)."""
        precision = np.linalg.inv(self.error_covariance(model_error))
        mapped = np.einsum("pij,bpj->bpi", self._unmap, self.base.errors(theta))
        return precision, np.einsum("bkij,bkj->bki", precision, self._rows_at(model_error) @ mapped)

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
        if not self.is_free:
            return self._levels_by_node[0]
        lower, share = self.place(model_error[..., -1])
        share, values = share[..., None], self._levels_by_node
        return np.asarray((1.0 - share) * values[lower] + share * values[lower + 1])

    @cached_property
    def _levels_by_node(self) -> Array:
        """Mean eigenvalue of the combinations of each level at every node, shape (G, L)."""
        chosen = np.eye(self.levels.max() + 1)[self.levels]
        return np.asarray(self.values @ (chosen / chosen.sum(axis=0)))

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
        errors = np.einsum("qij,bqj->bqi", np.linalg.inv(held), poses.errors(theta)) - mean
        factor = np.linalg.cholesky(total.reshape(len(theta), n_poses * n, -1))
        white = np.linalg.solve(factor, errors.reshape(len(theta), -1, 1))[..., 0]
        half_log_det = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=-1)
        constant = poses.log_constant.sum() - np.linalg.slogdet(held)[1].sum()
        return np.asarray(constant - half_log_det - 0.5 * np.einsum("bi,bi->b", white, white))

    def _correlate(self, poses: PoseLikelihood, model_error: Array) -> Array:
        """Return the kernel at poses, shape (Q, Q), or of each model error, (B, Q, Q)."""
        kernel, inputs = self._kernels(model_error[:, -1]) if self.is_free else self.kernel, self.inputs_of(poses)
        return kernel(inputs, inputs)

    def _transfer(self, poses: PoseLikelihood, theta: Array, model_error: Array) -> tuple[Array, Array, Array, Array]:
        """Return g's mean at poses (B, Q, N), the precisions, the kernel seen by combinations (Q, P), and w s²."""
        precision, solved = self._solve(theta, model_error)
        seen = self._see(poses, model_error)
        scale = self._legs_weight * model_error[:, self.n_legs : 2 * self.n_legs] ** 2
        mean = scale[:, None, :] * np.einsum("...qk,...ki->...qi", seen, solved, optimize=True)
        return mean, precision, seen, scale

    def _see(self, poses: PoseLikelihood, model_error: Array) -> Array:
        """Return the kernel of poses and combinations, shape (Q, P), or of each model error, (B, Q, P)."""
        kernel = self.kernel
        if self.is_free:
            kernel = self._kernels(np.exp(self.log_nodes[self.find_node(model_error)]))
        return np.asarray(kernel(self.inputs_of(poses), self._inputs) @ np.swapaxes(self._rows_at(model_error), -1, -2))

    @property
    def per_actuator(self) -> Array:
        """Closure per displacement of each leg's actuator, without its sign, shape (N,)."""
        return np.asarray(np.sqrt(self._legs_weight))
