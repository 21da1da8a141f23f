"""Tables of commands and of poses as they are read, and of what a calibrated machine makes of them.

Columns are named by channel and unit as those of readings: ``rho_1_mm``, ``motor_2_deg``. A pose has the columns of the
machine's coordinates; that of a tool which is something else has ``tool_`` before its names.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import PoseCommands, PosePrediction, is_pose
from bayescal.data.actuators import check_travel
from bayescal.data.instruments.read_poses import OTHER_COLUMNS, VECTOR, name_covariances, read_rotation_vectors
from bayescal.errors import InputError
from bayescal.files.csv_tables import CsvTable, format_table, read_table
from bayescal.machines.readings import Channel, Coordinate
from bayescal.machines.readings.placed import READ_BY
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import units_like

REACHED, MISFIT = "reached", "misfit_sd"
NAMED = 12
"""Poses out of reach that a message names."""
TOOL = "tool_"
FINE = {"mm": ("um", 1e3), "rad": ("urad", 1e6)}
"""Units of standard deviations and covariances in files, and how many of them make an inner one."""
TURNED = ("rx", "ry", "rz")
MAX_TOOL_MISMATCH = 1e-3
"""Share of the tool's way over the workspace by which it may be off from where coordinates have it: a predicted tool is
a mean over the posterior."""


@dataclass(frozen=True, eq=False)
class CommandedPoses:
    """Poses to be taken: their table, names (P), the tool's numbers or the coordinates (P, n), what is given (P,)."""

    table: CsvTable
    names: tuple[str, ...]
    poses: Array
    given: dict[str, Array]
    coordinates: bool


# --- reading -------------------------------------------------------------------------------------------------------


def read_quantities(table: CsvTable, wanted: Sequence[Channel | Coordinate], prefix: str = "") -> Array:
    """Return the columns of some quantities, each in a unit of its kind, in the inner one, shape (P, n).

    The components of a rotation vector rx, ry, rz may be there in any form of rotation. InputError for a missing
    column, two of the same quantity, and a cell that is no number.
    """
    values = np.full((len(table.rows), len(wanted)), np.nan)
    turned = _find_turned(wanted)
    for k, one in enumerate(wanted):
        if k in turned:
            continue
        there = _find_columns(table, one, prefix)
        if not there:
            units = dict.fromkeys([one.unit, *units_like(one.unit)])
            listed = " or ".join(f"{prefix}{one.stem}_{unit}" for unit in units)
            raise InputError(f"{table.path}: found no column '{prefix}{one.stem}_{one.unit}', expected {listed}")
        if len(there) > 1:
            first, second = map(table.name, [*there][:2])
            raise InputError(f"{table.path}: found columns {first!r} and {second!r}, expected one of them")
        for column, size in there.items():
            values[:, k] = size * table.numbers([column])[:, 0]
    if turned:
        values[:, turned] = read_rotation_vectors(table, prefix)
        whole = np.isfinite(values[:, turned]).all(axis=1)
        expected = ", ".join(table.name(f"{prefix}{name}") for name in VECTOR)
        table.refuse(~whole, lambda _: f"found part of a rotation, expected {expected}")
    return values


def _find_columns(table: CsvTable, quantity: Channel | Coordinate, prefix: str = "") -> dict[str, float]:
    """Return the columns that hold a quantity, with the sizes of their units in its own."""
    units = {f"{prefix}{quantity.stem}_{unit}": size for unit, size in units_like(quantity.unit).items()}
    return {name: units[name] for name in table.columns if name in units}


def _find_turned(wanted: Sequence[Channel | Coordinate]) -> list[int]:
    """Return where a rotation vector rx, ry, rz stands among some quantities; nowhere, where they have none."""
    return [k for k, one in enumerate(wanted) if getattr(one, "rotation", "") and one.name in TURNED]


def list_columns(wanted: Sequence[Channel | Coordinate], prefix: str = "") -> list[str]:
    """Return the columns that some quantities may be in, the first of each in its own unit."""
    names: list[str] = []
    for one in wanted:
        units = dict.fromkeys([one.unit, *units_like(one.unit)])
        names += [f"{prefix}{one.stem}_{unit}" for unit in units]
    return names + [f"{prefix}{name}" for name in OTHER_COLUMNS if _find_turned(wanted)]


