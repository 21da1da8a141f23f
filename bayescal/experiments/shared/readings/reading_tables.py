"""Tables of readings of any machine: one row a pose, columns by channel and unit, empty cells for what was not read.

Columns: ``pose``; ``use`` (calibration or verification), optional; a channel's readings, ``motor[2]`` in degrees being
``motor_2_deg``; a deviation of its own for each row, ``motor_2_sd_deg``; correlations of two channels' noise,
``corr_x_y``, or its covariances ``cov_x_x``, ``cov_x_y`` in µm and µrad, as `bayescal poses-from-targets` writes them;
and what else is known of each row, by its name.
"""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayescal.config.classes import choose, name_failures
from bayescal.data.actuators import check_ends
from bayescal.data.instruments.read_poses import OTHER_COLUMNS, read_rotation_vectors
from bayescal.data.reader import TableReader, read_with
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.data_schema import OwnDataConfig, ReadingsTable
from bayescal.experiments.shared.rows import USES
from bayescal.files.csv_tables import CsvTable, WrittenColumn, read_table
from bayescal.machines.readings import Channel, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE, units_like

COVARIANCE_UNITS = {"mm": MICROMETRE, "rad": 1e-6}
"""Roots of the units of covariances, in the channels' units."""


class ChannelColumn(NamedTuple):
    """Where the readings of a channel come from: which column of which file."""

    channel: str
    column: WrittenColumn
    file: str


@dataclass(frozen=True, eq=False)
class PoseReadings:
    """Readings of all tables together."""

    poses: tuple[str, ...]
    verification: np.ndarray  # (P,)
    # with sd, (P, K): in the channels' units; NaN where there is none: not read, or no deviation of its own
    values: Array
    sd: Array
    correlation: Array | None  # (P, K, K)
    commanded: np.ndarray  # (P, K): which readings are positions that the machine was commanded to
    given: dict[str, Array] = field(default_factory=dict)  # (P,): NaN where it is not known
    columns: list[ChannelColumn] = field(default_factory=list)

    def spread(self, at: Sequence[int], model: ReadingModel) -> PoseReadings:
        """Return the same as readings of some of a machine's channels, at these places among them."""
        n, k = len(self.poses), len(model.channels)
        if list(at) == list(range(k)) and not model.given:
            return self
        found = _make_empty(self.poses, k, self.correlation is not None, model.given)
        found.verification[:] = self.verification
        found.values[:, at], found.sd[:, at], found.commanded[:, at] = self.values, self.sd, self.commanded
        if self.correlation is not None and found.correlation is not None:
            found.correlation[np.ix_(range(n), at, at)] = self.correlation
        return found

    def list_columns(self) -> dict[str, WrittenColumn]:
        """Return the columns by channel, as files have them."""
        return {one.channel: one.column for one in self.columns}

    def list_units(self, channels: Sequence[Channel]) -> dict[str, str]:
        """Return the units that columns have by channel, of those in another one than the channel's own."""
        columns = self.list_columns()
        return {
            one.name: unit
            for one in channels
            for unit, size in units_like(one.unit).items()
            if one.name in columns and size == columns[one.name].size != 1.0
        }

    def tell_unused(self, taken: Collection[str]) -> str:
        """Return in a line which columns are of other channels than those taken in; nothing where there are none."""
        files: dict[str, list[str]] = {}
        for channel, column, file in self.columns:
            if channel not in taken:
                files.setdefault(file, []).append(column.name)
        listed = "; ".join(f"{', '.join(columns)} of {file}" for file, columns in files.items())
        return f"Not used: {listed}; expected them in [sensors], or in data.ignore" if files else ""


@dataclass(frozen=True)
class _Column:
    """What a column holds: ``values``, ``sd``, ``corr`` or ``given``, of which channels; a factor to their unit.

    A covariance states an ``sd`` by its square, or a ``corr`` by what it is times both deviations.
    """

    role: str
    places: tuple[int, ...] = ()
    factor: float = 1.0
    covariance: bool = False


def _make_empty(poses: Sequence[str], k: int, is_correlated: bool, given: Sequence[str]) -> PoseReadings:
    """Return P poses at which nothing is read of K channels."""
    n = len(poses)
    return PoseReadings(
        tuple(poses),
        np.zeros(n, dtype=bool),
        np.full((n, k), np.nan),
        np.full((n, k), np.nan),
        np.tile(np.eye(k), (n, 1, 1)) if is_correlated else None,
        np.zeros((n, k), dtype=bool),
        {name: np.full(n, np.nan) for name in given},
    )


