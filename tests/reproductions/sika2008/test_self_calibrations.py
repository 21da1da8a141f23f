"""The shipped experiment, tiny; its parts against closed forms and against each other; what it refuses."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from papers import SIKA
from rich.console import Console
from sliding_platforms import make_content
from tiny_experiments import copy_tiny

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import FOUND_LATE, run_experiment
from bayescal.machines.readings import FunctionModel
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from sika2008.documented import QUANTILE, cover, list_calibrabilities, list_steps, name_parts, ratio_of, rms_of
from sika2008.machines import GEOMETRY, draw_candidate, lay_out
from sika2008.published import band_of, read_published
from sika2008.setup import read_setup
from sika2008.simulate import (
    BAYESIAN,
    PAPER,
    PROCEDURES,
    measure,
    predict_covariance,
    predict_tool,
    simulate,
    state_spread,
)

TABLES = {
    "calibrability",
    "correlations",
    "coverage",
    "errors",
    "judged",
    "machine_steps",
    "machine_summary",
    "machines",
    "parameters",
    "path",
    "steps",
    "sweep_errors",
    "sweep_steps",
    "uncalibrated",
}
FIGURES = {"errors", "machines", "parameters", "path", "predictors", "sweep"}


@pytest.fixture
def path(tmp_path):
    """Return the config of the shipped experiment, tiny."""
    return copy_tiny(tmp_path, "sika2008", "sliding_star") / "sika2008" / "calibrations.toml"


@pytest.fixture
def setup(path):
    return read_setup(load_experiment(path), path.parent)


def edit(path, old, new):
    text = path.read_text()
    assert old in text, old
    path.write_text(text.replace(old, new))


def run(path):
    out = path.parents[1] / "out"
    console = Console(file=io.StringIO(), width=120)
    run_experiment(load_experiment(path), path.parent, out).show(console)
    return out, console.file.getvalue()


def plain_text(page):
    return re.sub(r"base64,[^\"]*", "", page.read_text())


# --- the whole -------------------------------------------------------------------------------------------------------


def test_shipped_experiment_runs_tiny(path, no_pictures):
    out, text = run(path)
    assert "report.html" in text
    assert {p.stem for p in out.glob("*.csv")} == TABLES | {"findings"}
    assert {p.stem for p in (out / "figures").iterdir()} == FIGURES
    summary = json.loads((out / "summary.json").read_text())
    assert summary["headline"] in text
    assert [row["n_parameters"] for row in summary["calibrability"]] == [18, 22, 26]
    assert not re.search(r"\bnan\b", plain_text(out / "report.html"))


def write_legs(path, n_legs):
    """Give the experiment a machine with N legs."""
    content = make_content(n_legs)
    lines = ['kind = "sliding_platform"', 'name = "other"']
    for leg in content["legs"]:
        lines += ["[[legs]]", *(f"{key} = {json.dumps(value)}" for key, value in leg.items())]
    lines += ["[tool]", "point_mm = [5.0, 7.0]", "[home]", "tool_mm = [3.0, -2.0]", "angle_deg = 4.0"]
    (path.parents[1] / "sliding_star" / "machine.toml").write_text("\n".join(lines) + "\n")


@pytest.mark.runs
@pytest.mark.parametrize(
    ("n_legs", "sets"),
    [
        (3, {"angles": ["s", "phi"], "one more": ["s", "phi", "psi[2]"]}),
        (6, {"carriages": ["s"], "all": ["s", "phi", "psi"]}),
        (4, {"single": ["s", "phi[1]", "psi[3]"]}),
        (4, {"outside": ["s", "x_V", "y_V"], "inside": ["s", "phi"]}),
    ],
)
def test_any_sets_on_any_legs(path, n_legs, sets, request):
    request.getfixturevalue("pictures" if n_legs == 6 else "no_pictures")  # its sets of two sizes have every picture
    write_legs(path, n_legs)
    text = path.read_text().partition("[[sets]]")[0]
    text = text.replace("position_mm = 200.0", "position_mm = 150.0").replace("angle_deg = 30.0", "angle_deg = 15.0")
    text = text.replace("n_poses = 20", "n_poses = 60", 1)
    text = text.replace("[sensors]", "[sensors]\nx_V = { noise_um = 5.0 }\ny_V = { noise_um = 5.0 }")
    path.write_text(
        text + "".join(f"[[sets]]\nname = {json.dumps(n)}\nsensors = {json.dumps(s)}\n" for n, s in sets.items())
    )
    out, _ = run(path)
    errors = pd.read_csv(out / "errors.csv")
    assert list(dict.fromkeys(errors["set"])) == list(sets)
    assert (errors["n_failed"] == 0).all()
    assert errors["tool"].between(1e-5, 2.0).all()
    assert not re.search(r"\bnan\b", plain_text(out / "report.html"))
    assert "published figures" not in plain_text(out / "report.html")


# --- parts -----------------------------------------------------------------------------------------------------------


def test_prediction_is_what_simulation_finds(setup):
    """For the paper's procedure; and with the wrong noise it is not."""
    n = 300
    for plan in setup.plans.plans[1:]:
        measured = measure(setup.plans, setup.pose, setup.targets, n, setup.rng(9))
        found = simulate(setup.plans, plan, PAPER, measured, setup.pose, setup.targets)
        covariance = predict_covariance(plan, setup.pose)
        ratio = np.sqrt(np.mean(found.error**2, axis=0) / np.diagonal(covariance))
        assert np.abs(ratio - 1.0).max() < 4.5 / np.sqrt(2 * n) + 0.02
        tool = predict_tool(plan, covariance, setup.targets)
        assert np.sqrt(found.tool_squares.mean()) == pytest.approx(tool, rel=0.12)
        louder = replace(plan, sensors=replace(plan.sensors, noise=1.5 * plan.sensors.noise))
        assert np.diagonal(predict_covariance(louder, setup.pose)) == pytest.approx(2.25 * np.diagonal(covariance))