def read_named(path: Path, known: Sequence[str], expected: Sequence[str]) -> tuple[CsvTable, tuple[str, ...]]:
    """Return a table with a column ``pose`` and others out of those known, and the poses' names, each once."""
    table = read_table(path, None).convert(known)
    for name in table.columns:
        if name not in ("pose", *known):
            close = difflib.get_close_matches(name, ("pose", *known), n=1, cutoff=0.4)
            hint = f", did you mean {close[0]!r}?" if close else ""
            raise InputError(f"{path}: found column {name!r}{hint}, expected pose, {', '.join(expected)}")
    if "pose" not in table.columns:
        raise InputError(f"{path}: found no column 'pose'")
    names = table.text("pose")
    table.check_unique([(name,) for name in names], "pose")
    return table, tuple(names)


def read_given(table: CsvTable, names: Sequence[str]) -> dict[str, Array]:
    """Return what has to be known of each pose besides, (P,) by name; InputError where a column is missing."""
    for name in names:
        if name not in table.columns:
            raise InputError(f"{table.path}: found no column of {name}, expected one")
    return {name: table.numbers((name,))[:, 0] for name in names}


def read_commanded(path: Path, calibrated: CalibratedMachine) -> CommandedPoses:
    """Return the poses of a table, the tool's or the machine's coordinates; what else is measured is passed over.

    InputError for a missing column, a cell that is no number, or a pose that stands twice.
    """
    model = calibrated.model
    tool = [] if is_pose(calibrated) else list_columns(model.tool_channels, TOOL)
    pose = list_columns(model.pose_channels)
    upper, lower = name_covariances([one.name for one in model.pose_channels])
    of_tool, _ = name_covariances([f"{TOOL}{one.stem}" for one in model.tool_channels])
    sds = [*(f"sd_{one}" for one in pose), *_name_sd(model.pose_channels)]
    others = ("use", MISFIT, *sds, *upper, *lower, *of_tool, *list_columns(calibrated.command_channels))
    expected = [name_column(calibrated, one) for one in model.pose_channels]
    expected += [f"or {', '.join(TOOL + name_column(calibrated, one) for one in model.tool_channels)}"] if tool else []
    table, names = read_named(path, [*pose, *tool, *model.given, *others], [*expected, *model.given])
    by_tool = any(name in tool for name in table.columns)
    if by_tool and any(name in pose for name in table.columns):  # as predictions are written
        by_tool = False
        check_both(calibrated, table)
    wanted = model.tool_channels if by_tool else model.pose_channels
    values = read_quantities(table, wanted, TOOL if by_tool else "")
    return CommandedPoses(table, names, values, read_given(table, model.given), not by_tool)


def check_both(calibrated: CalibratedMachine, table: CsvTable) -> None:
    """Raise InputError for a table of tools and coordinates that the machine does not have at the same pose."""
    model = calibrated.model
    pose, tool = read_quantities(table, model.pose_channels), read_quantities(table, model.tool_channels, TOOL)
    with np.errstate(all="ignore"):
        own, by_pose, _ = model.tool(calibrated.theta, pose, False)
        off = np.abs(calibrated.comparison.subtract(tool, own))
        least = MAX_TOOL_MISMATCH * np.abs(by_pose * model.pose_scale).sum(axis=-1)
    for k, m in np.argwhere(~(off <= least))[:1]:
        one = model.tool_channels[m]
        _, size = show_unit(calibrated, one)
        columns = _find_columns(table, one, TOOL) or {TOOL + name_column(calibrated, one): size}
        for column, size in columns.items():
            raise InputError(
                f"{table.where(int(k))}: {table.name(column)}: found {tool[k, m] / size:.6g}, by the coordinates "
                f"{own[k, m] / size:.6g}, expected the same, or either"
            )


