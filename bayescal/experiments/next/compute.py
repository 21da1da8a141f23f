"""Computing what to do next: the course so far, the best further pose, and whether to stop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import softmax
from threadpoolctl import threadpool_limits

from bayescal.experiments.frame.results import Results
from bayescal.experiments.next.inputs import NextInputs
from bayescal.experiments.next.state import State, Subject, find_state
from bayescal.identifiability.requirements import Standing
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import Step, compare_variants, look_ahead

MOST_ERRORS = 2_000_000  # draws times poses of the workspace: their errors are kept
FEWEST_DRAWS = 200
COURSE, COURSE_DRAWS = 8, 500
SHOWN = 10  # poses of the list to come
SEED, COURSE_SEED = 11, 12


@dataclass(frozen=True, eq=False)
class Ahead:
    """Further poses in the order in which to measure them.

    Attributes
    ----------
    steps : list of Step
    standings : dict of int to Standing
        How requirements are expected to stand after so many of them.
    """

    steps: list[Step]
    standings: dict[int, Standing]


def compute_next(inputs: NextInputs) -> Results:
    """Return what is known, which pose to measure next and whether to stop."""
    with threadpool_limits(1), np.errstate(all="ignore"):
        states, probabilities = _find_states(inputs)
        names = list(states)
        best = names[int(np.argmax(probabilities))]
        state = states[best]
        ahead = _look_ahead(inputs, state, _tell_apart(inputs, states, probabilities, state))
        tables = {
            "next_poses": _list_poses(state, ahead),
            "requirements": _tabulate_requirements(inputs, state, ahead),
            "course": pd.concat([_follow_course(inputs, state), _foresee(inputs, ahead, state)], ignore_index=True),
            "variants": pd.DataFrame(
                {
                    "variant": names,
                    "log_evidence": [one.belief.log_evidence for one in states.values()],
                    "probability": probabilities,
                }
            ),
        }
        summary = _summarise(inputs, state, best, float(probabilities.max()), ahead)
        return Results(summary if inputs.slip is None else summary | {"slip": inputs.slip.record()}, tables)


# --- what is known -----------------------------------------------------------------------------------------------


def _find_states(inputs: NextInputs) -> tuple[dict[str, State], Array]:
    """Return what is known by each variant, and how probable these are, shape (K,)."""
    seed = inputs.config.seed + SEED
    states = {
        name: find_state(one, None, _count_draws(one, inputs.config.draws), seed)
        for name, one in inputs.subjects.items()
    }
    return states, softmax([one.belief.log_evidence for one in states.values()])


def _count_draws(subject: Subject, wanted: int) -> int:
    return max(FEWEST_DRAWS, min(wanted, MOST_ERRORS // subject.n_workspace))


def _follow_course(inputs: NextInputs, last: State) -> pd.DataFrame:
    """Return how requirements stood after the first poses, each time updated from the time before."""
    if not inputs.requirements:
        return pd.DataFrame()
    subject = last.subject
    n_poses, start, rows = subject.n_poses, None, []
    draws, seed = _count_draws(subject, COURSE_DRAWS), inputs.config.seed + COURSE_SEED
    for n in sorted(set(np.linspace(1, n_poses, min(COURSE, n_poses)).round().astype(int).tolist())):
        state = last
        if n < n_poses:
            state = find_state(subject.first(n), start, draws, seed, anew=False)
            start = state.belief.y
        rough = state.belief.pareto_k > PARETO_K_LIMIT and state.belief.way == "updated"
        rows.append({**_describe_standing(inputs, n, "measured", state.standing), "rough": rough})
    return pd.DataFrame(rows)


def _describe_standing(inputs: NextInputs, n: int, what: str, standing: Standing) -> dict[str, Any]:
    bounds = standing.bound(inputs.config.probability)
    shares = {f"{r.name}_of_limit": float(b) for r, b in zip(inputs.requirements, bounds, strict=True)}
    return {
        "poses": n,
        "what": what,
        "probability": standing.probability,
        "standard_error": standing.standard_error,
        **shares,
    }


# --- what may come -----------------------------------------------------------------------------------------------


def _tell_apart(inputs: NextInputs, states: dict[str, State], probabilities: Array, best: State) -> Array | None:
    """Return what each candidate is expected to tell of which variant is right, nats, (C,); None where it is no aim."""
    if inputs.config.aim != "variants":
        return None
    predicted = [state.predict(best) for state in states.values()]
    differences, covariances = (np.stack(part) for part in zip(*predicted, strict=True))
    return compare_variants(probabilities, differences, covariances)


def _look_ahead(inputs: NextInputs, state: State, telling: Array | None) -> Ahead:
    """Return the poses to measure next: by the requirements one after the other, or the one that tells most."""
    allowed = state.subject.allowed
    if telling is not None:
        allowed = allowed & (telling >= np.nanmax(telling[allowed]))
    found = look_ahead(state.weight, state.covariance, state.rows, allowed)
    steps = list(islice(found, 1 if telling is not None else inputs.config.ahead))
    return Ahead(steps, dict(_foretell(inputs, state, steps)) if inputs.requirements else {})


def _foretell(inputs: NextInputs, state: State, steps: list[Step]) -> Iterator[tuple[int, Standing]]:
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


def find_goal(inputs: NextInputs, state: State) -> float:
    """Return the probability to be reached: the stated one, or its share of what an exactly known geometry reaches."""
    wanted, best = inputs.config.probability, state.at_best.probability
    return wanted if best >= wanted else wanted * best


def count_needed(ahead: Ahead, probability: float) -> int | None:
    """Return after how many further poses a probability is expected; None where it is not that soon."""
    enough = [n for n, standing in ahead.standings.items() if standing.probability >= probability]
    return min(enough, default=None)


def _foresee(inputs: NextInputs, ahead: Ahead, state: State) -> pd.DataFrame:
    n_poses = state.subject.n_poses
    rows = [
        {**_describe_standing(inputs, n_poses + n, "expected", standing), "rough": False}
        for n, standing in sorted(ahead.standings.items())
    ]
    return pd.DataFrame(rows)


def _list_poses(state: State, ahead: Ahead) -> pd.DataFrame:
    """Return the poses to come, as the machine is sent there."""
    chosen = np.array([step.candidate for step in ahead.steps[:SHOWN]])
    order = {"order": np.arange(1, len(chosen) + 1), "candidate": chosen + 1}
    return pd.DataFrame(order | state.list_poses(chosen))


# --- results -----------------------------------------------------------------------------------------------------


def _tabulate_requirements(inputs: NextInputs, state: State, ahead: Ahead) -> pd.DataFrame:
    """Return each requirement with the error that is kept with the stated probability, now and after the next pose."""
    if not inputs.requirements:
        return pd.DataFrame()
    wanted, after = inputs.config.probability, ahead.standings[1]
    rows = []
    for k, one in enumerate(inputs.requirements):
        limit = inputs.config.requirements[one.name]
        rows.append(
            {
                "requirement": one.name,
                "unit": inputs.units[one.name],
                "limit": limit,
                "error": limit * float(state.standing.bound(wanted)[k]),
                "error_after_next": limit * float(after.bound(wanted)[k]),
                "error_at_best": limit * float(state.at_best.bound(wanted)[k]),
                "probability": float(state.standing.probabilities[k]),
                "probability_after_next": float(after.probabilities[k]),
            }
        )
    return pd.DataFrame(rows)


def _summarise(inputs: NextInputs, state: State, best: str, of_best: float, ahead: Ahead) -> dict[str, Any]:
    config, belief = inputs.config, state.belief
    first = ahead.steps[0]
    summary = {
        "name": config.name,
        "title": config.title,
        "study": config.study,
        "data_origin": inputs.origin,
        "aim": config.aim,
        "stated_probability": config.probability,
        "n_poses": state.subject.n_poses,
        "n_candidates": inputs.n_candidates,
        "n_workspace": state.subject.n_workspace,
        "ahead": config.ahead,
        "n_draws": len(belief.draws),
        "variant": best,
        "variant_probability": of_best,
        "found": belief.way,
        "efficiency": belief.efficiency,
        "pareto_k": belief.pareto_k,
        "stays": state.stays,
        "next_candidate": first.candidate + 1,
        "next_pose": state.describe_pose(first.candidate),
        "shown": [asdict(one) for one in state.subject.list_shown()],
        "mean_error": float(np.sqrt(np.trace(state.weight @ state.covariance))),
        "mean_error_after_next": float(np.sqrt(first.mean_square)),
        "requirements": None,
    }
    if inputs.requirements:
        summary["requirements"] = {
            "probability": state.standing.probability,
            "standard_error": state.standing.standard_error,
            "after_next": ahead.standings[1].probability,
            "at_best": state.at_best.probability,
            "goal": find_goal(inputs, state),
            "poses_needed": count_needed(ahead, find_goal(inputs, state)),
        }
    return {**summary, "decision": _decide(inputs, summary)}


def _decide(inputs: NextInputs, summary: dict[str, Any]) -> str:
    """Return ``stop``, ``measure``, or ``hopeless`` where not even an exactly known geometry would do."""
    wanted = inputs.config.probability
    if inputs.config.aim == "variants":
        return "stop" if summary["variant_probability"] >= wanted else "measure"
    standing = summary["requirements"]
    if standing["probability"] >= wanted:
        return "stop"
    return "hopeless" if standing["at_best"] <= 1.0 - wanted else "measure"