def test_stated_intervals_cover_and_understated_ones_do_not(setup):
    n = 200
    plan = setup.plans.plans[2]
    measured = measure(setup.plans, setup.pose, setup.targets, n, setup.rng(9))
    found = simulate(setup.plans, plan, BAYESIAN, measured, setup.pose, setup.targets)
    stated = state_spread(found, setup.targets)
    pairs = ((found.error, stated.parameters), (found.tool, stated.tool), (found.noisy_tool, stated.noisy_tool))
    for error, spread in pairs:
        share = cover(error, spread, QUANTILE, 0.9).share
        assert abs(share.value - 0.9) < 4.0 * share.error
        assert share.error < 0.03
        assert cover(error, 0.6 * spread, QUANTILE, 0.9).share.value < 0.8
    added = found.noisy_tool - found.tool  # by the noise of the readings in use
    wanted = stated.noisy_tool**2 - stated.tool**2
    assert np.sqrt(np.mean(added**2) / np.mean(wanted)) == pytest.approx(1.0, abs=0.06)


def test_sets_share_machines_and_noise(setup):
    plans = setup.plans
    measured = measure(plans, setup.pose, setup.targets, 4, setup.rng(9))
    small, large = plans.plans[0], plans.plans[2]
    np.testing.assert_array_equal(plans.columns(small), np.arange(4))
    np.testing.assert_array_equal(plans.columns(large), np.arange(12))
    assert small.sensors.names == tuple(plans.every.sensors.names[k] for k in plans.columns(small))
    off = measured.readings - plans.every.sensors.read(measured.theta[:, None], setup.pose)
    assert (off / plans.every.sensors.noise).std() == pytest.approx(1.0, abs=0.06)
    exact = plans.every.sensors.read(measured.theta[:, None], setup.targets)
    np.testing.assert_array_equal(measured.at_targets, exact)


def test_parts_are_what_all_sets_calibrate(setup):
    parts = name_parts(setup.plans.plans)
    assert len(parts["lengths"]) == 15
    assert parts["guide_angles"] == {"beta[2]", "beta[3]", "beta[4]"}


def test_steps_are_ratios_of_root_mean_squares(setup):
    measured = measure(setup.plans, setup.pose, setup.targets, 5, setup.rng(9))
    found = {
        (plan.name, procedure): simulate(setup.plans, plan, procedure, measured, setup.pose, setup.targets)
        for plan in setup.plans.plans
        for procedure in PROCEDURES
    }
    steps = list_steps(setup.plans, found).set_index(["from", "to", "procedure", "quantity"])["ratio"]
    one, two = (found[name, PAPER].tool for name in ("4 sensors", "8 sensors"))
    wanted = np.sqrt((one**2).sum() / (two**2).sum())
    assert steps["4 sensors", "8 sensors", PAPER, "tool"] == pytest.approx(wanted)
    assert wanted > 10.0


