"""The accuracy of a rotary delta whose tracker has a frame of its own: where the base lies is no error."""

from __future__ import annotations

import re

import numpy as np
import pytest
from refusals import line_of

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.readings.inputs import read_inputs

EFFORT = "[sampler]\nwalkers = 64\nburn_in = 10\nsteps = 20\n\n[evidence]\ndraws = 1000\nmax_draws = 1000\n"


@pytest.fixture
def study(case, monkeypatch):
    monkeypatch.setenv("BAYESCAL_TRUST", "1")
    path = case("rotary_delta_tracker") / "study.toml"
    path.write_text(re.sub(r'(?ms)^\[\[variants\]\]\nname = "no_tilt".*', "", path.read_text()))
    return path


def read(study):
    return read_inputs(load(study)[1], study.parent)


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("", "[requirements]\nphi = 0.1\n", "requirements: found 'phi'"),
        ('accuracy_frame = "base"', "", "accuracy_frame: found 'base', but tracker_frame"),
    ],
)
def test_what_the_tool_or_the_base_does_not_have_is_refused(study, key, text, said):
    study.write_text(study.read_text().replace("seed = 1", f"seed = 1\n{key}") + text)
    assert said in line_of(read, study)


def test_marks_on_the_base_say_where_it_is(study):
    """The tracker's frame known better than the machine's parts: accuracy may be relative to the base."""
    text = study.read_text().replace("seed = 1", 'seed = 1\naccuracy_frame = "base"')
    study.write_text(text.replace("sd = 10.0", "sd = 0.02"))
    assert not read(study).variants["all"].aligned


@pytest.mark.runs
def test_accuracy_is_that_of_the_aligned_tool(study, tmp_path, no_pictures):
    """After a best fit the tool is off by 0.038 mm in truth, the nominal machine by 0.24 mm."""
    study.write_text(f"{study.read_text()}\n{EFFORT}\n[requirements]\nposition = 1.0\n")
    done = run_experiment(load(study)[1], study.parent, tmp_path / "out", quiet=True).results
    accuracy = done.table("accuracy")
    assert (accuracy["posterior_sd"] < 0.03).all()
    assert (accuracy["unaligned_sd"] > 5.0 * accuracy["posterior_sd"]).all()
    held = done.table("before_after")
    held = held[held["use"] == "verification"]
    before, after = (np.sqrt(np.mean(held[one] ** 2)) for one in ("before_mm", "after_mm"))
    assert after < 0.06
    assert 0.1 < before < 0.5
    assert done.summary["variants"]["all"]["requirements"]["position"] > 0.95
