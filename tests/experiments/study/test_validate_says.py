"""`validate` says what a run would: tolerances and noise stated wrong, and errors far beyond what was allowed for."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bayescal.projects.start import OWN, start_project

pytestmark = pytest.mark.runs

SIZE = 0.3  # mm rms, fifteen times what functions of the pose are allowed by default
SCALED = {
    "tolerances that are too tight": ("sd", 0.1, "but the tolerance of all parameters is about", "times too tight"),
    "tolerances that are too wide": ("sd", 10.0, "the tolerance of all parameters is about", "times too wide"),
    "noise that is too small": ("noise_um", 0.1, "but the noise of all channels is about 10 times", "state it so"),
}


@pytest.fixture
def study(tmp_path) -> Path:
    start_project(tmp_path / "own", OWN, None)
    path = tmp_path / "own" / "study.toml"
    path.write_text(re.sub(r'(?ms)\[\[variants\]\]\nname = "one_rod".*?\n\n', "", path.read_text()))
    return path


@pytest.mark.parametrize("what", SCALED)
def test_what_is_stated_wrong(what, study, call):
    key, factor, begin, said = SCALED[what]
    text = re.sub(rf"\b{key} = ([\d.]+)", lambda one: f"{key} = {factor * float(one[1]):.6g}", study.read_text())
    study.write_text(text)
    code, out, _ = call("validate", study)
    assert code == 0
    (line,) = [one for one in out.splitlines() if one.startswith(begin)]
    assert said in line


def test_errors_that_need_a_cause(study, call):
    """Own channels err in proportion to travel of all of them."""
    path = study.parent / "data" / "readings.csv"
    lines = path.read_text().splitlines()
    comments, (header, *rows) = (
        [one for one in lines if one[0] == "#"],
        [one.split(",") for one in lines if one[0] != "#"],
    )
    own = [header.index(f"s_{k}_mm") for k in (1, 2, 3)]
    values = np.array([[float(row[k]) for k in own] for row in rows])
    errors = (values - values.mean(axis=0)) @ np.random.default_rng(1).standard_normal((3, 3))
    values += SIZE * errors / np.sqrt(np.mean(errors**2))
    for row, one in zip(rows, values, strict=True):
        for k, value in zip(own, one, strict=True):
            row[k] = f"{value:.6f}"
    path.write_text("\n".join([*comments, *map(",".join, [header, *rows])]) + "\n")
    code, out, _ = call("validate", study)
    assert code == 0
    (line,) = [one for one in out.splitlines() if one.startswith("but the readings need errors of")]
    assert re.search(r"; single cause, odds .*s err in proportion", line)
