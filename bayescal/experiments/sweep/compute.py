"""Members of a sweep side by side, each computed once, and the table of their figures."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.parallel import Failed, Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.frame.store import open_pool
from bayescal.experiments.sweep.answers import COLUMNS, NUMBERS, find_answers
from bayescal.experiments.sweep.inputs import SweepInputs
from bayescal.experiments.sweep.members import Outcome, Setting, compute_member, look_up
from bayescal.experiments.sweep.schema import SweepConfig

DONE, UNSURE, FAILED = "done", "not converged", "failed"

type Row = list[Any]
"""Of a member: its figures, its state and why."""


def compute_sweep(inputs: SweepInputs, run: Run) -> Results:
    """Return the table of all members and what it answers; members that fail are in it, with the reason."""
    taken, addresses, tasks, faults = _plan(inputs)
    rows = {address: _read_row(inputs.config, fault) for address, fault in faults.items()}
    run = _keep(inputs.config, run)
    for address, outcome in run.stream("members", compute_member, inputs.base, tasks, (Outcome,)):
        known = Outcome.from_failure(outcome.reason) if isinstance(outcome, Failed) else outcome
        rows[address] = _read_row(inputs.config, known)
    members = _tabulate(inputs.config, taken, [rows[address] for address in addresses])
    answers = find_answers(inputs.config, members)
    return Results(
        _summarise(inputs.config, members, len(set(addresses)), answers),
        {"members": members, "answers": pd.DataFrame(answers, columns=list(COLUMNS)).astype(NUMBERS)},
    )


def _plan(
    inputs: SweepInputs,
) -> tuple[list[tuple[Any, ...]], list[str], dict[str, tuple[Setting, ...]], dict[str, Outcome]]:
    """Return what each member takes and its address, what is to be computed, and members that are no experiments."""
    taken, addresses, tasks, faults = [], [], {}, {}
    for values, settings in inputs.list_members():
        try:
            address = inputs.find_address(settings)
            tasks[address] = settings
        except InputError as error:
            address = json.dumps(settings)
            faults[address] = Outcome.from_failure(str(error))
        taken.append(values)
        addresses.append(address)
    return taken, addresses, tasks, faults


def _keep(config: SweepConfig, run: Run) -> Run:
    """Return the run that keeps members beside its results directory, for other sweeps too."""
    if run.store is None or not config.cache:
        return run
    return replace(run, store=open_pool(run.store.out.resolve().parent / config.cache))


def _read_row(config: SweepConfig, outcome: Outcome) -> Row:
    """Return what the table has of a member; of thousands, unpacked or packed, whole summaries would take gigabytes."""
    summary = outcome.read()
    return [*(_show(look_up(summary, figure.key)) for figure in config.figures), _say(outcome), outcome.failure]


def _tabulate(config: SweepConfig, taken: list[tuple[Any, ...]], rows: list[Row]) -> pd.DataFrame:
    """Return a row per member: what its axes take, its figures, and what became of it."""
    names = [*(figure.key for figure in config.figures), "state", "reason"]
    columns: dict[str, list[Any]] = {
        axis.name: [_show(values[k]) for values in taken] for k, axis in enumerate(config.axes)
    }
    columns |= {name: [row[k] for row in rows] for k, name in enumerate(names)}
    return pd.DataFrame({name: _unify(values) for name, values in columns.items()})


def _say(outcome: Outcome) -> str:
    return FAILED if not outcome.has_summary else UNSURE if outcome.failure else DONE


def _show(value: Any) -> Any:
    """Return a number or a text as it is, a truth value as a number, anything else as JSON."""
    if isinstance(value, bool):
        return int(value)
    return value if value is None or isinstance(value, int | float | str) else json.dumps(value)


def _unify(values: list[Any]) -> pd.Series:
    """Return a column of numbers, or of texts where not all are."""
    if all(isinstance(value, int | float) or value is None for value in values):
        return pd.Series([float("nan") if value is None else float(value) for value in values], dtype=float)
    return pd.Series(["" if value is None else str(value) for value in values], dtype=object)


def _summarise(
    config: SweepConfig, members: pd.DataFrame, n_distinct: int, answers: list[dict[str, Any]]
) -> dict[str, Any]:
    figures = {}
    for figure in config.figures:
        column = members[figure.key]
        known = column.dropna() if column.dtype.kind == "f" else column[:0]
        spread = {"least": float(known.min()), "most": float(known.max())} if len(known) else {}
        figures[figure.key] = {"n_known": len(known), **spread}
    states = members["state"]
    return {
        "name": config.name,
        "title": config.title,
        "experiment": config.experiment,
        "n_members": len(members),
        "n_distinct": n_distinct,
        "n_failed": int((states == FAILED).sum()),
        "n_not_converged": int((states == UNSURE).sum()),
        "figures": figures,
        "answers": answers,
    }
