"""What fails costs its line: tasks, parts of them, sections and figures of a page, a page; never the run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import toys

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import losses
from bayescal.experiments.runner.blocks import show_sections
from bayescal.experiments.runner.losses import Loss, attempt, describe, note_losses
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import write_json
from bayescal.report.blocks import PageSection


def fail(error: Exception) -> float:
    raise error


@pytest.mark.parametrize("error", [NumericalError("no mode"), ValueError("NaN"), np.linalg.LinAlgError("singular")])
def test_a_failure_is_noted_and_replaced(error):
    with note_losses() as lost:
        assert attempt("the mode", lambda: fail(error), 7.0) == 7.0
    assert [one.what for one in lost] == ["the mode"]
    assert str(error) in lost[0].why


@pytest.mark.parametrize("error", [InputError("a file"), MemoryError(), KeyError("a slip of ours")])
def test_what_is_no_loss_is_raised(error):
    with note_losses() as lost, pytest.raises(type(error)):
        attempt("anything", lambda: fail(error), 0.0)
    assert lost == []


def test_without_anybody_who_collects_all_is_raised():
    with pytest.raises(NumericalError):
        attempt("anything", lambda: fail(NumericalError("no mode")), 0.0)


def test_for_users_a_programming_error_is_a_loss_that_says_where(monkeypatch):
    monkeypatch.setattr(losses, "RAISE_OTHERS", False)
    with note_losses() as lost:
        attempt("anything", lambda: fail(KeyError("x")), 0.0)
    assert lost[0].why.startswith("KeyError: 'x' (test_losses.py, line")


def test_somebodys_own_class_is_named_and_not_what_it_called(tmp_path):
    path = tmp_path / "own_class.py"
    path.write_text("import numpy as np\n\n\ndef act():\n    return np.linalg.inv(np.zeros((2, 2)))\n")
    space: dict[str, object] = {}
    exec(compile(path.read_text(), str(path), "exec"), space)
    with pytest.raises(np.linalg.LinAlgError) as caught:
        space["act"]()
    assert "own_class.py, line 5" in describe(caught.value)


# --- tasks -----------------------------------------------------------------------------------------------------------


def divide(limit: float, k: int) -> float:
    """Return what has parts that fail, and fails beyond a limit."""
    if k > limit:
        raise NumericalError(f"{k} is too large")
    return attempt(f"the part of {k}", lambda: fail(ValueError("odd")) if k % 2 else 1.0, -1.0)


def test_tasks_that_can_be_spared_are_left_out():
    run = Run()
    assert run.map("tasks", divide, 1.0, {"a": 0, "b": 1, "c": 2}, spare=True) == {"a": 1.0, "b": -1.0}
    assert [one.what.split()[-1] for one in run.losses] == ["1", "'c'"]
    with pytest.raises(NumericalError, match="3 is"):  # not all of them
        Run().map("tasks", divide, 0.0, {"a": 2, "b": 3}, spare=True)


def outer(limit: float, k: int) -> float:
    """Run tasks of its own."""
    return Run().once("inner", inner, k)


def inner(k: int) -> float:
    return divide(5.0, k)


def test_losses_of_tasks_within_tasks_are_known():
    run = Run()
    run.map("outer", outer, 0.0, {"a": 1})
    assert run.losses == [Loss("the part of 1", run.losses[0].why)]


# --- pages -----------------------------------------------------------------------------------------------------------


def show_what_is_there(subject: int) -> PageSection:
    return PageSection("There", (str(subject),))


def show_what_fails(subject: int) -> PageSection:
    raise ValueError(f"no {subject}")


def test_a_section_that_fails_says_why_in_its_place():
    with note_losses() as lost:
        first, second = show_sections((show_what_fails, show_what_is_there), 3)
    assert second.title == "There"
    assert "no 3" in str(first.blocks)
    assert len(lost) == 1


def test_what_is_not_finite_is_null_in_json(tmp_path):
    write_json(tmp_path / "a.json", {"a": [float("nan"), 1.0], "b": {"c": np.float64("inf")}})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": [None, 1.0], "b": {"c": None}}


FAILING = {
    "the page": ('total = results.summary["total"]', "raise ValueError('planted')"),
    "figure 'a'": ('(make_section("Text"),)', '(make_section("Text", figures=[Figure("a", "A", lambda: 1 / 0)]),)'),
    "the sum": ('"total": float(table["square"].sum())', '"total": attempt("the sum", lambda: 1.0 / 0.0, 0.0)'),
}


@pytest.mark.runs
@pytest.mark.parametrize("what", FAILING)
def test_results_are_written_whatever_fails(what, call, tmp_path):
    path, out = toys.write_toy(tmp_path), tmp_path / "out"
    old, new = FAILING[what]
    code = toys.KIND.replace("import Page, make_section", "import Figure, Page, make_section").replace(old, new)
    code = code.replace("import Run\n", "import Run\nfrom bayescal.experiments.runner.losses import attempt\n")
    (tmp_path / "toy_kind.py").write_text(code)
    code, _, complaint = call("run", path, "--out", out, "--workers", 1, "--quiet")
    assert (code, complaint.count("\n")) == (3, 1)
    assert what in complaint
    assert [one["what"] for one in json.loads((out / "summary.json").read_text())["lost"]] == [what]
    assert what in (out / "report.html").read_text().replace("&#39;", "'")
    assert (out / "squares.csv").is_file()
    assert not Path(f"{out}.partial").exists()
    assert call("report", out)[0] == 0  # as often as wanted