def test_path_is_a_circle_of_the_tool(setup):
    position, _, _ = setup.machine.tool(setup.machine.layout.nominal, setup.path)
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), 150.0, rtol=1e-12)
    turned = np.degrees(setup.path[:, 2] - setup.machine.home_pose[2])
    assert turned.max() == pytest.approx(20.0)
    assert turned.min() == pytest.approx(-20.0)


# --- statistics ------------------------------------------------------------------------------------------------------


def test_standard_errors_are_those_of_repeats(rng):
    n, repeats = 150, 600
    one, common = rng.standard_normal((2, repeats, n)) ** 2
    two = 0.25 * (0.5 * one + 0.5 * common)
    rms = [rms_of(row) for row in one]
    assert np.mean([e.error for e in rms]) == pytest.approx(np.std([e.value for e in rms]), rel=0.15)
    ratios = [ratio_of(a, b) for a, b in zip(one, two, strict=True)]
    assert np.mean([e.value for e in ratios]) == pytest.approx(2.0, rel=0.02)
    spread = np.std([e.value for e in ratios])
    assert np.mean([e.error for e in ratios]) == pytest.approx(spread, rel=0.15)
    loose = [ratio_of(a, rng.permutation(b)) for a, b in zip(one, two, strict=True)]  # machines that are not the same
    assert np.mean([e.error for e in loose]) > 1.2 * spread


def test_cover_counts_a_calibration_once(rng):
    """All quantities of a calibration alike: the error is that of 100 calibrations, not of 1000 numbers."""
    error = np.repeat(rng.standard_normal((100, 1)), 10, axis=1)
    found = cover(error, np.ones((100, 10)), QUANTILE, 0.9)
    assert found.share.error == pytest.approx(np.sqrt(found.share.value * (1 - found.share.value) / 99))
    assert found.lowest == found.highest == found.share.value
    assert found.binomial_error == pytest.approx(0.03)


def test_failed_calibrations_are_left_out():
    squares = np.array([4.0, np.nan, 4.0, 1.0])
    assert rms_of(squares).value == pytest.approx(np.sqrt(3.0))
    assert ratio_of(squares, np.array([1.0, 1.0, np.nan, 0.25])).value == pytest.approx(2.0)
    assert np.isnan(rms_of(np.full(3, np.nan)).value)


# --- machines --------------------------------------------------------------------------------------------------------


def test_machines_are_drawn_from_their_ranges(setup):
    config = setup.config.machines
    drawn = [draw_candidate(setup, config, setup.rng(7, k)) for k in range(40)]
    kept = [one for one in drawn if one is not None]
    assert 10 < len(kept) < 40  # some do not reach their poses
    for one in kept:
        for name in GEOMETRY:
            low, high = getattr(config, name)
            assert low <= one.geometry[name] <= high
        platform = one.machine.machine
        platform.check_poses(one.pose)
        np.testing.assert_allclose(np.hypot(*platform.guide_points.T), one.geometry["guide_radius_mm"])
        tool, _, _ = one.machine.tool(one.machine.layout.nominal, one.pose)
        assert np.abs(tool).max() <= one.geometry["position_mm"]


def test_the_documented_machine_is_one_of_them(setup):
    geometry = dict.fromkeys(GEOMETRY, 0.0) | {"guide_radius_mm": 600.0, "leg_length_mm": 800.0}
    ours = lay_out(geometry | {"platform_radius_mm": 100.0}, 4)
    found = FunctionModel("drawn", SlidingPlatform(ours))
    off = found.layout.nominal - setup.machine.layout.nominal
    turns = np.array(found.layout.units) == "rad"
    np.testing.assert_allclose(off[~turns], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * off[turns]), 1.0, atol=1e-12)


# --- published figures -----------------------------------------------------------------------------------------------


def test_published_figures_are_the_papers(path):
    found = read_published(load_experiment(path), path.parent)
    assert found.sets == {"4 sensors": (18, 3e8), "8 sensors": (22, 3e4), "12 sensors": (26, 4e4)}
    step = found.steps["4 sensors", "8 sensors"]
    assert step == {"calibrability": 1e4, "parameters": 1e2, "tool": 1e2}
    assert band_of("tool", 100.0) == pytest.approx((30.0, 300.0))
    assert band_of("tool", 1.0) == (0.5, 2.0)
    assert band_of("calibrability", 1e4) == (1e3, np.inf)


# --- faults ----------------------------------------------------------------------------------------------------------


