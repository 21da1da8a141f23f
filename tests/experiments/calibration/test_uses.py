"""The documented script of a user-defined machine class: its calibration and all uses of that, then from elsewhere."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import calibrations
import h5py
import numpy as np
import pandas as pd
import pytest
import studies
from saved_trees import check_tree

from bayescal import load_calibrated, predict_poses
from bayescal.files.csv_tables import read_table

pytestmark = [pytest.mark.runs, pytest.mark.skipif(shutil.which("sh") is None, reason="no shell")]


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    """Return what the script has written, moved away from the experiment, which is gone."""
    folder = tmp_path_factory.mktemp("uses")
    path = calibrations.write_delta(folder)
    command = folder / "bin" / "bayescal"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m bayescal "$@"\n')
    command.chmod(0o755)
    surroundings = {**os.environ, "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["sh", "uses.sh"], cwd=path.parent, env=surroundings, capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"[Tt]ool x [^(]*\(standard uncertainty, k = 1\)", " ".join(done.stdout.split()))
    shutil.move(path.parent / "results", folder / "moved")
    shutil.rmtree(path.parent)
    return folder / "moved"


PAGES = ("selftest/report.html", "study/report.html", "next_pose/report.html")


def read(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, comment="#").set_index("pose")


def test_the_script_leaves_what_it_says(results):
    for name in (*PAGES, "certificate.html", "plan.csv", "machine/calibrated.toml"):
        assert (results / name).is_file(), name
    poses, again = read(results / "poses.csv"), read(results / "poses_again.csv")
    pd.testing.assert_frame_equal(poses, again, rtol=1e-6)
    told = read(calibrations.OWN_MACHINE / "commands.csv")
    found = read(results / "commands.csv")
    np.testing.assert_allclose(found[told.columns], told, rtol=0, atol=1e-6)
    assert (found["reached"] == "yes").all()


def test_the_class_belongs_to_the_identity(results):
    provenance = json.loads((results / "study" / "provenance.json").read_text())
    assert set(provenance["files"]) == {"machine.toml", "linear_delta.py", "data/readings.csv"}


def test_the_truth_lies_where_the_posterior_says_and_so_do_held_back_readings(results):
    tables = results / "study" / "tables"
    found, held = (pd.read_csv(tables / f"{name}.csv") for name in ("parameters", "predictions"))
    true = pd.read_csv(calibrations.OWN_MACHINE / "data" / "true_parameters.csv", comment="#").set_index("parameter")
    every = found[found["variant"] == "all"].set_index("parameter")
    z = (every["mean"] - true["value"][every.index]) / every["sd"]
    assert (z.abs() < 4.0).all()
    assert (z**2).mean() < 2.5
    assert len(held) == 2 * 5 * 6
    assert 0.75 <= held["in_interval_90"].mean() <= 1.0


def test_arviz_judges_every_posterior(results):
    files = sorted((results / "study" / "posterior").glob("*.nc"))
    variants = set(pd.read_csv(results / "study" / "tables" / "variants.csv")["variant"])
    assert {check_tree(path, k_is_good=False).attrs["variant"] for path in files} == variants


def test_truth_fed_back_gives_the_same_readings(tmp_path, call):
    folder = calibrations.copy_delta(tmp_path)
    path = folder / "simulate.toml"
    path.write_text(path.read_text() + '\n[truth]\nparameters = "data/true_parameters.csv"\n')
    assert call("simulate", path, "--out", tmp_path / "data")[0] == 0
    found, shipped = (base / "data" / "readings.csv" for base in (tmp_path, folder))
    studies.assert_same_text(found.read_text(), shipped.read_text(), "readings.csv")


def test_results_alone_are_enough_from_python(results):
    machine = load_calibrated(str(results / "study"), trust=True)
    told = read(calibrations.OWN_MACHINE / "commands.csv")
    found = predict_poses(machine, told.to_numpy())
    np.testing.assert_allclose(found.tool, read(results / "poses.csv")[["x_mm", "y_mm", "z_mm"]], rtol=0, atol=1e-8)
    assert machine.covariance.shape == (len(machine.names), len(machine.names))
    assert len(machine.measured) == len(read_table(results / "study" / "machine" / "commands_all.csv", None).rows)


@pytest.mark.parametrize("what", ["study", "machine"])
def test_the_kept_code_is_run_only_where_somebody_says_so(what, results, call, distrust):
    table = calibrations.OWN_MACHINE / "commands.csv"
    before = studies.snapshot(results)
    code, out, err = call("predict", results / what, table)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert re.search(r"machine\.toml: kind: found 'linear_delta\.py:LinearDelta'.*bayescal trust", err)
    assert studies.snapshot(results) == before


@pytest.mark.parametrize("use", ["predict", "compensate", "certificate", "verify", "export"])
def test_a_posterior_that_was_changed_is_refused(use, results, call, tmp_path, voice):
    folder, table = tmp_path / "study", calibrations.OWN_MACHINE / "commands.csv"
    shutil.copytree(results / "study", folder)
    with h5py.File(folder / "posterior" / "all.nc", "r+") as file:
        draws = file["posterior"]["l"]
        draws[:, 0] = 1e6 * draws[:, 0]
    given = {"compensate": [results / "poses.csv"], "predict": [table]}.get(use, [])
    code, out, err = call(use, folder, *given, "--out", tmp_path / "out.html")
    assert (code, out) == (2, "")
    assert f"{folder}: found posterior/all.nc edited," in err
    assert not (tmp_path / "out.html").exists()
    if use == "predict":
        code, out, err = call(use, folder, *given, "--allow-changed-files")
        assert code == 0
        assert "posterior/all.nc edited: used" in err


def test_kept_code_that_was_changed_is_refused(results, call, tmp_path):
    folder = tmp_path / "study"
    shutil.copytree(results / "study", folder)
    source = folder / "machine" / "linear_delta.py"
    source.write_text(source.read_text() + "\nraise SystemExit\n")
    code, out, err = call("export", folder, "--trust-code", "--out", tmp_path / "out")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "linear_delta.py:" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("export", "study", "--format", "urdf"), "found no legs"),
        (("export", "study", "--variant", "none"), "--variant: found 'none', expected one of all, one_rod"),
        (("predict", "study", "poses.csv"), "expected pose, s_1_mm, s_2_mm, s_3_mm"),
        (("compensate", "study", "far.csv"), "s[1] is unreachable there"),
        (("certificate", "study", "--position-mm", 1, 1, 1, "--rotation-deg", 1, 1, 1), "--rotation-deg: found three"),
    ],
)
def test_refusals_are_one_line(arguments, expected, results, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("far.csv").write_text("pose,x_mm,y_mm,z_mm\nA,0,0,20\nB,900,0,20\n")
    named = {"study": results / "study", "poses.csv": results / "poses.csv"}
    before = studies.snapshot(tmp_path)
    code, out, err = call(*(named.get(one, one) for one in arguments), "--trust-code")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert expected in err
    assert studies.snapshot(tmp_path) == before
