"""Tables with their line numbers: every fault is named with its file and line.

Lines that start with ``#`` are comments; the first other line names the columns, with their units.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayescal.errors import InputError
from bayescal.files.plain_text import guard_cell, is_plain, release_cell
from bayescal.files.table_files import DECIMAL_COMMA, read_cells
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ANGLES, LENGTHS

LEG_NUMBER = re.compile(r"(?:^|[^0-9])([1-9][0-9]*)(?=_|$)")
SHOWN = 12  # columns that may be there, listed in a message
LARGEST = 1e9
"""Numbers beyond this size are taken for slips: as millimetres, a thousand kilometres."""


class WrittenColumn(NamedTuple):
    """What a file calls a column, and the size of its unit there in the unit that it has here."""

    name: str
    size: float = 1.0


@dataclass(frozen=True)
class CsvTable:
    """Text cells of a table's file with the line each row stands on.

    Cells are as the file has them: ``written`` says of which columns it has another name or unit, and `numbers`
    converts. Messages name the file's own column and value, by `name` and `show`.
    """

    path: Path
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    written: Mapping[str, WrittenColumn] = field(default_factory=dict)

    def written_as(self, column: str) -> WrittenColumn:
        """Return how the file has a column."""
        return self.written.get(column, WrittenColumn(column))

    def name(self, column: str) -> str:
        """Return the file's own name of a column."""
        return self.written_as(column).name

    def show(self, column: str, value: float) -> str:
        """Return a value in the unit that the file has the column in."""
        return f"{value / self.written_as(column).size:g}"

    def where(self, row: int) -> str:
        """Return ``file, line n``."""
        return f"{self.path}, line {self.lines[row]}"

    def text(self, column: str) -> list[str]:
        """Return a column as stripped text; an empty cell is an error."""
        k = self.columns.index(column)
        values = [release_cell(row[k].strip()) for row in self.rows]
        for number, value in enumerate(values):
            if not value:
                raise InputError(f"{self.where(number)}: {self.name(column)}: found an empty cell, expected a name")
            if not is_plain(value):
                where = f"{self.where(number)}: {self.name(column)}"
                raise InputError(f"{where}: found control characters in {value!r}, expected a name")
        return values

    def numbers(self, columns: Sequence[str], gaps: bool = False) -> Array:
        """Return columns as finite numbers, shape (rows, columns); with gaps an empty cell is NaN, else an error."""
        index = [self.columns.index(column) for column in columns]
        result = np.empty((len(self.rows), len(index)))
        for number, row in enumerate(self.rows):
            for k, column in enumerate(index):
                empty = gaps and not row[column].strip()
                result[number, k] = np.nan if empty else self._number(row[column], number, columns[k])
        return result

    def convert(self, known: Collection[str]) -> CsvTable:
        """Return the same with lengths and angles in the units of known columns: ``x_m`` is ``x_mm`` then."""
        units = find_units(self.columns, known)
        own = {name: self.written_as(name) for name in units}
        found = {
            wanted: WrittenColumn(own[name].name, factor * own[name].size) for name, (wanted, factor) in units.items()
        }
        columns = tuple(units[name][0] if name in units else name for name in self.columns)
        return replace(self, columns=columns, written={**self.written, **found})

    def positive(self, columns: Sequence[str]) -> Array:
        """Return columns as `numbers` does; zero or less is an error, too."""
        result = self.numbers(columns)
        self.refuse_values(columns, result, result <= 0.0, "expected above 0")
        return result

    def refuse(self, wrong: np.ndarray, say: Callable[..., str]) -> None:
        """Raise InputError for the first entry of a mask (rows, ...), in words for its row and its other places."""
        for row, *places in np.argwhere(wrong)[:1]:
            raise InputError(f"{self.where(row)}: {say(row, *places)}")

    def refuse_values(self, columns: Sequence[str], values: Array, wrong: np.ndarray, expected: str) -> None:
        """Raise InputError for the first value of some columns (rows, columns) that a mask of that shape marks."""
        self.refuse(
            wrong,
            lambda row, k: f"{self.name(columns[k])}: found {self.show(columns[k], float(values[row, k]))}, {expected}",
        )

    def refuse_beyond(self, columns: Sequence[str], values: Array, most: float, what: str = "", hint: str = "") -> None:
        """Raise InputError for the first value of some columns (rows, columns) that is larger in size, or smaller."""
        for k, one in enumerate(columns):
            expected = f"expected {what}at most {self.show(one, most)} in size{hint}"
            self.refuse_values(columns[k : k + 1], values[:, k : k + 1], np.abs(values[:, k : k + 1]) > most, expected)

    def has(self, columns: Sequence[str]) -> bool:
        """Whether the table has any of these columns; InputError where it has some of them, but not all."""
        there = [column for column in columns if column in self.columns]
        if there and len(there) < len(columns):
            missing = next(column for column in columns if column not in self.columns)
            raise InputError(
                f"{self.path}: found column {self.name(there[0])!r} without {missing!r}, expected all or none"
            )
        return bool(there)

    def check_unique(self, keys: Sequence[tuple[str, ...]], what: str) -> None:
        """Raise InputError where two rows have the same key."""
        seen: dict[tuple[str, ...], int] = {}
        for row, key in enumerate(keys):
            if key in seen:
                first, name = self.lines[seen[key]], "/".join(key)
                raise InputError(f"{self.where(row)}: {what} {name!r} is already on line {first}, expected once")
            seen[key] = row

    def _number(self, cell: str, row: int, column: str) -> float:
        name, size = self.written_as(column)
        try:
            value = size * float(cell.replace("_", "?"))  # Python would read 1_0 as ten
        except ValueError as error:
            hint = " with a decimal point, or a TOML file with decimal = ','" if DECIMAL_COMMA.fullmatch(cell) else ""
            raise InputError(f"{self.where(row)}: {name}: found {cell.strip()!r}, expected a number{hint}") from error
        if not math.isfinite(value):
            raise InputError(f"{self.where(row)}: {name}: found {cell.strip()}, expected a finite number")
        if abs(value) > LARGEST:
            raise InputError(
                f"{self.where(row)}: {name}: found {cell.strip()}, expected at most {LARGEST / size:g} in size"
            )
        return value


