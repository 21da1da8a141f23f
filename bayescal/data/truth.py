"""The truth behind simulated data as CSV files: parameters, which a simulation also reads, and poses.

A machine is simulated with the digits that its file of parameters holds, so that the file fed back is the same machine
to the last bit.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import format_table, read_table
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

PARAMETERS_FILE, POSES_FILE = "true_parameters.csv", "true_poses.csv"
PARAMETER_COLUMNS = ("parameter", "unit", "value")
DECIMALS = 12


def round_as_written(values: Array) -> Array:
    """Return numbers with the digits that a file of the truth holds, any shape: as if written and read again.

    A text of an integer over a power of ten is read as the double nearest to that quotient, which a division gives.
    """
    flat, scale = np.asarray(np.ravel(values), dtype=np.float64), 10.0**DECIMALS
    with np.errstate(all="ignore"):
        scaled = flat.astype(np.longdouble) * scale
        whole, size = np.rint(scaled), np.abs(scaled)
        found = whole.astype(np.float64) / scale
        # half a unit in the last place, by which the product is off, may lead across the middle of two integers
        unsure = ~((np.abs(scaled - whole) + np.spacing(size) < 0.5) & (size < 2.0**53))
    found[unsure] = [float(_write(x)) for x in flat[unsure]]
    return np.asarray(found.reshape(np.shape(values)))


def _write(value: float) -> str:
    return f"{value:.{DECIMALS}f}"


def format_true_parameters(comments: Sequence[str], layout: ParameterLayout, theta: Array) -> str:
    """Return the text of a file with all parameters (D,) and their units."""
    cells = zip(layout.names, layout.units, map(_write, theta), strict=True)
    return format_table(comments, PARAMETER_COLUMNS, list(cells))


def format_true_poses(comments: Sequence[str], coordinates: Sequence[str], names: Sequence[str], poses: Array) -> str:
    """Return the text of a file with poses (P, q): their names, and coordinates in mm and rad as columns say."""
    rows = [(name, *map(_write, pose)) for name, pose in zip(names, poses, strict=True)]
    return format_table(comments, ("pose", *coordinates), rows)


def list_true_symbols(path: Path) -> set[str]:
    """Return the symbols of the parameters of a file."""
    return {name.partition("[")[0] for name in read_table(path, PARAMETER_COLUMNS).text("parameter")}


def read_true_parameters(path: Path, layout: ParameterLayout) -> Array:
    """Return the parameters (D,) of a file, each once, in any order.

    InputError for an unknown, missing or repeated parameter, a unit that is not the parameter's, and a value that no
    machine has.
    """
    table = read_table(path, PARAMETER_COLUMNS)
    known = {name: k for k, name in enumerate(layout.names)}
    names = table.text("parameter")
    for row, name in enumerate(names):
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f", did you mean {close[0]!r}?" if close else ""
            symbols = ", ".join(layout.symbols)
            raise InputError(f"{table.where(row)}: parameter: found {name!r}{hint}, expected those of {symbols}")
    table.check_unique([(name,) for name in names], "parameter")
    places = [known[name] for name in names]
    for row, (unit, place) in enumerate(zip(table.text("unit"), places, strict=True)):
        if unit != layout.units[place]:
            where = f"{table.where(row)}: unit of {layout.names[place]}"
            raise InputError(f"{where}: found {unit!r}, expected {layout.units[place]!r}")
    missing = [name for k, name in enumerate(layout.names) if k not in set(places)]
    if missing:
        others = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"{table.where(len(places) - 1)}: found {len(places)} parameters without "
            f"{missing[0]}{others}, expected {layout.size}"
        )
    theta = np.empty(layout.size)
    theta[places] = table.numbers(("value",))[:, 0]
    with name_faults(path):
        layout.check(theta)
    return theta
