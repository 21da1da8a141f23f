"""A self-calibration as a whole: what it finds, what it writes, what the page says."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from reading_machines import EXPERIMENT
from reading_studies import copy_shipped, describe_variant, load_small, write_small
from rich.console import Console
from saved_trees import check_tree, read_tree

from bayescal.experiments.frame.identity import hash_identity, identify
from bayescal.experiments.frame.load import find_kind, load, load_experiment
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.run import Finished, run_experiment
from bayescal.experiments.self_calibration.blunders import check_readings
from bayescal.experiments.self_calibration.compute import compute_variants
from bayescal.experiments.self_calibration.fit import fit_variant
from bayescal.experiments.self_calibration.identifiability import audit_variant, compute_rows
from bayescal.experiments.self_calibration.kind import SelfCalibration
from bayescal.experiments.self_calibration.page.verdict import explains, list_rows, write_names
from bayescal.experiments.self_calibration.tables import rank_models, tabulate
from bayescal.experiments.self_calibration.tool import assess_tool, predict_tool
from bayescal.experiments.shared.calibrability import compute_calibrability
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.shared.sensor_sets import locate_tool
from bayescal.experiments.shared.trees import write_packed

pytestmark = pytest.mark.runs

RESULTS = Path(__file__).parents[3] / "results" / "sliding_star"
TABLES = {"variants", "parameters", "identifiability", "ridges", "predictions", "residuals"}


def run(path: Path, out: Path, workers: int = 1) -> str:
    """Return what a run prints, whether or not so little sampling converges."""
    return say(run_experiment(load_experiment(path), path.parent, out, workers))


def say(finished: Finished) -> str:
    console = Console(file=io.StringIO(), width=120)
    finished.show(console)
    return console.file.getvalue()


@pytest.fixture(scope="module")
def shipped():
    """Return the inputs of the shipped experiment."""
    inputs = load_small(EXPERIMENT / "study.toml")
    check_readings(inputs, EXPERIMENT)
    return inputs


@pytest.fixture(scope="module")
def some(tmp_path_factory):
    """Return the inputs of two of its sets of sensors, with half of the poses."""
    effort = {"walkers": 64, "burn_in": 10, "steps": 20, "draws": 2000, "max_draws": 2000}
    return load_small(copy_shipped(tmp_path_factory.mktemp("some") / "star", ("s4", "s8_external"), 30, effort))


@pytest.fixture(scope="module")
def fits(some):
    """Return the fits of two sets of sensors."""
    return {name: fit_variant(some, some.variants[name]) for name in ("s4", "s8_external")}


# --- the saved posterior -----------------------------------------------------------------------------------------


def test_arviz_judges_a_saved_posterior(fits, tmp_path):
    path = tmp_path / "s8.nc"
    write_packed(fits["s8_external"].evaluated[TREE], path)
    tree = check_tree(path, k_is_good=False)
    near = tree["posterior_predictive/readings"] - tree["observed_data/readings"]
    assert tree["observed_data/unit"].dims == ("channel",)
    assert float(near.std(("chain", "draw")).max()) < 0.05  # mm
    assert float(np.abs(near.mean(("chain", "draw"))).max()) < 0.05
    far = tree["prior_predictive/readings"] - tree["observed_data/readings"]
    assert float(far.std()) > 10.0 * float(near.std())


# --- the whole -------------------------------------------------------------------------------------------------------


def test_shipped_experiment_runs_tiny(tmp_path, no_pictures, search_little):
    kept = ("s4", "s8", "s8_one_length")
    path, out = copy_shipped(tmp_path / "sliding_star", kept), tmp_path / "out"
    finished = run_experiment(load_experiment(path), path.parent, out)
    said = say(finished)
    assert f"report: {out / 'report.html'}" in said
    assert finished.page.headline in said
    assert all(name in said for name in kept)
    assert {p.stem for p in out.glob("*.csv")} == TABLES
    assert {p.stem for p in (out / "figures").iterdir()} == {"tool", "parameters", "predictions"}
    assert {p.stem for p in (out / "posterior").iterdir()} == set(kept)
    tree = read_tree(out / "posterior" / "s8.nc")
    assert tree["posterior/l"].attrs["units"] == "mm"
    assert tree["posterior/beta"].attrs["units"] == "rad"
    summary = json.loads((out / "summary.json").read_text())
    assert summary == finished.summary
    assert summary["rankings"][0][0] == "s8_one_length"
    page = re.sub(r"base64,[^\"]*", "", (out / "report.html").read_text())
    assert not re.search(r"\bnan\b|None", page)
    assert "never measured" in page


@pytest.mark.slow  # the contract of all kinds has the same of small ones
def test_workers_change_nothing(tmp_path):
    path = write_small(tmp_path, *(describe_variant(name, ["s", name]) for name in ("phi", "psi")))
    for workers in (1, 2):
        run(path, tmp_path / f"out{workers}", workers)
    for name in ("summary.json", *(f"{table}.csv" for table in TABLES)):
        assert (tmp_path / "out1" / name).read_bytes() == (tmp_path / "out2" / name).read_bytes()


def test_not_converged_is_3_with_the_results_written(call, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    write_small(tmp_path)
    path = Path("study.toml")
    path.write_text(path.read_text().replace("walkers = 56", "walkers = 8").replace("steps = 12", "steps = 3"))
    code, out, err = call("run", "study.toml", "--out", "out", "--workers", 1)
    *progress, complaint = err.splitlines()
    assert code == 3
    assert all(line.startswith("variants: ") for line in progress)
    assert complaint.startswith("bayescal: out: not everything converged")
    assert "NOT everything converged" in out
    assert not json.loads(Path("out/summary.json").read_text())["converged"]
    assert '<section id="verdict" class="verdict failed">' in Path("out/report.html").read_text()
    assert not list(Path().glob("*.partial"))


def test_converged_is_0(call, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    path = write_small(tmp_path)
    path.write_text(path.read_text().replace("burn_in = 5\nsteps = 12", "burn_in = 10\nsteps = 30"))
    code, out, err = call("run", "study.toml", "--workers", 1)
    assert code == 0
    *earlier, last = err.splitlines()  # on a busy computer a stage is heard of before its end
    assert all(studies.PROGRESS.fullmatch(line) for line in earlier)
    assert re.fullmatch(r"variants: 1 of 1 done, \d+ s", last)
    assert "report: results/small/report.html" in out


def test_measured_readings_need_no_truth(tmp_path, no_pictures, search_little):
    """Without a truth, verification poses, or a variant in which all is free."""
    path = write_small(tmp_path, describe_variant("six", ["s", "phi"], 'common = ["l"]'))
    text = path.read_text()
    path.write_text(re.sub(r"true_\w+ = .*\n", "", text))
    said = run(path, tmp_path / "out")
    assert "truly" not in said
    assert "true_mm" in (tmp_path / "out" / "predictions.csv").read_text()
    assert "true" not in pd.read_csv(tmp_path / "out" / "parameters.csv")
    readings = tmp_path / "data" / "readings.csv"
    readings.write_text("\n".join(x for x in readings.read_text().splitlines() if not x.startswith("V")) + "\n")
    run(path, tmp_path / "other")
    assert not (tmp_path / "other" / "predictions.csv").exists()
    summary = json.loads((tmp_path / "other" / "summary.json").read_text())
    assert summary["n_poses"] == {"calibration": 20, "verification": 0}
    assert not re.search(
        r"\bnan\b|None", re.sub(r"base64,[^\"]*", "", (tmp_path / "other" / "report.html").read_text())
    )


@pytest.mark.parametrize(
    ("n_legs", "sensors"),
    [
        (3, ["s", "psi[1]", "phi[2]"]),
        pytest.param(5, ["s"], marks=pytest.mark.slow),
        pytest.param(6, ["s[1]", "s[2]", "s[3]", "s[4]", "phi"], marks=pytest.mark.slow),
    ],
)
def test_other_legs_and_sensors_find_their_truth(tmp_path, n_legs, sensors):
    path = write_small(tmp_path, describe_variant("one", sensors, 'fixed = ["x_P"]'), n_legs=n_legs)
    # what is fixed must be so in truth: those of x_P are set back, and the readings made anew
    inputs = load_small(path)
    model, truth = inputs.model, inputs.truth
    theta, index = truth.theta.copy(), model.layout.index["x_P"]
    theta[index] = model.layout.nominal[index]
    rng = np.random.default_rng(3)
    exact, noise = model.read(theta, truth.pose), np.full(len(model.channels), np.radians(1 / 3600))
    noise[: model.n_legs] = 1e-3
    values = exact + noise * rng.standard_normal(exact.shape)
    object.__setattr__(inputs.table, "values", values)
    variant = inputs.variants["one"]
    fit = fit_variant(inputs, variant)
    places = [model.layout.names.index(name) for name in fit.names]
    off = (theta[places] - fit.mean) / fit.sd
    assert np.sqrt(np.mean(off**2)) < 2.0
    assert np.abs(off).max() < 4.5


# --- one variant -----------------------------------------------------------------------------------------------------


def test_the_truth_lies_where_the_posterior_says(some, fits):
    for name, fit in fits.items():
        variant = some.variants[name]
        places = [some.model.layout.names.index(n) for n in fit.names]
        off = (some.truth.theta[places] - fit.mean) / fit.sd
        assert np.abs(off).max() < 4.0
        assert 0.3 < np.sqrt(np.mean(off**2)) < 1.7
        assert not fit.list_problems()
        assert abs(fit.importance.log_evidence - fit.bridge.log_evidence) < 0.1
        prediction = predict_tool(some, variant, fit, np.random.default_rng(1))
        assert prediction.inside.mean() > 0.5
        assert (prediction.error < 4 * prediction.sd).all()


def test_the_instrument_finds_the_tool_on_the_platform(some, fits):
    """What no internal sensor sees: the tool's place, and where the machine stands for the instrument."""
    fit = fits["s8_external"]
    index = some.model.layout.index
    for symbol in ("xi_V", "eta_V"):
        k = fit.names.index(symbol)
        assert fit.sd[k] < 0.02
        off = some.truth.theta[index[symbol][0]] - fit.mean[k]
        assert abs(off) < 4 * fit.sd[k]
    assert "xi_V" not in fits["s4"].names