def read_commands(path: Path, calibrated: CalibratedMachine) -> tuple[tuple[str, ...], Array, dict[str, Array]]:
    """Return names (P), commands (P, C) in the channels' units and what is given; InputError where out of range."""
    model, channels = calibrated.model, calibrated.command_channels
    others = ("use", REACHED, READ_BY, *_name_sd(channels))
    expected = [name_column(calibrated, one) for one in channels]
    table, names = read_named(path, [*list_columns(channels), *model.given, *others], [*expected, *model.given])
    commands = read_quantities(table, channels)
    check_travel(commands, model.command_range, channels, names, path)
    return names, commands, read_given(table, model.given)


def check_reached(commanded: CommandedPoses, command: PoseCommands) -> None:
    """Raise InputError that names the poses out of reach, with their lines."""
    lost = [k for k, fault in enumerate(command.faults) if fault]
    if not lost:
        return
    lines, names = commanded.table.lines, commanded.names
    listed = [f"line {lines[k]}, pose {names[k]!r}: {command.faults[k]}" for k in lost[:NAMED]]
    more = f"; and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
    raise InputError(
        f"{commanded.table.path}: found {len(lost)} of {len(names)} poses out of reach "
        f"(--allow-unreachable marks them): {'; '.join(listed)}{more}"
    )


def say_contradictory(path: Path, names: Sequence[str], prediction: PosePrediction) -> str:
    """Return in a line at which commands contradict one another; empty where at none."""
    if prediction.misfit is None or not prediction.contradictory.any():
        return ""
    some = np.flatnonzero(prediction.contradictory).tolist()
    rows = sorted(some, key=(-prediction.misfit).__getitem__)
    listed = [f"{names[k]!r} by {prediction.misfit[k]:.3g} sd" for k in rows[:NAMED]]
    more = f" and {len(rows) - NAMED} more" if len(rows) > NAMED else ""
    return f"{path}: commands contradict one another at {', '.join(listed)}{more}: no pose, or another one"


def check_found(path: Path, names: Sequence[str], prediction: PosePrediction) -> None:
    """Raise InputError that names the commands at which the machine has no pose."""
    lost = [repr(name) for name, found in zip(names, prediction.found, strict=True) if not found]
    if lost:
        more = f" and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
        raise InputError(
            f"{path}: found no pose at {', '.join(lost[:NAMED])}{more}, expected commands on home's branch"
        )


# --- writing -------------------------------------------------------------------------------------------------------


def format_command(
    calibrated: CalibratedMachine, names: Sequence[str], command: PoseCommands, given: Mapping[str, Array]
) -> str:
    """Return commands as CSV text, with standard deviations, and which poses are out of reach."""
    channels = calibrated.command_channels
    sd = np.full(command.commands.shape, np.nan) if command.sd is None else command.sd * _fine(channels)
    known, shown = _list_given(given, len(names)), show_values(calibrated, command.commands, channels)
    rows = [
        (name, fault or "yes", *own, *_format_cells(value, ".9f", fault), *_format_cells(spread, ".6g", fault))
        for name, fault, own, value, spread in zip(names, command.faults, known, shown, sd, strict=True)
    ]
    comments = [
        *calibrated.source.describe(),
        "Commands that hold the poses: posterior mean, sd",
        "of the actuators' readings.",
    ]
    columns = ["pose", REACHED, *given, *(name_column(calibrated, one) for one in channels), *_name_sd(channels)]
    return format_table(comments, columns, rows)


