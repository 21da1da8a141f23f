"""A criterion as a function of the poses themselves, with its gradient.

With Γ the criterion's derivative by the information, the gradient by a coordinate x of a pose with rows B is
2 tr(Γ Bᵀ ∂B/∂x). The rows themselves come from exact first derivatives of the closure. Their derivatives ∂B/∂x, the
closure's second ones, would have to be written for every model; they are found by differences of fourth order over long
steps, the same for any model, of relative error below 1e-8.
"""

from __future__ import annotations

import numpy as np

from bayescal.errors import NumericalError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.domain import PlacedPoses
from bayescal.pose_selection.problem import SelectionProblem

STEP = 0.01
"""Of the box's half width."""
NODES = np.array([-2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


class PoseObjective:
    """The criterion of a problem for poses anywhere in the domain.

    Attributes
    ----------
    n_evaluations : int
        How many sets have been judged.
    """

    def __init__(self, problem: SelectionProblem) -> None:
        self.problem = problem
        self.domain = problem.candidates.domain
        self.n_evaluations = 0

    def value(self, shares: Array) -> float:
        """Return the criterion of poses (n, d) in the unit box."""
        self.n_evaluations += 1
        return self.problem.value_of(self._rows(shares))

    def value_and_gradient(self, shares: Array) -> tuple[float, Array]:
        """Return the criterion of poses (n, d) in the unit box, and its gradient, shape (n, d)."""
        self.n_evaluations += 1
        problem, n, d = self.problem, *shares.shape
        every = self._rows(np.concatenate([shares, self._moved(shares)]))
        blocks, moved = every[:n], every[n:].reshape(n, d, len(NODES), *every.shape[1:])
        stacked = np.concatenate([problem.base, blocks.reshape(-1, problem.n_parameters)])
        by_information = problem.criterion.gradient(stacked, problem.n_measured + n)
        slopes = np.einsum("m,ndmkl->ndkl", WEIGHTS, moved) / STEP
        return problem.value_of(blocks), 2.0 * np.einsum("nkl,ndkl->nd", blocks @ by_information, slopes)

    def margins(self, shares: Array) -> Array:
        """Return what is left of each constraint, shape (n * m,)."""
        return self.domain.margins(self._place(shares)).ravel()

    def margin_slopes(self, shares: Array) -> Array:
        """Return the derivatives of `margins` by all coordinates, shape (n * m, n * d)."""
        n, d = shares.shape
        moved = self.domain.margins(self._place(self._moved(shares))).reshape(n, d, len(NODES), -1)
        own = np.einsum("v,ndvm->nmd", WEIGHTS, moved) / STEP
        result = np.zeros((n, own.shape[1], n, d))
        result[np.arange(n), :, np.arange(n)] = own
        return result.reshape(n * own.shape[1], n * d)

    @staticmethod
    def _moved(shares: Array) -> Array:
        d = shares.shape[1]
        steps = STEP * NODES[:, None] * np.eye(d)[:, None]  # (d, nodes, d)
        return (shares[:, None, None] + steps).reshape(-1, d)

    def _place(self, shares: Array) -> PlacedPoses:
        placed = self.domain.place(shares)
        if not placed.found.all():
            raise NumericalError(
                "poses: found one out of the machine's reach at the edge of the box while optimising it"
            )
        return placed

    def _rows(self, shares: Array) -> Array:
        return self.problem.criterion.rows(self.domain.knowledge, self.domain.linearise(self._place(shares), "pose"))
