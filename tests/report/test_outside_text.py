"""Text that others have written does no harm, whichever way it goes out: terminal, tables, names of files, figures."""

from __future__ import annotations

import time

import pandas as pd
import pytest
from matplotlib.figure import Figure
from rich.table import Table

from bayescal.calibrated.machine import Source
from bayescal.experiments.runner.results import Results, read_results, write_results
from bayescal.experiments.runner.terminal import PlainConsole, TerminalColumn, print_table
from bayescal.files.csv_tables import format_table, read_table
from bayescal.files.plain_text import name_file
from bayescal.report.pictures import render_picture
from bayescal.report.symbols import LONGEST_NAME, make_label, quote, set_mathematics, set_parameter
from bayescal.results import LoadedResults

ESCAPE = "\x1b]0;title\x07\x1b[2J[red]x[/red]\u202e"
SHOWN = r"\x1b]0;title\x07\x1b[2J[red]x[/red]\u202e"

# --- terminal --------------------------------------------------------------------------------------------------------


def test_a_terminal_is_not_commanded(capsys):
    console = PlainConsole(width=200)
    table = Table(ESCAPE)
    table.add_row(ESCAPE)
    console.print(ESCAPE)
    console.print(table)
    print_table(console, [TerminalColumn(ESCAPE)], [[ESCAPE]])
    console.print("two\nlines")
    said = capsys.readouterr().out
    assert not {"\x1b", "\x07", "\u202e"} & set(said)
    assert said.count(SHOWN) == 5
    assert "two\nlines\n" in said


def test_compare_and_what_python_shows_are_plain(tmp_path, call):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        found = Results({ESCAPE: 1, "headline": ESCAPE}, {}, {}, {"kind": "simulation"})
        write_results(found, tmp_path / name)
    code, out, _ = call("compare", tmp_path / "one", tmp_path / "two")
    assert code == 0
    assert r"\x1b]0;title" in out.replace("\n", "")
    assert "\x1b" not in out + repr(LoadedResults(read_results(tmp_path / "one")))


# --- tables ----------------------------------------------------------------------------------------------------------

CELLS = {
    "=cmd|x": "'=cmd|x",
    "+1+1": "'+1+1",
    "-2+3": "'-2+3",
    "@sum": "'@sum",
    "-": "'-",
    "'=x": "''=x",
    "''-": "'" * 3 + "-",
    "a=b": "a=b",
    "'quoted'": "'quoted'",
    "-5": "-5",
    "+1e3": "+1e3",
    'a "b", c': '"a ""b"", c"',
}
"""Texts as they stand in a CSV file."""


def test_no_cell_of_a_table_is_a_formula(tmp_path):
    text = format_table(["one\n=two"], ["pose", "x_mm"], [[cell, -5.0] for cell in CELLS])
    assert text.splitlines() == ["# one =two", "pose,x_mm", *(f"{cell},-5.0" for cell in CELLS.values())]
    (tmp_path / "table.csv").write_text(text)
    read = read_table(tmp_path / "table.csv", ("pose", "x_mm"))
    assert read.text("pose") == list(CELLS)
    assert set(read.numbers(["x_mm"])[:, 0]) == {-5.0}
    assert format_table([], ["a"], [["\t=x"], ["\r=x"]]) == "a\n'\t=x\n\"'\r=x\"\n"


def test_tables_of_results_hold_no_formula_and_read_as_they_were(tmp_path):
    table = pd.DataFrame({"name": list(CELLS), "x": -1.5})
    write_results(Results({}, {"table": table}), tmp_path)
    assert (tmp_path / "table.csv").read_text().splitlines()[1:] == [f"{cell},-1.5" for cell in CELLS.values()]
    pd.testing.assert_frame_equal(read_results(tmp_path).table("table"), table, check_dtype=False)


# --- names of files --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../../up", "/etc/x", "a\x1b\n", "..", "", "W" * 999, "C:\\x", "con|x", ".hidden"])
def test_a_name_from_outside_is_one_file_here(name):
    for found in (name_file(name), Source(name, name, "").stem):
        assert 0 < len(found) <= 210
        assert not found.startswith(".")
        assert all(letter.isalnum() or letter in "._+-" for letter in found)


def test_usual_names_stay_what_they_were():
    assert name_file("six_pus/matrix") == "six_pus-matrix"
    assert Source("m2_hexapod", "free lengths", "").stem == "m2_hexapod-free_lengths"


# --- figures ---------------------------------------------------------------------------------------------------------


def _draw_names(name: str):
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label=name)
    axes.set_yticks([0, 1], [name, "short"])
    axes.set_title(name)
    axes.set_xlabel(name)
    axes.text(0, 0, name)
    axes.legend()
    return figure


@pytest.mark.parametrize(
    "name",
    [
        "W" * 100_000,
        "W\n" * 50_000,
        r"$\frac{$",
        "$x$ $",
        r"\$\alpha$^{_",
        "中文 \U0001f600",
        "a\x1b[31m",
        "$" * 999,
        "\\",
    ],
)
def test_any_name_is_drawn_soon_and_without_a_word(name, capfd):
    began = time.process_time()
    picture = render_picture(lambda: _draw_names(name))
    assert time.process_time() - began < 10.0
    assert picture.png.startswith(b"\x89PNG")
    assert len(picture.markup) < 300_000
    assert capfd.readouterr() == ("", "")


def test_mathematics_is_that_of_symbols_alone():
    for own in (
        "a",
        set_parameter("rho0[3]"),
        set_mathematics("k1_d", "Δ", 2) + " (mm)",
        quote("5 $ and $x$"),
        "5\nµm",
    ):
        assert make_label(own, LONGEST_NAME) == own
    assert make_label("$x$^2 costs $5", LONGEST_NAME) == r"\$x\$^2 costs \$5"
    assert make_label(r"$\frac{1}{2}$", LONGEST_NAME) == r"\$frac{1}{2}\$"
    assert make_label("W" * 100, LONGEST_NAME) == "W" * 47 + "…"
