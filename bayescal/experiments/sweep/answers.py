"""How good something must be: up to where on an axis a figure keeps what is required of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.sweep.schema import SEED, AxisConfig, FigureConfig, SweepConfig
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_plain

COLUMNS = ("figure", "axis", "where", "holds", "bound", "inside", "outside")
NUMBERS = dict.fromkeys(("bound", "inside", "outside"), float)
ALWAYS, NEVER, UP_TO, FROM, MIXED = "everywhere", "nowhere", "up to", "from", "in places"


def is_scale(axis: AxisConfig, column: pd.Series) -> bool:
    """Whether an axis takes two different numbers at least; seeds only repeat."""
    return axis.name != SEED and column.dtype.kind == "f" and column.nunique() >= 2


def find_answers(config: SweepConfig, members: pd.DataFrame) -> list[dict[str, Any]]:
    """Return, for every figure of which something is required and every axis of numbers, where it holds.

    ``bound`` is interpolated between the neighbours ``inside`` and ``outside``, on the scales of axis and figure.
    """
    found = []
    for figure in config.figures:
        if figure.limit is None or members[figure.key].dtype.kind != "f":
            continue
        for axis in config.axes:
            if not is_scale(axis, members[axis.name]):
                continue
            for where, rows in group_others(config, members, axis):
                answer = _find_one(axis, figure, rows)
                found.append({"figure": figure.key, "axis": axis.name, "where": where, **answer})
    return found


def group_others(config: SweepConfig, members: pd.DataFrame, axis: AxisConfig) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the members of each setting of all other axes but seeds, with it in words; all where rows are a list."""
    others = [one for one in config.axes if one.name not in (axis.name, SEED)]
    if not others or config.combine == "list":
        yield "", members
        return
    names = [one.label or one.name.rpartition(".")[2].replace("_", " ") for one in others]
    for values, rows in members.groupby([one.name for one in others], sort=False):
        said = [f"{name} {_show(x, one)}" for name, x, one in zip(names, values, others, strict=True)]
        yield ", ".join(said), rows


def _show(value: Any, axis: AxisConfig) -> str:
    text = format_plain(value, 4) if isinstance(value, float) else str(value)
    return f"{text} {axis.unit if axis.factors is None else 'times'}".rstrip()


def _find_one(axis: AxisConfig, figure: FigureConfig, rows: pd.DataFrame) -> dict[str, Any]:
    """Return where along an axis a figure keeps its requirement; of repeats the worst counts."""
    known = rows[np.isfinite(rows[figure.key])]
    repeats = known.groupby(axis.name)[figure.key]
    worst = repeats.max() if figure.at_most is not None else repeats.min()
    x, y = worst.index.to_numpy(), worst.to_numpy()
    limit = figure.limit
    assert limit is not None
    good = y <= limit if figure.at_most is not None else y >= limit
    changes = np.flatnonzero(good[1:] != good[:-1])
    nothing = {"bound": None, "inside": None, "outside": None}
    if len(x) == 0 or not good.any():
        return {"holds": NEVER, **nothing}
    if good.all():
        return {"holds": ALWAYS, **nothing}
    if len(changes) > 1:
        return {"holds": MIXED, **nothing}
    k = int(changes[0])
    bound = _interpolate(x[k : k + 2], y[k : k + 2], limit, axis.scale == "log", figure.scale == "log")
    inside, outside = (x[k], x[k + 1]) if good[k] else (x[k + 1], x[k])
    return {"holds": UP_TO if good[k] else FROM, "bound": bound, "inside": float(inside), "outside": float(outside)}


def _interpolate(x: Array, y: Array, limit: float, log_x: bool, log_y: bool) -> float:
    """Return where a figure between two points takes a value; a zero or negative number has no logarithm."""
    log_x, log_y = log_x and min(x) > 0.0, log_y and min(*y, limit) > 0.0
    ends, values = (np.log(x) if log_x else x), (np.log(y) if log_y else y)
    wanted = math.log(limit) if log_y else limit
    place = float(ends[0] + (ends[1] - ends[0]) * (wanted - values[0]) / (values[1] - values[0]))
    return float(f"{math.exp(place) if log_x else place:.9g}")
