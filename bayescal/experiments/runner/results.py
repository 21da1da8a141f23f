"""Results as files: tables as CSV with the kinds of their columns kept, so that what is read is what was written."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bayescal.errors import InputError
from bayescal.files import manifest
from bayescal.files.atomic import read_json
from bayescal.files.plain_text import add_article, guard_cell, release_cell

if TYPE_CHECKING:
    import pandas as pd

SUMMARY_FILE = "summary.json"
PROVENANCE_FILE = "provenance.json"
PRELIMINARY = "preliminary"
"""Key of a summary: whether its numbers are those of a preliminary answer."""
MANIFEST_KEY = "manifest"
"""Key of the provenance that names the manifest, which such results must have."""
TABLES, EMPTY_TABLES = "tables", "empty_tables"
"""Keys of the provenance for what the columns of every table hold, and for the columns of tables without rows."""
LENGTHS = "table_rows"
"""Key of the provenance for the number of rows of every table."""
TABLE_NAME = re.compile(r"([A-Za-z0-9_-]+/)?[A-Za-z0-9_-]+\.csv")
KINDS: dict[str, Callable[[str], object]] = {
    "number": lambda cell: float(cell) if cell else float("nan"),
    "integer": int,
    "flag": {"True": True, "False": False}.__getitem__,
    "text": str,
}
"""What a column may hold, and how a cell of it is read; an empty cell is NaN, or an empty text."""

type ColumnKind = Literal["number", "integer", "flag", "text"]
type Writer = Callable[[Path], None]

NUMBER = (int, float)

type Summary = dict[str, Any]
"""A summary, or a part of one: as JSON has it, keys by kind of experiment."""


@dataclass(frozen=True, eq=False)
class Results:
    """What an experiment found; the frame adds provenance, where it comes from, and the folder where it stands.

    The summary is JSON-ready. Tables are written as CSV unless they are empty. Further files are texts by their names
    in the results directory, or what writes one to the path it is given.
    """

    summary: Summary
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    files: Mapping[str, str | Writer] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    folder: Path | None = None

    @property
    def config(self) -> dict[str, Any]:
        """The config without its titles, as JSON has it."""
        config: dict[str, Any] = self.provenance.get("config", {})
        return config

    @property
    def hashes(self) -> set[str]:
        """SHA-256 of all files that the results go back to."""
        files = self.provenance.get("files")
        return {str(one) for one in files.values()} if isinstance(files, dict) else set()

    def table(self, name: str) -> pd.DataFrame:
        """Return a table; one without rows where there is none."""
        import pandas as pd  # a third of a second, for those who have tables

        return self.tables.get(name, pd.DataFrame())


def write_results(results: Results, folder: Path, tables_in: str = "", digits: int = 9) -> None:
    """Write tables (numbers to so many significant digits, zero for all), summary, files and provenance to a folder."""
    (folder / tables_in).mkdir(exist_ok=True)
    write_json(folder / PROVENANCE_FILE, {**results.provenance, TABLES: {}, EMPTY_TABLES: {}, LENGTHS: {}})
    for name, table in results.tables.items():
        write_table(name, table, folder, tables_in, digits)
    write_json(folder / SUMMARY_FILE, results.summary)
    for name, content in results.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, str):
            (folder / name).write_text(content, encoding="utf-8")
        else:
            content(folder / name)


def write_table(name: str, table: pd.DataFrame, folder: Path, tables_in: str = "", digits: int = 9) -> None:
    """Write a table to a folder whose provenance is there, and note its columns in that; see `write_results`."""
    provenance = read_json(folder / PROVENANCE_FILE)
    if table.empty:
        provenance[EMPTY_TABLES][name] = [str(column) for column in table.columns]
    else:
        path = f"{tables_in}/{name}.csv" if tables_in else f"{name}.csv"
        text = f"%.{digits}g" if digits else None
        guarded = table.map(lambda cell: guard_cell(cell) if isinstance(cell, str) else cell)
        cells = guarded.to_csv(index=False, float_format=text, lineterminator="\n")
        (folder / path).write_bytes(cells.encode())
        provenance[LENGTHS][path] = len(table)
        provenance[TABLES][path] = {str(column): find_kind(table[column]) for column in table.columns}
    write_json(folder / PROVENANCE_FILE, provenance)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON object, which has no number for what is not finite: null stands for it."""
    text = json.dumps(_make_json(content), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _make_json(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _make_json(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_make_json(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def find_kind(column: pd.Series) -> ColumnKind:
    """Return what a column holds."""
    import pandas as pd  # a third of a second, for those who have tables

    if pd.api.types.is_bool_dtype(column):
        return "flag"
    if pd.api.types.is_integer_dtype(column):
        return "integer"
    if pd.api.types.is_float_dtype(column):
        return "number"
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in column.dropna())
    return "number" if numbers else "text"


def check_results(folder: Path, but: Callable[[str], bool] = lambda name: False) -> None:
    """Raise InputError for a results directory that is not as it was written; see `manifest.check_whole`."""
    manifest.check_whole(folder, MANIFEST_KEY in read_json(folder / PROVENANCE_FILE), but)


def read_results(folder: Path, only: Collection[str] | None = None, checked: bool = True) -> Results:
    """Read a results directory, all its tables or only some: whoever uses results gets them here.

    ``checked``: whether its files must be those that its manifest has. InputError where it is none, a file was edited,
    is missing or was added, or a cell is not what its column holds.
    """
    import pandas as pd  # a third of a second, for those who have tables

    if checked:
        check_results(folder)
    provenance = read_json(folder / PROVENANCE_FILE)
    kinds = provenance.get(TABLES)
    if not isinstance(kinds, dict) or not all(isinstance(columns, dict) for columns in kinds.values()):
        raise InputError(f"{folder / PROVENANCE_FILE}: found no tables, expected results of this version")
    empty = provenance.get(EMPTY_TABLES, {})
    lists = empty.values() if isinstance(empty, dict) else [None]
    if not all(isinstance(one, list) and all(isinstance(column, str) for column in one) for one in lists):
        raise InputError(f"{folder / PROVENANCE_FILE}: empty_tables: found {empty!r}, expected lists of columns")
    for name in kinds:
        if not TABLE_NAME.fullmatch(name):
            raise InputError(f"{folder / PROVENANCE_FILE}: tables: found {name!r}, expected names of CSV files")
    summary = read_json(folder / SUMMARY_FILE)
    kinds = {name: columns for name, columns in kinds.items() if only is None or Path(name).stem in only}
    lengths, tables = provenance.get(LENGTHS), {}
    for name, columns in kinds.items():
        table = tables[Path(name).stem] = _read_table(folder / name, columns)
        known = lengths.get(name, len(table)) if isinstance(lengths, dict) else len(table)
        if known != len(table):  # cut between two rows, which says nothing of what it lacks
            raise InputError(f"{folder / name}: found {len(table)} rows, expected {known} as were written")
    tables |= {name: pd.DataFrame(columns=columns) for name, columns in empty.items()}
    return Results(summary, tables, {}, provenance, folder)


def _read_table(path: Path, kinds: Mapping[str, str]) -> pd.DataFrame:
    import pandas as pd  # a third of a second, for those who have tables

    try:
        table = pd.read_csv(io.BytesIO(path.read_bytes()), dtype=str, keep_default_na=False)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such table") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a table ({' '.join(str(error).split())})") from error
    if list(table.columns) != list(kinds):
        raise InputError(f"{path}: found columns {', '.join(table.columns)}, expected {', '.join(kinds)}")
    return pd.DataFrame({name: _read_column(path, table[name], kind) for name, kind in kinds.items()})


def _read_column(path: Path, cells: pd.Series, kind: str) -> pd.Series:
    import pandas as pd  # a third of a second, for those who have tables

    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{path}: {cells.name}: found kind {kind!r} in {PROVENANCE_FILE}, expected {', '.join(KINDS)}")
    if kind == "text":
        return cells.map(release_cell)
    read, values = KINDS[kind], []
    for row, cell in enumerate(cells, start=2):
        try:
            values.append(read(cell))
        except (ValueError, KeyError) as error:
            raise InputError(
                f"{path}, line {row}: {cells.name}: found {cell!r}, expected {add_article(kind)}"
            ) from error
    return pd.Series(values, name=cells.name)


type Kinds = type | tuple[type, ...]


def check_keys(content: Any, keys: Mapping[str, Kinds], path: Path, where: str) -> None:
    """Raise InputError where a JSON object lacks a key or holds a value of another kind; ``where`` leads to it."""
    for key, kind in keys.items():
        value = content.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            found = "nothing" if value is None else type(value).__name__
            wanted = "a number" if kind == NUMBER else getattr(kind, "__name__", str(kind))
            raise InputError(f"{path}: {where}{key}: found {found}, expected {wanted}")
