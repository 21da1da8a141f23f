"""Computing an experiment on pose selection: its selections, what calibrations with them achieve, tables and plans."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.config.registry import is_own
from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.selection.inputs import SelectionInputs
from bayescal.experiments.selection.rows import (
    CalibrationErrorRow,
    CalibrationErrorSummaryRow,
    RandomSetRow,
    SelectedPlanRow,
    SelectionClassRow,
    SelectionRow,
    SelectionSummaryRow,
    SelectionTimeRow,
    SelectionTraceRow,
)
from bayescal.experiments.selection.schema import label_of
from bayescal.files.csv_tables import format_table
from bayescal.identifiability.information import information_of_rows
from bayescal.identifiability.pose_volume import AXES
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from bayescal.pose_selection import SelectedPoses, SelectionProblem, select
from bayescal.pose_selection.calibrations import compute_workspace_errors, simulate_calibrations

SETS, MACHINES = 2, 3  # streams of random numbers
UNKNOWN = 1e-8  # weight of the tolerances where the identification does not know them
DESIGN, RANDOM = "given", "random"
KEY = ["label", "criterion", "n_poses"]
SCALES = {"position_um": 1.0 / MICROMETRE, "rotation_arcsec": 1.0 / ARCSECOND, "over_limits": 1.0}
BOUNDARY_FRACTION = 0.95  # of the box: a pose beyond counts as at its boundary


def compute_selections(inputs: SelectionInputs, run: Run) -> Results:
    """Return what an experiment found."""
    tasks = {f"{k} {task.label} {task.criterion} {task.n_poses}": task for k, task in enumerate(list_tasks(inputs))}
    longest = dict(sorted(tasks.items(), key=lambda pair: -pair[1].n_poses))
    found = run.map("selections", run_one, inputs, longest, (JudgedPoses,))
    chosen = [found[name] for name in tasks]
    summary = {
        "name": inputs.config.name,
        "machine": inputs.design.machine.mechanism.name,
        "n_parameters": len(inputs.design.sd),
        "n_measured": None if inputs.measured is None else len(inputs.measured),
    }
    return Results(summary, tabulate(inputs, chosen), format_plans(inputs, chosen))


# --- selections --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Task:
    """One selection to make; ``criterion`` is `DESIGN` for a set of poses that somebody else has chosen.

    ``choice`` counts the config's selections, None for such a set; ``is_histogram`` says whether it judges many random
    sets to see how they spread.
    """

    label: str
    criterion: str
    n_poses: int
    repeat: int
    choice: int | None
    is_histogram: bool = False


@dataclass(frozen=True, eq=False)
class JudgedPoses:
    """A set of poses and what it is worth."""

    task: Task
    selection: SelectedPoses | None  # None for a set that somebody else has chosen
    actuators: Array  # (n, N), mm
    moves: Array  # (n, 6): displacements from home, mm and rad
    indices: dict[str, float]  # by name: O1 to O5
    accuracy: dict[str, float] | None  # after calibrations, by column
    seconds: float  # that the selection took


def list_tasks(inputs: SelectionInputs) -> list[Task]:
    """Return the selections of an experiment in the order of its config, then the designs of others.

    A design is repeated as often as a selection where calibrations are simulated, each time with other machines.
    """
    tasks = [
        Task(label_of(choice), criterion, n, repeat, place, choice.is_best_of_many)
        for place, choice in enumerate(inputs.config.selections)
        for criterion in map(label_class, choice.criteria)
        for n in choice.n_poses
        for repeat in range(choice.repeats)
    ]
    often = 1 if inputs.config.calibrations is None else max(choice.repeats for choice in inputs.config.selections)
    designs = [(name, len(poses), repeat) for name, poses in inputs.designs.items() for repeat in range(often)]
    return tasks + [Task(name, DESIGN, n, repeat, None) for name, n, repeat in designs]


def run_one(inputs: SelectionInputs, task: Task) -> JudgedPoses:
    """Return the outcome of a task: sets of the same repeat start alike, machines of the same repeat are the same."""
    began, selection, config = time.perf_counter(), None, inputs.config
    if task.choice is None:
        actuators = inputs.designs[task.label]
        moves = inputs.domain.at_actuators(actuators).moves
    else:
        candidates, criterion = inputs.candidates(task.repeat), inputs.criterion(task.criterion)
        problem = SelectionProblem(candidates, criterion, task.n_poses, inputs.measured)
        rng = np.random.default_rng([config.seed, SETS, task.n_poses, task.repeat])
        selection = select(problem, inputs.method(config.selections[task.choice]), rng)
        actuators, moves = selection.actuators, selection.placed.moves
    seconds = time.perf_counter() - began
    whole = actuators if inputs.measured is None else np.concatenate([inputs.measured, actuators])
    accuracy = None
    if (wanted := config.calibrations) is not None:
        rng = np.random.default_rng([config.seed, MACHINES, task.repeat])
        accuracy = judge_poses(inputs, whole, wanted.machines, rng, wanted.use_priors)
    return JudgedPoses(task, selection, actuators, moves, inputs.indices(whole), accuracy, seconds)


# --- calibrations ------------------------------------------------------------------------------------------------


def judge_poses(
    inputs: SelectionInputs, actuators: Array, n_machines: int, rng: np.random.Generator, known: bool = True
) -> dict[str, float]:
    """Return pose errors over the workspace after calibrations with poses at actuator positions (n, N), as a row.

    Machines are drawn within the tolerances, the same ones for the same generator; the identification knows these, or
    is least squares weighted by the noise. ``simulated`` is the root mean square over machines, comparable with
    ``predicted`` to first order, with its standard error. Machines that the one as expected cannot fit, or that have no
    pose somewhere, have failed and count in nothing else.
    """
    seen, weight = inputs.see(actuators), 1.0 if known else UNKNOWN
    # errors of an identification are K Rᵀ ε - w K z with K = (w + Λ)⁻¹, of covariance K (Λ + w²) K; (1 + Λ)⁻¹ for w = 1
    values, vectors = information_of_rows(seen.rows, np.ones(len(inputs.design.sd))).spectrum()
    covariance = (vectors * ((values + weight**2) / (values + weight) ** 2)) @ vectors.T
    slope = inputs.workspace.located.tool
    variance = np.einsum("wij,jk,wik->wi", slope, covariance, slope, optimize=True).mean(axis=0)
    found = simulate_calibrations(seen, n_machines, rng, weight)
    errors = compute_workspace_errors(inputs.design, found, inputs.workspace_actuators)
    good = np.isfinite(errors).all(axis=(1, 2))
    if not good.any():
        raise InputError(f"calibrations: found none of {n_machines} converged, expected more poses or tolerances")
    square = errors[good] ** 2
    parts = (square[..., :3], square[..., 3:], square / inputs.limits**2)
    of_machines = np.stack([np.sqrt(part.sum(axis=-1).mean(axis=1)) for part in parts], axis=1) ** 2  # (B, 3)
    predicted = np.sqrt([variance[:3].sum(), variance[3:].sum(), (variance / inputs.limits**2).sum()])
    root = np.sqrt(of_machines.mean(axis=0))
    spread = of_machines.std(axis=0, ddof=1) if len(square) > 1 else np.full(3, np.nan)
    error = spread / np.sqrt(len(square)) / (2.0 * root)
    row = dict[str, float]()
    for k, (part, scale) in enumerate(SCALES.items()):
        row[f"predicted_{part}"] = float(predicted[k] * scale)
        row[f"simulated_{part}"] = float(root[k] * scale)
        row[f"simulated_{part}_se"] = float(error[k] * scale)
    distances = np.sqrt(square[..., :3].sum(axis=-1)).mean(axis=1)
    row["mean_position_um"] = float(distances.mean() / MICROMETRE)
    in_tolerances = np.sqrt(np.mean(found.errors[good] ** 2, axis=1))
    row["parameters_rms"] = float(np.sqrt(np.mean(in_tolerances**2)))
    return row | {"n_machines": len(square), "n_failed": int(n_machines - good.sum())}


# --- tables ------------------------------------------------------------------------------------------------------


def tabulate(inputs: SelectionInputs, chosen: list[JudgedPoses]) -> dict[str, pd.DataFrame]:
    """Return all tables of an experiment."""
    judged = pd.DataFrame([_key(o.task) | o.accuracy for o in chosen if o.accuracy is not None])
    errors = (
        pd.DataFrame() if judged.empty else CalibrationErrorRow.tabulate(name=name_ways(judged), **_columns(judged))
    )
    selections = SelectionRow.collect(map(describe_selection, chosen))
    summary = selections.groupby(KEY, sort=False)["value"].agg(["max", "mean", "std", "count"]).reset_index()
    classes = list_classes(inputs)
    made = [(_key(one.task), one, one.selection) for one in chosen if one.selection is not None]
    return {
        **({"classes": SelectionClassRow.collect(classes)} if classes else {}),
        "selections": selections,
        "selection_summary": SelectionSummaryRow.tabulate(
            **_columns(summary.rename(columns={"max": "best", "std": "sd", "count": "n_repeats"}))
        ),
        "poses": tabulate_poses(inputs, chosen),
        "traces": SelectionTraceRow.collect(
            SelectionTraceRow(**key, iteration=k, value=value)
            for key, one, selection in made
            if not one.task.is_histogram
            for k, value in enumerate(selection.trace)
        ),
        "random_sets": RandomSetRow.collect(
            RandomSetRow(**key, set=k, value=value)
            for key, one, selection in made
            if one.task.is_histogram
            for k, value in enumerate(selection.trace, start=1)
        ),
        "timings": SelectionTimeRow.collect(SelectionTimeRow(**key, seconds=one.seconds) for key, one, _ in made),
        "errors": errors,
        "error_summary": errors if errors.empty else summarise_errors(errors),
    }


def _columns(table: pd.DataFrame) -> dict[str, pd.Series]:
    return {str(name): column for name, column in table.items()}


def describe_selection(outcome: JudgedPoses) -> SelectionRow:
    """Return a selection as a row; the time it took is apart, in ``timings``."""
    chosen = outcome.selection
    if chosen is None:
        return SelectionRow(
            **_key(outcome.task),
            method="given",
            value=outcome.indices.get(outcome.task.criterion, np.nan),
            others=outcome.indices,
            n_evaluations=0,
            n_iterations=0,
            converged=True,
            reason="",
            boundary_fraction=np.nan,
        )
    return SelectionRow(
        **_key(outcome.task),
        method=chosen.method,
        value=chosen.value,
        others=outcome.indices,
        n_evaluations=chosen.n_evaluations,
        n_iterations=len(chosen.trace) - 1,
        converged=chosen.converged,
        reason=chosen.reason,
        boundary_fraction=float(np.mean(np.abs(chosen.shares).max(axis=1) > BOUNDARY_FRACTION)),
    )


def list_classes(inputs: SelectionInputs) -> list[SelectionClassRow]:
    """Return user-defined criteria and methods; none of built-in ones, which every page knows."""
    config = inputs.config
    criteria = [inputs.criterion(label) for label in config.criteria]
    methods = [inputs.method(choice) for choice in config.selections]
    found = [
        *(
            SelectionClassRow(role="criterion", name=c.name, title=c.title, source=c.source)
            for c in criteria
            if is_own(type(c))
        ),
        *(
            SelectionClassRow(role="method", name=m.name, title=m.title, source=m.source)
            for m in methods
            if is_own(type(m))
        ),
    ]
    return list(dict.fromkeys(found))


def tabulate_poses(inputs: SelectionInputs, outcomes: list[JudgedPoses]) -> pd.DataFrame:
    """Return one row per chosen pose: displacements from home, and of the actuators from their initial positions."""
    start = inputs.design.machine.mechanism.initial_actuator_positions
    columns = [f"{axis.replace(' ', '_')}_{'mm' if k < 3 else 'deg'}" for k, axis in enumerate(AXES)]
    legs = [f"drho_{k}_mm" for k in range(1, len(start) + 1)]
    parts = []
    for outcome in outcomes:
        moves = np.concatenate([outcome.moves[:, :3], np.degrees(outcome.moves[:, 3:])], axis=1)
        where = np.concatenate([moves, outcome.actuators - start], axis=1)
        others = dict(zip([*columns, *legs], where.T, strict=True))
        parts.append(SelectedPlanRow.tabulate(others, **_key(outcome.task), pose=np.arange(1, len(where) + 1)))
    return pd.concat(parts, ignore_index=True)


def name_ways(table: pd.DataFrame) -> pd.Series:
    """Return what each row's way to choose is called: label, criterion, or both, whichever tells them apart.

    Labels go by themselves where each has one criterion, criteria where each has one label. Random sets know no
    criterion.
    """
    plain = (table["label"] == RANDOM) | (table["criterion"] == DESIGN)
    found = table.loc[~plain, ["label", "criterion"]].drop_duplicates()
    if len(found) == found["label"].nunique():
        return table["label"].astype(str)
    one_label = len(found) == found["criterion"].nunique()
    names = table["criterion"] if one_label else table["label"] + ", " + table["criterion"]
    return names.mask(plain, table["label"])


def summarise_errors(errors: pd.DataFrame) -> pd.DataFrame:
    """Return pose errors as mean over repeats, with standard deviation and standard error.

    Of one repeat alone the standard error is that of its machines.
    """
    groups = errors.groupby(KEY, sort=False)
    n, mean, sd = groups.size(), groups.mean(numeric_only=True), groups.std(numeric_only=True)
    table = pd.DataFrame({"n_repeats": n})
    for part in SCALES:
        table[f"predicted_{part}"] = mean[f"predicted_{part}"]
        simulated = f"simulated_{part}"
        table[simulated], table[f"{simulated}_sd"] = mean[simulated], sd[simulated]
        table[f"{simulated}_se"] = (sd[simulated] / np.sqrt(n)).where(n > 1, mean[f"{simulated}_se"])
    table["mean_position_um"], table["mean_position_um_sd"] = mean["mean_position_um"], sd["mean_position_um"]
    table["parameters_rms"], table["n_failed"] = mean["parameters_rms"], groups["n_failed"].sum()
    table = table.reset_index()
    return CalibrationErrorSummaryRow.tabulate(name=name_ways(table), **_columns(table))


def format_plans(inputs: SelectionInputs, outcomes: list[JudgedPoses]) -> dict[str, str]:
    """Return CSV texts of the best set of each label, criterion and number: actuator displacements in mm.

    Names of files to texts; an audit's plan of kind ``file`` reads them.
    """
    best: dict[tuple[str, str, int], JudgedPoses] = {}
    for outcome in outcomes:
        task, chosen = outcome.task, outcome.selection
        if chosen is None:
            continue
        key = (task.label, task.criterion, task.n_poses)
        before = best.get(key)
        if before is None or before.selection is None or chosen.value > before.selection.value:
            best[key] = outcome
    start = inputs.design.machine.mechanism.initial_actuator_positions
    columns = [f"drho_{k}_mm" for k in range(1, len(start) + 1)]
    texts = {}
    for (label, criterion, n), outcome in best.items():
        rows = [[f"{x + 0.0:.6f}" for x in row] for row in np.round(outcome.actuators - start, 6)]
        comment = f"{inputs.config.name}: {n} poses, criterion {criterion}, {label}; displacements, mm"
        texts[str(Path("plans") / f"{label}_{criterion}_{n}.csv")] = format_table([comment], columns, rows)
    return texts


class _SelectionKey(TypedDict):
    label: str
    criterion: str
    n_poses: int
    repeat: int


def _key(task: Task) -> _SelectionKey:
    return {"label": task.label, "criterion": task.criterion, "n_poses": task.n_poses, "repeat": task.repeat + 1}
