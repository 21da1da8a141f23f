"""Methods of pose selection by name: what each has to supply, what it returns, and the one way in, `select`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np
from scipy.optimize import OptimizeResult, minimize
from threadpoolctl import threadpool_limits

from bayescal.config.sections import Section
from bayescal.errors import InputError, NumericalError, say_unknown
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria import Scorer
from bayescal.pose_selection.design import PlacedPoses
from bayescal.pose_selection.domain import PoseDomain
from bayescal.pose_selection.problem import SelectionProblem

ATTEMPTS = 100
GAIN = 1e-12
"""Of the criterion's size: less is rounding, no improvement."""
CHUNK = 100  # random sets judged at once
WITHIN = 1e-9  # in shares of a limit: a pose no further out is within it
BOX_STEP = 0.01
"""Of differences, in shares of the box's half width."""
NODES = np.array([-2.0, -1.0, 1.0, 2.0])
WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


@dataclass(frozen=True, eq=False)
class SelectedPoses:
    """Poses to measure."""

    method: str
    criterion: str
    index: np.ndarray | None  # (n,), int: which candidates; None where poses lie between them
    shares: Array  # (n, d): coordinates in the domain's unit box
    placed: PlacedPoses  # displacements from home and actuator positions
    value: float  # the criterion, computed again from the poses' rows; larger is better
    trace: Array  # (T,): the criterion after each iteration, that of the start first
    n_evaluations: int  # how many sets were judged
    converged: bool  # whether the method ended by itself
    reason: str  # why it ended

    @property
    def actuators(self) -> Array:
        """Actuator positions to command, shape (n, N), mm."""
        return self.placed.actuators


class SelectionMethod(ABC):
    """A method of pose selection.

    One of somebody else's is named in a config, ``method = "own.py:Own"``; its ``Config`` checks what its table says
    beside the keys of every choice, and `__init__(self, config)` makes it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    Config: ClassVar[type[Section]] = Section

    @classmethod
    def from_config(cls, config: Any) -> Self:
        """Return a built-in method, whose options are its fields."""
        return cls(**dict(config))

    @abstractmethod
    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the poses that the method selects."""

    def _from_candidates(
        self,
        problem: SelectionProblem,
        index: np.ndarray,
        trace: list[float],
        n_evaluations: int,
        reason: str,
        converged: bool = True,
    ) -> SelectedPoses:
        index = np.sort(index)
        candidates = problem.candidates
        return SelectedPoses(
            self.name,
            problem.criterion.name,
            index,
            candidates.shares[index],
            candidates.domain.place(candidates.shares[index]),
            problem.value_of(problem.blocks[index]),
            np.array(trace),
            n_evaluations,
            converged,
            reason,
        )


@dataclass(frozen=True)
class RandomSets(SelectionMethod):
    """The best of random sets; its trace holds the criterion of each (Yu, Wu and Wang 2023, figure 7)."""

    n_sets: int = 1000  # how many; 1 for a single random set

    name: ClassVar[str] = "random"
    title: ClassVar[str] = "Best of random sets"
    source: ClassVar[str] = "Random sampling"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the best of the sets."""
        if self.n_sets < 1:
            raise InputError(f"random: found {self.n_sets} sets, expected at least 1")
        sets = np.stack([problem.draw_set(rng) for _ in range(self.n_sets)])
        values = np.empty(len(sets))
        for k in range(0, len(sets), CHUNK):
            rows = problem.blocks[sets[k : k + CHUNK]].reshape(
                -1, problem.n * problem.blocks.shape[1], problem.n_parameters
            )
            base = np.broadcast_to(problem.base, (len(rows), *problem.base.shape))
            stacked = np.concatenate([base, rows], axis=1)
            values[k : k + CHUNK] = problem.criterion.value(stacked, problem.n_measured + problem.n)
        best = sets[int(np.argmax(values))]
        return self._from_candidates(problem, best, values.tolist(), len(sets), f"{len(sets)} sets judged")


def begin_exchange(
    problem: SelectionProblem, rng: np.random.Generator, start: Sequence[int] | None = None
) -> tuple[Scorer, float, np.ndarray]:
    """Return a scorer with the first set, what it is worth, and which distinct candidates are outside, (C,).

    The set is ``start``, or a random one that determines the parameters. InputError where the given set is not one of n
    distinct candidates, or no random one determines the parameters.
    """
    scorer = problem.scorer()
    if start is not None:
        within = all(0 <= k < len(problem.candidates) for k in start)
        if len(set(start)) != problem.n or len(start) != problem.n or not within:
            raise InputError(f"start: found candidates {list(start)}, expected {problem.n} different ones")
        scorer.start(start)
        value = scorer.value()
    else:
        for _ in range(ATTEMPTS):
            scorer.start(problem.draw_set(rng).tolist())
            value = scorer.value()
            if np.isfinite(value) and value != 0.0:
                break
        else:
            raise InputError(
                f"candidates: found no determining set of {problem.n} in {ATTEMPTS} random ones, "
                "expected more poses or other candidates"
            )
    outside = problem.candidates.distinct.copy()
    outside[scorer.members] = False
    return scorer, value, outside


@dataclass(frozen=True)
class Exchange(SelectionMethod):
    """Eliminate and add; where the pose that matters least stays the best choice, the next one is tried.

    In the manner of IOOPS, which adds the pose by a local optimisation over the workspace, this over the candidates.
    What is found cannot be improved by exchanging any one pose.
    """

    max_iterations: int = 1000  # exchanges
    # candidates to start from instead of random ones that determine the parameters
    start: tuple[int, ...] | None = None

    name: ClassVar[str] = "exchange"
    title: ClassVar[str] = "Exchange (eliminate and add)"
    source: ClassVar[str] = "Fedorov 1972; Daney, Papegay and Madeline 2005"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the set where the exchange ends."""
        scorer, value, outside = begin_exchange(problem, rng, self.start)
        trace = [value]
        ended = False
        while not ended and len(trace) <= self.max_iterations:
            better = _improve(scorer, outside, trace[-1]) if outside.any() else None
            ended = better is None
            if better is not None:
                trace.append(better)
        reason = "no exchange improves" if ended else f"{self.max_iterations} exchanges"
        return self._from_candidates(
            problem, np.array(scorer.members), trace, scorer.n_evaluations, reason, converged=ended
        )


