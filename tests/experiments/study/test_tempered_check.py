"""A study whose evidences are checked by tempering on demand: both numbers are said, and disagreement is refused."""

from __future__ import annotations

import json
from functools import partial

import pytest
import studies

from bayescal.inference.tempered import estimate_by_tempering


@pytest.fixture
def checked(tmp_path, monkeypatch):
    """Return the config of a tiny study of two lengths that asks for the check, with little effort."""
    little = partial(estimate_by_tempering, n_chains=16, n_runs=2)
    monkeypatch.setattr("bayescal.experiments.shared.estimate.estimate_by_tempering", little)
    path = studies.write_tiny_study(tmp_path)
    text = path.read_text().replace("max_draws = 1000", 'max_draws = 1000\ncheck = "tempered"')
    first, second = text.split('[[variants]]\nmodel = "six_pus"\ndeformation = "matrix"')
    first = first.replace("kappa = { prior", "a_x = { prior")
    path.write_text(first + second[second.index("[sampler]") :])
    return path


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_both_numbers_are_said(checked, tmp_path, call):
    code, out, err = call("run", checked, "--out", tmp_path / "out", "--workers", "1")
    assert code == 3, err  # so short a run does not converge
    fit = json.loads((tmp_path / "out" / "summary.json").read_text())["variants"]["six_pus/none"]
    check = fit["log_evidence_tempered"]
    assert check == pytest.approx(fit["log_evidence"], abs=2.0)
    line = next(line for line in out.splitlines() if line.startswith("checked six_pus/none:"))
    assert f"{fit['log_evidence']:.3f}" in line
    assert f"{check:.3f}" in line


def test_another_check_is_refused(checked, call):
    studies.edit(checked, 'check = "tempered"', 'check = "nested"')
    code, _, err = call("run", checked)
    assert code == 2
    (line,) = studies.list_errors(err)
    assert "evidence.check" in line
    assert "'tempered'" in line