def complete_readings(found: PoseReadings, model: ReadingModel) -> PoseReadings:
    """Return the same with the readings that anyone may state of a machine; see `ReadingModel.complete`.

    Where rows state their noise it is that of a usual row.
    """
    values = model.complete(found.values)
    stated = np.isnan(found.values) & np.isfinite(values)
    if not stated.any():
        return found
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of columns without any
        usual = np.nanmedian(found.sd, axis=0)
    return replace(found, values=values, sd=np.where(stated & np.isnan(found.sd), usual, found.sd))


def join_readings(blocks: Sequence[PoseReadings], model: ReadingModel, path: Path) -> PoseReadings:
    """Return readings of all channels that several tables have, rows of one pose together.

    InputError where two have a reading of the same channel and pose, a pose has none, or none is for calibration.
    """
    if len(blocks) == 1:
        return blocks[0]
    poses = list(dict.fromkeys(name for one in blocks for name in one.poses))
    places = {name: row for row, name in enumerate(poses)}
    given = list(dict.fromkeys(name for one in blocks for name in one.given))
    is_correlated = any(one.correlation is not None for one in blocks)
    found = _make_empty(poses, len(model.channels), is_correlated, given)
    for one in blocks:
        rows = np.array([places[name] for name in one.poses])
        found.verification[rows] |= one.verification
        found.commanded[rows] |= one.commanded
        for into, values in ((found.values, one.values), (found.sd, one.sd)):
            twice = np.isfinite(into[rows]) & np.isfinite(values)
            for row, k in np.argwhere(twice)[:1]:
                channel = model.channels[k].name
                raise InputError(
                    f"{path}: pose {one.poses[row]!r}: found a second reading of {channel} in [[data]], expected one"
                )
            into[rows] = np.where(np.isfinite(values), values, into[rows])
        if one.correlation is not None and found.correlation is not None:
            apart = np.where(np.eye(len(model.channels), dtype=bool), 0.0, one.correlation)
            found.correlation[rows] += apart
        for name, column in one.given.items():
            found.given[name][rows] = np.where(np.isfinite(column), column, found.given[name][rows])
        found.columns.extend(one.columns)
    _check_poses(found, path)
    return found


def read_tables(
    sections: Sequence[ReadingsTable],
    folder: Path,
    channels: Sequence[Channel],
    given: Sequence[str],
    alone: bool = True,
) -> PoseReadings:
    """Return the readings of several tables.

    Parameters
    ----------
    sections : sequence of ReadingsTable
        A table each.
    folder : Path
        Where their files start.
    channels : sequence of Channel
        All of the machine.
    given : sequence of str
        Names of what may be known of rows besides.
    alone : bool
        Whether these are all tables that there are.

    Raises
    ------
    InputError
        Names file, line and column.
    """
    known = _list_columns(channels, given)
    read = [_turn(_read(one, folder), known, channels) for one in sections]
    tables = [_check(table, known, channels, one) for table, one in zip(read, sections, strict=True)]
    is_correlated = any(name in known and known[name].role == "corr" for one in tables for name in one.columns)
    poses = list(dict.fromkeys(name for table in tables for name in table.text("pose")))
    places = {name: row for row, name in enumerate(poses)}
    found = _make_empty(poses, len(channels), is_correlated, given)
    for table, one in zip(tables, sections, strict=True):
        _fill(found, table, known, channels, [places[name] for name in pose_names(table)], one)
    if alone:
        _check_poses(found, folder / sections[0].file)
    return found


def _read(section: ReadingsTable, folder: Path) -> CsvTable:
    """Return a table as its file has it, or as a reader of somebody else makes it of the file."""
    path, field = folder / section.file, "data.kind"
    if not isinstance(section, OwnDataConfig):
        return read_table(path, None)
    choice = choose("READERS", section.kind, TableReader, field, folder, section.options)  # type: ignore[type-abstract]
    with name_failures(choice.found, field):
        return read_with(choice.found(choice.options), path)


