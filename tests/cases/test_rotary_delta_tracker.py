"""A rotary delta seen by a laser tracker in its own frame: the frame is found, stated or not."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from bayescal.errors import InputError
from bayescal.experiments.frame.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.shared.slip_search import find_slip

FRAME_MM = np.array([2310.8, -1479.4, 654.8])  # as stated, within a few mm and tenths of a degree of the truth
FRAME = np.radians([-4.48, -0.18, 112.04])


@pytest.fixture(autouse=True)
def _trusted(monkeypatch):
    monkeypatch.setenv("BAYESCAL_TRUST", "1")


@pytest.fixture
def study(case):
    return case("rotary_delta_tracker") / "study.toml"


def edit(study, *changes):
    text = study.read_text()
    for old, new in changes:
        text, n = re.subn(old, new, text, flags=re.MULTILINE)
        assert n, old
    study.write_text(text)


def read(study, *variants):
    _, config = load(study)
    return read_inputs(config, study.parent, variants or None)


def forget(*keys):
    return [(rf"^{key} = .*\n", "") for key in keys]


@pytest.mark.parametrize("keys", [("frame_mm", "frame_deg"), ("frame_deg",), ("frame_mm",)])
def test_a_frame_that_nobody_states_is_found(study, keys):
    edit(study, *forget(*keys))
    inputs = read(study)
    centres = [
        {name: (one.priors[name].mean, one.priors[name].sd) for name in one.priors if name.startswith("tracker")}
        for one in inputs.variants.values()
    ]
    assert centres[0] == centres[1] == centres[2]  # evidence compares them
    names = {"frame_mm": "tracker_frame", "frame_deg": "tracker_frame_r"}
    for key, stated, near, wide in zip(names, (FRAME_MM, FRAME), (3.0, 0.01), (1e3, 0.5), strict=True):
        mean, sd = np.transpose([centres[0][f"{names[key]}[{k}]"] for k in (1, 2, 3)])
        np.testing.assert_allclose(mean, stated, atol=near if key in keys else 1e-9)
        assert (sd > wide).all() == (key in keys)
    assert all(key in inputs.found for key in keys)


def test_it_is_free_in_variants_that_do_not_name_it(study):
    edit(study, *forget("frame_mm", "frame_deg"), (r', "tracker_frame", "tracker_frame_r"\]', "]"))
    for one in read(study).variants.values():
        assert {f"tracker_frame{end}[{k}]" for end in ("", "_r") for k in (1, 2, 3)} <= set(one.priors)


def test_a_tolerance_without_a_value_may_be_left_out(study):
    edit(study, *forget("frame_mm", "frame_deg", "tracker_frame", "tracker_frame_r"))
    assert "tracker_frame[1]" in read(study, "zeros").variants["zeros"].priors


def test_a_stated_frame_that_the_readings_contradict_is_refused(study):
    edit(study, (r"^frame_deg = .*", "frame_deg = [0.0, 0.0, 0.0]"))
    with pytest.raises(InputError, match=r"instruments\.tracker.* mm .*frame_deg = \[-4\.\d+, -0\.\d+, 112\.") as error:
        read(study)
    assert "\n" not in str(error.value)


def test_a_wide_tolerance_about_zero_leads_to_the_same_machine(study):
    wide = (r"^tracker_frame = .*", 'tracker_frame = { prior = "normal", sd = 5000.0 }')
    turned = (r"^tracker_frame_r = .*", 'tracker_frame_r = { prior = "normal", sd = 180.0 }')
    stated = read(study, "all").variants["all"].plain()
    edit(study, wide, turned, *((rf"^{key} = .*", f"{key} = [0.0, 0.0, 0.0]") for key in ("frame_mm", "frame_deg")))
    inputs = read(study, "all")
    own = inputs.variants["all"].plain()
    for one in (stated, own):
        np.testing.assert_allclose(one.theta(one.approach()[None])[0, -6:-3], FRAME_MM, atol=5.0)
    first, second = (one.theta(one.approach()[None])[0] for one in (stated, own))
    assert np.abs(first - second)[:-6].max() < 0.5
    assert own.priors["tracker_frame[1]"].mean == 0.0  # as stated
    assert find_slip([inputs.variants["all"].list_readings()]) is None


@pytest.mark.parametrize("column", ["tracker_x_mm", "tracker_y_mm", "tracker_z_mm"])
def test_a_left_handed_frame_is_called_one(study, column):
    table = study.parent / "data" / "readings.csv"
    rows = pd.read_csv(table)
    rows[column] *= -1.0
    rows.to_csv(table, index=False)
    with pytest.raises(InputError, match=r"instruments\.tracker.*left-handed"):
        read(study, "all")


def test_readings_that_fit_no_frame_are_refused(study):
    edit(study, *forget("frame_mm", "frame_deg"))
    table = study.parent / "data" / "readings.csv"
    rows = pd.read_csv(table)
    rows["theta_3_deg"] *= -1.0
    rows.to_csv(table, index=False)
    with pytest.raises(InputError, match=r"instruments\.tracker.*with the best frame"):
        read(study, "all")


def test_another_kind_of_experiment_needs_the_frame(study, call, tmp_path):
    text = study.read_text().replace('kind = "study"', 'kind = "simulation"').replace("[[data]]", "[nothing]")
    text = re.sub(r"(?ms)^\[nothing\].*?(?=^\[instruments)|^\[\[variants.*", "", text)
    text = re.sub(r"(?m)^frame_deg.*\n", "", text).replace("seed = 1", "seed = 1\nn_poses = 12")
    (study.parent / "simulate.toml").write_text(text)
    code, _, error = call("simulate", study.parent / "simulate.toml", "--out", tmp_path / "out")
    assert (code, error.count("\n")) == (2, 1), error
    assert "frame_r" in error
