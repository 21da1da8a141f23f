"""A distance to a point on either side of a line: two machines explain the readings, and nothing lies between them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayescal as bc

pytestmark = pytest.mark.runs

CASE = Path(__file__).parent / "two_modes"
B, PRIOR_MEAN = 11.983, 4.0


def expect(prior_sd: float) -> float:
    """Return the probability of the side on which nominal lies: both fit alike, the prior decides."""
    gap = ((B + PRIOR_MEAN) ** 2 - (B - PRIOR_MEAN) ** 2) / (2.0 * prior_sd**2)
    return 1.0 / (1.0 + np.exp(-gap))


def run(folder: Path, call, prior_sd: float) -> Path:
    shutil.copytree(CASE, folder, dirs_exist_ok=True)
    study = folder / "study.toml"
    before, text = "sd = 10.0 }", study.read_text()
    assert text.count(before) == 1
    text = text.replace(before, f"sd = {prior_sd} }}")
    study.write_text(text)
    code, *said = call("run", study, "--out", folder / "results", "--workers", 1)
    assert code == 0, said
    return folder / "results"


def find_results(folder: Path) -> Path:
    return next(folder.rglob("summary.json")).parent


@pytest.fixture
def results(tmp_path, call) -> Path:
    return find_results(run(tmp_path, call, 10.0))


def test_each_solution_is_a_machine_with_a_probability(results, call, tmp_path):
    fit = json.loads((results / "summary.json").read_text())["variants"]["all"]
    first, second = fit["modes"]
    assert first["probability"] == pytest.approx(expect(10.0), abs=4.0 * first["standard_error"])
    assert first["standard_error"] < 0.01
    assert first["parameters"]["b"][0] == pytest.approx(B, abs=0.05)
    assert second["parameters"]["b"][0] == pytest.approx(-B, abs=0.05)
    assert set(first["parameters"]) == {"b"}

    table = pd.read_csv(results / "tables" / "parameters.csv").set_index(["mode", "parameter"])
    assert set(table["verdict"].xs("b", level="parameter")) == {"several"}
    assert table["contraction"].xs("b", level="parameter").isna().all()
    assert set(table["verdict"].drop(index="b", level="parameter")) == {"identifiable"}
    findings = pd.read_csv(results / "tables" / "findings.csv").set_index("subject")
    assert (findings.loc["Several solutions", ["value", "status"]] == [2, "warning"]).all()
    assert "Parameters" not in findings.index  # of which all would be known well
    assert "<h2>Solutions of" in (results / "report.html").read_text()

    code, _, complaint = call("export", results, "--out", tmp_path / "none")
    assert code == 2
    assert "--mode 1" in complaint
    assert len(complaint.strip().splitlines()) == 1
    assert not (tmp_path / "none").exists()
    assert call("export", results, "--mode", 3, "--out", tmp_path / "none")[0] == 2
    for mode, side in ((1, B), (2, -B)):
        where = tmp_path / f"mode{mode}"
        assert call("export", results, "--mode", mode, "--out", where)[0] == 0
        machine = bc.load_calibrated(where)
        b = machine.model.layout.names.index("b")
        assert machine.theta[b] == pytest.approx(side, abs=0.05)
        assert machine.sd[b] < 0.05
        assert machine.draws.std(axis=0).max() < 0.05
    (tmp_path / "commands.csv").write_text("pose,s_mm\nP,3.0\n")
    for words in (("predict", results, tmp_path / "commands.csv"), ("verify", results), ("certificate", results)):
        assert call(*words)[0] == 2
    assert call("predict", results, tmp_path / "commands.csv", "--mode", 2)[0] == 0

    best = bc.load_results(results, trust=True).best
    with pytest.raises(bc.InputError, match="mode"):
        _ = best.machine
    assert best.take_mode(2).machine.theta[b] == pytest.approx(-B, abs=0.05)


def test_a_small_solution_is_mentioned_and_left_out(tmp_path, call):
    """With a tolerance of 4 mm the other side has a probability of a quarter of a percent."""
    results = find_results(run(tmp_path, call, 4.0))
    fit = json.loads((results / "summary.json").read_text())["variants"]["all"]
    assert "modes" not in fit
    assert fit["other_modes"] == pytest.approx(1.0 - expect(4.0), abs=0.0015)
    table = pd.read_csv(results / "tables" / "parameters.csv").set_index("parameter")
    assert table["verdict"]["b"] == "identifiable"
    assert table["sd"]["b"] < 0.05
    assert call("export", results, "--out", tmp_path / "machine")[0] == 0
    machine = bc.load_calibrated(tmp_path / "machine")
    assert machine.sd[machine.model.layout.names.index("b")] < 0.05
