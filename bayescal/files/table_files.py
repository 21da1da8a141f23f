"""How a table's file is written: as comma CSV, tabs, JSON lines or Parquet by its name, or as a TOML file says of it.

Wherever a table is named, in a config, in Python or on the command line, such a file may stand for it::

    table = "recorded.csv"     # beside it
    separator = ";"
    decimal = ","
    columns = { "q{1}" = "joint_{1}_rad", x = "x_m", time = "" }

``columns`` gives the file's own names their names here, the first number of a run in braces on both sides; an empty
name leaves a column out. Rows without a column ``pose`` are named by ``pose = "P{1}"``, which holds where nothing is
said: rows of one name in several tables belong together. JSON's lists are numbered from one:
``{"q": [0.1, 0.2]}`` has the columns ``q_1`` and ``q_2``.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from bayescal.errors import InputError, say_unknown
from bayescal.files.atomic import read_text

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
TABS, JSON_LINES, PARQUET = (".tsv",), (".jsonl", ".ndjson"), (".parquet", ".pq")
DECIMAL_COMMA = re.compile(r"\s*[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?\s*")
DECIMAL_POINT = re.compile(r"\s*[+-]?(\d+\.\d*|\.\d+)([eE][+-]?\d+)?\s*")
NUMBERED = re.compile(r"\{(\d{1,6})\}")
MOST_COLUMNS = 2000
POSE = "pose"


@dataclass(frozen=True)
class TableCells:
    """Text cells of a file under a header, with the line that each row stands on.

    ``fault`` is what is wrong with how the header is written, empty where nothing is; ``pose`` how rows may be named by
    their order; ``named`` the file's own names of columns that have another here.
    """

    path: Path
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    header_line: int = 1
    fault: str = ""
    pose: str = ""
    named: Mapping[str, str] = field(default_factory=dict)

    def check_lengths(self) -> None:
        """Raise InputError for a row with more or fewer cells than the header."""
        n = len(self.header)
        for line, cells in zip(self.lines, self.rows, strict=True):
            if len(cells) != n:
                hint = "; decimal commas?" if len(cells) in (2 * n, 2 * n - 1) else ""
                raise InputError(f"{self.path}, line {line}: found {len(cells)} cells, expected {n}{hint}")

    def name_rows(self) -> TableCells:
        """Return the same with a column of poses, where there is none and its TOML file lets rows be named."""
        if not self.pose or POSE in self.header:
            return self
        first = int(NUMBERED.findall(self.pose)[0])
        rows = tuple((NUMBERED.sub(str(k), self.pose), *row) for k, row in enumerate(self.rows, start=first))
        return replace(self, header=(POSE, *self.header), rows=rows)


@dataclass(frozen=True)
class TableForm:
    """How a table is written, as its TOML file says: the keys of that, and where it is."""

    table: Path
    separator: str = ""  # by the file's name
    decimal: str = "."
    columns: Mapping[str, str] = field(default_factory=dict)
    pose: str = "P{1}"
    source: Path | None = None

    def read(self, expected: str) -> TableCells:
        """Return the cells of the file; InputError, with its line, for what is not written in this form."""
        suffix = self.table.suffix.lower()
        if suffix in PARQUET:
            cells = _read_parquet(self.table)
        elif suffix in JSON_LINES:
            cells = _read_json_lines(self.table)
        else:
            cells = self._read_separated(expected)
        if self.decimal == ",":
            rows = tuple(tuple(self._turn(cell, cells, k) for cell in row) for k, row in enumerate(cells.rows))
            cells = replace(cells, rows=rows)
        if self.source is None or cells.fault:
            return cells
        cells.check_lengths()
        return self._rename(cells)

    def _read_separated(self, expected: str) -> TableCells:
        path, separator = self.table, self.separator or ("\t" if self.table.suffix.lower() in TABS else ",")
        lines = enumerate(read_text(path, "a CSV table").splitlines(), start=1)
        numbered = [(line, row) for line, row in lines if row.strip() and not row.startswith("#")]
        if not numbered:
            raise InputError(f"{path}: found no header, expected {expected}")
        parsed = list[tuple[str, ...]]()
        for line, row in numbered:
            try:
                parsed.append(tuple(next(csv.reader([row], delimiter=separator, strict=True))))
            except csv.Error as error:
                raise InputError(f"{path}, line {line}: not a CSV row ({error})") from error
        line, row = numbered[0]
        other = next((one for one in SEPARATORS if one in row and separator not in row), "")
        header = tuple(cell.strip() for cell in (row.split(other) if other else parsed[0]))
        fault = f"found cells separated by {SEPARATORS[other]}, expected {SEPARATORS[separator]}" if other else ""
        if fault and self.source is None:
            fault += f", and decimal points; or a TOML file with table = {path.name!r} and separator = {other!r}"
        return TableCells(
            path, header, tuple(parsed[1:]), tuple(line for line, _ in numbered[1:]), numbered[0][0], fault
        )

    def _turn(self, cell: str, cells: TableCells, row: int) -> str:
        """Return a cell with a decimal point; InputError where it has one already, which may be of thousands."""
        if DECIMAL_POINT.fullmatch(cell):
            where = f"{self.table}, line {cells.lines[row]}"
            raise InputError(f"{where}: found {cell.strip()!r}, expected a decimal comma, as {self.source} says")
        return cell.replace(",", ".") if DECIMAL_COMMA.fullmatch(cell) else cell

    def _rename(self, cells: TableCells) -> TableCells:
        named = dict[str, str]()
        for name, here in self.columns.items():
            start, wanted = NUMBERED.search(name), NUMBERED.search(here)
            form = re.compile(re.escape(name))
            if start is not None:
                form = re.compile(re.escape(name[: start.start()]) + r"(\d{1,6})" + re.escape(name[start.end() :]))
            found = [(one, fits) for one in cells.header if (fits := form.fullmatch(one))]
            if start is not None:
                found = [(one, fits) for one, fits in found if int(fits[1]) >= int(start[1])]
            if not found:
                raise InputError(say_unknown(f"{self.where('columns')}", name, cells.header))
            for one, fits in found:
                number = int(fits[1]) - int(start[1]) if start else 0
                named[one] = NUMBERED.sub(str(number + int(wanted[1])), here) if wanted else here
        kept = [k for k, one in enumerate(cells.header) if named.get(one, one)]
        header = tuple(named.get(cells.header[k], cells.header[k]) for k in kept)
        rows = tuple(tuple(row[k] for k in kept) for row in cells.rows)
        own = {here: cells.header[k] for k, here in zip(kept, header, strict=True) if here != cells.header[k]}
        return replace(cells, header=header, rows=rows, pose=self.pose, named=own)

    def where(self, key: str) -> str:
        """Return where a key stands in the TOML file."""
        assert self.source is not None
        return _find_key(self.source, read_text(self.source, "a TOML file of a table"), key)


def _find_key(path: Path, text: str, key: str) -> str:
    lines = [k for k, row in enumerate(text.splitlines(), start=1) if re.match(rf"\W*{re.escape(key)}\W", row)]
    return f"{path}, line {lines[0]}: {key}" if lines else f"{path}: {key}"


def read_cells(path: Path, expected: str) -> TableCells:
    """Return the cells of a table's file, or of that which a TOML file names; InputError for what cannot be read.

    ``expected`` is what the message of an empty file speaks of.
    """
    return read_form(path).read(expected)


def read_form(path: Path) -> TableForm:
    """Return how a table's file is written; InputError, with the line, for a TOML file that does not say it."""
    if path.suffix.lower() != ".toml":
        return TableForm(path)
    text = read_text(path, "a TOML file of a table")
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error

    def refuse(key: str, found: str, expected: str) -> InputError:
        return InputError(f"{_find_key(path, text, key)}: found {found}, expected {expected}")

    known = ("table", "separator", "decimal", "columns", "pose")
    for key in content:
        if key not in known:
            raise refuse(key, "an unknown key", f"one of {', '.join(known)}")
    table, separator, decimal = content.get("table"), content.get("separator", ""), content.get("decimal", ".")
    if not isinstance(table, str) or not table or table.lower().endswith(".toml"):
        raise refuse("table", "none" if table is None else repr(table), "the file of a table")
    if separator not in ("", *SEPARATORS):
        raise refuse("separator", repr(separator), ", ".join(map(json.dumps, SEPARATORS)))
    by_commas = separator == "," or not (separator or table.lower().endswith((*TABS, *JSON_LINES, *PARQUET)))
    if decimal not in (".", ",") or (decimal == "," and by_commas):
        raise refuse("decimal", repr(decimal), "'.', or ',' beside another separator")
    columns = content.get("columns", {})
    if not isinstance(columns, dict) or not all(isinstance(one, str) for one in columns.values()):
        raise refuse("columns", repr(columns), "a table of names, the file's own to those here")
    for name, here in columns.items():
        if here and [len(NUMBERED.findall(one)) for one in (name, here)] not in ([0, 0], [1, 1]):
            raise refuse("columns", f"{name!r} = {here!r}", "one number in braces on both sides, or none")
    pose = content.get("pose", TableForm.pose)
    if not isinstance(pose, str) or len(NUMBERED.findall(pose)) != 1:
        raise refuse("pose", repr(pose), "a name with one number in braces, as P{1}")
    return TableForm(path.parent / table, separator, decimal, columns, pose, path)


