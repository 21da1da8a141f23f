"""Running an experiment on pose selection: its tables, plans, figures and page, put in place as a whole."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pandas as pd

from bayescal.config.load import dump_config
from bayescal.config.selection_schema import SelectionConfig
from bayescal.report.experiment_page import write_experiment_page
from bayescal.selection_study import tables as made
from bayescal.selection_study.compare import name_ways
from bayescal.selection_study.inputs import SelectionInputs, read_selection
from bayescal.selection_study.page import build_page
from bayescal.selection_study.tasks import Outcome, run_tasks
from bayescal.selection_study.verdict import Tables, state_headline, state_verdict
from bayescal.study.inputs import hash_identity
from bayescal.study.store import PROVENANCE_FILE, Store

PAGE = "report.html"


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
    staged = store.stage()
    _write(staged, inputs, outcomes, tables, identity)
    write_experiment_page(build_page(inputs, tables), staged)
    store.publish()
    lines = [state_headline(tables), *(f"{s.lead}: {s.text}" for s in state_verdict(tables))]
    return "\n".join([*lines, f"report: {out / PAGE}"])


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
    """Return what determines the results: the config, and its files by their hashes."""
    named = [config.mechanism, *(design.configurations for design in config.designs)]
    named += [] if config.measured is None else [config.measured.configurations]
    named += [] if config.published is None or config.published.table is None else [config.published.table]
    files = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in named}
    return {"config": {k: v for k, v in dump_config(config).items() if k != "title"}, "files": files}


def _write(
    folder: Path, inputs: SelectionInputs, outcomes: list[Outcome], tables: Tables, identity: dict[str, Any]
) -> None:
    every = {
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
    for name, table in every.items():
        if table is not None and not table.empty:
            table.to_csv(folder / f"{name}.csv", index=False, float_format=made.FORMAT, lineterminator="\n")
    (folder / "plans").mkdir()
    for name, text in made.format_plans(inputs, outcomes).items():
        (folder / "plans" / name).write_text(text, encoding="utf-8")
    said = [{"lead": s.lead, "text": s.text, "level": s.level} for s in state_verdict(tables)]
    summary = {"name": inputs.config.name, "headline": state_headline(tables), "verdict": said}
    _write_json(folder / "summary.json", summary)
    _write_json(folder / PROVENANCE_FILE, {"config_sha256": hash_identity(identity), **identity})


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
