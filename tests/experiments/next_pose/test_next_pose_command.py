"""The command as a user gives it: what it says, what it writes, what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pandas as pd
import pytest
import studies

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import compute_experiment

pytestmark = pytest.mark.runs

NEXT = """
name = "tiny_next_pose"
title = "Tiny: the next pose"
seed = 3
study = "study.toml"
variants = ["six_pus/matrix"]
draws = 300
horizon = 8

[workspace]
position_mm = [0.3, 0.3, 0.3]
rotation_deg = [0.1, 0.1, 0.1]
poses = 15

[requirements]
z = 0.02

[candidates]
count = 64
range_mm = 1.2
"""


@pytest.fixture
def question(tmp_path) -> Path:
    studies.write_tiny_study(tmp_path)
    path = tmp_path / "next_pose.toml"
    path.write_text(NEXT)
    return path


def test_it_says_what_to_measure_and_what_to_expect(question, call, no_pictures):
    question.write_text('accuracy_frame = "base"\n' + question.read_text())
    studies.edit(question, "z = 0.02", "z = 0.004")
    studies.edit(question, "draws", "n_first_poses = 4\ndraws")
    out = question.parent / "out"
    code, said, complaint = call("next-pose", question, "--out", out)
    assert (code, complaint) == (0, "")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["decision"] == "measure"
    assert summary["n_poses"] == 4
    assert f"candidate {summary['next_candidate']}." in said
    poses, history = (pd.read_csv(out / f"{name}.csv") for name in ("next_poses", "history"))
    first = poses.iloc[0]
    moves = [first[f"displacement_{leg}_mm"] for leg in range(1, 7)]
    assert max(map(abs, moves)) <= 1.2 + 1e-9
    assert ", ".join(f"{move:.3f}".replace("-", "−") for move in moves) in said
    assert list(history.loc[history["measured_or_planned"] == "measured", "n_poses"]) == [1, 2, 3, 4]
    assert history.loc[history["measured_or_planned"] == "planned", "n_poses"].iloc[0] == 5
    page = (out / "report.html").read_text()
    assert "History" in page


def test_the_same_question_has_the_same_answer_to_the_last_digit(question):
    one, other = (compute_experiment(load(question)[1], question.parent) for _ in range(2))
    assert one.summary == other.summary
    for name, table in one.tables.items():
        pd.testing.assert_frame_equal(table, other.tables[name], check_exact=True)


FAULTS = {
    'study = "study.toml"': ('study = "simulate.toml"', "kind: found 'simulation', expected 'study'"),
    'variants = ["six_pus/matrix"]': (
        'variants = ["six_pus/lienar"]',
        "'six_pus/lienar': expected one of six_pus/none",
    ),
    "draws = 300": ("n_first_poses = 99", "n_first_poses: found 99, expected at most 13"),
    "z = 0.02": ("", "found no [requirements], expected them, or goal = 'variants'"),
    "range_mm = 1.2": ("range_mm = 400.0", "candidates.range_mm: found 400, expected at most 1.3"),
    "count = 64": ("position_mm = [1.0, 1.0, 1.0]", "candidates: expected position_mm with rotation_deg"),
    "poses = 15": ("poses = 5", "workspace.poses: found 5"),
    "position_mm = [0.3, 0.3, 0.3]": ("position_mm = [900.0, 1.0, 1.0]", "workspace: out of reach"),
}


@pytest.mark.parametrize("old", FAULTS)
def test_faults_are_one_line_and_nothing_is_written(question, refuse, old):
    new, fault = FAULTS[old]
    studies.edit(question, old, new)
    refuse(re.escape(fault), question.parent / "out", "next-pose", question)


def test_a_study_is_asked_for_requirements_anywhere_and_again_after_more_poses(question, call, no_pictures):
    study, out = question.with_name("study.toml"), question.parent / "out"
    table = study.parent / "data" / "actuators.csv"
    original = table.read_text()
    try:
        for text in (original, original.replace(",calibration,", ",verification,", 1)):
            table.write_text(text)
            asked = ("--require", "z=0.02", "--variant", "six_pus/none")
            code, said, complaint = call("next-pose", study, *asked, "--seed", 5, "--out", out)
            assert (code, complaint) == (0, ""), complaint
            assert "requirement" in said
            assert json.loads((out / "summary.json").read_text())["name"] == "tiny_next_pose"
    finally:
        table.write_text(original)


def test_options_of_a_study_that_cannot_be_are_one_line(question, refuse):
    study = question.with_name("study.toml")
    for path, options, fault in (
        (study, ["--variant", "six_pus/none"], "expected --require NAME=VALUE"),
        (study, ["--require", "z"], "--require: found 'z', expected NAME=VALUE"),
        (study, ["--require", "lead=0.02"], "requirements: found 'lead', expected one of x, y, z"),
        (question, ["--require", "z=0.02"], "next_pose.toml, expected a study"),
        (question.with_name("simulate.toml"), [], "kind: found 'simulation', expected 'study'"),
    ):
        refuse(re.escape(fault), question.parent / "out", "next-pose", path, *options)


def test_the_shipped_question_is_of_the_shipped_study():
    experiment, config = load(studies.EXPERIMENTS / "m2_hexapod" / "next_pose.toml")
    inputs = experiment.read(config, studies.EXPERIMENTS / "m2_hexapod")
    assert list(inputs.subjects) == ["six_ups/none"]
    assert inputs.subjects["six_ups/none"].n_poses == config.n_first_poses