def list_beside(name: str, folder: Path) -> tuple[str, ...]:
    """Return a file with the table that it names, where it is the TOML file of one."""
    path = folder / name
    if path.suffix.lower() == ".toml" and path.is_file():
        try:
            content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError, RecursionError):  # whoever reads it says so
            return (name,)
        if isinstance(table := content.get("table"), str):
            return name, (Path(name).parent / table).as_posix()
    return (name,)


# --- other programs' forms -------------------------------------------------------------------------------------------


def _read_json_lines(path: Path) -> TableCells:
    text, found, lines = read_text(path, "JSON lines"), list[dict[str, str]](), list[int]()
    header = dict[str, None]()
    for line, row in enumerate(text.splitlines(), start=1):
        if not row.strip():
            continue
        try:
            one = json.loads(row)
            if not isinstance(one, dict):
                raise InputError(f"{path}, line {line}: found {row.strip()[:40]!r}, expected a JSON object")
            found.append(dict(_flatten(one)))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}, line {line}: not JSON ({error})") from error
        header |= dict.fromkeys(found[-1])
        lines.append(line)
        if len(header) > MOST_COLUMNS:
            raise InputError(f"{path}, line {line}: found more than {MOST_COLUMNS} columns, expected fewer")
    rows = tuple(tuple(one.get(name, "") for name in header) for one in found)
    return TableCells(path, tuple(header), rows, tuple(lines))