def read_table(path: Path, columns: Sequence[str] | None, optional: Sequence[str] = ()) -> CsvTable:
    """Read a table with these columns, in any order, and some that may be there; None takes them as they are.

    A column in another unit, as ``x_m`` is of ``x_mm``, is converted. InputError for a missing or unreadable file, an
    unknown or missing column, a row of another length, or no rows; a quoted cell must end on its line. A TOML file may
    stand for one that is no comma CSV, see `table_files`.
    """
    cells = read_cells(path, ", ".join(columns or ["..."]))
    if columns is None or "pose" in columns:
        cells = cells.name_rows()
    known = (*(columns or ()), *optional)
    units = find_units(cells.header, known)
    faults = [cells.fault] if cells.fault else []
    faults += _list_header_faults([units.get(one, (one,))[0] for one in cells.header], columns, optional)
    if faults:
        first, *others = (f"{cells.path}, line {cells.header_line}: {fault}" for fault in faults)
        raise InputError(first, others)
    cells.check_lengths()
    if not cells.rows:
        raise InputError(f"{cells.path}: found no rows, expected some")
    written = {here: WrittenColumn(name) for here, name in cells.named.items()}
    return CsvTable(cells.path, cells.header, cells.rows, cells.lines, written).convert(known)


def find_units(columns: Sequence[str], known: Collection[str]) -> dict[str, tuple[str, float]]:
    """Return the columns that are known in another unit: by name what they are there, and the factor to its unit."""
    found = dict[str, tuple[str, float]]()
    for name in columns:
        stem, _, unit = name.rpartition("_")
        sizes = next((units for units in (LENGTHS, ANGLES) if unit in units), {})
        for other, size in sizes.items():
            if name not in known and f"{stem}_{other}" in known:
                found.setdefault(name, (f"{stem}_{other}", float(sizes[unit]) / float(size)))
    return found