def _turn(table: CsvTable, known: Mapping[str, _Column], channels: Sequence[Channel]) -> CsvTable:
    """Return a table whose rotations in other forms, quaternions or angles, are the rotation vectors of channels."""
    for k, channel in enumerate(channels):
        if not channel.rotation or any(one.rotation == channel.rotation for one in channels[max(k - 1, 0) : k]):
            continue
        stems = [one.stem for one in channels[k : k + 3]]
        ending = next((end for end in ("r_x", "rx") if stems[0].endswith(end)), None)
        prefix = f"{channel.rotation}_" if ending is None else stems[0].removesuffix(ending)
        others = [f"{prefix}{name}" for name in OTHER_COLUMNS if f"{prefix}{name}" not in known]
        table = table.convert(others)
        if not set(others) & set(table.columns):
            continue
        for one in table.columns:
            if one in known and known[one].role == "values" and set(known[one].places) & {k, k + 1, k + 2}:
                other = next(name for name in table.columns if name in others)
                first, second = table.name(one), table.name(other)
                raise InputError(f"{table.path}: found {first!r} and {second!r}, expected one rotation form")
        vectors = read_rotation_vectors(table, prefix)
        kept = [place for place, name in enumerate(table.columns) if name not in others]
        rows = tuple(
            (*(row[place] for place in kept), *("" if np.isnan(x) else repr(float(x)) for x in vector))
            for row, vector in zip(table.rows, vectors, strict=True)
        )
        table = replace(
            table, columns=(*(table.columns[place] for place in kept), *(f"{one}_rad" for one in stems)), rows=rows
        )
    return table


def _list_columns(channels: Sequence[Channel], given: Sequence[str]) -> dict[str, _Column]:
    columns = {name: _Column("given") for name in given}
    for k, channel in enumerate(channels):
        for unit, factor in units_like(channel.unit).items():
            columns[f"{channel.stem}_{unit}"] = _Column("values", (k,), factor)
            columns[f"{channel.stem}_sd_{unit}"] = _Column("sd", (k,), factor)
        own = COVARIANCE_UNITS.get(channel.unit, 1.0)
        columns[f"cov_{channel.stem}_{channel.stem}"] = _Column("sd", (k,), own, covariance=True)
        for j, other in enumerate(channels[:k]):
            columns[f"corr_{other.stem}_{channel.stem}"] = _Column("corr", (j, k))
            factor = own * COVARIANCE_UNITS.get(other.unit, 1.0)
            columns[f"cov_{other.stem}_{channel.stem}"] = _Column("corr", (j, k), factor, covariance=True)
    return columns


def _hint(name: str, channels: Sequence[Channel], known: Mapping[str, _Column]) -> str:
    """Return what a column's name lacks, or which one is near."""
    for one in channels:
        if name == one.stem or name.startswith(f"{one.stem}_"):
            return f", expected unit {', '.join(units_like(one.unit))}"
    usual = [f"{one.stem}_{one.unit}" for one in channels] + [key for key, one in known.items() if one.role == "given"]
    close = difflib.get_close_matches(name, usual, n=1)
    return f", did you mean {close[0]!r}?" if close else ""


def _check(
    table: CsvTable, known: Mapping[str, _Column], channels: Sequence[Channel], section: ReadingsTable
) -> CsvTable:
    if "pose" not in table.columns:
        raise InputError(f"{table.path}: found no column 'pose'")
    taken: dict[tuple[str, tuple[int, ...]], str] = {}
    for name in table.columns:
        if name in ("pose", "use", *section.ignore):
            continue
        if name not in known:
            expected = ", ".join(f"{one.stem}_{one.unit}" for one in channels)
            hint = _hint(name, channels, known)
            raise InputError(
                f"{table.path}: found column {name!r}{hint}, expected pose, use, {expected}; others in data.ignore"
            )
        column = known[name]
        if column.places and (other := taken.setdefault((column.role, column.places), name)) != name:
            first, second = table.name(other), table.name(name)
            raise InputError(f"{table.path}: found columns {first!r} and {second!r}, expected one of them")
    read = {channels[c.places[0]].name for n in table.columns if (c := known.get(n)) and c.role == "values"}
    for key in ("channels", "commanded_channels"):
        for name in getattr(section, key):
            asked = [one.name for one in channels if name in (one.name, one.kind)]
            if missing := [one for one in asked or [name] if one not in read]:
                raise InputError(f"{table.path}: found no column of {missing[0]!r}, which data.{key} names")
    return table


