"""Members of a sweep side by side, each computed once, and the table of their figures."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from difflib import get_close_matches
from typing import Any, Final

import numpy as np
import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.runner.parallel import Failed, Run
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.runner.store import open_pool
from bayescal.experiments.sweep.inputs import Outcome, Setting, SweepInputs, compute_member, list_keys, look_up
from bayescal.experiments.sweep.rows import Extent, SweepAnswerRow, SweepMemberRow
from bayescal.experiments.sweep.schema import SEED, AxisConfig, FigureConfig, SweepConfig
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_plain

DONE, UNSURE, FAILED = "done", "not converged", "failed"
ALWAYS: Final = "everywhere"
NEVER: Final = "nowhere"
UP_TO: Final = "up to"
FROM: Final = "from"
MIXED: Final = "in places"


def compute_sweep(inputs: SweepInputs, run: Run) -> Results:
    """Return the table of all members and what it answers; members that fail are in it, with the reason."""
    config = inputs.config
    taken, addresses, tasks, rows = [], list[str](), dict[str, tuple[Setting, ...]](), dict[str, list[object]]()
    for values, settings in inputs.list_members():
        try:
            address = inputs.find_address(settings)
            tasks[address] = settings
        except InputError as error:  # no experiment
            address = json.dumps(settings)
            rows[address] = _read_row(config, Outcome.of(str(error)))
        taken.append(values)
        addresses.append(address)
    if run.store is not None and config.cache_dir:  # members are kept beside the results, for other sweeps too
        run = replace(run, store=open_pool(run.store.out.resolve().parent / config.cache_dir))
    is_told = False
    for address, outcome in run.stream("members", compute_member, inputs.base, tasks, (Outcome,)):
        known = Outcome.of(outcome.reason) if isinstance(outcome, Failed) else outcome
        if known.has_summary and not is_told:
            _check_figures(config, known.read())
            is_told = True
        rows[address] = _read_row(config, known)
    members = _tabulate(config, taken, [rows[address] for address in addresses])
    answers = find_answers(config, members)
    return Results(
        _summarise(config, members, len(set(addresses)), answers),
        {"members": members, "answers": SweepAnswerRow.collect(answers)},
    )


def _check_figures(config: SweepConfig, summary: Summary) -> None:
    """Raise InputError where the summary of the first member that is done has none of the figures."""
    keys = [figure.key for figure in config.figures]
    if all(look_up(summary, key) is None for key in keys):
        near = get_close_matches(keys[0], list_keys(summary), 1, 0.0)
        said = f", expected such as {near[0]!r}" if near else ""
        raise InputError(f"figures: found none of {', '.join(keys)} in the first summary{said}")


def _read_row(config: SweepConfig, outcome: Outcome) -> list[object]:
    """Return a member's figures, its state and why; of thousands whole summaries, even packed, would take gigabytes."""
    summary = outcome.read()
    state = FAILED if not outcome.has_summary else UNSURE if outcome.failure else DONE
    return [*(_show(look_up(summary, figure.key)) for figure in config.figures), state, outcome.failure]


def _tabulate(config: SweepConfig, taken: list[tuple[object, ...]], rows: list[list[object]]) -> pd.DataFrame:
    """Return a row per member: what its axes take, its figures, and what became of it."""
    names = [*(figure.key for figure in config.figures), "state", "reason"]
    columns: dict[str, list[Any]] = {
        axis.name: [_show(values[k]) for values in taken] for k, axis in enumerate(config.axes)
    }
    columns |= {name: [row[k] for row in rows] for k, name in enumerate(names)}
    found: dict[str, pd.Series] = {}
    for name, values in columns.items():
        if all(isinstance(value, int | float) or value is None for value in values):
            found[name] = pd.Series([float("nan") if value is None else float(value) for value in values], dtype=float)
        else:  # texts where not all are numbers
            found[name] = pd.Series(["" if value is None else str(value) for value in values], dtype=object)
    state, reason = found.pop("state"), found.pop("reason")
    return SweepMemberRow.tabulate(found, state=state, reason=reason)


def _show(value: object) -> object:
    """Return a number or a text as it is, a truth value as a number, anything else as JSON."""
    if isinstance(value, bool):
        return int(value)
    return value if value is None or isinstance(value, int | float | str) else json.dumps(value)


