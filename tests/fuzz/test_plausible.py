"""Plausible input that would fail when all is computed fails before; and what is damaged is named."""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import studies
from fuzz.hostile import dump_toml
from fuzz.judged import judge_call, judge_refusal

from bayescal.errors import InputError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture
def uncomputed(monkeypatch):
    """Fail where anything is computed."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr(frame, "Run", refuse)


# --- where results go ------------------------------------------------------------------------------------------------


def make_loop(folder: Path) -> Path:
    (folder / "one").symlink_to(folder / "other")
    (folder / "other").symlink_to(folder / "one")
    return folder / "one"


def make_file(folder: Path) -> Path:
    (folder / "file").write_text("mine")
    return folder / "file"


OUTS: dict[str, Callable[[Path], Path]] = {
    "loop": make_loop,
    "loop above": lambda folder: make_loop(folder) / "results",
    "file": make_file,
    "file above": lambda folder: make_file(folder) / "results",
    "others' things": lambda folder: make_file(folder).parent,
    "root": lambda folder: Path("/"),
    "long": lambda folder: folder / ("x" * 300),
    "closed": lambda folder: Path("/proc/none/results"),
}
TAKEN = {("file", "poses-from-targets"), ("others' things", "simulate"), ("root", "simulate")}
COMMANDS = {
    "run": ("run", "telescope/short.toml"),
    "audit": ("audit", "audit/m2_hexapod.toml"),
    "simulate": ("simulate", "telescope/simulate.toml"),
    "poses-from-targets": ("poses-from-targets", "telescope/short.toml"),
    "calibration": ("run", "own_machine/study.toml"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("out", OUTS)
@pytest.mark.usefixtures("uncomputed")
def test_out_is_checked_before_computing(root, tmp_path, out, command):
    if (out, command) in TAKEN:
        pytest.skip("its output is a file, which may be replaced, or files beside others")
    name, config = COMMANDS[command]
    judge_refusal([name, root / config, "--out", OUTS[out](tmp_path)], tmp_path)


@pytest.mark.skipif(not os.path.ismount("/proc"), reason="there is no file system known to be mounted")
@pytest.mark.usefixtures("uncomputed")
def test_mounted_file_system_is_not_replaced(root, tmp_path):
    judge_refusal(["run", root / "telescope/short.toml", "--out", "/proc"], tmp_path)


# --- what nobody uses ------------------------------------------------------------------------------------------------


def test_pads_that_nobody_uses_are_no_fault(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    targets = tmp_path / "data" / "targets.csv"
    rows = targets.read_text().splitlines()
    targets.write_text("\n".join(row for row in rows if not row.startswith("C03,platform,L1")) + "\n")
    with pytest.raises(InputError, match="pose 'C03'"):
        StudyInputs.load(load_experiment(path), tmp_path)
    content = tomllib.loads(path.read_text())
    content["variants"] = content["variants"][:1]
    del content["parameters"]["kappa"]
    path.write_text(dump_toml(content))
    inputs = StudyInputs.load(load_experiment(path), tmp_path)
    assert inputs.pads.pads is None


# --- what does not come out ------------------------------------------------------------------------------------------


def test_calibrations_that_all_fail_are_said(root, tmp_path):
    content = tomllib.loads((root / "yu2023/figure10.toml").read_text())
    content["study"]["noise"] = {"position_mm": 100.0, "attitude_deg": 10.0}
    path = root / "yu2023" / "noisy.toml"
    path.write_text(dump_toml(content))
    outcome = judge_call(["run", path, "--out", tmp_path / "out", "--quiet", "--workers", 1], tmp_path)
    assert outcome.faults == ()
    assert outcome.code == 3
    assert re.search(r"\b12: none of 4 .*less noise.*\b24: none of", outcome.err)


# --- damaged results -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [slice(-1), slice(1)], ids=["cut", "emptied"])
@pytest.mark.parametrize("command", ["report", "compare"])
@pytest.mark.usefixtures("no_pictures")
def test_table_that_lacks_rows_is_named(tmp_path, kept, command):
    folder = Path(shutil.copytree(RESULTS / "hexapod_figure10", tmp_path / "results"))
    studies.keep_committed(folder, studies.EXPERIMENTS / "yu2023" / "figure10.toml")
    whole = frame.read_results(folder)
    rows = {name: len(whole.tables[Path(name).stem]) for name in whole.provenance["tables"]}
    frame.write_json(folder / "provenance.json", whole.provenance | {"table_rows": rows})
    assert judge_call([command, folder, "--trust-code"], tmp_path).code == 0
    lines = (folder / "figure10.csv").read_text().splitlines(keepends=True)
    (folder / "figure10.csv").write_text("".join(lines[kept]))
    assert "figure10.csv: found" in judge_refusal([command, folder, "--trust-code"], tmp_path)
