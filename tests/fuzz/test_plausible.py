"""Plausible input that would fail when all is computed fails before; and what is damaged is named."""

from __future__ import annotations

import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
import studies
from fuzz.hostile import dump_toml
from fuzz.judged import judge_call
from fuzz.subjects import write_subjects

from bayescal.errors import InputError
from bayescal.experiments.frame import run as frame
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.study.inputs import load_inputs
from bayescal.report.pictures import Picture

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("plausible")
    write_subjects(folder)
    return folder / "experiments"


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


def make_loop_above(folder: Path) -> Path:
    return make_loop(folder) / "results"


def make_file_above(folder: Path) -> Path:
    (folder / "file").write_text("mine")
    return folder / "file" / "results"


def make_file(folder: Path) -> Path:
    (folder / "file").write_text("mine")
    return folder / "file"


def make_long(folder: Path) -> Path:
    return folder / ("x" * 300)


def make_closed(folder: Path) -> Path:
    return Path("/proc/none/results")


OUTS = [make_loop, make_loop_above, make_file_above, make_file, make_long, make_closed]
COMMANDS = {
    "run": ("run", "telescope/short.toml"),
    "audit": ("audit", "audit/m2_hexapod.toml"),
    "simulate": ("simulate", "telescope/simulate.toml"),
    "poses-from-targets": ("poses-from-targets", "telescope/short.toml"),
    "calibration": ("run", "own_machine/study.toml"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("make", OUTS)
@pytest.mark.usefixtures("uncomputed")
def test_out_is_checked_before_computing(root, tmp_path, make, command):
    if make is make_file and command == "poses-from-targets":
        pytest.skip("its output is a file, which may be replaced")
    name, config = COMMANDS[command]
    outcome = judge_call([name, root / config, "--out", make(tmp_path)], tmp_path)
    assert outcome.faults == ()
    assert outcome.code == 2


@pytest.mark.skipif(not os.path.ismount("/proc"), reason="there is no file system known to be mounted")
@pytest.mark.usefixtures("uncomputed")
def test_mounted_file_system_is_not_replaced(root, tmp_path):
    outcome = judge_call(["run", root / "telescope/short.toml", "--out", "/proc"], tmp_path)
    assert outcome.faults == ()
    assert outcome.code == 2


def test_directories_above_refused_results_are_not_left(root, tmp_path, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise InputError("found something late")

    monkeypatch.setattr(frame, "Run", refuse)
    outcome = judge_call(["run", root / "telescope/short.toml", "--out", tmp_path / "a" / "b" / "c"], tmp_path)
    assert outcome.faults == ()
    assert (outcome.code, list(tmp_path.iterdir())) == (2, [])


# --- what nobody uses ------------------------------------------------------------------------------------------------


def test_pads_that_nobody_uses_are_no_fault(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    targets = tmp_path / "data" / "targets.csv"
    rows = targets.read_text().splitlines()
    targets.write_text("\n".join(row for row in rows if not row.startswith("C03,platform,L1")) + "\n")
    with pytest.raises(InputError, match="pose 'C03'"):
        load_inputs(load_experiment(path), tmp_path)
    content = tomllib.loads(path.read_text())
    content["variants"] = content["variants"][:1]
    del content["parameters"]["kappa"]
    path.write_text(dump_toml(content))
    inputs = load_inputs(load_experiment(path), tmp_path)
    assert (inputs.deflection, inputs.measured_matrix, inputs.measured_kappa) == (None, None, None)


# --- what does not come out ------------------------------------------------------------------------------------------


def test_calibrations_that_all_fail_are_said(root, tmp_path):
    content = tomllib.loads((root / "yu2023/figure10.toml").read_text())
    content["study"]["noise"] = {"position_mm": 100.0, "attitude_deg": 10.0}
    path = root / "yu2023" / "noisy.toml"
    path.write_text(dump_toml(content))
    outcome = judge_call(["run", path, "--out", tmp_path / "out", "--quiet", "--workers", 1], tmp_path)
    assert outcome.faults == ()
    assert outcome.code == 3
    assert "calibrations converged, expected less noise" in outcome.err


# --- damaged results -------------------------------------------------------------------------------------------------


def cut(path: Path) -> None:
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def empty(path: Path) -> None:
    path.write_text(path.read_text().splitlines(keepends=True)[0])


@pytest.mark.parametrize("damage", [cut, empty])
@pytest.mark.parametrize("command", ["report", "compare"])
def test_table_that_lacks_rows_is_named(tmp_path, monkeypatch, damage: Callable[[Path], None], command):
    monkeypatch.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
    folder = Path(shutil.copytree(RESULTS / "hexapod_figure10", tmp_path / "results"))
    whole = frame.read_results(folder)
    frame.write_json(folder / "provenance.json", whole.provenance | {"table_rows": count_rows(whole)})
    assert judge_call([command, folder, "--trust-code"], tmp_path).code == 0
    damage(folder / "figure10.csv")
    outcome = judge_call([command, folder, "--trust-code"], tmp_path)
    assert outcome.faults == ()
    assert outcome.code == 2
    assert "figure10.csv: found" in outcome.err


def count_rows(results) -> dict[str, int]:
    return {name: len(results.tables[Path(name).stem]) for name in results.provenance["tables"]}
