"""All poses at once over the workspace, with bounds and exact gradients (RR-8096, figure 13)."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import ClassVar

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from bayescal.errors import NumericalError
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.domain import PoseDomain
from bayescal.pose_selection.methods.base import Selection, SelectionMethod
from bayescal.pose_selection.methods.exchange import Exchange
from bayescal.pose_selection.objective import PoseObjective
from bayescal.pose_selection.problem import SelectionProblem

KEPT = 1e-9  # in shares of a limit


@dataclass(frozen=True)
class Continuous(SelectionMethod):
    """Local optimisation of all poses of a set that another method found.

    Bounds of the box alone are kept by L-BFGS-B; where the actuators' range or the workspace might be left inside of
    the box, SLSQP keeps them as inequalities.

    Attributes
    ----------
    start : SelectionMethod
        Finds the poses to start from.
    max_iterations : int
    tolerance : float
        Relative change of the criterion at which it ends.
    """

    start: SelectionMethod = field(default_factory=Exchange)
    max_iterations: int = 300
    tolerance: float = 1e-10

    name: ClassVar[str] = "continuous"
    title: ClassVar[str] = "All poses at once, continuous"
    source: ClassVar[str] = "Local optimisation with exact gradients"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> Selection:
        """Return the local optimum; the start where the optimiser found nothing better within the constraints."""
        start = self.start.select(problem, rng)
        objective = PoseObjective(problem)
        domain = problem.candidates.domain
        trace = [start.value]
        result = self._minimise(objective, domain, start, trace)
        shares = np.clip(result.x.reshape(start.shares.shape), -1.0, 1.0)
        placed = domain.place(shares)
        kept = bool(placed.found.all() and np.all(domain.margins(placed) >= -KEPT))
        value = objective.value(shares) if kept else -np.inf
        if value <= start.value:
            shares, placed, value = start.shares, start.placed, start.value
        return Selection(
            self.name,
            problem.criterion.name,
            None,
            shares,
            placed,
            value,
            np.array(trace),
            start.n_evaluations + objective.n_evaluations,
            bool(result.success),
            str(result.message),
        )

    def _minimise(
        self, objective: PoseObjective, domain: PoseDomain, start: Selection, trace: list[float]
    ) -> OptimizeResult:
        shape, scale = start.shares.shape, abs(start.value)

        def minus(x: Array) -> tuple[float, Array]:
            value, gradient = objective.value_and_gradient(x.reshape(shape))
            trace_now[0] = value
            return -value / scale, -gradient.ravel() / scale

        trace_now = [start.value]
        options = {"maxiter": self.max_iterations, "ftol": self.tolerance}
        arguments = {
            "fun": minus,
            "x0": start.shares.ravel(),
            "jac": True,
            "bounds": [(-1.0, 1.0)] * start.shares.size,
            "callback": lambda _: trace.append(trace_now[0]),
        }
        if not _may_break(domain):
            return minimize(method="L-BFGS-B", options=options | {"maxls": 40}, **arguments)
        constraint = {
            "type": "ineq",
            "fun": lambda x: objective.margins(x.reshape(shape)),
            "jac": lambda x: objective.margin_slopes(x.reshape(shape)),
        }
        return minimize(method="SLSQP", constraints=[constraint], options=options, **arguments)


def _may_break(domain: PoseDomain) -> bool:
    """Return whether a constraint beside the box is broken at one of its corners, or cannot be judged there."""
    corners = np.array(list(product((-1.0, 1.0), repeat=domain.n_coordinates)))
    try:
        return not bool(domain.allows(domain.place(corners)).all())
    except NumericalError:
        return True
