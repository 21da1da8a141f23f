"""CSV tables: every fault names its file and line; what spreadsheets add (marks, line ends, quotes) is fine."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from refusals import line_of

from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table, read_by_leg, read_matrix, read_table

COLUMNS = ("pose", "x_mm", "y_mm")


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "table.csv"


def fail(path: Path, columns: tuple[str, ...] | None = COLUMNS) -> str:
    """Return the one-line message with which reading fails."""
    message = line_of(lambda: read_table(path, columns).numbers(("x_mm", "y_mm")))
    assert message.startswith(str(path))
    return message


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "found no header, expected pose, x_mm, y_mm"),
        ("# only a comment\n", "found no header"),
        ("pose,x_mm,y_mm\n", "found no rows"),
        ("# note\npose,x_in,y_mm\nA,1,2\n", "line 2: found column 'x_in', did you mean 'x_mm'?, expected pose, x_mm"),
        ("pose,x_mm\nA,1\n", "line 1: found no column 'y_mm', expected pose, x_mm, y_mm"),
        ("pose,x_mm,y_mm,y_mm\nA,1,2,3\n", "line 1: found a column twice"),
        ("pose,x_mm,y_mm,colour\nA,1,2,3\n", "line 1: found column 'colour'"),
        ("pose;x_mm;y_mm\nA;1;2\n", "separated by semicolons"),
        ("pose\tx_mm\ty_mm\nA\t1\t2\n", "line 1: found cells separated by tabs, expected commas"),
        ("A,1,2\nB,1,2\n", "line 1: found column 'A', expected"),
        ("pose,x_mm,y_mm\nA,1,2\n\n# note\nB,1\n", "line 5: found 2 cells, expected 3"),
        ("pose,x_mm,y_mm\nA,1,2,3\n", "line 2: found 4 cells, expected 3"),
        ("pose,x_mm,y_mm\nA,1,2\nB,one,2\n", "line 3: x_mm: found 'one', expected a number"),
        ("pose,x_mm,y_mm\nA,1,2\nB,1.0 mm,2\n", "line 3: x_mm: found '1.0 mm', expected a number"),
        ("pose,x_mm,y_mm\nA,1,1_0\n", "line 2: y_mm: found '1_0', expected a number"),
        ("pose,x_mm,y_mm\nA,1,\n", "line 2: y_mm: found '', expected a number"),
        ("pose,x_mm,y_mm\nA,nan,2\n", "line 2: x_mm: found nan, expected a finite number"),
        ("pose,x_mm,y_mm\nA,1,-inf\n", "line 2: y_mm: found -inf, expected a finite number"),
        ("pose,x_mm,y_mm\nA,1,1e999\n", "line 2: y_mm: found 1e999, expected a finite number"),
        ("pose,x_mm,y_mm\nA,1,1e300\n", "line 2: y_mm: found 1e300, expected at most 1e+09 in size"),
        ('pose,x_mm,y_mm\nA,1,"2\nB,1,2\n', "line 2: not a CSV row"),
        ('pose,x_mm,y_mm\nA,1,2\nB,1,"2\n', "line 3: not a CSV row"),
    ],
)
def test_faulty_table(path, text, expected):
    path.write_text(text)
    assert expected in fail(path)


def test_missing_file_directory_and_binary(path):
    assert f"{path}: no such" in fail(path)
    assert f"{path.parent}: is a folder" in fail(path.parent)
    path.write_bytes(b"pose,x_mm,y_mm\nA,\xff,2\n")
    assert "line 2: not UTF-8" in fail(path)


def test_empty_name_is_an_error(path):
    path.write_text("pose,x_mm,y_mm\nA,1,2\n ,1,2\n")
    with pytest.raises(InputError, match=re.escape(f"{path}, line 3: pose:")):
        read_table(path, COLUMNS).text("pose")


@pytest.mark.parametrize(
    "content",
    [
        b"pose,x_mm,y_mm\nA,1,-2.5e0\nB,3,4\n",
        b"\xef\xbb\xbfpose,x_mm,y_mm\r\nA,1,-2.5\r\nB,3,4\r\n",
        b"\xef\xbb\xbf# note\n\n# more\npose,x_mm,y_mm\nA,1,-2.5\n\n# between\nB,3,4",
        b"y_mm, pose ,x_mm\n-2.5, A ,1\n4,B, 3 \n",
        b'"pose","x_mm","y_mm"\n"A","1","-2.5"\n"B","3","4"\n',
    ],
    ids=["plain", "windows", "comments", "other order, spaces", "quotes"],
)
def test_same_table_however_written(path, content):
    path.write_bytes(content)
    table = read_table(path, COLUMNS)
    assert table.text("pose") == ["A", "B"]
    np.testing.assert_array_equal(table.numbers(("x_mm", "y_mm")), [[1, -2.5], [3, 4]])


def test_line_numbers_count_comments_and_blanks(path):
    path.write_text("# one\n\npose,x_mm,y_mm\n# four\nA,1,2\n\nB,3,4\n")
    assert read_table(path, COLUMNS).lines == (5, 7)


def test_matrix_of_another_width(path):
    path.write_text("rho_1,rho_2\n1,2\n")
    np.testing.assert_array_equal(read_matrix(path, 2), [[1, 2]])
    with pytest.raises(InputError, match="2 columns, expected 6,"):
        read_matrix(path, 6)


def test_format_and_read_round_trip(path):
    path.write_text(format_table(["Note, with a comma"], COLUMNS, [("A", 0.1, 2.0), ("B", -1e-7, 3.0)]))
    table = read_table(path, COLUMNS)
    np.testing.assert_array_equal(table.numbers(("x_mm", "y_mm")), [[0.1, 2.0], [-1e-7, 3.0]])


def test_legs_stand_in_any_order(path):
    path.write_text("drho_2_1e-3,drho_1_1e-3\n1,2\n3,4\n")
    np.testing.assert_array_equal(read_matrix(path, 2), [[2, 1], [4, 3]])
    path.write_text("dx,leg\n1,2\n3,1\n")
    np.testing.assert_array_equal(read_by_leg(path, ("dx",), 2), [[3], [1]])


@pytest.mark.parametrize("header", ["a,b", "rho_1,rho_3", "rho_01,rho_2", "rho_1_mm,rho_1"])
def test_a_matrix_without_the_legs_numbers(path, header):
    path.write_text(f"{header}\n1,2\n")
    with pytest.raises(InputError, match="drho_1 to drho_2"):
        read_matrix(path, 2)


@pytest.mark.parametrize(
    ("rows", "fault"),
    [
        ("1,1\n1,2\n", "leg '1' is already on line 2, expected once"),
        ("1,1\n3,2\n", "leg: found '3', expected 1 to 2"),
        ("2,1\n", "found no row of leg 1, expected legs 1 to 2"),
    ],
)
def test_rows_of_legs_at_fault(path, rows, fault):
    path.write_text(f"leg,dx\n{rows}")
    with pytest.raises(InputError, match=fault):
        read_by_leg(path, ("dx",), 2)