def _flatten(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the cells of a JSON value, by the names and numbers that lead there."""
    if isinstance(value, dict | list):
        inner = value.items() if isinstance(value, dict) else enumerate(value, start=1)
        for key, one in inner:
            yield from _flatten(one, f"{name}_{key}" if name else str(key))
    else:
        yield name, "" if value is None else value if isinstance(value, str) else json.dumps(value)


def _read_parquet(path: Path) -> TableCells:
    import pandas as pd

    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a Parquet table")
    try:
        import pyarrow  # noqa: F401  # pandas would name several libraries
    except ImportError as error:
        raise InputError(
            f"{path}: found a Parquet table, expected pyarrow (pip install 'bayescal[parquet]'), or CSV"
        ) from error
    try:
        table = pd.read_parquet(BytesIO(path.read_bytes()), engine="pyarrow")
    except Exception as error:  # what pyarrow raises is of many kinds
        raise InputError(f"{path}: not Parquet ({' '.join(str(error).split())[:200]})") from error
    return cells_from_frame(table if table.index.name is None else table.reset_index(), path)


def cells_from_frame(table: pd.DataFrame, path: Path) -> TableCells:
    """Return the cells of a DataFrame, rows counted as lines under a header."""
    rows = tuple(tuple(map(_write_value, row)) for row in table.itertuples(index=False, name=None))
    return TableCells(path, tuple(map(str, table.columns)), rows, tuple(range(2, len(rows) + 2)))


def _write_value(value: object) -> str:
    import pandas as pd

    return "" if value is None or value is pd.NA or value is pd.NaT or value != value else str(value)
