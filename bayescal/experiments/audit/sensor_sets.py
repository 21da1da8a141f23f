"""What any set of sensors would determine at the planned poses, to first order about the machine expected.

The derivatives by pose and parameters are taken once, of all sensors there are to choose from. A set has rows of them:
with its poses eliminated, R = A - H H⁺ A at every planned pose, it leaves (1 + Σ RᵀR)⁻¹ of the parameters. In use the
machine's own sensors of the set locate the tool. All sets are judged where they are few; else the best of every number
are found by adding and exchanging.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from math import comb
from typing import TYPE_CHECKING, Literal, NamedTuple, TypedDict

import numpy as np

from bayescal.errors import InputError, say_unknown
from bayescal.experiments.audit.rows import (
    ERROR,
    NOISE,
    PARAMETER_ERROR,
    BestSetParameterRow,
    BestSetRow,
    InfeasibleSetRow,
    SensorSetRow,
)
from bayescal.experiments.audit.schema import SensorChoiceConfig
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import differentiate
from bayescal.experiments.shared.readings.workspace import SINGULAR
from bayescal.identifiability.information import Information, information_of_rows, marginalise, root_of
from bayescal.identifiability.reading_rows import Jacobians, name_tool, rms
from bayescal.identifiability.requirements import ErrorsInUse, Requirement, WorkspaceErrorModel, forecast_tool
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units

if TYPE_CHECKING:
    import pandas as pd

MOST_ROUNDS = 20  # of exchanges
DIGITS = 9  # of a cost, for sums of the same costs to be the same

type Reason = Literal["", "calibration", "use"]


@dataclass(frozen=True)
class SensorGroup:
    """A sensor, or an instrument of several readings."""

    name: str
    channels: tuple[str, ...]
    cost: float = np.nan  # NaN where none are stated


def list_choices(
    model: ReadingModel, section: SensorChoiceConfig, spread: Callable[[Sequence[str]], list[str]]
) -> tuple[SensorGroup, ...]:
    """Return what there is to choose from, kinds spread, with costs.

    ``spread`` takes names to channels or kinds of them, a sensor of poses to all that belong together. InputError for
    unknown sensors and those listed twice; where there are costs, for one without and a cost of nothing.
    """
    candidates, always, costs = section.candidates, section.required_sensors, section.costs
    found: list[SensorGroup] = []
    for entry in candidates:
        names = spread([entry] if isinstance(entry, str) else entry)
        channels = tuple(model.names[k] for k in model.select(names))
        if isinstance(entry, list) or names != [entry]:
            found.append(SensorGroup(entry if isinstance(entry, str) else " + ".join(entry), channels))
        else:
            found += [SensorGroup(one, (one,)) for one in channels]
    taken = [model.names[k] for k in model.select(spread(always))] + [name for one in found for name in one.channels]
    for name in taken:
        if taken.count(name) > 1:
            raise InputError(f"found {name} twice in candidates and required_sensors")
    if not costs:
        return tuple(found)
    named = [one.name if one.name in costs else one.name.partition("[")[0] for one in found]
    for name in named:
        if name not in costs:
            raise InputError(f"costs: found none of {name}, expected one per candidate or kind")
    for name in costs:
        if name not in named:
            raise InputError(say_unknown("costs", name, dict.fromkeys(named)))
    return tuple(replace(one, cost=costs[name]) for one, name in zip(found, named, strict=True))


@dataclass(frozen=True, eq=False)
class SensorChoice:
    """Sensors to choose from."""

    section: SensorChoiceConfig
    always: tuple[str, ...]  # channels, or kinds of them, of every set
    variant: Variant  # with all sensors there are to choose from
    expected: Array  # (n,): the machine and its errors as expected, in the coordinates of the variant's posterior
    see_errors: Callable[[Array], ErrorsInUse]  # what its channels err by at poses (W, q) of the machine in use
    choices: tuple[SensorGroup, ...]
    requirements: tuple[Requirement, ...]  # of the tool's coordinates
    units: Units
    seed: int

    @cached_property
    def members(self) -> np.ndarray:
        """Which sensors each choice has, bool, shape (C, K)."""
        return np.array([np.isin(self.variant.model.names, one.channels) for one in self.choices])


@dataclass(frozen=True, eq=False)
class SetAccuracy:
    """How good a set of sensors is."""

    # why it is infeasible: its readings would not determine the poses of the ``calibration``, or its own sensors not
    # where the machine is in ``use``; empty where it is
    reason: Reason
    missing: int  # how many coordinates are not determined, in calibration and in use together
    # what is to be small: the largest standard deviation as a share of its limit, at the worst pose or rms as is
    # required; where nothing is required the root mean square of the tool's error, lengths together. Infinite for
    # a set that is infeasible
    goal: float
    # (t,) each: rms over the workspace of all together, of what is unknown of the parameters, of noise in use
    error: Array
    after: Array
    noise: Array
    sd: Array  # (m,): what remains of each parameter's tolerance, as a share
    n_readings: int  # at a pose


class _SetResult(NamedTuple):
    """Coordinates that a set does not determine in calibration and in use, else what it informs of and the forecast."""

    lost: tuple[int, int]
    n_readings: int
    information: Information | None = None
    forecast: WorkspaceErrorModel | None = None


class _Judge:
    """Judges every set once, from derivatives at the planned poses and at poses of the workspace."""

    def __init__(self, choice: SensorChoice) -> None:
        self.choice, variant, self.posterior = choice, choice.variant, choice.variant.plain()
        expected, posterior = choice.expected, self.posterior
        white, found = posterior.likelihood.explain(*posterior.at(expected[None]))
        # of the white readings at the planned poses, by the pose (P, K, q) and by the coordinates (P, K, m)
        _, self.by_pose, self.by_parameters = posterior.likelihood.rows(*posterior.around(expected), white, found.pose)
        errors, zeta = posterior.errors, posterior.zeta(expected[None])
        # by coefficients of functions of the pose, (P, K, N)
        self.by_functions = posterior.likelihood.white_columns(errors, zeta, white)[0] if errors.has_columns else None
        pose = variant.workspace.draw(variant.workspace.n_poses, np.random.default_rng([choice.seed, 5]))
        self.around: Jacobians = differentiate(posterior, variant, expected, pose)
        self.errors = choice.see_errors(self.around.pose)
        always = [variant.model.names[k] for k in variant.model.select(choice.always)]
        self.always = np.isin(variant.model.names, always)
        self.n_lengths = max(1, variant.model.pose_units.count("mm"))
        self.known: dict[tuple[int, ...], SetAccuracy] = {}

    def __call__(self, chosen: tuple[int, ...]) -> tuple[int, float]:
        """Return what is not determined, and the goal, of a set of choices: less is better."""
        if chosen not in self.known:
            self.known[chosen] = self.judge(chosen)
        return self.known[chosen].missing, self.known[chosen].goal

    def see(self, chosen: tuple[int, ...]) -> _SetResult:
        some, at = self.always | self.choice.members[list(chosen)].any(axis=0), self.around
        own = some & self.choice.variant.internal
        white, n_readings = at.white[own, None], int(some.sum())
        basis, values, _ = np.linalg.svd(self.by_pose[:, some] * at.half, full_matrices=False)
        in_use, sizes, turned = np.linalg.svd(white * at.by_pose[:, own] * at.half, full_matrices=False)
        lost = _count_lost(values, len(at.half)), _count_lost(sizes, len(at.half))
        if any(lost):
            return _SetResult(lost, n_readings)
        by_parameters = self.by_parameters[:, some]
        rows = _leave_out(basis, by_parameters)
        gain = np.swapaxes(turned * at.half, -1, -2) / sizes[:, None] @ np.swapaxes(in_use, -1, -2)
        located = at.tool_by_pose @ gain
        whole = at.mislocate(located, white * at.seen[:, own])
        forecast = forecast_tool(whole, located * white.T, self.errors.of(own), at.alignment)
        if self.by_functions is None:
            return _SetResult(lost, n_readings, information_of_rows(rows, np.ones(rows.shape[-1])), forecast)
        others = _leave_out(basis, self.by_functions[:, some])
        flat = (one.reshape(-1, one.shape[-1]) for one in (rows, others))
        return _SetResult(lost, n_readings, marginalise(*flat), forecast)

    def judge(self, chosen: tuple[int, ...]) -> SetAccuracy:
        seen = self.see(chosen)
        if seen.information is None or seen.forecast is None:
            nothing = np.full(self.around.tool_by_pose.shape[1], np.nan)
            all_of_it = np.ones(self.by_parameters.shape[-1])
            reason: Reason = "calibration" if seen.lost[0] else "use"
            return SetAccuracy(reason, sum(seen.lost), np.inf, nothing, nothing, nothing, all_of_it, seen.n_readings)
        covariance, forecast = seen.information.covariance, seen.forecast
        after = rms(forecast.slope, covariance)
        noise = np.sqrt(np.diagonal(forecast.noise, axis1=-2, axis2=-1).mean(axis=0))
        tool = forecast.covariance(seen.information.joint) + forecast.noise  # with functions, which geometry imitates
        error = np.sqrt(np.diagonal(tool, axis1=-2, axis2=-1).mean(axis=0))
        if self.choice.requirements:
            goal = max(one.size(tool) / one.limit for one in self.choice.requirements)
        else:
            goal = float(np.linalg.norm(error[: self.n_lengths]))
        return SetAccuracy("", 0, goal, error, after, noise, np.sqrt(np.diagonal(covariance)), seen.n_readings)

    def find_probability(self, chosen: tuple[int, ...], rng: np.random.Generator) -> float:
        """Return the probability that a set keeps all requirements; NaN without any."""
        seen = self.see(chosen)
        if seen.information is None or seen.forecast is None or not self.choice.requirements:
            return float("nan")
        root = root_of(seen.information.joint).T
        return seen.forecast.find_probabilities(self.choice.requirements, root, rng)[2]


def _leave_out(basis: Array, rows: Array) -> Array:
    """Return rows (P, k, m) without what a basis (P, k, q) has of them."""
    return np.asarray(rows - basis @ (np.swapaxes(basis, -1, -2) @ rows))


def _count_lost(values: Array, q: int) -> int:
    """Return how many of q coordinates readings of singular values (P, k) lose where they determine least."""
    known = (values > SINGULAR * values.max(axis=1, initial=0.0)[:, None]).sum(axis=1)
    return int(q - known.min())


# --- the search ------------------------------------------------------------------------------------------------------


class _SetColumns(TypedDict):
    n_sensors: int
    sensors: str
    cost: float | None
    n_readings: int
    reason: Reason


@dataclass(frozen=True, eq=False)
class FoundSets:
    """Sets of sensors that were judged."""

    sets: np.ndarray  # (S, C), bool: by their numbers of choices, then in the order in which they were tried
    accuracy: list[SetAccuracy]
    exhaustive: bool  # whether these are all there are
    # (S,): that all requirements are kept, of the best set of every number and of those on the front against the
    # cost; NaN of others and without requirements
    probability: Array

    def best_of(self, number: int) -> int | None:
        """Return the place of the best set of a number of choices; None where none is any good."""
        places = np.flatnonzero(self.sets.sum(axis=1) == number)
        goals = np.array([self.accuracy[k].goal for k in places])
        return int(places[goals.argmin()]) if np.isfinite(goals).any() else None

    def list_best(self) -> list[tuple[int, int]]:
        """Return each number of choices of which any set is good, with the place of the best one."""
        best = [(int(number), self.best_of(number)) for number in np.unique(self.sets.sum(axis=1))]
        return [(number, place) for number, place in best if place is not None]


def search_sensors(choice: SensorChoice) -> FoundSets:
    """Return all sets of at most some number of choices, or those tried on the way to the best ones."""
    judge, n = _Judge(choice), len(choice.choices)
    largest = min(choice.section.max_sensors or n, n)
    every = sum(comb(n, number) for number in range(largest + 1)) <= choice.section.max_exhaustive_sets
    if every:
        for number in range(largest + 1):
            for chosen in combinations(range(n), number):
                judge(chosen)
    else:
        _add_and_exchange(judge, n, largest)
    tried = sorted(judge.known, key=len)
    masks = np.array([np.isin(np.arange(n), one) for one in tried]).reshape(-1, n)
    found = FoundSets(masks, [judge.known[one] for one in tried], every, np.full(len(masks), np.nan))
    front = find_front(_tabulate_judged(choice, found))
    for k in dict.fromkeys([place for _, place in found.list_best()] + [int(k) for k in front.index]):
        found.probability[k] = judge.find_probability(tried[k], np.random.default_rng([choice.seed, 3]))
    return found


def _add_and_exchange(judge: _Judge, n: int, largest: int) -> None:
    """Add the best choice, then exchange chosen ones for others while that helps, for every number of them."""

    def add(chosen: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        return (tuple(sorted((*chosen, k))) for k in range(n) if k not in chosen)

    chosen: tuple[int, ...] = ()
    judge(chosen)
    for _ in range(largest):
        chosen = min(add(chosen), key=judge)
        for _ in range(MOST_ROUNDS):
            others = (other for out in chosen for other in add(tuple(k for k in chosen if k != out)) if other != chosen)
            best = min(others, key=judge, default=chosen)
            if not judge(best) < judge(chosen):
                break
            chosen = best


def find_infeasible(found: FoundSets) -> list[int]:
    """Return the largest sets that are infeasible: their parts, which determine less, are infeasible, too."""
    places = np.array([k for k, one in enumerate(found.accuracy) if one.reason], dtype=int)
    some = found.sets[places]
    within = (some.astype(np.int64) @ (~some).T.astype(np.int64)) == 0  # a set of the row within that of the column
    np.fill_diagonal(within, val=False)
    return [int(k) for k in places[~within.any(axis=1)]]


def find_front(sets: pd.DataFrame) -> pd.DataFrame:
    """Return the sets that no other one beats at its cost or below, the cheapest first; empty without costs."""
    import pandas as pd  # a third of a second, for those who have tables

    if "cost" not in sets:
        return pd.DataFrame()
    good = sets[sets["goal"].notna()].sort_values(["cost", "goal", "n_sensors"], kind="stable")
    return good[good["goal"] < good["goal"].cummin().shift(fill_value=np.inf)]


# --- tables ----------------------------------------------------------------------------------------------------------


def tabulate_sets(choice: SensorChoice, found: FoundSets) -> dict[str, pd.DataFrame]:
    """Return ``sensor_sets``, ``best_sets``, their ``front`` against the cost, and what no set of them determines.

    That is ``best_set_parameters`` and ``infeasible_sets``; tables without rows are left out.
    """
    import pandas as pd

    best = found.list_best()
    tables = {
        "sensor_sets": (sets := _tabulate_judged(choice, found)),
        "front": find_front(sets),
        "best_sets": BestSetRow.collect(_describe(BestSetRow, choice, found, k, number) for number, k in best),
        "best_set_parameters": pd.concat([_tabulate_parameters(choice, found, *one) for one in best])
        if best
        else pd.DataFrame(),
        "infeasible_sets": InfeasibleSetRow.collect(
            InfeasibleSetRow(**_name_set(choice, found, k)) for k in find_infeasible(found)
        ),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def _tabulate_judged(choice: SensorChoice, found: FoundSets) -> pd.DataFrame:
    """Return a row per set that was judged."""
    return SensorSetRow.collect(_describe(SensorSetRow, choice, found, k) for k in range(len(found.sets)))


def _name_set(choice: SensorChoice, found: FoundSets, place: int) -> _SetColumns:
    """Return the columns of an infeasible set, which are those of any set."""
    chosen = [one for one, there in zip(choice.choices, found.sets[place], strict=True) if there]
    cost = None if np.isnan(choice.choices[0].cost) else round(sum(one.cost for one in chosen), DIGITS)
    return {
        "n_sensors": len(chosen),
        "sensors": ", ".join(one.name for one in chosen),
        "cost": cost,
        "n_readings": found.accuracy[place].n_readings,
        "reason": found.accuracy[place].reason,
    }


def _describe[R: SensorSetRow](
    row: type[R], choice: SensorChoice, found: FoundSets, place: int, number: int | None = None
) -> R:
    """Return a set as a row, with how many of a number of choices were judged where one is given."""
    one, variant = found.accuracy[place], choice.variant
    some = choice.members[found.sets[place]].any(axis=0)
    some[variant.model.select(choice.always)] = True
    n_read = int(variant.data.present[:, some].sum())
    names = [f"{name}_{unit}" for name, unit in zip(*name_tool(variant.model), strict=True)]
    parts = {ERROR: one.error, PARAMETER_ERROR: one.after, NOISE: one.noise}
    same = [] if number is None else [found.accuracy[k] for k in np.flatnonzero(found.sets.sum(axis=1) == number)]
    return row(
        **_name_set(choice, found, place),
        n_equations=max(0, n_read - variant.data.n_poses * len(variant.model.coordinates)),
        goal=one.goal if np.isfinite(one.goal) else np.nan,
        probability=found.probability[place] if choice.requirements else None,
        sd_ratio=float(np.sqrt(np.mean(one.sd**2))),
        n_sets=None if number is None else len(same),
        n_infeasible=None if number is None else sum(some.reason != "" for some in same),
        others={f"{part}{name}": x for part, values in parts.items() for name, x in zip(names, values, strict=True)},
    )


def _tabulate_parameters(choice: SensorChoice, found: FoundSets, number: int, place: int) -> pd.DataFrame:
    posterior, units = choice.variant.plain(), choice.units
    n = posterior.n_geometry
    prior = posterior.prior_sd[:n] / np.array([units.factor(unit) for unit in posterior.units[:n]])
    return BestSetParameterRow.tabulate(
        n_sensors=number,
        parameter=posterior.sampling.names,
        unit=[units.name(unit) for unit in posterior.units[:n]],
        prior_sd=prior,
        sd=found.accuracy[place].sd * prior,
    )
