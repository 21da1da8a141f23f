"""Columns that repeat one another, one sensor exported twice or copied with a factor, and such of a single value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.files.csv_tables import WrittenColumn
from bayescal.machines.readings import Channel, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant

MIN_ROWS: Final = 5  # fewer may lie on a line by chance
MAX_SCATTER: Final = 0.02  # of the noise of a difference: two sensors scatter about each other by all of it
MIN_DISTINCT: Final = 4  # values: columns of fewer are plans, not measurements
MAX_NAMED: Final = 3


def check_columns(data: Measurements, model: ReadingModel, columns: Mapping[str, WrittenColumn]) -> None:
    """Raise InputError where a measured column is another one, or a + b times another one, in all rows.

    Two sensors have noise of their own, so that what one reads scatters about any line through the other by the noise
    of both. Commands may be equal, and so may values that are rounded to more than their noise.

    Parameters
    ----------
    data : Measurements
        Readings (P, K), their noise and which are commands.
    model : ReadingModel
        The machine with these K channels.
    columns : mapping of str to WrittenColumn
        Columns by names of channels, where these are known.
    """
    measured = np.isfinite(data.values) & (data.sd > 0.0) & ~_may_be_commands(model)
    if said := _list_copies(data, model, columns, measured & ~_is_commanded(data)):
        more = f"; so are {len(said) - MAX_NAMED} more" if len(said) > MAX_NAMED else ""
        raise InputError(f"data: {'; '.join(said[:MAX_NAMED])}{more}, expected readings of each sensor")


def doubt_columns(data: Measurements, model: ReadingModel, columns: Mapping[str, WrittenColumn]) -> list[str]:
    """Return in lines which columns of the machine's own channels repeat others, and which of any are of one value.

    Nobody has said that they hold commands, which may be equal; see `check_columns`.
    """
    own, read = _may_be_commands(model), np.isfinite(data.values) & (data.sd > 0.0) & ~_is_commanded(data)
    said = _list_copies(data, model, columns, read & own)
    found = [f"{one}: export each sensor, unless both were commanded so" for one in said]
    for k, one in enumerate(model.channels):
        values = data.values[read[:, k], k]
        if len(values) >= MIN_ROWS and not np.ptp(values) and _has_digits(values, data.sd[read[:, k], k], one.unit):
            text = f"column {_find_column(one, columns).name} is constant without any noise: check its sensor"
            found.append(f"{text}{', unless it was commanded so' if own[k] else ''}")
    return found[:MAX_NAMED]


def _list_copies(
    data: Measurements, model: ReadingModel, columns: Mapping[str, WrittenColumn], some: np.ndarray
) -> list[str]:
    """Return in words which columns repeat another one, by some of the readings, (P, K)."""
    channels, values = model.channels, np.where(some, data.values, np.nan)
    written = [_find_column(one, columns) for one in channels]
    fine = [_is_fine(values[:, k], data.sd[:, k], one.unit) for k, one in enumerate(channels)]
    said, copies = list[str](), set[int]()
    for k in np.flatnonzero(fine).tolist():
        same = [j for j in range(k + 1, len(channels)) if fine[j] and channels[j].unit == channels[k].unit]
        for j in same if k not in copies else ():
            line = _fit_line(data, values, k, j)
            if line is not None and j not in copies:
                copies.add(j)
                said.append(_describe(written[k], written[j], *line))
    return said


def _find_column(channel: Channel, columns: Mapping[str, WrittenColumn]) -> WrittenColumn:
    return columns.get(channel.name, WrittenColumn(f"{channel.stem}_{channel.unit}"))


def _may_be_commands(model: ReadingModel) -> np.ndarray:
    """Return which channels are the machine's own, (K,): their tables hold commands more often than not."""
    return np.array([one.name in model.commanded and not one.external for one in model.channels], dtype=bool)


def _is_commanded(data: Measurements) -> np.ndarray:
    """Return which readings are said to be commands, (P, K)."""
    return np.zeros(data.values.shape, dtype=bool) if data.commanded is None else data.commanded


def _is_fine(values: Array, sd: Array, unit: str) -> bool:
    """Whether readings are written with more digits than their noise leaves, and differ."""
    there = np.isfinite(values)
    if there.sum() < MIN_ROWS or len(np.unique(values[there])) < MIN_DISTINCT:
        return False
    return _has_digits(values[there], sd[there], unit)


def _has_digits(values: Array, sd: Array, unit: str) -> bool:
    """Whether some readings are written with more digits than their noise leaves."""
    shown, noise = (np.degrees(one) if unit == "rad" else one for one in (values, sd))
    steps = shown / 10.0 ** np.ceil(np.log10(np.median(noise)))
    return not np.allclose(steps, np.round(steps), rtol=0.0, atol=1e-6)


def _fit_line(data: Measurements, values: Array, k: int, j: int) -> tuple[float, float] | None:
    """Return slope and offset that make column j of column k, where that leaves a small part of their noise."""
    there = np.isfinite(values[:, k]) & np.isfinite(values[:, j])
    first, second = values[there, k], values[there, j]
    if len(first) < MIN_ROWS or not np.ptp(first) or not np.ptp(second):
        return None
    if np.array_equal(first, second):
        return 1.0, 0.0
    slope = float(np.cov(first, second)[0, 1] / np.var(first, ddof=1))
    left = (second - second.mean()) - slope * (first - first.mean())
    shared = 0.0 if data.correlation is None else data.correlation[there, k, j]
    own, other = slope * data.sd[there, k], data.sd[there, j]
    noise = float(np.mean(own**2 + other**2 - 2.0 * shared * own * other))
    alike = float(np.sum(left**2)) < MAX_SCATTER**2 * noise * (len(first) - 2)
    return (slope, float(second.mean() - slope * first.mean())) if alike else None


def _describe(column: WrittenColumn, copy: WrittenColumn, slope: float, offset: float) -> str:
    slope, offset = slope * column.size / copy.size, offset / copy.size
    if (slope, offset) == (1.0, 0.0):
        return f"columns {copy.name} and {column.name} are equal"
    line = f"{format_significant(offset, 4)} + {format_significant(slope, 6)} times {column.name}"
    return f"column {copy.name} is {line}, without noise"
