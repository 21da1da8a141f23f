"""Tables of pages that follow from the declaration of their rows: heading, unit, group and format of each column."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Literal

from bayescal.files.rows import ColumnType, TableRow
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.numbers import (
    NO_VALUE,
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
)
from bayescal.report.symbols import ChosenUnits, shown_in

KINDS: dict[str, Literal["text", "name", "symbol"]] = {"text": "text", "name": "name", "symbol": "symbol"}
UNIT, AMOUNT = "unit", "amount"
"""Formats of a row's inner unit, and of values in it: both are shown in the units that were chosen."""


def tabulate_rows(
    caption: str,
    rows: Sequence[TableRow],
    asked: ChosenUnits = None,
    without: Collection[str] = (),
    notes: Sequence[Statement] = (),
    style: str = "",
) -> Table:
    """Return a table of rows of one type: its columns that have a format, but those named in ``without``."""
    declared = [one for one in type(rows[0]).list_columns() if one.show and one.name not in without] if rows else []
    columns = [_head(one) for one in declared]
    return make_table(caption, columns, [[_write(row, one, asked) for one in declared] for row in rows], notes, style)


def _head(one: ColumnType) -> Column:
    title = one.title or one.name.replace("_", " ").capitalize()
    if one.show in KINDS:
        return Column(title, one.unit, one.group, kind=KINDS[one.show])
    return Column(title, "", one.group, "text") if one.show == UNIT else Column(title, one.unit, one.group)


def _write(row: TableRow, one: ColumnType, asked: ChosenUnits) -> str | Cell:
    """Return a cell: ``fixed 2``, ``significant 3`` and ``percent 1`` say their digits, ``± sd`` names its column."""
    value, (how, _, what) = getattr(row, one.name), one.show.partition(" ")
    if how in KINDS or value is None:
        return NO_VALUE if value is None or value == "" else str(value)
    if how == UNIT:
        return shown_in(value, asked)[1]
    if how == "±":
        return format_estimate(value, getattr(row, what))
    if how == "count":
        return str(value)
    if how == "plain":
        return format_plain(value) if math.isfinite(value) else NO_VALUE
    if how == "percent":
        return format_percent(value, int(what or 0))
    if how == AMOUNT:
        return format_significant(shown_in(getattr(row, UNIT), asked)[0] * value)
    return format_fixed(value, int(what)) if how == "fixed" else format_significant(value, int(what))
