"""How far a run is, stage by stage: in a pipe, on a terminal, by processes and by a scheduler's workers."""

from __future__ import annotations

import io
import os
import re
import tempfile
import time
from pathlib import Path

import pytest
import staged
from rich.console import Console

from bayescal.experiments.runner import terminal as progress
from bayescal.experiments.runner.engine import open_engine
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.terminal import Progress, Stage, describe_tasks
from bayescal.inference.stages import Report, answer_first

PATH = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])  # for `staged`
TASKS = {"one": 1, "two": 2}


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Return where temporary folders are, and let workers find `staged`."""
    monkeypatch.setenv("PYTHONPATH", PATH)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_a_pipe_hears_of_long_stages(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(progress, "EVERY", 0.2)
    with Progress(quiet=False).follow("stage", 3, 1) as stage:
        stage.done += 1
        time.sleep(0.5)
        stage.done += 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("stage: 2 of 3 done, 0 s, about")
    assert re.fullmatch(r"stage: 3 of 3 .*\b[01] s", lines[-1])


def test_a_first_answer_is_said_once(folders, capsys):
    watch = progress.TaskWatch(("one", "two"))
    marked = watch.mark({"one": 1})

    def compute(shared, task):
        answer_first(lambda: f"x {shared * task} mm")
        return task

    assert progress.run_marked((compute, 3), marked["one"]) == 1
    with Progress(quiet=False).follow("sampling", 2, 0, watch) as stage:
        stage.done += 1
    assert capsys.readouterr().err.splitlines()[0] == "first answer, one: x 3 mm"
    assert watch.read_answers() == []
    assert stage.read() == {}
    watch.close()


@pytest.mark.runs
@pytest.mark.parametrize(("workers", "scheduler"), [(1, None), (2, None), (1, "local:2")])
def test_a_pipe_hears_at_which_stage_tasks_are(workers, scheduler, monkeypatch, capsys, folders):
    if scheduler is not None:
        pytest.importorskip("distributed")
    monkeypatch.setattr(progress, "EVERY", 0.2)
    with open_engine(workers, scheduler) as engine:
        run = Run(engine, None, Progress(quiet=False))
        assert run.map("tasks", staged.take_a_while, 2.0, TASKS) == {"one": 1, "two": 4}
    said = capsys.readouterr().err
    for name in TASKS:
        shares = [int(share) for share in re.findall(rf"{name}: sampling (\d+) %", said)]
        assert f"{name}: search" in said
        assert len(set(shares)) > 1
        assert shares == sorted(shares)
    assert re.search(r"about \d+ s left; .*sampling", said)
    assert said.splitlines()[-1].startswith("tasks: 2 of 2 done")
    assert not [path for path in folders.iterdir() if path.name.startswith("bayescal-")]


def test_a_terminal_shows_it(monkeypatch, folders):
    monkeypatch.setattr(progress, "REDRAWN", 0.05)
    shown = Progress(quiet=False)
    shown.console = Console(file=io.StringIO(), force_terminal=True, width=120)
    assert Run(progress=shown).map("tasks", staged.take_a_while, 0.8, {"one": 1}) == {"one": 1}
    text = shown.console.file.getvalue()
    assert re.search(r"tasks  one: search.*tasks  one: sampling \d+ %", text, re.DOTALL)
    assert "s left" in text


def test_a_quiet_run_leaves_no_trace(folders):
    assert Run().map("tasks", staged.take_a_while, 0.0, TASKS) == {"one": 1, "two": 4}
    assert not list(folders.iterdir())


def test_parts_of_tasks_tell_how_long_the_rest_takes(monkeypatch):
    stage = Stage("tasks", 4, 1)
    monkeypatch.setattr(progress.time, "monotonic", lambda: stage.began + 30.0)
    stage.done += 1
    done, left = stage.estimate(
        {"two": Report("sampling", 0.5, 15.0, 15.0), "three": Report("search", None, 9.0, None)}
    )
    assert done == 2.5
    assert left == pytest.approx(30.0 / 1.5 * 1.5)
    assert Stage("tasks", 4, 1).estimate({}) == (1, None)


def test_a_few_of_many_tasks_are_named():
    many = {f"t{k}": Report("sampling", 0.1 * k, 1.0, None) for k in range(6)}
    assert describe_tasks(many) == ["t0: sampling 0 %", "t1: sampling 10 %", "t2: sampling 20 %", "3 more"]
