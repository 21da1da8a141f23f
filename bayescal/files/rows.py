"""Tables of results, each declared once as a frozen dataclass whose fields are its columns.

From the declaration follow the table that is computed (`TableRow.tabulate`, `TableRow.collect`), the check of one that
is read (`TableRow.check`), its rows with attributes for pages (`TableRow.read`), and the columns of the reference
(`TableRow.describe`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self, get_args, get_origin, get_type_hints

from bayescal.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

TEXT, UNIT, PAGE = "text", "unit", "page"
OTHERS = "others"
"""Field of the columns that a table has beyond those that are declared, by their names."""


class ColumnType(NamedTuple):
    """What a column of a table holds."""

    name: str
    kind: type  # str, float, int or bool
    choices: tuple[str, ...]  # the texts that it may have; empty where any
    is_optional: bool  # whether a table may be without it, and a row without a value
    unit: str  # as the reference states it; empty where it has none, or where another column has it
    meaning: str
    title: str = ""  # on pages; its name where it is empty
    group: str = ""  # heading over it and its neighbours on pages
    show: str = ""  # how pages write its values; empty where they do not show it


def column(
    meaning: str, unit: str = "", default: object = MISSING, *, show: str = "", title: str = "", group: str = ""
) -> Any:
    """Return the field of a column: what it means, its unit, and None as default where a table may be without it.

    ``show`` is how pages write its values, empty where they do not show it; see `bayescal.report.row_tables`.
    """
    return field(default=default, metadata={TEXT: meaning, UNIT: unit, PAGE: (title, group, show)})


@dataclass(frozen=True, kw_only=True)
class TableRow:
    """A row of a table of results.

    A subclass is a frozen dataclass whose fields are made by `column`. A field ``others`` of type ``Mapping`` takes the
    columns whose names depend on the machine.

    Attributes
    ----------
    table : str
        Name of the table: that of its CSV file without the ending.
    """

    table: ClassVar[str]

    def __init_subclass__(cls, table: str = "", **more: object) -> None:
        super().__init_subclass__(**more)
        if table:
            cls.table = table

    @classmethod
    def list_columns(cls) -> list[ColumnType]:
        """Return the declared columns in their order."""
        return list(_list_columns(cls))

    @classmethod
    def list_names(cls) -> list[str]:
        """Return the names of the columns that every such table has."""
        return [one.name for one in _list_columns(cls) if not one.is_optional]

    @classmethod
    def tabulate(cls, others: Mapping[str, object] | None = None, /, **columns: object) -> pd.DataFrame:
        """Return the table of whole columns, each of N values or one value for all rows.

        Columns stand in the order of the declaration. TypeError where one is missing or unknown.
        """
        import pandas as pd  # a third of a second, for those who have tables

        declared = _list_columns(cls)
        unknown = set(columns) - {one.name for one in declared}
        missing = set(cls.list_names()) - set(columns)
        if unknown or missing or (others and not _takes_others(cls)):
            raise TypeError(f"{cls.__name__}: unknown {sorted(unknown)}, missing {sorted(missing)}, others {others}")
        return pd.DataFrame(_arrange(cls, columns, others or {}))

    @classmethod
    def collect(cls, rows: Iterable[Self]) -> pd.DataFrame:
        """Return the table of rows; optional columns that no row has are left out."""
        import pandas as pd  # a third of a second, for those who have tables

        rows = list(rows)
        found = {one.name: [getattr(row, one.name) for row in rows] for one in _list_columns(cls)}
        optional = {one.name for one in _list_columns(cls) if one.is_optional}
        kept = {name: x for name, x in found.items() if name not in optional or any(one is not None for one in x)}
        names = dict.fromkeys(name for row in rows for name in getattr(row, OTHERS, {}))
        return pd.DataFrame(
            _arrange(cls, kept, {name: [getattr(row, OTHERS).get(name) for row in rows] for name in names})
        )

    @classmethod
    def read(cls, table: pd.DataFrame) -> list[Self]:
        """Return the rows of a table that has the declared columns; a missing number is NaN."""
        declared = {one.name for one in _list_columns(cls)}
        rows = []
        for row in table.to_dict("records"):
            own = {str(name): value for name, value in row.items() if name in declared}
            others = {str(name): value for name, value in row.items() if name not in declared}
            rows.append(cls(**own, **({OTHERS: others} if _takes_others(cls) else {})))
        return rows

    @classmethod
    def check(cls, table: pd.DataFrame, path: Path) -> None:
        """Raise InputError where a table, read from a path, lacks a column or a column holds what it must not."""
        import pandas as pd  # a third of a second, for those who have tables

        for name, kind, choices, is_optional, *_ in _list_columns(cls):
            if name not in table.columns:
                if is_optional:
                    continue
                raise InputError(f"{path}: found no column {name!r}, expected {', '.join(cls.list_names())}")
            if kind is not str and not pd.api.types.is_numeric_dtype(table[name]):  # flags are numeric too
                raise InputError(f"{path}: column {name!r}: found text, expected numbers")
            for line, value in enumerate(table[name] if choices else (), start=2):
                if value not in choices:
                    raise InputError(f"{path}, line {line}: {name}: found {value!r}, expected {', '.join(choices)}")

    @classmethod
    def describe(cls) -> list[tuple[str, str, str]]:
        """Return name, unit and meaning of each column, as the reference lists them."""
        return [(one.name, one.unit, one.meaning) for one in _list_columns(cls)]


def check_tables(rows: Sequence[type[TableRow]], tables: Mapping[str, pd.DataFrame], folder: Path) -> None:
    """Raise InputError where a table of a folder, of those that are there and declared, is not as declared."""
    for one in rows:
        if one.table in tables and not tables[one.table].empty:
            one.check(tables[one.table], folder / f"{one.table}.csv")


def _arrange(row: type[TableRow], columns: Mapping[str, object], others: Mapping[str, object]) -> dict[str, object]:
    """Return columns in the order of the declaration, the undeclared ones at the place of ``others``."""
    arranged = dict[str, object]()
    for one in fields(row):
        arranged |= others if one.name == OTHERS else {k: v for k, v in columns.items() if k == one.name}
    return arranged


def _takes_others(row: type[TableRow]) -> bool:
    return any(one.name == OTHERS for one in fields(row))


def _list_columns(row: type[TableRow]) -> tuple[ColumnType, ...]:
    hints = get_type_hints(row)
    return tuple(_describe_column(one, hints[one.name]) for one in fields(row) if one.name != OTHERS)


def _describe_column(one: Field[object], kind: object) -> ColumnType:
    """Return a column of a field and its type: str, float, int, bool, literal texts, or one of these or None."""
    inner = [part for part in get_args(kind) if part is not NoneType] if NoneType in get_args(kind) else [kind]
    kind, choices = getattr(inner[0], "__value__", inner[0]), ()
    if get_origin(kind) is Literal:
        kind, choices = str, get_args(kind)
    if len(inner) > 1 or kind not in (str, float, int, bool):
        raise TypeError(f"{one.name}: found {kind}, expected a text, number or flag")
    is_optional, data = one.default is not MISSING, one.metadata
    return ColumnType(one.name, kind, choices, is_optional, data[UNIT], data[TEXT], *data[PAGE])
