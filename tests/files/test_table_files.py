"""Tables as other programs write them: one content in every form, and one line for what is not as it is said."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusals import line_of

from bayescal.errors import InputError
from bayescal.files.csv_tables import read_matrix, read_table
from bayescal.files.memory import MemoryPath
from bayescal.files.table_files import list_beside

NAMES = 'columns = { "q{0}" = "joint_{1}_rad", x = "x_m", time = "" }\n'
COLUMNS = ("pose", "joint_1_rad", "joint_2_rad", "x_mm")
VALUES = np.array([[0.25, -1.5, 812.5], [1e-3, 2.0, -40.0]])
SEMICOLONS = "time;q0;q1;x\n7;0,25;-1,5;0,8125\n8;1e-3;2;-,04\n"


def write(folder: Path, name: str, text: str, form: str = NAMES) -> Path:
    """Return the TOML file of a table that is written beside it."""
    (folder / name).write_text(text)
    (folder / "form.toml").write_text(f"table = {name!r}\n{form}")
    return folder / "form.toml"


@pytest.mark.parametrize(
    ("name", "text", "form"),
    [
        ("t.csv", SEMICOLONS, "separator = ';'\ndecimal = ','\n" + NAMES),
        ("t.tsv", SEMICOLONS.replace(";", "\t").replace(",", "."), NAMES),
        ("t.txt", SEMICOLONS.replace(";", "\t"), "separator = \"\\t\"\ndecimal = ','\n" + NAMES),
        ("t.csv", "# a logger\n" + SEMICOLONS.replace(",", ".").replace(";", ","), NAMES),
        (
            "t.jsonl",
            '{"time": 7, "q": [0.25, -1.5], "x": 0.8125}\n\n{"q": [0.001, 2], "x": -0.04, "time": null}\n',
            'columns = { "q_{1}" = "joint_{1}_rad", x = "x_m", time = "" }\n',
        ),
    ],
)
def test_one_table_in_every_form(tmp_path, name, text, form):
    table = read_table(write(tmp_path, name, text, form), COLUMNS)
    assert table.text("pose") == ["P1", "P2"]
    np.testing.assert_allclose(table.numbers(COLUMNS[1:]), VALUES, rtol=1e-15)
    assert table.path.name == name


def test_parquet_is_read_where_its_library_is(tmp_path):
    path = tmp_path / "t.parquet"
    path.write_bytes(b"PAR1 and no more")
    message = line_of(read_table, path, None)
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        assert "expected pyarrow (pip install 'bayescal[parquet]')" in message
        return
    assert "not Parquet" in message
    pd.DataFrame({"time": [7, 8], "q0": VALUES[:, 0], "q1": VALUES[:, 1], "x": VALUES[:, 2] / 1e3}).to_parquet(path)
    (tmp_path / "form.toml").write_text(f"table = 't.parquet'\n{NAMES}")
    np.testing.assert_array_equal(read_table(tmp_path / "form.toml", COLUMNS).numbers(COLUMNS[1:]), VALUES)


@pytest.mark.parametrize(
    ("text", "form", "said"),
    [
        (SEMICOLONS, NAMES, "t.csv, line 1: found cells separated by semicolons, expected commas"),
        (
            SEMICOLONS,
            "separator = ';'\n" + NAMES,
            "t.csv, line 2: q0: found '0,25', expected a number with a decimal",
        ),
        (
            SEMICOLONS.replace("0,8125", "0.8125"),
            "separator = ';'\ndecimal = ','\n" + NAMES,
            "t.csv, line 2: found '0.81",
        ),
        ("q0,q1,x\n0,25,1,5,3,1\n", "", "t.csv, line 2: found 6 cells, expected 3; decimal commas?"),
        ("q0,q1,z\n1,2,3\n", NAMES, "form.toml, line 2: columns: found 'x', expected one of q0, q1, z"),
        ("a,b\n1,2\n", "columns = { a = 'x_m', b = 'x_m' }", "line 1: found a column twice"),
        (
            "a,b\n1,2\n",
            "columns = { a = 'q{1}' }",
            "columns: found 'a' = 'q{1}', expected one number in braces on both",
        ),
        ("a,b\n1,2\n", "decimal = ','", "form.toml, line 2: decimal: found ',', expected '.', or ',' beside"),
        ("a,b\n1,2\n", "\nseparator = 'x'", "form.toml, line 3: separator: found 'x', expected"),
        ("a,b\n1,2\n", "pose = 'P'", "pose: found 'P', expected a name with one number in braces"),
        ("a,b\n1,2\n", "seperator = ';'", "line 2: seperator: found an unknown key, expected one of table, separator"),
        ("a,b\n1,2\n", "table = 'x'", "form.toml: not valid TOML"),
    ],
)
def test_what_is_not_as_it_is_said(tmp_path, text, form, said):
    path = write(tmp_path, "t.csv", text, form)
    assert said in line_of(lambda: read_table(path, COLUMNS).numbers(COLUMNS[1:]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"a": 1}\n[1]\n', "t.jsonl, line 2: found '[1]', expected a JSON object"),
        ('{"a": 1}\n\n{"a": \n', "t.jsonl, line 3: not JSON"),
        ('{"a": true}\n', "t.jsonl, line 1: a: found 'true', expected a number"),
        ('{"a": NaN}\n', "t.jsonl, line 1: a: found NaN, expected a finite number"),
        ('{"a": 1}\n{"b": 1}\n', "t.jsonl, line 2: a: found '', expected a number"),
        ("\n", "t.jsonl, line 1: found no column 'a'"),
    ],
)
def test_json_lines_that_are_none(tmp_path, text, said):
    (tmp_path / "t.jsonl").write_text(text)
    assert said in line_of(lambda: read_table(tmp_path / "t.jsonl", ("a",), ("b",)).numbers(["a"]))


def test_rows_are_named_as_their_file_says(tmp_path):
    path = write(tmp_path, "t.csv", "drho_1,drho_2\n1,2\n3,4\n", "pose = 'V{8}'\n")
    assert read_table(path, None).text("pose") == ["V8", "V9"]
    np.testing.assert_array_equal(read_matrix(path, 2), [[1, 2], [3, 4]])
    assert list_beside("form.toml", tmp_path) == ("form.toml", "t.csv")
    assert list_beside("t.csv", tmp_path) == ("t.csv",)


def test_lengths_and_angles_are_in_any_unit(tmp_path):
    (tmp_path / "t.csv").write_text("x_m,a_deg,sd_x_mm\n0.5,180,0.25\n,90,1\n")
    table = read_table(tmp_path / "t.csv", ("x_mm", "a_rad", "sd_x_um"))
    values = table.numbers(table.columns, gaps=True)
    np.testing.assert_allclose(values, [[500.0, np.pi, 250.0], [np.nan, np.pi / 2, 1000.0]])
    (tmp_path / "t.csv").write_text("x_m,x_mm\n0.5,500\n")
    assert "found a column twice" in line_of(read_table, tmp_path / "t.csv", ("x_mm",))


@pytest.mark.parametrize("suffix", ["csv", "tsv", "jsonl", "toml", "parquet"])
@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_any_file_is_a_table_or_one_line(suffix, data):
    row = st.dictionaries(
        st.text(max_size=5), st.recursive(st.none() | st.floats() | st.text(max_size=5), st.lists, max_leaves=6)
    )
    lines = st.lists(
        st.text(max_size=30) | row.map(json.dumps) | st.sampled_from([NAMES, "table = 't.csv'", "a;b", "1,5;2"])
    )
    content = data.draw(st.binary(max_size=60) | lines.map(lambda one: "\n".join(one).encode("utf-8", "ignore")))
    files = {f"f.{suffix}": content, "t.csv": data.draw(st.sampled_from([b"", b"a,b\n1,2\n", b"q0;x\n1,5;2\n"]))}
    with suppress(InputError):
        table = read_table(MemoryPath(f"f.{suffix}", files=files), None)
        table.numbers(table.columns, gaps=True)


def test_a_frame_is_read_as_its_file(tmp_path):
    from bayescal.data.reader import TableReader, read_with

    class Logger(TableReader):
        def read(self, path: Path) -> pd.DataFrame:
            return pd.DataFrame({"a": [1, None], "b": [None, 2]}).convert_dtypes()

    assert read_with(Logger(), tmp_path / "x").rows == (("1", ""), ("", "2"))
