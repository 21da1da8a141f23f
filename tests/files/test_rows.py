"""Tables of results that follow from a declaration of their rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pytest

from bayescal.errors import InputError
from bayescal.files.rows import TableRow, check_tables, column


@dataclass(frozen=True, kw_only=True)
class Reading(TableRow, table="readings"):
    """A reading."""

    pose: str = column("name of the pose")
    use: Literal["fit", "check"] = column("what it is for")
    value: float = column("as read", "mm")
    count: int = column("how often")
    is_good: bool | None = column("whether it is", default=None)
    others: Mapping[str, float] = field(default_factory=dict)


def make_rows() -> list[Reading]:
    return [
        Reading(pose="A", use="fit", value=1.5, count=2, others={"x_mm": 3.0}),
        Reading(pose="B", use="check", value=math.nan, count=1, others={"x_mm": 4.0}),
    ]


def test_rows_become_a_table_and_come_back():
    table = Reading.collect(make_rows())
    assert list(table.columns) == ["pose", "use", "value", "count", "x_mm"]
    assert table["count"].dtype == np.int64
    assert table["value"].dtype == np.float64
    first, second = Reading.read(table)
    assert first == make_rows()[0]
    assert math.isnan(second.value)
    assert second.others == {"x_mm": 4.0}


def test_columns_become_the_same_table():
    columns = {"use": ["fit", "check"], "count": [2, 1], "value": [1.5, math.nan], "pose": ["A", "B"]}
    table = Reading.tabulate({"x_mm": [3.0, 4.0]}, **columns)
    pd.testing.assert_frame_equal(table, Reading.collect(make_rows()))


def test_one_value_stands_in_every_row():
    table = Reading.tabulate(use="fit", count=[2, 1], value=0.0, pose=["A", "B"])
    assert table["use"].tolist() == ["fit", "fit"]


def test_an_optional_column_is_there_where_a_row_has_it():
    rows = [*make_rows(), Reading(pose="C", use="fit", value=0.0, count=0, is_good=True)]
    assert "is_good" not in Reading.collect(make_rows())
    assert Reading.collect(rows)["is_good"].tolist() == [None, None, True]


def test_a_table_without_rows_has_its_columns():
    assert list(Reading.collect([]).columns) == Reading.list_names()


@pytest.mark.parametrize("columns", [{"pose": ["A"]}, {"pose": ["A"], "use": "fit", "value": 1.0, "count": 1, "z": 0}])
def test_columns_that_are_missing_or_unknown_are_refused(columns):
    with pytest.raises(TypeError, match="Reading"):
        Reading.tabulate(**columns)


def test_a_type_that_no_column_has_is_refused():
    @dataclass(frozen=True, kw_only=True)
    class Wrong(TableRow, table="wrong"):
        parts: tuple[float, ...] = column("several in a cell")

    with pytest.raises(TypeError, match="parts"):
        Wrong.list_columns()


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda table: table.drop(columns="value"), "readings.csv: found no column 'value', expected pose, use"),
        (lambda table: table.assign(value="much"), "readings.csv: column 'value': found text, expected numbers"),
        (lambda table: table.assign(use="none"), "readings.csv, line 2: use: found 'none', expected fit, check"),
    ],
)
def test_a_table_that_is_not_as_declared_is_refused(change, wanted, tmp_path):
    table = Reading.collect(make_rows())
    check_tables([Reading], {"readings": table, "foreign": pd.DataFrame({"a": [1]})}, tmp_path)
    with pytest.raises(InputError) as found:
        check_tables([Reading], {"readings": change(table)}, Path("out"))
    assert wanted in str(found.value)


def test_the_reference_lists_columns_with_units():
    assert Reading.describe()[2] == ("value", "mm", "as read")
