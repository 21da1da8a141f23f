"""A rotary delta seen by a laser tracker in its own frame: the frame is found, stated or not."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from refusals import line_of

from bayescal import cli
from bayescal.calibrated.predict import predict_poses
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.shared.slip_search import find_slip

HERE = Path(__file__).parent / "rotary_delta_tracker"
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
        mean, sd = np.transpose([centres[0][f"{names[key]}[{k}]"] for k in "xyz"])
        np.testing.assert_allclose(mean, stated, atol=near if key in keys else 1e-9)
        assert (sd > wide).all() == (key in keys)
    assert all(key in inputs.found for key in keys)


def test_it_is_free_in_variants_that_do_not_name_it(study):
    edit(study, *forget("frame_mm", "frame_deg"), (r', "tracker_frame", "tracker_frame_r"\]', "]"))
    for one in read(study).variants.values():
        assert {f"tracker_frame{end}[{k}]" for end in ("", "_r") for k in "xyz"} <= set(one.priors)


def test_a_tolerance_without_a_value_may_be_left_out(study):
    edit(study, *forget("frame_mm", "frame_deg", "tracker_frame", "tracker_frame_r"))
    assert "tracker_frame[x]" in read(study, "zeros").variants["zeros"].priors


def test_a_stated_frame_that_the_readings_contradict_is_refused(study):
    edit(study, (r"^frame_deg = .*", "frame_deg = [0.0, 0.0, 0.0]"))
    assert re.search(r"instruments\.tracker.* mm .*frame_deg = \[-4\.\d+, -0\.\d+, 112\.", line_of(read, study))


def test_a_wide_tolerance_about_zero_leads_to_the_same_machine(study):
    wide = (r"^tracker_frame = .*", 'tracker_frame = { prior = "normal", sd = 5000.0 }')
    turned = (r"^tracker_frame_r = .*", 'tracker_frame_r = { prior = "normal", sd = 180.0 }')
    stated = read(study, "all").variants["all"].plain()
    edit(study, wide, turned, *((rf"^{key} = .*", f"{key} = [0.0, 0.0, 0.0]") for key in ("frame_mm", "frame_deg")))
    inputs = read(study, "all")
    own = inputs.variants["all"].plain()
    for one in (stated, own):
        np.testing.assert_allclose(one.theta(one.least_squares_start()[None])[0, -6:-3], FRAME_MM, atol=5.0)
    first, second = (one.theta(one.least_squares_start()[None])[0] for one in (stated, own))
    assert np.abs(first - second)[:-6].max() < 0.5
    assert own.priors["tracker_frame[x]"].mean == 0.0  # as stated
    assert find_slip([inputs.variants["all"].list_readings()]) is None


@pytest.mark.parametrize("column", ["tracker_x_mm", "tracker_y_mm", "tracker_z_mm", "theta_3_deg"])
def test_readings_that_fit_no_frame_or_a_left_handed_one_are_refused(study, column):
    edit(study, *forget(*(("frame_mm", "frame_deg") if column == "theta_3_deg" else ())))
    table = study.parent / "data" / "readings.csv"
    rows = pd.read_csv(table)
    rows[column] *= -1.0
    rows.to_csv(table, index=False)
    said = "best frame" if column == "theta_3_deg" else "left-handed"
    with pytest.raises(InputError, match=rf"instruments\.tracker.*{said}"):
        read(study, "all")


def test_another_kind_of_experiment_needs_the_frame(study, call, tmp_path):
    text = study.read_text().replace('kind = "study"', 'kind = "simulation"').replace("[[data]]", "[nothing]")
    text = re.sub(r"(?ms)^\[nothing\].*?(?=^\[instruments)|^\[\[variants.*", "", text)
    text = re.sub(r"(?m)^frame_deg.*\n", "", text).replace("seed = 1", "seed = 1\nn_poses = 12")
    (study.parent / "simulate.toml").write_text(text)
    code, _, error = call("simulate", study.parent / "simulate.toml", "--out", tmp_path / "out")
    assert (code, error.count("\n")) == (2, 1), error
    assert "frame_r" in error


SMALL = """
[sampler]
walkers = 64
burn_in = 10
steps = 20