def pose_names(table: CsvTable) -> list[str]:
    """Return the names of a table's poses; InputError where one stands there twice."""
    names, known = table.text("pose"), dict[str, int]()
    for row, name in enumerate(names):
        if (first := known.setdefault(name, row)) != row:
            raise InputError(f"{table.where(row)}: pose {name!r}: already on line {table.lines[first]}")
    return names


def _fill(
    found: PoseReadings,
    table: CsvTable,
    known: Mapping[str, _Column],
    channels: Sequence[Channel],
    rows: list[int],
    section: ReadingsTable,
) -> None:
    held, ignored = section.verification_poses, section.ignore
    for name in held:
        if name not in found.poses:
            raise InputError(f"{table.path}: verification_poses: found {name!r}, expected a pose")
    found.verification[rows] |= np.isin(np.array(found.poses, dtype=object)[rows], list(held))
    if "use" in table.columns:
        for row, use in enumerate(table.text("use")):
            if use not in USES:
                raise InputError(
                    f"{table.where(row)}: {table.name('use')}: found {use!r}, expected {' or '.join(USES)}"
                )
            found.verification[rows[row]] |= use == "verification"
    for name in table.columns:
        if name in known and known[name].role == "values" and name not in ignored:
            channel, size = channels[known[name].places[0]], known[name].factor
            found.columns.append(ChannelColumn(channel.name, WrittenColumn(table.name(name), size), section.file))
    for name in sorted(table.columns, key=lambda name: name in known and known[name].role == "corr"):
        if name not in known or name in ignored:
            continue
        column, values, own = known[name], table.numbers((name,), gaps=True)[:, 0], table.name(name)
        if column.role == "given":
            found.given[name][rows] = values
        elif column.role == "corr":
            _fill_correlation(found, table, name, column, values, rows)
        else:
            into, k = (found.values if column.role == "values" else found.sd), column.places[0]
            for at in np.flatnonzero(np.isfinite(values) & np.isfinite(into[rows, k])):
                raise InputError(
                    f"{table.where(int(at))}: {own}: found a second reading of {channels[k].name} at "
                    f"pose {found.poses[rows[at]]!r}, expected one"
                )
            for at in np.flatnonzero((values < 0.0) & (column.role == "sd"))[:1]:
                raise InputError(f"{table.where(int(at))}: {own}: found {values[at]:g}, expected no negative noise")
            if column.role == "values":
                check_ends(table, name, channels[k], values, column.factor)
            values = np.sqrt(values) if column.covariance else values
            there = np.isfinite(values)
            into[np.array(rows)[there], k] = column.factor * values[there]
    for k, channel in enumerate(channels):
        if {channel.name, channel.kind} & set(section.commanded_channels):
            for row in np.flatnonzero(~np.isfinite(found.values[rows, k]))[:1]:
                where = table.where(int(row))
                raise InputError(f"{where}: found no {channel.name}, expected it by data.commanded_channels")
            found.commanded[rows, k] = True


def _fill_correlation(
    found: PoseReadings, table: CsvTable, name: str, column: _Column, values: Array, rows: list[int]
) -> None:
    assert found.correlation is not None
    j, k = column.places
    if column.covariance:
        sd = found.sd[rows][:, [j, k]]
        for row in np.flatnonzero(np.isfinite(values) & ~(sd > 0.0).all(axis=1))[:1]:
            raise InputError(
                f"{table.where(int(row))}: {table.name(name)}: found no variance, expected cov_ columns of both"
            )
        values = column.factor * values / sd.prod(axis=1)
    for row, value in enumerate(values):
        if np.isfinite(value):
            if abs(value) >= 1.0:
                raise InputError(
                    f"{table.where(row)}: {table.name(name)}: found {value:g}, expected a correlation within ±1"
                )
            found.correlation[rows[row], j, k] = found.correlation[rows[row], k, j] = value


def _check_poses(found: PoseReadings, path: Path) -> None:
    if found.verification.all():
        raise InputError(f"{path}: found no calibration pose, expected some")
    empty = ~np.isfinite(found.values).any(axis=1)
    for k in np.flatnonzero(empty)[:1]:
        raise InputError(f"{path}: pose {found.poses[k]!r}: found no reading, expected one")
    if found.correlation is not None:
        smallest = np.linalg.eigvalsh(found.correlation)[:, 0]
        for k in np.flatnonzero(smallest <= 0.0)[:1]:
            raise InputError(f"{path}: pose {found.poses[k]!r}: found an indefinite covariance")
