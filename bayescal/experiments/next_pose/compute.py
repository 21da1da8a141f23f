"""Computing what to do next: the history so far, the best further pose, and whether to stop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import islice
from typing import Literal

import numpy as np
import pandas as pd
from scipy.special import softmax
from threadpoolctl import threadpool_limits

from bayescal.calibrated.in_use import MachineInUse
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Comparison
from bayescal.experiments.next_pose.inputs import MOST_ERRORS, MeasuredVariant, NextPoseInputs
from bayescal.experiments.next_pose.rows import (
    OVER_LIMIT,
    ComparedVariantRow,
    NextPoseRow,
    PoseHistoryRow,
    RequirementForecastRow,
)
from bayescal.experiments.runner.results import Results, Summary
from bayescal.identifiability.reading_rows import (
    Jacobians,
    differentiate_poses,
    linearise_near,
    typical_covariance,
    whiten,
)
from bayescal.identifiability.requirements import RequirementSummary, ToolRemaining, find_limits, move_draws
from bayescal.inference.updating import LaplacePosterior, update
from bayescal.limits import PARETO_K_LIMIT
from bayescal.machines.readings import Given
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import NextPoseStep, compare_variants, learn_all, look_ahead
from bayescal.report.numbers import format_fixed

FEWEST_DRAWS = 200
HISTORY_POINTS, HISTORY_DRAWS = 8, 500
SHOWN = 10  # poses of the list to come
SEED, HISTORY_SEED, FUNCTIONS_SEED = 11, 12, 13
OFTEN = 1000.0
"""How many times each candidate is measured after which noise no longer matters: what remains, no such pose tells."""


def compute_next_pose(inputs: NextPoseInputs) -> Results:
    """Return what is known, which pose to measure next and whether to stop."""
    config, seed = inputs.config, inputs.config.seed + SEED
    with threadpool_limits(1), np.errstate(all="ignore"):
        states = {
            name: find_state(one, None, _count_draws(one, config.draws), seed) for name, one in inputs.subjects.items()
        }
        names, probabilities = list(states), softmax([one.belief.log_evidence for one in states.values()])
        best = names[int(np.argmax(probabilities))]
        state, most, allowed = states[best], config.horizon, states[best].subject.allowed
        if config.goal == "variants":  # the one that is expected to tell most of which variant is right, nats
            predicted = [one.predict(state) for one in states.values()]
            differences, covariances = (np.stack(part) for part in zip(*predicted, strict=True))
            telling = compare_variants(probabilities, differences, covariances)
            most, allowed = 1, allowed & (telling >= np.nanmax(telling[allowed]))
        steps = list(islice(look_ahead(state.weight, state.covariance, state.rows, allowed), most))
        standings = dict(_foretell(inputs, state, steps)) if inputs.requirements else {}
        chosen = np.array([step.candidate for step in steps[:SHOWN]])
        touching = state.subject.candidates.touching
        tables = {
            "next_poses": NextPoseRow.tabulate(
                state.list_poses(chosen),
                order=np.arange(1, len(chosen) + 1),
                candidate=chosen + 1,
                **({"touching": [touching[k] for k in chosen]} if touching else {}),
            ),
            "requirements": _tabulate_requirements(inputs, state, standings),
            "history": _tabulate_history(inputs, state, standings),
            "variants": ComparedVariantRow.tabulate(
                variant=names,
                log_evidence=[one.belief.log_evidence for one in states.values()],
                probability=probabilities,
            ),
        }
        summary = _summarise(inputs, state, best, float(probabilities.max()), steps[0], standings)
        summary |= {} if inputs.slip is None else {"suspected_data_error": inputs.slip.record()}
        return Results(summary, tables)


def _count_draws(subject: MeasuredVariant, wanted: int) -> int:
    return max(FEWEST_DRAWS, min(wanted, MOST_ERRORS // len(subject.workspace.values)))


def _tabulate_history(inputs: NextPoseInputs, last: State, standings: dict[int, RequirementSummary]) -> pd.DataFrame:
    """Return how requirements were met after the first poses, each time updated from before, and what is expected."""
    if not inputs.requirements:
        return pd.DataFrame()
    subject = last.subject
    n_poses, start, rows = subject.n_poses, None, list[PoseHistoryRow]()
    draws, seed = _count_draws(subject, HISTORY_DRAWS), inputs.config.seed + HISTORY_SEED
    for n in sorted(set(np.linspace(1, n_poses, min(HISTORY_POINTS, n_poses)).round().astype(int).tolist())):
        state = last
        if n < n_poses:
            state = find_state(subject.first(n), start, draws, seed, may_explore=False)
            start = state.belief.y
        approximate = state.belief.pareto_k > PARETO_K_LIMIT and state.belief.way == "updated"
        rows.append(_describe_standing(inputs, n, "measured", state.standing, approximate))
    for n, standing in sorted(standings.items()):
        rows.append(_describe_standing(inputs, n_poses + n, "planned", standing))
    return PoseHistoryRow.collect(rows)


def _describe_standing(
    inputs: NextPoseInputs,
    n: int,
    measured_or_planned: Literal["measured", "planned"],
    standing: RequirementSummary,
    approximate: bool = False,
) -> PoseHistoryRow:
    bounds = standing.bound(inputs.config.probability)
    return PoseHistoryRow(
        n_poses=n,
        measured_or_planned=measured_or_planned,
        probability=standing.probability,
        standard_error=standing.standard_error,
        approximate=bool(approximate),
        others={f"{r.name}{OVER_LIMIT}": float(b) for r, b in zip(inputs.requirements, bounds, strict=True)},
    )


def _foretell(
    inputs: NextPoseInputs, state: State, steps: list[NextPoseStep]
) -> Iterator[tuple[int, RequirementSummary]]:
    """Yield how requirements are expected to stand after some of the steps: doubled, then halved to the one needed."""
    wanted = find_goal(inputs, state)
    low, n = 0, 1
    while True:
        standing = state.after(steps[n - 1].covariance)
        yield n, standing
        if standing.probability >= wanted or n == len(steps):
            break
        low, n = n, min(2 * n, len(steps))
    high = n
    while standing.probability >= wanted and high - low > 1:
        middle = (low + high) // 2
        between = state.after(steps[middle - 1].covariance)
        yield middle, between
        low, high = (low, middle) if between.probability >= wanted else (middle, high)


def find_goal(inputs: NextPoseInputs, state: State) -> float:
    """Return the probability to be reached: the stated one, or its share of what an exactly known geometry reaches."""
    wanted, best = inputs.config.probability, state.at_best.probability
    return wanted if best >= wanted else wanted * best


def _tabulate_requirements(
    inputs: NextPoseInputs, state: State, standings: dict[int, RequirementSummary]
) -> pd.DataFrame:
    """Return each requirement with the error that is kept with the stated probability, now and after the next pose."""
    if not inputs.requirements:
        return pd.DataFrame()
    wanted = inputs.config.probability
    limits = np.array([inputs.config.requirements[one.name] for one in inputs.requirements])
    return RequirementForecastRow.tabulate(
        requirement=[one.name for one in inputs.requirements],
        unit=[inputs.units[one.name] for one in inputs.requirements],
        limit=limits,
        error=limits * state.standing.bound(wanted),
        error_after_next=limits * standings[1].bound(wanted),
        error_parameters_known=limits * state.at_best.bound(wanted),
        probability=state.standing.probabilities,
        probability_after_next=standings[1].probabilities,
    )


def _summarise(
    inputs: NextPoseInputs,
    state: State,
    best: str,
    of_best: float,
    first: NextPoseStep,
    standings: dict[int, RequirementSummary],
) -> Summary:
    config, belief, wanted = inputs.config, state.belief, inputs.config.probability
    summary = {
        "name": config.name,
        "title": config.title,
        "study": config.study,
        "data_origin": inputs.origin,
        "goal": config.goal,
        "stated_probability": config.probability,
        "n_poses": state.subject.n_poses,
        "n_candidates": inputs.n_candidates,
        "n_workspace": len(state.subject.workspace.values),
        "horizon": config.horizon,
        "n_draws": len(belief.draws),
        "variant": best,
        "variant_probability": of_best,
        "method": belief.way,
        "efficiency": belief.efficiency,
        "pareto_k": belief.pareto_k,
        "remaining_error": "noise of own sensors stays",  # with all parameters known
        "next_candidate": first.candidate + 1,
        "next_pose": state.describe_pose(first.candidate),
        "columns": [asdict(one) for one in state.subject.list_shown()],
        "mean_error": float(np.sqrt(np.trace(state.weight @ state.covariance))),
        "mean_error_after_next": float(np.sqrt(first.mean_square)),
        "requirements": None,
    }
    if inputs.requirements:
        goal = find_goal(inputs, state)
        enough = [n for n, standing in standings.items() if standing.probability >= goal]
        summary["requirements"] = {
            "probability": state.standing.probability,
            "standard_error": state.standing.standard_error,
            "probability_after_next": standings[1].probability,
            "probability_parameters_known": state.at_best.probability,
            "probability_all_candidates": state.at_length.probability,
            "target_probability": goal,
            "n_poses_needed": min(enough, default=None),
        }
    reached = of_best if config.goal == "variants" else state.standing.probability
    infeasible = config.goal == "requirements" and min(state.at_best.probability, state.at_length.probability) <= (
        1.0 - wanted  # even with the geometry known, or with all that such poses tell of it
    )
    return {**summary, "decision": "stop" if reached >= wanted else "infeasible" if infeasible else "measure"}


@dataclass(frozen=True, eq=False)
class State:
    """A variant after the poses measured so far; S draws, m parameters in the posterior's coordinates, C candidates."""

    belief: LaplacePosterior
    seed: int
    subject: MeasuredVariant

    @property
    def _posterior(self) -> CalibrationPosterior:
        return self.subject.posterior

    @cached_property
    def _y(self) -> Array:
        """Mean of the draws of the posterior of the readings, shape (n,)."""
        return np.asarray(self.belief.draws.mean(axis=0))

    @cached_property
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""
        return self._posterior.theta(self.belief.draws)

    @cached_property
    def calibrated(self) -> Array:
        """The machine as calibrated, the posterior mean, shape (D,)."""
        return np.asarray(self.theta.mean(axis=0))

    @cached_property
    def machine(self) -> MachineInUse:
        """What is known of geometry and of errors that were found with it."""
        m = self.subject.measured.posterior.n_geometry
        return MachineInUse.find(self._posterior, self.belief.draws, self.belief.covariance[:m, :m])

    @property
    def covariance(self) -> Array:
        """Of the geometry's coordinates and of A coefficients of errors found with it, shape (m + A, m + A)."""
        return self.machine.covariance

    @cached_property
    def _drawn(self) -> Array:
        """Draws of both about their mean, shape (S, m + A)."""
        return self.machine.draw(self.belief.draws, np.random.default_rng(self.seed + FUNCTIONS_SEED))

    @cached_property
    def _candidates(self) -> Array:
        """Where the machine as calibrated is at the candidates, (C, q)."""
        return self.subject.candidates.place(self.subject.model, self.calibrated)

    @cached_property
    def _workspace(self) -> Array:
        """Where it is at the workspace's poses, (W, q)."""
        return self.subject.workspace.place(self.subject.model, self.calibrated)

    # --- what poses say ----------------------------------------------------------------------------------------------

    def _differentiate(self, pose: Array, given: Given) -> Jacobians:
        measured = self.subject.measured
        return differentiate_poses(self._posterior, measured.half, self._y, pose, given, measured.aligned)

    @cached_property
    def rows(self) -> Array:
        """What all channels say of what is unknown at each candidate, its pose eliminated, shape (C, K, m + A)."""
        candidates, shape = self.subject.candidates, (len(self.subject.model.channels), len(self.covariance))
        rows = np.zeros((len(self._candidates), *shape))
        for some, read in candidates.split(self.subject.model):
            given = {name: value[some] for name, value in candidates.given.items()}
            slopes = self._differentiate(self._candidates[some], given)
            there = {name: value[slopes.places] for name, value in given.items()}
            rows[some[slopes.places]] = self.machine.see(slopes, there, read)
        return rows

    @cached_property
    def slope(self) -> Array:
        """Where the tool errs as its own channels locate it, by what is unknown, shape (W, c, m + A)."""
        given, internal = self.subject.workspace.given, self.subject.measured.internal
        slopes = self._differentiate(self._workspace, given)
        some = {name: value[slopes.places] for name, value in given.items()}
        found = self.machine.predict_tool_errors(slopes.select_channels(internal), internal, some)
        return found.slope if found.functions is None else np.concatenate([found.slope, found.functions], axis=-1)

    @cached_property
    def weight(self) -> Array:
        """W (m, m): tr(W C) is the mean square of the workspace's errors in units of the limits (I-optimality)."""
        shares = self.slope / find_limits(self.subject.requirements, self.slope)[:, None]
        return np.asarray(np.einsum("wci,wcj->ij", shares, shares, optimize=True) / len(shares))

    def predict(self, reference: State) -> tuple[Array, Array]:
        """Return what readings at the candidates leave for this variant against another one, and its covariance.

        In the directions, K - q of the white readings, that no pose of the other one explains.
        """
        given, model, other = self.subject.candidates.given, self.subject.model, reference.subject.model
        pose, noise = reference._candidates, typical_covariance(self._posterior, self._y)
        there = linearise_near(other, reference.calibrated, pose, given)
        here = linearise_near(model, self.calibrated, pose, given)
        read = np.diagonal(noise) > 0.0
        white = whiten(typical_covariance(reference._posterior, reference._y), read)[read]
        basis = np.linalg.qr(np.nan_to_num(white @ np.nan_to_num(there.by_pose)), mode="complete").Q
        across = np.swapaxes(basis[..., there.by_pose.shape[-1] :], 1, 2) @ white  # (C, K - q, K)
        apart = np.nan_to_num(Comparison(model.channels).subtract(here.values, there.values))
        rows = across @ np.nan_to_num(here.by_parameters) @ self._posterior.around(self._y)[1].T.T
        covariance = rows @ self.machine.geometry @ np.swapaxes(rows, 1, 2) + across @ noise @ np.swapaxes(across, 1, 2)
        return np.einsum("cdk,ck->cd", across, apart), covariance

    # --- requirements ------------------------------------------------------------------------------------------------

    @cached_property
    def remaining(self) -> ToolRemaining:
        """Errors of the tool over the workspace."""
        measured, given = self.subject.measured, self.subject.workspace.given
        draws = self.belief.draws
        return self.machine.remain(measured.internal, self._workspace, given, draws, self.seed, measured.aligned)

    @cached_property
    def standing(self) -> RequirementSummary:
        """How the requirements stand."""
        return self._judge(self.theta, self._drawn)

    @cached_property
    def at_best(self) -> RequirementSummary:
        """How they would stand were the geometry known exactly."""
        return self._judge(np.broadcast_to(self.calibrated, self.theta.shape), np.zeros_like(self._drawn))

    @cached_property
    def at_length(self) -> RequirementSummary:
        """How they are expected to stand were all candidates measured over and over."""
        return self.after(learn_all(self.covariance, self.rows, OFTEN))

    def after(self, covariance: Array) -> RequirementSummary:
        """Return how they are expected to stand with another covariance of what is unknown, (m + A, m + A)."""
        m, y = self._posterior.n_geometry, self.belief.draws.copy()
        drawn = move_draws(self._drawn, self.covariance, covariance)
        y[:, :m] = self._y[:m] + drawn[:, :m]
        return self._judge(self._posterior.theta(y), drawn)

    def _judge(self, theta: Array, drawn: Array) -> RequirementSummary:
        coefficients = drawn[:, self._posterior.n_geometry :]
        return RequirementSummary(self.remaining.find_largest(self.subject.requirements, theta, coefficients))

    # --- poses to come -----------------------------------------------------------------------------------------------

    def list_poses(self, chosen: np.ndarray) -> dict[str, Array]:
        """Return the columns of the table of poses to come, for some of the candidates."""
        subject, pose, candidates = self.subject, self._candidates[chosen], self.subject.candidates
        given = {name: value[chosen] for name, value in candidates.given.items()}
        read = subject.model.read(self.calibrated, pose, given)[:, subject.measured.internal]
        home = subject.model.command_range.mean(axis=1)
        moves = candidates.values[chosen] - home if candidates.commanded else pose[:, :0]
        every = np.concatenate([moves, pose, read], axis=1)
        return {
            one.column: np.degrees(every[:, k]) if one.unit == "deg" else every[:, k]
            for k, one in enumerate(subject.list_shown())
        }

    def describe_pose(self, candidate: int) -> str:
        """Return in a sentence how to go to a candidate."""
        columns, shown = self.list_poses(np.array([candidate])), self.subject.list_shown()
        first = [(one, format_fixed(float(columns[one.column][0]), one.decimals)) for one in shown]
        first = [pair for pair in first if pair[0].group == shown[0].group]
        if self.subject.candidates.commanded:
            moves = ", ".join(value for _, value in first)
            return f"Displace the actuators by {moves} mm."
        touching = self.subject.candidates.touching
        there = f", where {touching[candidate]} is touched" if touching else ""
        return f"Go to {', '.join(f'{one.heading} = {value} {one.unit}' for one, value in first)}{there}."


def find_state(
    subject: MeasuredVariant, start: Array | None, n_draws: int, seed: int, *, may_explore: bool = True
) -> State:
    """Return what is known after a variant's poses, updated from the mode before the last of them; see `update`."""
    return State(
        update(subject.measured.with_pose_guesses, start, n_draws, seed, may_explore=may_explore), seed, subject
    )