FAULTS = [
    (
        ("calibrations.toml", "n_poses = 20", "n_poses = 17"),
        r"sets: '4 sensors': sensors s\[1\], .*: found 17 equations \(17 poses .* for 18 parameters",
    ),
    (("calibrations.toml", 'sensors = ["s"]', 'sensors = ["s[1]", "s[2]"]'), "found 0 equations"),
    (("calibrations.toml", '["s", "phi"]', '["s", "fi"]'), "'8 sensors': sensor 'fi':"),
    (("calibrations.toml", "phi = { noise_arcsec", "theta = { noise_arcsec"), "sensor 'theta':"),
    (("calibrations.toml", "psi = { noise_arcsec = 0.5 }", ""), r"sensor psi\[1\]: found no noise"),
    (("calibrations.toml", "phi = { noise_arcsec", "phi = { noise_um"), "found noise_um, expected noise_arcsec"),
    (("calibrations.toml", "phi = { noise_arcsec", "phi = { noise_deg"), "sensors.phi.noise_deg: unknown key"),
    (("calibrations.toml", "position_mm = 200.0", "position_mm = 500.0"), r"pose \d+: leg \d: found"),
    (("calibrations.toml", "radius_mm = 150.0", "radius_mm = 450.0"), r"path: pose \d+: leg \d: found"),
    (
        ("calibrations.toml", "position_mm = 200.0\nangle_deg = 30.0", "position_mm = 50.0\nangle_deg = 170.0"),
        r"machine 'sliding_star': pose \d+: legs \d and \d cross",
    ),
    (("calibrations.toml", 'name = "8 sensors"', 'name = "4 sensors"'), "found two sets of the name '4 sensors'"),
    (
        ("calibrations.toml", "[500.0, 1000.0]", "[1000.0, 500.0]"),
        "leg_length_mm: found .*, expected the lower end first",
    ),
    (("calibrations.toml", "[500.0, 1000.0]", "[50.0, 60.0]"), "machines: found 0 in 150 draws that reach their poses"),
    (("calibrations.toml", "machine.toml", "engine.toml"), "engine.toml: no such file"),
    (("calibrations.toml", "calibrability.csv", "c.csv"), "c.csv: no such file"),
    (
        ("published/calibrability.csv", "8 sensors,", "9 sensors,"),
        "line 4: set: found '9 sensors', expected one of 4 s",
    ),
    (("published/improvements.csv", "8 sensors,12 sensors", "4 sensors,12 sensors"), "expected neighbours in"),
    (
        ("../sliding_star/machine.toml", "length_mm = 800.0", "length_mm = 400.0"),
        r"machine.toml: machine 'sliding_star': home: leg 1",
    ),
]


@pytest.mark.parametrize(("fault", "match"), FAULTS)
def test_faults_are_one_line_and_nothing_is_written(call, path, fault, match):
    edit(path.parent / fault[0], *fault[1:])
    out = path.parents[1] / "out"
    code, printed, error = call("run", path, "--out", out, "--workers", 1, "--quiet")
    assert (code, printed) == (3 if FOUND_LATE in error else 2, "")
    assert error.count("\n") == 1
    assert re.search(match, error), error
    assert not list(path.parents[1].glob("out*"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("length_mm = 0.3", "length_mm = 300.0", "tolerances: "),
        ("s = { noise_um = 1.0 }", "s = { noise_um = 100000.0 }", "none of 6"),
    ],
    ids=["machines beyond reach", "so noisy that no calibration has a solution"],
)
def test_what_shows_when_it_is_computed_is_a_numerical_failure(call, path, old, new, said):
    edit(path, old, new)
    code, _, error = call("run", path, "--out", path.parents[1] / "out", "--workers", 1, "--quiet")
    assert (code, error.count("\n")) == (3, 1)
    assert said in error


# --- committed results -----------------------------------------------------------------------------------------------


def test_committed_results_are_those_of_the_paper():
    """The published pattern, and intervals that hold what they state."""
    config, results = load_experiment(SIKA / "calibrations.toml"), SIKA.parents[1] / "results"
    results /= "sliding_star_calibrations"
    summary = json.loads((results / "summary.json").read_text())
    assert all(row["reached"] for row in summary["judged"])
    assert all(0.85 <= row["share"] <= 0.95 for row in summary["coverage"])
    setup = read_setup(config, SIKA)
    found = list_calibrabilities(setup.plans, setup.pose)
    committed = pd.DataFrame(summary["calibrability"])
    np.testing.assert_allclose(found["metres_radians"], committed["metres_radians"], rtol=1e-6)