[evidence]
draws = 1000
max_draws = 1000
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The study of the variant with everything free, its frame found: its folder, and its results."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("BAYESCAL_TRUST", "1")
        folder = tmp_path_factory.mktemp("run")
        study = Path(shutil.copytree(HERE, folder / "case")) / "study.toml"
        edit(study, *forget("frame_mm", "frame_deg"), (r"(?s)\[\[variants\]\]\nname = \"no_tilt\".*", SMALL))
        patched.setattr(sys, "argv", ["bayescal", "run", str(study), "--out", str(folder / "out"), "--workers", "1"])
        with pytest.raises(SystemExit):
            cli.main()
        return load_calibrated(folder / "out", allow_unconverged=True), folder / "out"


@pytest.mark.runs
def test_intervals_of_a_found_frame_are_honest(run):
    calibrated, _ = run
    fresh = pd.read_csv(HERE / "data" / "fresh_true.csv", comment="#")
    commands = np.radians(fresh[[f"theta_{k}_deg" for k in (1, 2, 3)]].to_numpy())
    found = predict_poses(calibrated, commands)
    off = (found.tool - fresh[["true_x_mm", "true_y_mm", "true_z_mm"]].to_numpy()) / found.sd
    assert np.mean(np.abs(off) < 1.645) > 0.8
    assert np.sqrt(np.mean(off**2)) > 0.2  # nor wider than they need be, though errors of a frame are common to all


def write_session(calibrated, path, rng, shift_arcsec, symbol="theta0[2]"):
    """Write ten poses that a draw of the posterior reads, its errors included, one of its parameters shifted."""
    model, known, theta = calibrated.model, calibrated.functions, calibrated.theta.copy()
    theta[calibrated.free] = calibrated.draws[int(rng.integers(len(calibrated.draws)))]
    along, root = known.given_geometry
    moved = (theta - calibrated.theta)[calibrated.free]
    coefficients = known.mean + along @ moved + root @ rng.standard_normal(root.shape[1])
    theta[model.layout.names.index(symbol)] += shift_arcsec * np.pi / 180.0 / 3600.0
    pose = np.column_stack([rng.uniform(-180.0, 180.0, (10, 2)), rng.uniform(-800.0, -640.0, 10)])
    values = model.read(theta, pose)
    sd = np.tile([np.radians(0.003)] * 3 + [0.015] * 3, (10, 1))
    acted, _ = known.show(model, Measurements(tuple(f"S{k}" for k in range(10)), values, sd), values)
    values = values + acted @ coefficients + rng.standard_normal((10, 6)) * sd
    columns = [*(f"theta_{k}_deg" for k in (1, 2, 3)), *(f"tracker_{axis}_mm" for axis in "xyz")]
    rows = pd.DataFrame(values * ([np.degrees(1.0)] * 3 + [1.0] * 3), columns=columns)
    rows.insert(0, "pose", [f"S{k}" for k in range(10)])
    rows.to_csv(path, index=False)


@pytest.mark.runs
def test_a_reverification_reads_the_instrument(run, call, tmp_path, rng):
    _, out = run
    calibrated = load_calibrated(out, allow_unconverged=True, with_instruments=True)
    assert "tracker[x]" in calibrated.model.names
    assert "tracker_frame[x]" in calibrated.names
    write_session(calibrated, tmp_path / "moved.csv", rng, 103.0)
    write_session(calibrated, tmp_path / "same.csv", rng, 0.0)
    asked = ("verify", out, "--allow-unconverged", "--sessions", 1, "--parameters", "theta0", "--measured")
    code, said, error = call(*asked, tmp_path / "moved.csv")
    assert code == 0, error
    size, sd = map(float, re.search(r"theta0\[2\] shifted by ([+-][\d.]+) ± ([\d.]+) arcsec", said).groups())
    assert abs(size - 103.0) < 3.5 * sd < 100.0
    assert "holds" in call(*asked, tmp_path / "same.csv")[1]
    code, plan, error = call("verify", out, "--allow-unconverged", "--parameters", "theta0", "--shift-arcsec", 100)
    assert code == 0, error
    assert "theta_1_deg" in plan  # as the data have it
