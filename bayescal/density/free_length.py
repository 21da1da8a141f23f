"""The density of poses whose structured model error has a kernel of unknown length, as fast as that of a known one.

With the length L the eigenvectors of the kernel's matrix over the poses, K = U diag(λ) Uᵀ, turn, and with them the
combinations of poses that are independent of each other (`bayescal.density.structured`). They are found beforehand at
`NODES` lengths, a hundredth of the prior's standard deviation of log L apart. Between two of them the log-density is
interpolated along log L: it is that of the dense kernel but for h² / 8 times its second derivative, h the distance of
the nodes, and batched over vectors that each have a length of their own.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from bayescal.density.columns import factor_by_columns
from bayescal.density.likelihood import Likelihood
from bayescal.density.model_error import Kernel, build_kernel
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import LogNormalPrior
from bayescal.density.structured import StructuredLikelihood, factor_kernel
from bayescal.numerics.geometry import Array

REACH = 4.5  # sds of log L on either side of its median; shorter and longer ones are taken for the outermost
NODES, FEWEST_NODES = 901, 91
MOST_BYTES = 128e6
AT_ONCE = 64  # nodes, while they are found


def count_nodes(n_poses: int) -> int:
    """Return at how many lengths the eigenvectors are kept: at fewer where poses are very many."""
    return int(np.clip(MOST_BYTES / (8.0 * n_poses**2), FEWEST_NODES, NODES))


class FreeLengthLikelihood(StructuredLikelihood):
    """Log-density of poses with a structured model error whose length is free.

    Model errors are vectors of 2 N + 1 entries, τ of each leg, s, and the length in units of the actuators' range.
    What a `StructuredLikelihood` has of one length this has of the prior's median.

    Parameters
    ----------
    poses : PoseLikelihood
        Density of the calibration poses without structured error.
    name : str
        Of the kernel.
    lengths : LogNormalPrior
        Prior of the length: where the nodes are.
    travel : float
        What the actuators' displacements are divided by, mm.

    Raises
    ------
    InputError
        For poses that are not measured alike, or too few.
    """

    def __init__(self, poses: PoseLikelihood, name: str, lengths: LogNormalPrior, travel: float) -> None:
        kernel = build_kernel(name, lengths.median)
        super().__init__(poses, kernel, travel)
        self._median, self._name = StructuredLikelihood(poses, kernel, travel), name
        half = REACH * lengths.spread
        self.log_nodes = np.log(lengths.median) + np.linspace(-half, half, count_nodes(poses.n_poses))
        parts = [self.log_nodes[k : k + AT_ONCE] for k in range(0, len(self.log_nodes), AT_ONCE)]
        found = [np.linalg.eigh(self._kernels(np.exp(part))(self._inputs, self._inputs)) for part in parts]
        self.values = np.maximum(np.concatenate([one.eigenvalues for one in found]), 0.0)
        vectors = np.concatenate([one.eigenvectors for one in found])
        self._rows = np.ascontiguousarray(np.swapaxes(vectors, -1, -2))  # (G, P, P), Uᵀ

    def _kernels(self, lengths: Array) -> Kernel:
        """Return the kernel of lengths (B,), all at once."""
        return build_kernel(self._name, lengths[:, None, None])

    # --- lengths -------------------------------------------------------------------------------------------------

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

    def at_node(self, node: int) -> StructuredLikelihood:
        """Return the density at the length of a node; model errors' derivatives by the length are those there."""
        kernel = self.kernel_at(node)
        return self._median.with_kernel(kernel, self.values[node], self._rows[node].T, lambda: self.slope_at(node))

    def kernel_at(self, node: int) -> Kernel:
        """Return the kernel at the length of a node."""
        return build_kernel(self._name, float(np.exp(self.log_nodes[node])))

    def kernel_of(self, length: Array) -> Kernel:
        """Return the kernel at the node nearest to a length (1,)."""
        return self.kernel_at(int(self.find_node(length)))

    def slope_at(self, node: int) -> Array:
        """Return the derivative of the kernel's matrix by log L at a node, in its combinations, shape (P, P)."""
        rows = self._rows[node]
        return np.asarray(rows @ self.kernel_at(node).slope(self._inputs, self._inputs) @ rows.T)

    def views(self, model_error: Array) -> list[tuple[float, Likelihood]]:
        """Return the densities at the nodes beside the length of model errors (2 N + 1,); one and none at the ends.

        Beyond the ends the density does not depend on the length.
        """
        lower, share = (one[0] for one in self.place(model_error[-1:]))
        inside = self.log_nodes[0] < np.log(model_error[-1]) < self.log_nodes[-1]
        found = [(1.0 - share, self.at_node(int(lower))), (share, self.at_node(int(lower) + 1))]
        if not inside:
            for _, one in found:
                one._turn = lambda: np.zeros((self.n_poses, self.n_poses))
        return list(found)

    def nearest(self, model_error: Array) -> Likelihood:
        """Return the density at the node nearest to the length of model errors (2 N + 1,)."""
        return self.at_node(int(self.find_node(model_error)))

    def _level_values(self, model_error: Array) -> Array:
        lower, share = self.place(model_error[..., -1])
        share, values = share[..., None], self._levels_by_node
        return np.asarray((1.0 - share) * values[lower] + share * values[lower + 1])

    @cached_property
    def _levels_by_node(self) -> Array:
        """Mean eigenvalue of the combinations of each level at every node, shape (G, L)."""
        chosen = np.eye(self.levels.max() + 1)[self.levels]
        return np.asarray(self.values @ (chosen / chosen.sum(axis=0)))

    # --- rows ----------------------------------------------------------------------------------------------------

    @property
    def n_model_errors(self) -> int:
        """2 N + 1."""
        return super().n_model_errors + 1

    def error_covariance(self, model_error: Array) -> Array:
        """Return the covariance of q, shape (B, P, N, N), for model errors (B, 2 N + 1), each at its nearest node."""
        n = self.n_legs
        own, function = (self._legs_weight * model_error[..., None, k : k + n] ** 2 for k in (0, n))
        added = own + self.values[self.find_node(model_error)][..., None] * function
        return np.asarray(self._mean_known + np.eye(n) * added[..., None, :])

    def _solve(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        precision = np.linalg.inv(self.error_covariance(model_error))
        errors = self._rows[self.find_node(model_error)] @ self._map_errors(theta)
        return precision, np.einsum("bkij,bkj->bki", precision, errors)

    def _map_errors(self, theta: Array) -> Array:
        """Return T⁻¹ r, shape (B, P, N), of vectors (B, D)."""
        return np.asarray(np.einsum("pij,bpj->bpi", self._unmap, self.base.leg_errors(theta)))

    def _combinations(self, model_error: Array) -> Array:
        return np.swapaxes(self._rows[self.find_node(model_error)], -1, -2)

    def factor(self, model_error: Array) -> Array:
        """Return F with F Fᵀ the kernel's matrix over the poses at the node nearest to each length, (B, P, R)."""
        return factor_kernel(self.values[self.find_node(model_error)], self._combinations(model_error))

    # --- density -------------------------------------------------------------------------------------------------

    @np.errstate(all="ignore")  # far out numbers overflow: no density in the end
    def _add_up(self, theta: Array, model_error: Array) -> Array:
        errors = self.base.leg_errors_by_leg(theta)
        n, n_poses, n_batch = errors.shape
        mapped = self._scratch.take("mapped", n_poses, n, n_batch)
        np.matmul(self._unmap, errors.transpose(1, 0, 2), out=mapped)
        by_vector = np.ascontiguousarray(mapped.transpose(2, 0, 1))
        lower, share = self.place(model_error[:, -1])
        density = (1.0 - share) * self._evaluate_at(lower, by_vector, model_error)
        density += share * self._evaluate_at(lower + 1, by_vector, model_error) + self._log_constant
        density[~np.isfinite(density)] = -np.inf
        return np.asarray(density)

    def _evaluate_at(self, nodes: np.ndarray, mapped: Array, model_error: Array) -> Array:
        """Return the log-density at nodes (B,) but for its constant, shape (B,), from T⁻¹ r (B, P, N)."""
        n_batch, n_poses, n = mapped.shape
        rows = self._scratch.take("combined", n, n_poses, n_batch)
        rows[:] = (self._rows[nodes] @ mapped).transpose(2, 1, 0)
        variance, values, weight = model_error.T**2, self.values[nodes].T, self._legs_weight

        def add(leg: int) -> Array:
            return np.asarray(weight[leg] * (variance[leg] + values * variance[n + leg]))

        known = np.broadcast_to(self._mean_known, (n_poses, n, n))
        return np.asarray(factor_by_columns(known, add, rows, self._scratch)[0].sum(axis=0))

    # --- prediction ----------------------------------------------------------------------------------------------

    def _correlate(self, poses: PoseLikelihood, model_error: Array) -> Array:
        inputs = self.inputs_of(poses)
        return self._kernels(model_error[:, -1])(inputs, inputs)

    def _see(self, poses: PoseLikelihood, model_error: Array) -> Array:
        kernels = self._kernels(np.exp(self.log_nodes[self.find_node(model_error)]))
        return np.asarray(kernels(self.inputs_of(poses), self._inputs) @ self._combinations(model_error))