def test_predicted_accuracy_is_that_of_the_draws(some, fits):
    """First order against the tool located anew with every draw."""
    variant, fit = some.variants["s4"], fits["s4"]
    accuracy = assess_tool(some, variant, fit)
    pose = some.workspace[:40]
    readings = variant.internal.read(fit.theta.mean(axis=0), pose)
    found = locate_tool(variant.internal, fit.theta[:300], readings, pose).position
    spread = np.sqrt(found.var(axis=0).sum(axis=-1).mean())
    assert accuracy.after == pytest.approx(spread, rel=0.15)
    assert accuracy.after < 0.3 * accuracy.before
    assert accuracy.calibrated_error < 4 * accuracy.after


def test_intervals_hold_ninety_per_cent_of_what_is_drawn(some, fits):
    """Tools drawn with parameters and noise: the quantiles are those of a normal of the given spread."""
    fit, variant = fits["s8_external"], some.variants["s8_external"]
    found = predict_tool(some, variant, fit, np.random.default_rng(1))
    halves = 0.5 * (found.high - found.low) / 1.645
    np.testing.assert_allclose(np.sqrt((halves**2).sum(axis=1)), found.sd, rtol=0.15)
    np.testing.assert_allclose(0.5 * (found.high + found.low), found.mean, atol=0.25 * found.sd.max())


