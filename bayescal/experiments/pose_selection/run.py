"""Running an experiment on pose selection: its tables, plans, figures and page, put in place as a whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from bayescal.experiments.frame.run import identify_experiment, publish
from bayescal.experiments.frame.store import Store
from bayescal.experiments.pose_selection import tables as made
from bayescal.experiments.pose_selection.compare import name_ways
from bayescal.experiments.pose_selection.inputs import SelectionInputs, read_selection
from bayescal.experiments.pose_selection.page import build_page
from bayescal.experiments.pose_selection.schema import SelectionConfig
from bayescal.experiments.pose_selection.tasks import Outcome, run_tasks
from bayescal.experiments.pose_selection.verdict import Tables

DIGITS = 12


def run_pose_selection(config: SelectionConfig, folder: Path, out: Path, workers: int = 1) -> str:
    """Run an experiment, put its results in ``out`` and return them in a few lines.

    Parameters
    ----------
    config : SelectionConfig
    folder : Path
        Where the config's file names start.
    out : Path
        Directory for the results; all of them or nothing.
    workers : int
        Processes; the results do not depend on it.

    Raises
    ------
    InputError
        For anything at fault in the config or its files, or where ``out`` holds results of another config.
    """
    inputs = read_selection(config, folder)
    identity = identify_selection(config, folder)
    store = Store(out)
    store.check_results(identity)
    outcomes = run_tasks(inputs, workers)
    tables = tabulate(inputs, folder, outcomes)
    return publish(
        store,
        identity,
        _list_tables(inputs, outcomes, tables),
        {"name": config.name},
        build_page(inputs, tables),
        DIGITS,
        lambda staged: _write_plans(inputs, outcomes, staged),
    )


def tabulate(inputs: SelectionInputs, folder: Path, outcomes: list[Outcome]) -> Tables:
    """Return all tables of an experiment."""
    selections = made.tabulate_selections(outcomes)
    summary = made.summarise_selections(selections)
    errors = made.tabulate_errors(outcomes)
    error_summary = pd.DataFrame()
    if not errors.empty:
        errors.insert(0, "name", name_ways(errors))
        error_summary = made.summarise_errors(errors)
        error_summary.insert(0, "name", name_ways(error_summary))
    return Tables(
        inputs.config,
        selections,
        summary,
        made.compare_published(inputs, folder, summary),
        made.tabulate_random_sets(outcomes),
        made.tabulate_traces(outcomes),
        errors,
        error_summary,
        made.tabulate_timings(outcomes),
    )


def identify_selection(config: SelectionConfig, folder: Path) -> dict[str, Any]:
    """Return what determines the results."""
    named: list[str | None] = [config.mechanism, *(design.configurations for design in config.designs)]
    named += [] if config.measured is None else [config.measured.configurations]
    named += [] if config.published is None else [config.published.table]
    return identify_experiment(config, folder, named)


def _list_tables(inputs: SelectionInputs, outcomes: list[Outcome], tables: Tables) -> dict[str, pd.DataFrame | None]:
    return {
        "selections": tables.selections,
        "selection_summary": tables.summary,
        "poses": made.tabulate_poses(inputs, outcomes),
        "traces": tables.traces,
        "random_sets": tables.random_sets,
        "timings": tables.timings,
        "published": tables.published,
        "errors": tables.errors,
        "error_summary": tables.error_summary,
    }


def _write_plans(inputs: SelectionInputs, outcomes: list[Outcome], staged: Path) -> None:
    (staged / "plans").mkdir()
    for name, text in made.format_plans(inputs, outcomes).items():
        (staged / "plans" / name).write_text(text, encoding="utf-8")
