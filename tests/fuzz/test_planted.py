"""The hostile suite finds faults that are planted: of each sort of what it holds calls to."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fuzz import disturbed, suite
from fuzz.disturbed import Stage, Undisturbed
from fuzz.judged import judge_call

from bayescal.errors import InputError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.store import Store
from bayescal.experiments.simulation.kind import Simulation
from bayescal.experiments.study.kind import Study

STUDY, SIMULATION = "own_machine/study.toml", "own_machine/simulate.toml"


@pytest.fixture
def simulation(ground) -> Path:
    return ground.root / SIMULATION


def raise_value_error(*_: object) -> None:
    raise ValueError("planted")


def test_a_traceback_is_found(simulation, monkeypatch):
    monkeypatch.setattr(Simulation, "read", raise_value_error)
    assert any("ValueError: planted" in fault for fault in judge_call(["validate", simulation]).faults)


def test_a_file_written_by_a_refused_call_is_found(simulation, tmp_path, monkeypatch):
    def write(*_: object) -> None:
        (tmp_path / "here.txt").write_text("written")
        raise InputError("refused")

    monkeypatch.setattr(Simulation, "read", write)
    (fault,) = judge_call(["validate", simulation], tmp_path).faults
    assert "here.txt changed" in fault


def test_a_file_written_beside_the_results_is_found(simulation, tmp_path, monkeypatch):
    monkeypatch.setattr(Simulation, "list_warnings", lambda *_: [str((tmp_path / "here.txt").write_text("written"))])
    (fault,) = judge_call(["validate", simulation], tmp_path).faults
    assert "exit code 0," in fault


def test_two_lines_for_one_fault_are_found(simulation, tmp_path, monkeypatch):
    program = sys.modules["bayescal.cli.app"]
    monkeypatch.setattr(program, "make_plain", lambda text, but="": text.replace(" ", "\n", 1))
    call = ["simulate", simulation.with_name("none.toml"), "--out", tmp_path / "out"]
    assert any("than a line" in fault for fault in judge_call(call).faults)


@pytest.mark.parametrize("where", ["looking", "running"])
def test_a_gate_that_is_not_the_same_for_both_is_found(where, ground, tmp_path, monkeypatch):
    admit = frame.prepare_run

    def refuse(config, folder, workers):
        if (where == "looking") == (workers > 1):
            raise InputError("planted")
        return admit(config, folder, workers)

    monkeypatch.setattr(frame, "prepare_run", refuse)
    monkeypatch.setattr(frame, "cpu_count", lambda: 2)
    with suite.cutting():
        looked, ran = suite.look_and_run(ground.subjects[STUDY], tmp_path)
    assert suite.hold_gate(looked, ran)


def test_input_that_is_refused_late_is_found(ground, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise InputError("planted")

    monkeypatch.setattr(Study, "compute", refuse)
    looked, ran = suite.look_and_run(ground.subjects[STUDY], tmp_path)
    assert (looked.code, ran.code, ran.faults) == (0, 3, ())
    assert suite.hold_gate(looked, ran)


@pytest.mark.runs
def test_a_lost_run_of_a_drawn_machine_is_found(ground, monkeypatch):
    monkeypatch.setattr(Study, "compute", raise_value_error)
    faults = suite.try_drawn(ground, 39).faults
    assert "ValueError: planted" in faults
    assert "no results" in faults


# --- disturbed runs --------------------------------------------------------------------------------------------------


@pytest.fixture
def stage(simulation, tmp_path) -> Stage:
    return Stage(simulation, 1, tmp_path / "stage")


def run_quietly(stage: Stage) -> Undisturbed:
    """Return what a run in an empty folder leaves that nobody disturbs."""
    shutil.rmtree(stage.folder, ignore_errors=True)
    stage.out.parent.mkdir(parents=True)
    quiet, faults = disturbed.run_undisturbed(stage)
    assert faults == []
    return quiet


def disturb(stage: Stage, quiet: Undisturbed, how: str, seed: int = 3) -> list[str]:
    shutil.rmtree(stage.folder, ignore_errors=True)
    stage.out.parent.mkdir(parents=True)
    return disturbed.disturb(stage, quiet, how, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def quiet(ground, tmp_path_factory) -> Undisturbed:
    return run_quietly(Stage(ground.root / SIMULATION, 1, tmp_path_factory.mktemp("quiet")))


@pytest.mark.parametrize("how", disturbed.DISTURBANCES)
def test_a_simulation_survives(how, stage, quiet):
    assert [fault for fault in disturb(stage, quiet, how) if disturbed.NOT_POSSIBLE not in fault] == []


def test_results_put_in_place_file_by_file_are_found(stage, quiet, monkeypatch):
    def publish(store: Store) -> None:
        store.out.mkdir(exist_ok=True)
        for path in sorted(store.staged.rglob("*")):
            path.rename(store.out / path.name)
        store.discard()

    monkeypatch.setattr(Store, "publish", publish)
    assert any("not whole" in fault or "half" in fault for fault in disturb(stage, quiet, "killed while ending"))


def test_numbers_that_hang_on_what_went_before_are_found(stage, monkeypatch):
    compute = Simulation.compute

    def forget(self, inputs, run):
        found = compute(self, inputs, run)
        found.summary["seen"] = len(list(stage.out.parent.glob("*.partial/.seen")))
        (stage.out.parent / "out.partial" / ".seen").touch()
        return found

    monkeypatch.setattr(Simulation, "compute", forget)
    assert disturb(stage, run_quietly(stage), "killed while writing")


@pytest.mark.parametrize("left", ["a run of its own", "a worker that nothing ends"])
def test_a_dead_process_ends_the_suite_and_names_the_case(left, monkeypatch):
    def die(ground: suite.Ground, number: int) -> suite.Trial:
        if left == "a run of its own":
            disturbed.Child(["list"], lambda: time.sleep(600.0))
        elif number >= 25:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            time.sleep(600.0)
        time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError

    monkeypatch.setattr(suite, "SORTS", {name: replace(one, n=0) for name, one in suite.SORTS.items()})
    monkeypatch.setitem(suite.SORTS, "inputs", suite.Sort("of no use", 50, die))
    _, faults, seconds = suite.run(1.0, 2, 0.0)
    assert len(faults) == 1
    assert re.search("inputs 0 to 24.* died", faults[0], re.DOTALL)
    assert seconds < 60.0


def test_a_lock_that_is_none_is_found(stage, monkeypatch):
    monkeypatch.setattr(frame, "hold_lock", lambda *_: nullcontext())
    quiet = run_quietly(stage)
    faults = [fault for seed in range(4) for fault in disturb(stage, quiet, "two runs on one --out", seed)]
    assert any("one refused" in fault for fault in faults)