def test_noise_alone_spreads_the_tool_as_it_does_when_drawn(some, fits):
    """One machine for certain: what remains is the noise of each pose's own readings."""
    variant = some.variants["s8_external"]
    mean = fits["s8_external"].theta.mean(axis=0)
    found = predict_tool(
        some, variant, replace(fits["s8_external"], theta=np.tile(mean, (4000, 1))), np.random.default_rng(1)
    )
    pose, sensors = variant.pose[some.table.verification], variant.internal
    rng = np.random.default_rng(2)
    exact = sensors.read(mean, pose)
    noisy = exact + sensors.noise * rng.standard_normal((4000, *exact.shape))
    drawn = locate_tool(sensors, np.tile(mean, (4000, 1)), noisy, pose).position
    np.testing.assert_allclose(found.sd, np.sqrt(drawn.var(axis=0).sum(axis=-1)), rtol=0.05)
    width = np.quantile(drawn, 0.95, axis=0) - np.quantile(drawn, 0.05, axis=0)
    np.testing.assert_allclose(found.high - found.low, width, rtol=0.08)


# --- audit -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "unseen"),
    [
        *((n, {"x_P[1]", "y_P[1]", "beta[1]", "xi_B[1]", "eta_B[1]", "eta_B[2]"}) for n in ("s4", "s8", "s12")),
        ("s8_external", {"xi_B[1]", "eta_B[1]"}),
    ],
)
def test_only_the_frames_are_never_seen(shipped, name, unseen):
    variant = shipped.variants[name]
    audit = audit_variant(shipped, variant)
    assert audit.structure.is_clear
    assert len(audit.seen) - audit.structure.rank == len(unseen)
    assert set(audit.unseen) == unseen
    assert not set(audit.unseen) & set(audit.names)
    assert set(audit.unseen) | set(audit.names) == set(audit.seen)


