"""Every planted fault is named, and clean studies pass: each check by itself, and all of them together."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import calibrations
import checked
import numpy as np
import pytest
import telescope_machines as machines
from checked import with_data

from bayescal.density.posterior import Posterior
from bayescal.experiments.selftest import compute, faults
from bayescal.experiments.selftest.compute import rank_truth
from bayescal.experiments.selftest.faults import (
    _fit_known,
    check_derivatives,
    check_modes,
    check_noise,
    check_priors,
    list_starts,
    look_at_data,
    state_cause,
)
from bayescal.experiments.selftest.inputs import draw_posterior, read_selftest
from bayescal.experiments.selftest.kind import configure_selftest
from bayescal.experiments.shared.slip_search import search_cause
from bayescal.inference.mode import find_modes

CHECKS = ["Derivatives", "Likely cause", "Modes", "Noise", "Tolerances"]


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    path = calibrations.write_delta(tmp_path_factory.mktemp("check"))
    return read_selftest(configure_selftest(path, ["all"], None, None), path.parent).subjects["all"]


def look(subject, seed=1):
    """Return the faults that are named, the gravest first."""
    findings, _, _ = look_at_data((subject, 1000, seed))
    return [one.fault for one in findings if one.fault], {one.check: one for one in findings}


def judge_noise(subject):
    return check_noise(subject.measured)


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=pytest.mark.runs if k < 2 else pytest.mark.slow) for k in (0, 1, *range(100, 120))]
)
def test_clean_studies_pass(seed):
    faults, said = look(checked.make_clean(seed))
    assert faults == [], said
    assert [name for name in said if name != "Undetectable error"] == CHECKS


def test_a_clean_calibration_passes(subject):
    findings, draws, y = look_at_data((subject, 500, 1))
    assert [one.fault for one in findings if one.fault] == []
    assert [one.check for one in findings] == CHECKS
    assert draws.shape == y.shape == (1000, 14)
    np.testing.assert_allclose(subject.posterior.natural(y), draws, rtol=1e-12)


@pytest.mark.runs
def test_the_tiny_study_passes_with_the_noise_of_its_targets():
    faults, _ = look(checked.tiny_subject())
    assert faults == []


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_noise_stated_at_half_is_named(seed):
    found = judge_noise(checked.scale_noise(checked.make_clean(seed), 0.5))
    assert found.fault == "noise"
    assert found.level in ("warning", "bad")


@pytest.mark.parametrize(
    ("per_dof", "dof", "level"), [(0.7, 40, "good"), (0.7, 400, "bad"), (1.4, 40, "good"), (4.0, 30, "bad")]
)
def test_how_far_targets_may_scatter_hangs_on_how_many_they_are(per_dof, dof, level):
    described = {"pose_extraction": {"chi2_per_dof": per_dof, "dof": dof}}
    found = check_noise(replace(checked.make_clean(3).measured, described=described))
    assert (found.level, found.fault) == (level, "noise" if level == "bad" else "")
    assert ("target_noise_um" in found.action) == (level == "bad")


@pytest.mark.parametrize(
    ("seed", "factor", "fault", "level"), [(6, 1.3, "", "good"), (3, 1.5, "noise", "bad"), (6, 2.0, "noise", "bad")]
)
def test_noise_stated_too_large_is_said_by_chance(seed, factor, fault, level):
    """Of clean data with 66 degrees of freedom."""
    found = judge_noise(checked.scale_noise(checked.make_clean(seed), factor))
    assert (found.fault, found.level) == (fault, level)
    assert found.value < 0.9  # of the stated noise


def test_the_error_of_a_measured_matrix_is_no_noise_of_single_poses():
    """It moves all poses alike, so that most of it is fitted away; counted pose by pose, little noise seems left."""
    without = checked.drop_known(checked.tiny_subject())
    shared, alone = (_fit_known(one.measured).found for one in (checked.tiny_subject(), without))
    assert 0.5 < shared.value / shared.dof < 1.5
    assert alone.value / alone.dof > 1.2 * shared.value / shared.dof


def test_model_errors_are_no_fault_but_are_said():
    found = judge_noise(checked.make_clean(4, with_model_error=True))
    assert (found.fault, found.level) == ("model error", "warning")


@pytest.mark.parametrize(("symbol", "said"), [("kappa", "by kappa are off"), ("l", "by l are off by up to 1")])
def test_a_wrong_derivative_is_named(symbol, said, subject, monkeypatch):
    """Of legs by κ, of the delta by its rods."""
    judged = checked.make_clean(6) if symbol == "kappa" else subject
    kind = type(judged.measured.posterior.likelihood.model)
    right = kind.linearise

    def wrong(self, theta, pose, with_parameters=True, given=None):
        found = right(self, theta, pose, with_parameters, given or {})
        if with_parameters:
            found.by_parameters[..., self.layout.index[symbol]] *= 1.01
        return found

    monkeypatch.setattr(kind, "linearise", wrong)
    found = check_derivatives(judged, np.random.default_rng(0))
    assert found.fault == "derivative"
    assert said in found.text


@pytest.mark.parametrize("seed", [7, 8])
def test_a_tolerance_three_times_too_tight_is_named(seed):
    subject = checked.make_clean(seed)
    for factor, fault in ((1.0, ""), (3.0, "prior")):
        tight = checked.tighten(subject.posterior, factor, "l[")
        draws, _, _, _ = draw_posterior(tight, 1000, np.random.SeedSequence(seed))
        found = check_priors(tight, draws)
        assert found.fault == fault
    assert " l " in found.text
    assert "kappa" not in found.text


@pytest.fixture(scope="module")
def folded():
    """Return a posterior with one component of u free and κ fixed: every leg's direction has a mirror image."""
    machine, symbols = machines.build_machine("none"), ("a_x", "a_y", "b_x", "b_y", "l", "u_x")
    layout, actuators = machine.layout, machines.table_3_actuators()[:10]
    exact = machines.place_poses(machine, layout.nominal, actuators, np.zeros((10, 6)))
    slope = machines.build_posterior("none", exact, symbols=symbols).sampling.coordinates.legs[:, 0]
    theta = layout.nominal.copy()
    theta[layout.index["u_x"]] = np.sin(np.arctan(slope)) + 0.03 * np.array([1, -1, 1, -1, 1, -1])
    poses = machines.simulate_poses(machine, theta, actuators, np.zeros(6), np.random.default_rng(5))
    return machines.build_posterior("none", poses, symbols=symbols)


