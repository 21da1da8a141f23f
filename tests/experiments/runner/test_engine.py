"""Work side by side and ahead: the same for any number of workers, which start before they are waited for."""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.engine import Processes, start_ahead, stop_workers
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.store import Store

pytestmark = pytest.mark.runs

MODULE = "bayescal.data.photogrammetry.line_fit"


@pytest.fixture(autouse=True)
def _alone():
    """Let no worker of another test stand ready, nor one of these afterwards."""
    stop_workers()
    yield
    stop_workers()


def has_imported(module: str, _: str) -> tuple[int, bool]:
    """Return which process this is and whether it knows a module."""
    time.sleep(0.3)  # the other one answers, too
    return os.getpid(), module in sys.modules


def test_workers_that_start_ahead_have_imported_what_tasks_need():
    with start_ahead(2, ("bayescal.no_module", MODULE)) as await_workers:
        assert len(multiprocessing.active_children()) == 2
        await_workers()
    found = Run(Processes(2)).map("modules", has_imported, MODULE, {name: name for name in "abcd"})
    assert all(known for _, known in found.values())
    assert os.getpid() not in {process for process, _ in found.values()}


def test_a_fault_leaves_workers_ready_and_says_nothing_else(capfd):
    with pytest.raises(InputError), start_ahead(2, (MODULE,)):
        raise InputError("found nothing")
    stop_workers()
    assert not multiprocessing.active_children()
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("workers", "modules"), [(1, (MODULE,)), (2, ())])
def test_none_starts_for_one_process_or_unknown_tasks(workers, modules):
    with start_ahead(workers, modules) as await_workers:
        await_workers()
        assert not multiprocessing.active_children()


def test_workers_end_when_the_program_does():
    Run(Processes(2)).map("modules", has_imported, MODULE, {"a": "a", "b": "b"})
    assert multiprocessing.active_children()
    stop_workers()
    assert not multiprocessing.active_children()


def touch(folder: Path, number: int) -> int:
    """Leave a file, and return a square."""
    if number > 2:
        raise NumericalError("too large")
    (folder / str(number)).touch()
    return number**2


@pytest.mark.parametrize("workers", [1, 2])
def test_what_was_begun_gives_what_map_gives_and_is_kept(tmp_path, workers):
    store = Store(tmp_path / "out").begin("{}", resume=False)
    run, tasks = Run(Processes(workers), store), {"b": 2, "a": 1, "c": 0}
    wait = run.begin("squares", touch, tmp_path, tasks)
    assert list(wait().items()) == [("b", 4), ("a", 1), ("c", 0)]
    for number in range(3):
        (tmp_path / str(number)).unlink()
    assert run.map("squares", touch, tmp_path, tasks) == {"b": 4, "a": 1, "c": 0}
    assert not (tmp_path / "1").exists()


def test_workers_begin_before_they_are_waited_for(tmp_path):
    wait = Run(Processes(2)).begin("squares", touch, tmp_path, {"a": 0, "b": 1, "c": 2})
    end = time.monotonic() + 60.0
    while not all((tmp_path / str(number)).exists() for number in range(3)):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert wait() == {"a": 0, "b": 1, "c": 4}


def test_what_nobody_waits_for_is_cancelled_without_a_word(tmp_path):
    wait = Run(Processes(2)).begin("squares", touch, tmp_path, {str(n): n for n in range(3)})
    end = time.monotonic() + 60.0
    while not (tmp_path / "0").exists():  # what loky has not handed on yet it may stumble over when it is cancelled
        assert time.monotonic() < end
        time.sleep(0.05)
    del wait
    gc.collect()
    assert Run(Processes(2)).map("squares", touch, tmp_path, {"a": 1, "b": 2}) == {"a": 1, "b": 4}


@pytest.mark.parametrize("workers", [1, 2])
def test_what_fails_is_told_when_it_is_waited_for(tmp_path, workers):
    wait = Run(Processes(workers)).begin("squares", touch, tmp_path, {"a": 1, "b": 3})
    with pytest.raises(NumericalError, match=r"^b: too large"):
        wait()