def test_predicted_sd_is_that_of_the_posterior(some, fits):
    for name, fit in fits.items():
        variant = some.variants[name]
        audit = audit_variant(some, variant)
        predicted = variant.free.scale * np.sqrt(np.diagonal(audit.information.covariance))
        assert audit.names == fit.names
        np.testing.assert_allclose(fit.sd, predicted, rtol=0.1)


def test_four_sensors_leave_a_ridge_and_eight_none(shipped):
    four, eight = (audit_variant(shipped, shipped.variants[name]) for name in ("s4", "s8"))
    assert len(four.ridges) == 1
    assert four.ridges[0].sentence.startswith("Changing x_P[")
    assert "changes no reading by more than" in four.ridges[0].sentence
    assert {four.names[k].partition("[")[0] for k in four.selection.fixed} == {"x_P"}
    assert set(eight.verdicts) == {"identifiable"}
    assert (eight.ridges, eight.selection.fixed) == ((), ())


def test_a_ridge_is_what_readings_do_not_see(shipped):
    """The move that the sentence tells of, in rows of the noise: less than one of a sensor's standard deviations."""
    variant = shipped.variants["s4"]
    ridge = audit_variant(shipped, variant).ridges[0]
    pose = variant.pose[~shipped.table.verification]
    rows = compute_rows(variant.sensors, variant.free.centre, pose)[..., variant.free.places] * variant.free.scale
    along = np.linalg.norm(rows @ ridge.direction.vector)
    across = np.linalg.norm(rows @ np.roll(ridge.direction.vector, 1))
    assert along < 1.0
    assert across > 100.0


def test_calibrability_is_the_condition_of_the_free_parameters(shipped):
    """Of one length for all legs too: J's columns of l summed."""
    for name in ("s8", "s8_one_length"):
        variant = shipped.variants[name]
        pose = variant.pose[~shipped.table.verification]
        found = compute_calibrability(variant.sensors, variant.free, pose, variant.together)
        rows = compute_rows(variant.sensors, variant.free.centre, pose)
        posterior = shipped.posterior(variant)
        moves = posterior.around(np.zeros(posterior.n_parameters))[1].T
        values = np.linalg.svd((rows @ moves.T).reshape(-1, len(moves)), compute_uv=False)
        assert found.scaled == pytest.approx((values[0] / values[-1]) ** 2, rel=1e-6)


