"""Computing an experiment on pose selection: its selections, their tables and plans."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.selection.compare import name_ways
from bayescal.experiments.selection.inputs import SelectionInputs
from bayescal.experiments.selection.tables import (
    compare_published,
    format_plans,
    summarise_errors,
    summarise_selections,
    tabulate_classes,
    tabulate_errors,
    tabulate_poses,
    tabulate_random_sets,
    tabulate_selections,
    tabulate_timings,
    tabulate_traces,
)
from bayescal.experiments.selection.tasks import JudgedPoses, run_tasks


def compute_selections(inputs: SelectionInputs, run: Run) -> Results:
    """Return what an experiment found."""
    chosen = run_tasks(inputs, run)
    summary = {
        "name": inputs.config.name,
        "machine": inputs.design.knowledge.machine.mechanism.name,
        "n_parameters": len(inputs.design.knowledge.sd),
        "n_measured": None if inputs.measured is None else len(inputs.measured),
    }
    plans = {str(Path("plans") / name): text for name, text in format_plans(inputs, chosen).items()}
    return Results(summary, tabulate(inputs, chosen), plans)


def tabulate(inputs: SelectionInputs, chosen: list[JudgedPoses]) -> dict[str, pd.DataFrame]:
    """Return all tables of an experiment."""
    selections = tabulate_selections(chosen)
    summary = summarise_selections(selections)
    errors, error_summary = tabulate_errors(chosen), pd.DataFrame()
    if not errors.empty:
        errors.insert(0, "name", name_ways(errors))
        error_summary = summarise_errors(errors)
        error_summary.insert(0, "name", name_ways(error_summary))
    published, classes = compare_published(inputs, summary), tabulate_classes(inputs)
    return {
        **({} if classes.empty else {"classes": classes}),
        "selections": selections,
        "selection_summary": summary,
        "poses": tabulate_poses(inputs, chosen),
        "traces": tabulate_traces(chosen),
        "random_sets": tabulate_random_sets(chosen),
        "timings": tabulate_timings(chosen),
        "published": pd.DataFrame() if published is None else published,
        "errors": errors,
        "error_summary": error_summary,
    }
