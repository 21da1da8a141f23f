"""A machine of one's own outside the package: installed nowhere, named in a TOML, run as a user would."""

import json
import subprocess
import sys

import calibrations
import pandas as pd
import pytest
import studies
from saved_trees import check_tree

pytestmark = pytest.mark.runs


def run(*arguments, folder):
    command = [sys.executable, "-m", "bayescal", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """The example run as a process by two workers, from a directory that has nothing to do with it."""
    folder = tmp_path_factory.mktemp("own")
    path, elsewhere = calibrations.write_delta(folder), folder / "elsewhere"
    elsewhere.mkdir()
    return folder, run("run", path, "--out", elsewhere / "results", "--workers", 2, folder=elsewhere)


def test_runs_from_another_directory(outcomes):
    folder, done = outcomes
    assert done.returncode == 0, done.stderr
    assert "Use “" in done.stdout
    assert (folder / "elsewhere" / "results" / "report.html").is_file()


def test_the_class_belongs_to_the_identity(outcomes):
    folder, _ = outcomes
    provenance = json.loads((folder / "elsewhere" / "results" / "provenance.json").read_text())
    assert set(provenance["files"]) == {"machine.toml", "linear_delta.py", "data/readings.csv"}


def test_the_truth_lies_where_the_posterior_says(outcomes):
    folder, _ = outcomes
    found = pd.read_csv(folder / "elsewhere" / "results" / "tables" / "parameters.csv")
    true = pd.read_csv(folder / "own_machine" / "data" / "true_parameters.csv", comment="#").set_index("parameter")
    every = found[found["variant"] == "all"].set_index("parameter")
    z = (every["mean"] - true["value"][every.index]) / every["sd"]
    assert (z.abs() < 4.0).all()
    assert (z**2).mean() < 2.5


def test_arviz_judges_every_posterior(outcomes):
    folder, _ = outcomes
    files = sorted((folder / "elsewhere" / "results" / "posterior").glob("*.nc"))
    variants = set(pd.read_csv(folder / "elsewhere" / "results" / "tables" / "variants.csv")["variant"])
    assert {check_tree(path, k_is_good=False).attrs["variant"] for path in files} == variants


def test_held_back_readings_lie_in_their_intervals(outcomes):
    folder, _ = outcomes
    found = pd.read_csv(folder / "elsewhere" / "results" / "tables" / "predictions.csv")
    assert len(found) == 2 * 5 * 6
    assert 0.75 <= found["inside"].mean() <= 1.0


def test_truth_fed_back_gives_the_same_readings(tmp_path, call):
    folder = calibrations.copy_delta(tmp_path)
    path = folder / "simulate.toml"
    path.write_text(path.read_text() + '\n[truth]\nparameters = "data/true_parameters.csv"\n')
    assert call("simulate", path, "--out", tmp_path / "data")[0] == 0
    found, shipped = (base / "data" / "readings.csv" for base in (tmp_path, folder))
    studies.assert_same_text(found.read_text(), shipped.read_text(), "readings.csv")
