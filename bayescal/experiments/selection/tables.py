"""The tables of an experiment on pose selection: what was chosen, what it is worth, and what was published."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.config.registry import is_own
from bayescal.experiments.selection.inputs import SelectionInputs
from bayescal.experiments.selection.published import KEY
from bayescal.experiments.selection.tasks import DESIGN, JudgedPoses, Task
from bayescal.files.csv_tables import format_table
from bayescal.identifiability.design import AXES
from bayescal.pose_selection import Criterion, SelectionMethod

MICROMETRES = 1e3
ARCSECONDS = 3600.0 * 180.0 / np.pi
SCALES = np.array([MICROMETRES, ARCSECONDS, 1.0])
PARTS = ("position_um", "rotation_arcsec", "share_of_limits")
NEAR = 0.95  # of the box: a pose beyond counts as at its boundary


def tabulate_selections(outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return one row per selection; what took time stands apart, in `tabulate_timings`."""
    rows = []
    for outcome in outcomes:
        chosen = outcome.selection
        value = outcome.indices.get(outcome.task.criterion, np.nan) if chosen is None else chosen.value
        rows.append(
            _key(outcome.task)
            | {"method": "given" if chosen is None else chosen.method, "value": value}
            | outcome.indices
            | {
                "n_evaluations": 0 if chosen is None else chosen.n_evaluations,
                "n_iterations": 0 if chosen is None else len(chosen.trace) - 1,
                "converged": True if chosen is None else chosen.converged,
                "reason": "" if chosen is None else chosen.reason,
                "at_boundary": np.nan if chosen is None else float(np.mean(np.abs(chosen.shares).max(axis=1) > NEAR)),
            }
        )
    return pd.DataFrame(rows)


def tabulate_classes(inputs: SelectionInputs) -> pd.DataFrame:
    """Return what criteria and methods of somebody else's are; none for built-in ones, which every page knows."""
    config = inputs.config
    found: list[tuple[str, Criterion | SelectionMethod]] = []
    found += [("criterion", inputs.criterion(label)) for label in config.criteria]
    found += [("method", inputs.method(choice)) for choice in config.selections]
    rows = {(what, one.name): (one.title, one.source) for what, one in found if is_own(type(one))}
    return pd.DataFrame([(*key, *words) for key, words in rows.items()], columns=["what", "name", "title", "source"])


