"""Simulated surveys whose noise or tolerances are stated otherwise than they are: χ² names each, and clean ones not."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
import studies
from rich.console import Console

from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.readings.errors import drop_model_error
from bayescal.experiments.shared.slip_causes import NOISE, SCATTER
from bayescal.experiments.shared.soundness import ChiSquare, measure_pulls
from bayescal.experiments.simulation.compute import build_twin, format_survey
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.readings import ReadingSubject
from bayescal.inference.exploration import explore

pytestmark = pytest.mark.runs

VARIANT = "six_pus/matrix"
LENGTHS = 'l = { prior = "normal", sd = 2.0 }'


def draw_survey(folder: Path, seed: int) -> None:
    """Write the survey of a machine from the prior."""
    rng = np.random.default_rng(1000 + seed)
    offsets = {"l": rng.normal(0.0, 2.0, 6), "kappa": rng.normal(0.0, 0.01, 6)}
    text = studies.SIMULATION
    for symbol, values in offsets.items():
        text = re.sub(rf"^{symbol} = .*$", f"{symbol} = {[float(x) for x in values]}", text, flags=re.MULTILINE)
    (folder / "simulate.toml").write_text(text)
    config = load_experiment(folder / "simulate.toml")
    twin = build_twin(config, folder)
    survey = twin.seen.survey(twin, np.random.default_rng(seed))[0]
    for name, table in format_survey(survey, config.provenance.text).items():
        (folder / "data" / name).write_text(table)


def read(folder: Path, noise: float = 3.0, sd: float = 2.0) -> StudyInputs:
    """Return the study with another noise of the targets, or another tolerance of the lengths, than is true."""
    text = studies.STUDY.replace("target_noise_um = 3.0", f"target_noise_um = {noise}")
    (folder / "study.toml").write_text(text.replace(LENGTHS, f'l = {{ prior = "normal", sd = {sd} }}'))
    return StudyInputs.load(load_experiment(folder / "study.toml"), folder)


def judge(inputs: StudyInputs) -> dict[str, ChiSquare]:
    """Return χ² of noise and tolerances, from a proposal that is nearly the posterior, and that of the targets."""
    subject = ReadingSubject(drop_model_error(inputs.variants[VARIANT].posterior()).with_pose_guesses())
    posterior = subject.posterior
    found = explore(posterior, np.random.SeedSequence(1))
    draws = posterior.natural(found.straight.y_from_x(found.proposal.draw(1000, np.random.default_rng(1))))
    extraction = inputs.measured[0].targets.extraction
    return {
        "noise": subject.measure_misfit(posterior, found.modes[0].y),
        "tolerances": measure_pulls(posterior, draws),
        "targets": ChiSquare(extraction.chi2_per_dof * extraction.dof, extraction.dof),
    }


@pytest.fixture
def folder(tmp_path):
    studies.write_tiny_study(tmp_path)
    draw_survey(tmp_path, 1)
    return tmp_path


@pytest.mark.parametrize(
    ("stated", "wrong", "factor"),
    [
        ({}, (), 1.0),
        ({"noise": 1.5}, ("noise", "targets"), 1.7),  # robust fits leave out the worst
        ({"noise": 6.0}, ("noise", "targets"), 0.5),
        ({"sd": 0.5}, ("tolerances",), 3.0),
    ],
    ids=["as it is", "noise at half", "noise doubled", "lengths too tight"],
)
def test_what_is_stated_wrong_is_named_and_nothing_else(folder, stated, wrong, factor):
    found = judge(read(folder, **stated))
    assert {name for name, one in found.items() if one.is_off} == set(wrong)
    for name in wrong:
        assert found[name].factor == pytest.approx(factor, rel=0.2)


@pytest.mark.parametrize(("noise", "cause"), [(3.0, None), (1.5, "too small"), (6.0, "too large")], ids=str)
def test_a_study_says_first_which_noise_is_wrong(folder, noise, cause, monkeypatch):
    monkeypatch.setattr(frame, "write_page", lambda page, folder, *more: folder)
    inputs = read(folder, noise)
    only = [one for one in inputs.config.variants if one.name == VARIANT]
    finished = run_experiment(inputs.config.model_copy(update={"variants": only}), folder, folder / "out")
    said = [statement for statement in finished.page.verdict if statement.lead == "Noise"]
    console = Console(file=io.StringIO(), width=120)
    finished.show(console)
    assert ("Noise: " in console.file.getvalue()) == (cause is not None)
    if cause is None:
        assert said == []
    else:
        assert finished.page.verdict[0].lead == "Noise"
        assert len(said) >= 2  # the targets on their bodies, and the variant's residuals
        misstated = finished.summary["misstated"]
        assert misstated["fault"] in (NOISE, SCATTER)
        assert (misstated["factor"] > 1.0) == (cause == "too small")


@pytest.mark.slow
def test_twenty_clean_surveys_raise_no_alarm(tmp_path):
    studies.write_tiny_study(tmp_path)
    sums = {"noise": np.zeros(2), "tolerances": np.zeros(2), "targets": np.zeros(2)}
    for seed in range(20):
        draw_survey(tmp_path, seed)
        for name, one in judge(read(tmp_path)).items():
            assert not one.is_off, (seed, name, one)
            sums[name] += one.value, one.dof
    for name, (value, dof) in sums.items():
        assert ChiSquare(float(value), float(dof)).factor == pytest.approx(1.0, abs=0.1), name
