"""A study whose evidences are checked by tempering on demand: both numbers are said, and disagreement is refused."""

from __future__ import annotations

import json
import re

import pytest
import studies

CHECK = 'cross_check = { class = "smc", runs = 4, chains = 64 }'


@pytest.fixture
def checked(tmp_path):
    """Return the config of a tiny study of two lengths that asks for the check, with little effort."""
    path = studies.write_tiny_study(tmp_path)
    text = path.read_text().replace("max_draws = 1000", f"max_draws = 1000\n{CHECK}")
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
    check = fit["log_evidence_check"]
    assert check == pytest.approx(fit["log_evidence"], abs=2.0)
    line = next(line for line in out.splitlines() if line.startswith("checked six_pus/none:"))
    assert f"{fit['log_evidence']:.3f}" in line
    assert f"{check:.3f}" in line


def test_another_check_is_refused(checked, call):
    studies.edit(checked, CHECK, 'cross_check = "nested"')
    code, _, err = call("run", checked)
    assert code == 2
    (line,) = studies.list_errors(err)
    assert re.search(r"evidence\.cross_check: .*emcee, nautilus, smc", line)