def _summarise(config: SweepConfig, members: pd.DataFrame, n_distinct: int, answers: list[SweepAnswerRow]) -> Summary:
    figures = {}
    for figure in config.figures:
        column = members[figure.key]
        is_number = column.dtype.kind == "f"
        known = column.dropna() if is_number else column[column != ""]
        spread = {"min": float(known.min()), "max": float(known.max())} if is_number and len(known) else {}
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
        "answers": [asdict(one) for one in answers],
    }


def list_missing(summary: Summary) -> list[str]:
    """Return the figures that are in no member's summary; none where all members failed."""
    if summary["n_failed"] == summary["n_members"]:
        return []
    return [key for key, one in summary["figures"].items() if one["n_known"] == 0]


def is_scale(axis: AxisConfig, column: pd.Series) -> bool:
    """Whether an axis takes two different numbers at least; seeds only repeat."""
    return axis.name != SEED and column.dtype.kind == "f" and column.nunique() >= 2


def find_answers(config: SweepConfig, members: pd.DataFrame) -> list[SweepAnswerRow]:
    """Return, for every figure of which something is required and every axis of numbers, where it is met.

    Bounds are interpolated between their neighbours, on the scales of axis and figure.
    """
    found = list[SweepAnswerRow]()
    for figure in config.figures:
        if figure.limit is None or members[figure.key].dtype.kind != "f":
            continue
        for axis in config.axes:
            if not is_scale(axis, members[axis.name]):
                continue
            for setting, rows in group_others(config, members, axis):
                extent, *bounds = _find_one(axis, figure, rows)
                row = SweepAnswerRow(
                    figure=figure.key,
                    axis=axis.name,
                    setting=setting,
                    extent=extent,
                    **dict(zip(("bound", "met_at", "failed_at"), bounds, strict=True)),
                )
                found.append(row)
    return found


def group_others(config: SweepConfig, members: pd.DataFrame, axis: AxisConfig) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the members of each setting of all other axes but seeds, with it in words; all where rows are a list."""
    others = [one for one in config.axes if one.name not in (axis.name, SEED)]
    if not others or config.mode == "zip":
        yield "", members
        return
    names = [one.label or one.name.rpartition(".")[2].replace("_", " ") for one in others]
    for values, rows in members.groupby([one.name for one in others], sort=False):
        said = [f"{name} {_show_setting(x, one)}" for name, x, one in zip(names, values, others, strict=True)]
        yield ", ".join(said), rows


def _show_setting(value: object, axis: AxisConfig) -> str:
    text = format_plain(value, 4) if isinstance(value, float) else str(value)
    return f"{text} {axis.unit if axis.factors is None else 'times'}".rstrip()


def _find_one(axis: AxisConfig, figure: FigureConfig, rows: pd.DataFrame) -> tuple[Extent, float, float, float]:
    """Return where along an axis a figure meets its requirement: extent, bound and neighbours; the worst of repeats."""
    known = rows[np.isfinite(rows[figure.key])]
    repeats = known.groupby(axis.name)[figure.key]
    worst = repeats.max() if figure.at_most is not None else repeats.min()
    x, y = worst.index.to_numpy(), worst.to_numpy()
    limit = figure.limit
    assert limit is not None
    good = y <= limit if figure.at_most is not None else y >= limit
    changes = np.flatnonzero(good[1:] != good[:-1])
    if len(x) == 0 or not good.any():
        return NEVER, math.nan, math.nan, math.nan
    if good.all():
        return ALWAYS, math.nan, math.nan, math.nan
    if len(changes) > 1:
        return MIXED, math.nan, math.nan, math.nan
    k = int(changes[0])
    bound = _interpolate(x[k : k + 2], y[k : k + 2], limit, axis.scale == "log", figure.scale == "log")
    inside, outside = (x[k], x[k + 1]) if good[k] else (x[k + 1], x[k])
    return UP_TO if good[k] else FROM, bound, float(inside), float(outside)


def _interpolate(x: Array, y: Array, limit: float, log_x: bool, log_y: bool) -> float:
    """Return where a figure between two points takes a value; a zero or negative number has no logarithm."""
    log_x, log_y = log_x and min(x) > 0.0, log_y and min(*y, limit) > 0.0
    ends, values = (np.log(x) if log_x else x), (np.log(y) if log_y else y)
    wanted = math.log(limit) if log_y else limit
    place = float(ends[0] + (ends[1] - ends[0]) * (wanted - values[0]) / (values[1] - values[0]))
    return float(f"{math.exp(place) if log_x else place:.9g}")
