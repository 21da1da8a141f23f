"""A preliminary answer and the answers that replace it."""

from __future__ import annotations

import json

import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.study_schema import change_effort
from bayescal.inference.schema import MORE, EvidenceConfig, SamplerConfig


def test_what_is_stated_holds_whatever_the_effort():
    stated = EvidenceConfig(draws=3000, max_draws=50_000, tolerance_nat=0.02)
    assert stated.follow("quick") == stated.follow("thorough") == stated
    default, quick, thorough = (EvidenceConfig().follow(effort) for effort in ("standard", "quick", "thorough"))
    assert default == EvidenceConfig()
    assert quick.max_draws < default.max_draws < thorough.max_draws
    assert quick.tolerance_nat > default.tolerance_nat > thorough.tolerance_nat
    usual, more = SamplerConfig(), SamplerConfig(effort="thorough")
    assert more.plan(is_easy=True)[1] == MORE * usual.plan(is_easy=False)[1]
    assert SamplerConfig(effort="thorough", steps=30).plan(is_easy=True)[1] == 30


@pytest.mark.runs
def test_a_preliminary_answer_is_replaced_by_one_that_asks_for_more(tmp_path, call):
    path, out = studies.write_tiny_study(tmp_path), tmp_path / "out"
    code, said, complaint = call("run", path, "--out", out, "--workers", 1, "--effort", "quick")
    assert (code, "Traceback" in complaint) == (0, False)
    assert said.startswith("Preliminary: ")
    assert "first answer, six_pus/none: tool" in complaint
    summary = json.loads((out / "summary.json").read_text())
    assert summary["preliminary"]
    assert not summary["converged"]
    assert summary["headline"].startswith("Preliminary: ")
    page = (out / "report.html").read_text()
    assert ">passed<" not in page
    assert ">converged<" not in page
    code, _, complaint = call("export", out, "--out", tmp_path / "machine")
    assert code == 2
    assert "preliminary" in complaint

    other = load_experiment(path).model_copy(update={"seed": 5})
    with pytest.raises(InputError, match="holds results of another config"):
        run_experiment(other, path.parent, out)
    found = run_experiment(change_effort(load_experiment(path), "standard"), path.parent, out)
    assert "preliminary" not in found.summary
    quick = {name: one["log_evidence"] for name, one in summary["variants"].items()}
    for name, one in found.summary["variants"].items():
        assert quick[name] == pytest.approx(one["log_evidence"], abs=0.3)
        assert one["converged"] == (not one["problems"])
    with pytest.raises(InputError, match="holds results of another config"):  # which was checked by chains
        run_experiment(change_effort(load_experiment(path), "quick"), path.parent, out)


@pytest.mark.parametrize("effort", ["fast", ""])
def test_another_word_is_refused(effort, tmp_path):
    path = studies.write_tiny_study(tmp_path)
    with pytest.raises(InputError, match=f"effort: found '{effort}', expected quick, standard or thorough"):
        change_effort(load_experiment(path), effort)