# --- evidence, words -------------------------------------------------------------------------------------------------


def test_evidence_ranks_only_models_of_the_same_readings(shipped):
    names = list(shipped.variants)
    table = pd.DataFrame({"variant": names, "log_evidence": np.arange(len(names), dtype=float)})
    assert rank_models(shipped, table) == [["s8_platform_nominal", "s8_guides_nominal", "s8_one_length", "s8"]]


def test_a_wrong_model_is_told_apart(tmp_path):
    path = write_small(
        tmp_path, describe_variant("all", ["s", "phi"]), describe_variant("wrong", ["s", "phi"], 'fixed = ["beta"]')
    )
    inputs = load_small(path)
    good, wrong = list_rows(tabulate(inputs, compute_variants(inputs, Run()))["variants"])
    assert explains(good)
    assert not explains(wrong)
    assert good["log_evidence"] - wrong["log_evidence"] > 100.0
    assert good["elpd"] > wrong["elpd"]
    assert wrong["tool_calibrated_error_um"] > 5 * good["tool_calibrated_error_um"]


def test_names_are_written_as_in_the_paper():
    text = "Changing xi_B[3] and x_P[2] with phi0[2], psi0[4], l[1], beta[2] and eta_V"
    assert write_names(text) == "Changing ξ_B3 and x_P2 with φ_20, ψ_40, l_1, β_2 and η_V"


# --- reference results -----------------------------------------------------------------------------------------------


def test_reference_results_are_those_of_the_committed_config():
    kind, config = load(EXPERIMENT / "study.toml")
    current = hash_identity(identify(config, EXPERIMENT, kind.files(config, EXPERIMENT)))
    for file in ("provenance.json", "summary.json"):
        assert json.loads((RESULTS / file).read_text())["config_sha256"] == current


def test_reference_results_hold_what_is_claimed():
    summary = json.loads((RESULTS / "summary.json").read_text())
    variants = summary["variants"]
    assert summary["converged"]
    for one in variants.values():
        assert abs(one["log_evidence_importance"] - one["log_evidence_bridge"]) < 0.1
        assert one["rhat_max"] < 1.01
        assert one["ess_bulk_min"] > 1000
    # the order of magnitude that is published: 3e8, 3e4, 4e4
    for name, published in (("s4", 3e8), ("s8", 3e4), ("s12", 4e4)):
        assert 0.5 < variants[name]["calibrability"] / published < 2.0
    assert [variants[name]["n_parameters"] for name in ("s4", "s8", "s12", "s8_external")] == [18, 22, 26, 28]
    assert variants["s4"]["tool_after_um"] > 10 * variants["s8"]["tool_after_um"]
    assert variants["s8"]["tool_after_um"] < 2 * variants["s12"]["tool_after_um"]


def test_one_outcome_is_computed_again(shipped):
    """What is cheap of the committed numbers: calibrability, and the audit."""
    summary = json.loads((RESULTS / "summary.json").read_text())
    for name in ("s4", "s8", "s12", "s8_external"):
        variant = shipped.variants[name]
        pose = variant.pose[~shipped.table.verification]
        found = compute_calibrability(variant.sensors, variant.free, pose, variant.together)
        assert summary["variants"][name]["calibrability"] == pytest.approx(found.metres_radians, rel=1e-4)
        audit = audit_variant(shipped, variant)
        assert summary["audits"][name]["recommended"] == [audit.names[k] for k in audit.selection.free]
        assert summary["audits"][name]["rank"] == audit.structure.rank


def test_kind_is_registered():
    assert type(find_kind("self_calibration", EXPERIMENT / "study.toml", None)) is SelfCalibration