def _list_header_faults(header: Sequence[str], columns: Sequence[str] | None, optional: Sequence[str]) -> list[str]:
    """Return what is wrong with a header's names, the first of several first."""
    faults = ["found a column twice, expected it once"] if len(set(header)) != len(header) else []
    if columns is None:
        return faults
    known = (*columns, *optional)
    more = ", ".join(optional[:SHOWN]) + (" …" if len(optional) > SHOWN else "")
    expected = ", ".join(columns) + (f", and maybe {more}" if optional else "")
    for name in header:
        if name not in known:
            close = [one for one in known if _stem(one) == _stem(name)]
            close = close or difflib.get_close_matches(name, known, n=1, cutoff=0.4)
            hint = f", did you mean {close[0]!r}?" if close else ""
            faults.append(f"found column {name!r}{hint}, expected {expected}")
    faults += [f"found no column {name!r}, expected {expected}" for name in columns if name not in header]
    return faults


def _stem(name: str) -> str:
    """Return a column's name without its unit."""
    return name.rpartition("_")[0] or name


def read_matrix(path: Path, n_columns: int) -> Array:
    """Read a table of numbers with a column for each leg, shape (rows, n_columns), in the order of the legs.

    The columns say which leg they are of, as in ``drho_1`` or ``rho_6_mm``; their order in the file does not matter.
    """
    table = read_table(path, None)
    names = [one for one in table.columns if one != "pose"]
    if len(names) != n_columns:
        raise InputError(f"{path}: found {len(names)} columns, expected {n_columns}, one per leg")
    legs = [LEG_NUMBER.search(name) for name in names]
    by_leg = {int(leg[1]): name for leg, name in zip(legs, names, strict=True) if leg}
    if set(by_leg) != set(range(1, n_columns + 1)):
        raise InputError(f"{path}: found columns {', '.join(names)}, expected one per leg, drho_1 to drho_{n_columns}")
    return table.numbers([by_leg[leg] for leg in sorted(by_leg)])


def read_by_leg(path: Path, columns: Sequence[str], n_legs: int) -> Array:
    """Read a table with a row for each leg, named in the column ``leg``; shape (N, columns), in the order of the legs.

    InputError where a leg is missing, stands twice or is none of the machine's.
    """
    table = read_table(path, ("leg", *columns))
    legs = table.text("leg")
    table.check_unique([(leg,) for leg in legs], "leg")
    expected = [str(leg) for leg in range(1, n_legs + 1)]
    for row, leg in enumerate(legs):
        if leg not in expected:
            raise InputError(f"{table.where(row)}: leg: found {leg!r}, expected 1 to {n_legs}")
    if len(legs) < n_legs:
        missing = next(leg for leg in expected if leg not in legs)
        raise InputError(f"{path}: found no row of leg {missing}, expected legs 1 to {n_legs}")
    return table.numbers(columns)[[legs.index(leg) for leg in expected]]


def format_table(comments: Sequence[str], columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return the text of a CSV file with comment lines above the header; no spreadsheet takes a text for a formula."""
    lines = [f"# {' '.join(comment.splitlines())}" for comment in comments]
    lines += [",".join(map(_write_cell, row)) for row in (columns, *rows)]
    return "\n".join(lines) + "\n"


def _write_cell(value: object) -> str:
    """Return a cell, quoted where a return is in it, too, which `csv.writer` leaves bare before a line's feed."""
    text = guard_cell(value) if isinstance(value, str) else str(value)
    quoted = text.replace('"', '""')
    return f'"{quoted}"' if any(sign in text for sign in ',"\r\n') else text