def tabulate_timings(outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return the seconds of each selection."""
    rows = [_key(o.task) | {"seconds": o.seconds} for o in outcomes if o.selection is not None]
    return pd.DataFrame(rows)


def tabulate_poses(inputs: SelectionInputs, outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return one row per chosen pose: displacements from home, and of the actuators from their initial positions."""
    start = inputs.design.knowledge.machine.mechanism.initial_actuator_positions
    columns = [f"{axis.replace(' ', '_')}_{'mm' if k < 3 else 'deg'}" for k, axis in enumerate(AXES)]
    legs = [f"drho_{k}_mm" for k in range(1, len(start) + 1)]
    parts = []
    for outcome in outcomes:
        moves = np.concatenate([outcome.moves[:, :3], np.degrees(outcome.moves[:, 3:])], axis=1)
        part = pd.DataFrame(np.concatenate([moves, outcome.actuators - start], axis=1), columns=[*columns, *legs])
        part.insert(0, "pose", np.arange(1, len(part) + 1))
        for place, (name, value) in enumerate(_key(outcome.task).items()):
            part.insert(place, name, value)
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def tabulate_traces(outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return the criterion after each iteration."""
    return _tabulate_values([o for o in outcomes if not o.task.is_histogram], "iteration")


def tabulate_random_sets(outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return what each of many random sets is worth."""
    return _tabulate_values([o for o in outcomes if o.task.is_histogram], "set")


def tabulate_errors(outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return predicted and simulated pose errors over the workspace of each set of poses.

    ``simulated`` is the root mean square over machines, to be set beside ``predicted``, with its standard error.
    """
    rows = []
    for outcome in outcomes:
        accuracy = outcome.accuracy
        if accuracy is None:
            continue
        row: dict[str, str | int | float] = {**_key(outcome.task)}
        square = accuracy.simulated**2
        root = np.sqrt(square.mean(axis=0))
        spread = square.std(axis=0, ddof=1) if len(square) > 1 else np.full(3, np.nan)
        error = spread / np.sqrt(len(square)) / (2.0 * root)
        for k, part in enumerate(PARTS):
            row |= {
                f"predicted_{part}": float(accuracy.predicted[k] * SCALES[k]),
                f"simulated_{part}": float(root[k] * SCALES[k]),
                f"simulated_{part}_se": float(error[k] * SCALES[k]),
            }
        row["mean_position_um"] = float(accuracy.positions.mean() * MICROMETRES)
        row["parameters_rms"] = float(np.sqrt(np.mean(accuracy.parameters**2)))
        row["n_machines"], row["n_failed"] = len(square), accuracy.n_failed
        rows.append(row)
    return pd.DataFrame(rows)


def summarise_selections(selections: pd.DataFrame) -> pd.DataFrame:
    """Return the criterion's best, mean and standard deviation over repeats."""
    groups = selections.groupby(KEY, sort=False)["value"]
    table = groups.agg(["max", "mean", "std", "count"]).reset_index()
    return table.rename(columns={"max": "best", "std": "sd", "count": "repeats"})


def summarise_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Return pose errors as mean over repeats, with standard deviation and standard error.

    Of one repeat alone the standard error is that of its machines.
    """
    rows = []
    for key, group in errors.groupby(KEY, sort=False):
        row = dict(zip(KEY, key, strict=True)) | {"repeats": len(group)}
        for part in PARTS:
            row[f"predicted_{part}"] = group[f"predicted_{part}"].mean()
            values = group[f"simulated_{part}"]
            row[f"simulated_{part}"] = values.mean()
            row[f"simulated_{part}_sd"] = values.std() if len(group) > 1 else np.nan
            alone = group[f"simulated_{part}_se"].iloc[0]
            row[f"simulated_{part}_se"] = values.std() / np.sqrt(len(group)) if len(group) > 1 else alone
        means = group["mean_position_um"]
        row |= {"mean_position_um": means.mean(), "mean_position_um_sd": means.std()}
        row |= {"parameters_rms": group["parameters_rms"].mean(), "n_failed": int(group["n_failed"].sum())}
        rows.append(row)
    return pd.DataFrame(rows)


def compare_published(inputs: SelectionInputs, summary: pd.DataFrame) -> pd.DataFrame | None:
    """Return published values of criteria beside those found; None where none are given."""
    published = inputs.published
    if published is None:
        return None
    merged = summary.merge(published, on=KEY, how="inner")
    if merged.empty:
        return None
    merged["ratio"] = merged["best"] / merged["published"]
    merged["ratio_of_mean"] = merged["mean"] / merged["published"]
    return merged


def format_plans(inputs: SelectionInputs, outcomes: list[JudgedPoses]) -> dict[str, str]:
    """Return CSV texts of the best set of each label, criterion and number: actuator displacements in mm.

    Names of files to texts; an audit's plan of kind ``file`` reads them.
    """
    best: dict[tuple[str, str, int], JudgedPoses] = {}
    for outcome in outcomes:
        task, chosen = outcome.task, outcome.selection
        if chosen is None or task.criterion == DESIGN:
            continue
        key = (task.label, task.criterion, task.n_poses)
        before = best.get(key)
        if before is None or before.selection is None or chosen.value > before.selection.value:
            best[key] = outcome
    start = inputs.design.knowledge.machine.mechanism.initial_actuator_positions
    columns = [f"drho_{k}_mm" for k in range(1, len(start) + 1)]
    texts = {}
    for (label, criterion, n), outcome in best.items():
        rows = [[f"{x + 0.0:.6f}" for x in row] for row in np.round(outcome.actuators - start, 6)]
        comment = f"{inputs.config.name}: {n} poses, criterion {criterion}, {label}; displacements, mm"
        texts[f"{label}_{criterion}_{n}.csv"] = format_table([comment], columns, rows)
    return texts


def _key(task: Task) -> dict[str, str | int]:
    return {"label": task.label, "criterion": task.criterion, "n_poses": task.n_poses, "repeat": task.repeat + 1}


def _tabulate_values(outcomes: list[JudgedPoses], what: str) -> pd.DataFrame:
    parts = []
    for outcome in outcomes:
        if outcome.selection is None:
            continue
        trace = outcome.selection.trace
        first = 1 if what == "set" else 0
        parts.append(pd.DataFrame(_key(outcome.task) | {what: np.arange(first, first + len(trace)), "value": trace}))
    columns = [*KEY, "repeat", what, "value"]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)
