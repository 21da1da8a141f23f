"""Odometry with little data, whose evidence may not come out: results are written, and the variant is not ranked."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from studies import run_little

from bayescal.experiments.runner.results import read_results
from bayescal.experiments.shared import estimate
from bayescal.inference.importance import ImportanceEvidence

pytestmark = [pytest.mark.runs, pytest.mark.usefixtures("no_pictures")]


@pytest.mark.parametrize("lost", ["importance", "importance and bridge"])
def test_results_are_written(lost, case, call, monkeypatch):
    """The first variant's evidence is no number, by one estimator or by both."""
    shift, shifted = estimate.shift_evidence, list[str]()

    def spoil(found, correction):
        shifted.append(type(found).__name__)
        is_lost = shifted.count(shifted[-1]) == 1 and ("bridge" in lost or isinstance(found, ImportanceEvidence))
        change = {"log_evidence": math.nan, "standard_error": math.nan} if is_lost else {}
        weights = {"efficiency": math.nan, "pareto_k": math.nan} if isinstance(found, ImportanceEvidence) else {}
        return replace(shift(found, correction), **change, **(weights if is_lost else {}))

    monkeypatch.setattr(estimate, "shift_evidence", spoil)
    study = case("no_coordinates") / "study.toml"  # quick, whatever the evidence
    with study.open("a", encoding="utf-8") as file:
        file.write('\n[[variants]]\nname = "skewed"\nfree = ["skew"]\n')
    code, complaint, out = run_little(call, study)
    assert (code, complaint.count("\n")) == (3, 1)
    results = read_results(out)
    first = results.summary["variants"]["all"]
    assert first["log_evidence_importance"] is None
    assert (first["log_evidence"] is None) == ("bridge" in lost)
    assert not first["converged"]
    assert results.summary["rankings"][0][-1] == "all" or "bridge" not in lost
    assert "lost" not in results.summary
    assert {*results.table("parameters")["variant"]} == {"all", "skewed"}
    assert [call(command, out)[::2] for command in ("report", "compare")] == [(0, "")] * 2


@pytest.mark.slow
def test_as_it_is(case, call):
    folder = case("evidence_nan_kills_run")
    code, _, _ = call("run", folder / "study.toml", "--out", folder / "results", "--quiet", "--workers", 1)
    assert code in (0, 3)
    assert {*read_results(folder / "results").summary["variants"]} == {"two_wheels", "wheels_alike"}
