"""The command: a whole check of a tiny study, what it writes, and what it refuses."""

from __future__ import annotations

import json

import calibrations
import pytest
import studies

from bayescal import cli
from bayescal.errors import NumericalError
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.selftest import compute
from bayescal.experiments.selftest.faults import Finding
from bayescal.experiments.selftest.kind import configure_selftest

pytestmark = pytest.mark.runs


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return studies.write_tiny_study(tmp_path_factory.mktemp("check"))


def run(*arguments):
    return cli.app([str(one) for one in arguments], standalone_mode=False)


def test_a_tiny_study_passes(study, tmp_path, capsys):
    config = configure_selftest(study, ["six_pus/matrix"], 8, None).model_copy(update={"draws": 300})
    finished = run_experiment(config, study.parent, tmp_path / "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["passed"], finished.results.table("checks")
    assert set(finished.results.table("checks").query("subject.str.startswith('Simulated')")["level"]) == {"warning"}
    assert list(finished.results.table("parameters").groupby("parameter").size()) == [2] * 13
    assert len(finished.results.table("ranks")) == 16


def test_faults_open_the_page_and_end_the_command(study, tmp_path, monkeypatch, capsys):
    fault = Finding("Noise", "noise", "bad", "the noise is twice as large.")
    nothing = compute.np.empty((0, 13))
    monkeypatch.setattr(compute, "look_at_data", lambda task: ([fault], nothing, nothing))
    with pytest.raises(NumericalError, match=r"six_pus/matrix.*\(noise\)"):
        run("selftest", study, "--variant", "six_pus/matrix", "--out", tmp_path / "out", "--workers", "1")
    out = capsys.readouterr().out
    assert f"Noise: T{fault.text[1:]}" in out


def test_the_best_variant_is_checked_where_none_is_named(study, tmp_path, monkeypatch):
    monkeypatch.setattr(compute, "_check_variant", lambda inputs, name, run: ([Finding("Noise", "", "good", name)], {}))
    finished = run_experiment(configure_selftest(study, [], None, None), study.parent, tmp_path / "out")
    assert list(finished.summary["variants"]) == ["six_pus/matrix"]


CANNOT = {
    "found 'audit', expected 'study'": calibrations.write_audit,
    "variant 'q': expected one of six_pus/none": studies.write_tiny_study,
    "variant 'q': expected one of all, one_rod": calibrations.write_delta,
}


@pytest.mark.parametrize("fault", CANNOT)
def test_what_cannot_be_checked_is_one_line(tmp_path, refuse, fault):
    refuse(fault, tmp_path / "out", "selftest", CANNOT[fault](tmp_path), "--variant", "q")