@pytest.mark.runs
def test_a_missed_mode_is_named(folded, monkeypatch):
    """A search that tries no mirror images finds but one of them."""
    monkeypatch.setattr(faults, "PAIRS", 2)
    monkeypatch.setattr(faults, "DRAWN_STARTS", 1)
    every = find_modes(folded)
    starts = list_starts(folded, every[0].y, np.random.default_rng(0))
    assert check_modes(folded, every, starts).fault == ""
    with monkeypatch.context() as patched:
        patched.setattr(Posterior, "mode_candidates", lambda self, y: [])
        alone = find_modes(folded)
    assert len(alone) < len(every)
    starts = list_starts(folded, alone[0].y, np.random.default_rng(0))
    assert check_modes(folded, alone, starts).fault == "mode"


def test_mirrored_starts_are_tried_alone_and_in_pairs(folded):
    starts = list_starts(folded, folded.least_squares_start(), np.random.default_rng(0))
    assert len(starts) > 10
    assert np.isfinite(folded.log_density(np.stack(starts))).mean() > 0.5


# --- a machine of functions ----------------------------------------------------------------------------------------


def test_which_slips_would_pass_unnoticed_is_said(subject):
    search = search_cause(subject.measured.readings)
    assert len(state_cause(search)) == 1 + len(search.unnoticed)
    _, unnoticed = state_cause(replace(search, unnoticed=["readings of s seem to be in inches"]))
    assert "readings of s" in unnoticed.text


def test_a_slip_is_named_and_nothing_else_said(subject):
    values = subject.measured.posterior.likelihood.data.values.copy()
    values[:, 4] *= -1.0
    findings, draws, _ = look_at_data((with_data(subject, values=values), 500, 1))
    assert findings[-1].fault == "unit"
    assert "cam_y" in findings[-1].text
    assert not len(draws)


@pytest.mark.parametrize(("factor", "fault", "level"), [(0.4, "noise", "bad"), (1.0, "", "good")])
def test_noise_stated_too_small_is_named(subject, factor, fault, level):
    finding = judge_noise(checked.scale_noise(subject, factor))
    assert (finding.fault, finding.level) == (fault, level)
    assert finding.value == pytest.approx(1.0 / factor, rel=0.25)


def test_tolerances_that_are_too_tight_are_named(subject):
    tight = checked.tighten(subject.posterior, 4.0)
    draws, _, _, _ = draw_posterior(tight, 500, np.random.SeedSequence(2))
    assert check_priors(tight, draws).fault == "prior"


def test_simulated_readings_have_the_plan_of_the_measured_ones(subject):
    values = subject.measured.posterior.likelihood.data.values.copy()
    values[3, 5] = np.nan
    holes = with_data(subject, values=values)
    truth, posterior = holes.draw_case(np.random.default_rng(1))
    assert truth.shape == (14,)
    np.testing.assert_array_equal(np.isnan(posterior.likelihood.data.values), np.isnan(values))
    both = holes.repeat(np.zeros(14), np.random.default_rng(2))
    assert both.likelihood.data.values.shape == (50, 6)
    np.testing.assert_array_equal(both.likelihood.data.values[:25], values)
    assert len(set(both.likelihood.data.poses)) == 50


@pytest.mark.slow
def test_ranks_of_truths_are_uniform(subject):
    """The mean rank of 14 parameters in 60 data sets, with its own standard error."""
    shared = (subject, np.empty((0, 14)), np.empty((0, 14)), 2000, 5)
    rank = np.array([rank_truth(shared, f"prior {k}")["rank"] for k in range(60)])
    assert rank.mean() == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * rank.size))
    held = np.mean((rank > 0.05) & (rank < 0.95))
    assert held == pytest.approx(0.9, abs=4.0 * np.sqrt(0.09 / rank.size))


def test_a_truth_of_zero_has_any_rank_among_draws_of_zero(monkeypatch):
    """As sizes of errors have that are there with some probability."""
    found, machine = np.repeat([0.0, 1.0], [300, 700])[:, None], np.zeros((1, 1))
    monkeypatch.setattr(compute, "draw_posterior", lambda *_: (found, found, None, np.zeros(2)))
    subject = SimpleNamespace(repeat=lambda *_: None)
    rank = np.array([rank_truth((subject, machine, machine, 0, k), "posterior 0")["rank"][0] for k in range(400)])
    assert 0.0 < rank.min() < 0.01
    assert rank.mean() == pytest.approx(0.15, abs=0.02)
    assert 0.29 < rank.max() < 0.301


@pytest.mark.runs
def test_the_command_checks_a_calibration(tmp_path, call, no_pictures):
    path = calibrations.write_delta(tmp_path)
    call("selftest", path, "--variant", "one_rod", "--data-sets", 4, "--out", tmp_path / "out", "--workers", 1)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert list(summary["variants"]) == ["one_rod"]
    assert summary["data_origin"].startswith("Simulated")
    assert "Likely cause" in (tmp_path / "out" / "report.html").read_text()
