"""Tables on a terminal of 80 letters: no name is cut, and what has no room is said."""

from __future__ import annotations

import io
import re

from rich.console import Console

from bayescal.cli.app import make_console, print_sentence
from bayescal.experiments.runner.terminal import PlainConsole, TerminalColumn, print_table

COLUMNS = (
    TerminalColumn("variant", justify="left"),
    TerminalColumn("log-evidence", 1),
    TerminalColumn("elpd", 2),
    TerminalColumn("error"),
)
ROWS = [("stiffness/matrix", "1601.22 ± 0.02", "1739.9 ± 6.4", "4.3 / 8.6 µm")]


def print_at(width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    print_table(console, COLUMNS, ROWS)
    return console.file.getvalue()


def test_columns_give_way_in_order():
    narrow = print_at(40)
    for text, hidden in ((print_at(80), []), (print_at(60), ["elpd"]), (narrow, ["log-evidence", "elpd"])):
        assert re.findall(r"log-evidence|elpd", text.partition("Hidden")[2]) == hidden
    assert "stiffness/matrix" in narrow
    assert "4.3 / 8.6 µm" in narrow
    assert max(map(len, narrow.splitlines())) <= 40


def test_without_a_terminal_it_is_as_wide_as_columns_says(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert make_console().width == 120
    monkeypatch.setenv("COLUMNS", "80")
    assert make_console().width == 80
    monkeypatch.setenv("COLUMNS", "wide")
    assert make_console(160).width == 160
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    assert not make_console().color_system


def test_sentences_break_between_words_on_a_terminal_alone(monkeypatch, capsys):
    print_sentence("25 of 37 combinations will be determined")
    terminal = PlainConsole(force_terminal=True, width=20)
    monkeypatch.setitem(print_sentence.__globals__, "make_console", lambda: terminal)
    print_sentence("25 of 37 combinations will be determined")
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert lines == ["25 of 37 combinations will be determined", "25 of 37", "combinations will be", "determined"]
