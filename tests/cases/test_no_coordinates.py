"""A machine in which nothing moves: three distances of a printed square tell the skew of a printer's axes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from studies import run_little

from bayescal.experiments.runner.results import read_results


def test_it_is_fit_to_run(case, call):
    code, out, _ = call("validate", case("no_coordinates") / "study.toml")
    assert code == 0
    assert "3 combinations" in out
    assert "tool" not in out  # nothing moves that a class could call one


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_skew_is_found(case, call):
    code, complaint, out = run_little(call, case("no_coordinates") / "study.toml")
    assert code in (0, 3), complaint
    results = read_results(out)
    assert "lost" not in results.summary
    found = results.table("parameters").set_index("parameter").loc["skew"]
    # with the squares of the diagonals: AC² − BD² = 4 AD AB sin(skew)
    side = 0.5 * np.sqrt(140.7**2 + 142.2**2)
    assert abs(found["mean"] - np.arcsin((140.7**2 - 142.2**2) / (4.0 * side**2))) < 0.2 * found["sd"]
    assert 0.5 < found["sd"] / (0.05 / (140.0 / np.sqrt(2.0))) < 2.0
    assert "bad" not in set(results.table("findings")["status"])


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_an_exported_one_is_reverified_by_readings_with_their_noise(case, call, tmp_path):
    """All channels stand beside the machine: an exported one knows no noise of theirs."""
    folder, machine, plan = case("no_coordinates"), tmp_path / "machine", tmp_path / "plan.csv"
    out = run_little(call, folder / "study.toml")[2]
    assert call("export", out, "--out", machine, "--allow-unconverged")[0] == 0
    like = folder / "like.csv"
    planned = ("verify", machine, "--noise-from", like, "--out", plan)

    def refuse(wanted, *words):
        code, _, complaint = call(*words)
        assert (code, complaint.splitlines()[-1].count(wanted), plan.exists()) == (2, 1, False), complaint

    refuse("AC_sd_mm", "verify", machine, "--out", plan)
    like.write_text((folder / "readings.csv").read_text())
    refuse("AC_sd_mm", *planned)
    like.write_text("pose,AC_mm,AC_sd_mm,BD_mm\n1,140.7,0.05,142.2\n")
    refuse("BD_sd_mm", *planned)
    refuse("AD_sd_mm", *planned, "--sensors", "AD")
    like.write_text("pose,AC_mm,AC_sd_mm,BD_mm,BD_sd_mm\n1,140.7,0.05,142.2,0.05\n")
    assert call(*planned)[0] == 0
    code, said, _ = call("verify", machine, "--measured", like)
    assert code == 0
    assert re.search(r"± [\d.]+ if ", said)  # no unit where there is none