def format_prediction(
    calibrated: CalibratedMachine, names: Sequence[str], prediction: PosePrediction, given: Mapping[str, Array]
) -> str:
    """Return tools, and coordinates where these are others, as CSV text; rotation vectors in degrees.

    The covariance of the tool is in µm and µrad, that of a machine on legs as `bayescal poses-from-targets` has it.
    """
    model, whole = calibrated.model, is_pose(calibrated)
    tool, pose = model.tool_channels, model.pose_channels
    prefix = "" if whole else TOOL
    columns = ["pose", *given, *(prefix + name_column(calibrated, one) for one in tool)]
    columns += [] if whole else [name_column(calibrated, one) for one in pose]
    values = np.concatenate([prediction.tool, prediction.pose], axis=1)[:, : len(columns) - 1 - len(given)]
    known = _list_given(given, len(names))
    rows: list[list[str]] = [
        [name, *own, *_format_values(calibrated, row, [*tool, *pose])]
        for name, own, row in zip(names, known, values, strict=True)
    ]
    if prediction.covariance is not None and prediction.pose_covariance is not None:
        columns += name_covariances([f"{prefix}{one.stem}" for one in tool])[0]
        scale, upper = _fine(tool), np.triu_indices(len(tool))
        cells = (prediction.covariance * np.outer(scale, scale))[:, upper[0], upper[1]]
        if not whole:
            columns += _name_sd(pose)
            sd = np.sqrt(np.diagonal(prediction.pose_covariance, axis1=1, axis2=2)) * _fine(pose)
            cells = np.concatenate([cells, sd], axis=1)
        rows = [[*row, *(f"{c:.8g}" for c in some)] for row, some in zip(rows, cells, strict=True)]
    if prediction.misfit is not None:
        columns += [MISFIT]
        rows = [[*row, f"{one:.4g}"] for row, one in zip(rows, prediction.misfit, strict=True)]
    about = "Predicted coordinates" if whole else "Predicted tool (tool_...) and coordinates"
    about += ", base frame; rotation vector in degrees." if model.tool_turned else "."
    comments = [
        *calibrated.source.describe(),
        about,
        "cov: covariance in µm and µrad, base axes: geometry, model error,",
        "actuator noise.",
    ]
    return format_table(comments, columns, rows)


def _list_given(given: Mapping[str, Array], n: int) -> list[list[str]]:
    """Return the cells of what is given of each of n poses."""
    return [[repr(float(x)) for x in row] for row in zip(*given.values(), strict=True)] or [[]] * n


def format_draws(calibrated: CalibratedMachine, names: Sequence[str], tools: Array) -> str:
    """Return drawn tools (S, P, m) as CSV text, a row for each draw of each pose."""
    channels, prefix = calibrated.model.tool_channels, "" if is_pose(calibrated) else TOOL
    rows: list[tuple[object, ...]] = []
    for draw, some in enumerate(tools, start=1):
        rows += [
            (name, draw, *_format_values(calibrated, row, channels)) for name, row in zip(names, some, strict=True)
        ]
    comments = [*calibrated.source.describe(), "Poses by posterior draws; rotation vectors in degrees."]
    return format_table(comments, ["pose", "draw", *(prefix + name_column(calibrated, one) for one in channels)], rows)


def show_unit(calibrated: CalibratedMachine, channel: Channel) -> tuple[str, float]:
    """Return the unit that a quantity is written in, and its size: the data's, and degrees of a rotation vector."""
    usual = calibrated.units.get(channel.name, calibrated.usual_units.get(channel.unit, channel.unit))
    unit = "deg" if channel.rotation else usual
    return unit, units_like(channel.unit)[unit]


def show_values(calibrated: CalibratedMachine, values: Array, channels: Sequence[Channel]) -> Array:
    """Return values (..., n) of quantities in the units that they are written in."""
    return values / [show_unit(calibrated, one)[1] for one in channels]


def name_column(calibrated: CalibratedMachine, channel: Channel) -> str:
    """Return the column that a quantity is written to."""
    return f"{channel.stem}_{show_unit(calibrated, channel)[0]}"


def _name_sd(channels: Sequence[Channel]) -> list[str]:
    """Return the columns of standard deviations."""
    return [f"sd_{one.stem}_{FINE.get(one.unit, (one.unit, 1.0))[0]}" for one in channels]


def _fine(channels: Sequence[Channel]) -> Array:
    return np.array([FINE.get(one.unit, ("", 1.0))[1] for one in channels])


def _format_values(calibrated: CalibratedMachine, values: Array, channels: Sequence[Channel]) -> list[str]:
    shown = show_values(calibrated, values, channels[: len(values)])
    return [f"{x:.10f}" if one.rotation else f"{x:.9f}" for x, one in zip(shown, channels, strict=False)]


def _format_cells(values: Array, digits: str, fault: str) -> list[str]:
    """Return cells, empty ones where there is nothing to be had."""
    return ["" if fault or not np.isfinite(value) else format(value, digits) for value in values]