def _improve(scorer: Scorer, outside: np.ndarray, value: float) -> float | None:
    """Exchange one member, the least needed first; return the new value, or None where nothing is better."""
    without = scorer.values_dropped()
    scorer.n_evaluations += len(without)
    members = list(scorer.members)
    for place in np.argsort(-without, kind="stable"):
        dropped = members[place]
        scorer.drop(dropped)
        added, found = scorer.best_added(outside)
        if found > value + GAIN * abs(value):
            scorer.add(added)
            outside[added], outside[dropped] = False, True
            return found
        scorer.start(members)
    return None


class PoseObjective:
    """The criterion of a problem as a function of the poses themselves, anywhere in the domain, with its gradient.

    With Γ the criterion's derivative by the information, the gradient by a coordinate x of a pose with rows B is
    2 tr(Γ Bᵀ ∂B/∂x). The rows themselves come from exact first derivatives of the closure. Their derivatives ∂B/∂x,
    the closure's second ones, would have to be written for every model; they are found by differences of fourth order
    over long steps, the same for any model, of relative error below 1e-8.

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
        slopes = np.einsum("m,ndmkl->ndkl", WEIGHTS, moved) / BOX_STEP
        return problem.value_of(blocks), 2.0 * np.einsum("nkl,ndkl->nd", blocks @ by_information, slopes)

    def margins(self, shares: Array) -> Array:
        """Return what is left of each constraint, shape (n * m,)."""
        return self.domain.margins(self._place(shares)).ravel()

    def margin_slopes(self, shares: Array) -> Array:
        """Return the derivatives of `margins` by all coordinates, shape (n * m, n * d)."""
        n, d = shares.shape
        moved = self.domain.margins(self._place(self._moved(shares))).reshape(n, d, len(NODES), -1)
        own = np.einsum("v,ndvm->nmd", WEIGHTS, moved) / BOX_STEP
        result = np.zeros((n, own.shape[1], n, d))
        result[np.arange(n), :, np.arange(n)] = own
        return result.reshape(n * own.shape[1], n * d)

    @staticmethod
    def _moved(shares: Array) -> Array:
        d = shares.shape[1]
        steps = BOX_STEP * NODES[:, None] * np.eye(d)[:, None]  # (d, nodes, d)
        return (shares[:, None, None] + steps).reshape(-1, d)

    def _place(self, shares: Array) -> PlacedPoses:
        placed = self.domain.place(shares)
        if not placed.found.all():
            raise NumericalError("poses: found one out of reach at the edge of the box")
        return placed

    def _rows(self, shares: Array) -> Array:
        return self.problem.criterion.rows(self.domain.design.see(self._place(shares)))


@dataclass(frozen=True)
class Continuous(SelectionMethod):
    """Local optimisation of all poses of a set that another method found.

    Bounds of the box alone are kept by L-BFGS-B; where the actuators' range or the workspace might be left inside of
    the box, SLSQP keeps them as inequalities.
    """

    start: SelectionMethod = field(default_factory=Exchange)  # finds the poses to start from
    max_iterations: int = 300
    tolerance: float = 1e-10  # relative change of the criterion at which it ends

    name: ClassVar[str] = "continuous"
    title: ClassVar[str] = "All poses at once, continuous"
    source: ClassVar[str] = "Local optimisation with exact gradients"

    def select(self, problem: SelectionProblem, rng: np.random.Generator) -> SelectedPoses:
        """Return the local optimum; the start where the optimiser found nothing better within the constraints."""
        start = self.start.select(problem, rng)
        objective = PoseObjective(problem)
        domain = problem.candidates.domain
        trace = [start.value]
        result = self._minimise(objective, domain, start, trace)
        shares = np.clip(result.x.reshape(start.shares.shape), -1.0, 1.0)
        placed = domain.place(shares)
        kept = bool(placed.found.all() and np.all(domain.margins(placed) >= -WITHIN))
        value = objective.value(shares) if kept else -np.inf
        if value <= start.value:
            shares, placed, value = start.shares, start.placed, start.value
        return SelectedPoses(
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
        self, objective: PoseObjective, domain: PoseDomain, start: SelectedPoses, trace: list[float]
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


METHODS: dict[str, type[SelectionMethod]] = {method.name: method for method in (RandomSets, Exchange, Continuous)}


def select(problem: SelectionProblem, method: str | SelectionMethod, rng: np.random.Generator) -> SelectedPoses:
    """Return the poses that a method selects.

    Parameters
    ----------
    problem : SelectionProblem
    method : str or SelectionMethod
        A name of `METHODS`, with its usual options, or a method with its own.
    rng : Generator
        The only source of chance.

    Raises
    ------
    InputError
        For an unknown name, or where the method cannot work on the problem.
    """
    if isinstance(method, str):
        if method not in METHODS:
            raise InputError(say_unknown("method", method, METHODS))
        method = METHODS[method]()
    with threadpool_limits(1):  # many small matrices: more threads only wait for each other
        return method.select(problem, rng)
