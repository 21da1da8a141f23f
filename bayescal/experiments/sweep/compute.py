"""Members of a sweep side by side, each computed once, and the table of their figures."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.pool import open_pool
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sweep.answers import COLUMNS, NUMBERS, find_answers
from bayescal.experiments.sweep.inputs import SweepInputs
from bayescal.experiments.sweep.keys import Setting, look_up
from bayescal.experiments.sweep.members import Outcome, compute_member
from bayescal.experiments.sweep.schema import SweepConfig

DONE, UNSURE, FAILED = "done", "not converged", "failed"


def compute_sweep(inputs: SweepInputs, run: Run) -> Results:
    """Return the table of all members and what it answers; members that fail are in it, with the reason."""
    taken, addresses, tasks, faults = _plan(inputs)
    found, lost = _keep(inputs.config, run).attempt("members", compute_member, inputs.base, tasks, (Outcome,))
    faults |= {address: Outcome.from_failure(fault) for address, fault in lost.items()}
    outcomes = [found.get(address) or faults[address] for address in addresses]
    members = _tabulate(inputs.config, taken, outcomes)
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


def _tabulate(config: SweepConfig, taken: list[tuple[Any, ...]], outcomes: list[Outcome]) -> pd.DataFrame:
    """Return a row per member: what its axes take, its figures, and what became of it."""
    columns: dict[str, list[Any]] = {
        axis.name: [_show(values[k]) for values in taken] for k, axis in enumerate(config.axes)
    }
    columns |= {figure.key: [] for figure in config.figures}
    for outcome in outcomes:  # one summary at a time: thousands of them, unpacked, take gigabytes
        summary = outcome.read()
        for figure in config.figures:
            columns[figure.key].append(_show(look_up(summary, figure.key)))
    columns["state"] = [_say(outcome) for outcome in outcomes]
    columns["reason"] = [outcome.failure for outcome in outcomes]
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
