"""Checks of calibrations of any machine: clean ones pass, planted faults are named, the command writes a page."""

from __future__ import annotations

import json
from dataclasses import replace

import calibrations
import numpy as np
import pytest

from bayescal.density.priors import NormalPrior
from bayescal.experiments.check.faults import check_derivatives, check_noise, check_priors, look_at_data, state_slips
from bayescal.experiments.check.inputs import Subject, draw_posterior, read_check
from bayescal.experiments.check.kind import configure_check
from bayescal.experiments.check.ranks import rank_truth
from bayescal.experiments.shared.reading_slips import audit_slips

FUNCTION = """
[errors.motors]
channels = ["s"]
kernel = "quadratic"
scale_um = 20.0
per = "channel"

"""


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    path = calibrations.write_delta(tmp_path_factory.mktemp("check"))
    return read_check(configure_check(path, ["all"], None, None), path.parent).subjects["all"]


def with_data(subject, **changes):
    """Return the variant with other data of the same poses."""
    likelihood = subject.measured.posterior.likelihood
    data = replace(likelihood.data, **changes)
    posterior = replace(subject.measured.posterior, likelihood=replace(likelihood, data=data))
    return Subject(replace(subject.measured, posterior=posterior))


def test_a_clean_calibration_passes(subject):
    findings, draws, y = look_at_data((subject, 500, 1))
    assert [one.fault for one in findings if one.fault] == []
    assert [one.check for one in findings] == ["Derivatives", "Units and order", "Modes", "Noise", "Tolerances"]
    assert draws.shape == y.shape == (1000, 14)
    np.testing.assert_allclose(subject.posterior.natural(y), draws, rtol=1e-12)


def test_which_slips_would_pass_unnoticed_is_said(subject):
    text = state_slips(*audit_slips(subject.measured)).text
    assert "of 125 planted slips 1 would pass unnoticed within the tolerances: readings of s, cam_x" in text


def test_a_slip_is_named_and_nothing_else_said(subject):
    values = subject.measured.posterior.likelihood.data.values.copy()
    values[:, 4] *= -1.0
    findings, draws, _ = look_at_data((with_data(subject, values=values), 500, 1))
    assert findings[-1].fault == "unit"
    assert "readings of cam_y seem to be of the other sign" in findings[-1].text
    assert not len(draws)


@pytest.mark.parametrize(("factor", "fault", "said"), [(0.4, "noise", "times the stated noise"), (1.0, "", "as noise")])
def test_noise_stated_too_small_is_named(subject, factor, fault, said):
    sd = factor * subject.measured.posterior.likelihood.data.sd
    quiet = with_data(subject, sd=sd)
    finding = check_noise(quiet.measured)
    assert finding.fault == fault
    assert said in finding.text


def test_a_wrong_derivative_is_named(subject, monkeypatch):
    model = subject.posterior.likelihood.model
    right = type(model).linearise

    def wrong(self, theta, pose, with_parameters=True, given=None):
        found = right(self, theta, pose, with_parameters, given or {})
        if with_parameters:
            found.by_parameters[..., self.layout.index["l"]] *= 1.01
        return found

    monkeypatch.setattr(type(model), "linearise", wrong)
    finding = check_derivatives(subject, np.random.default_rng(0))
    assert finding.fault == "derivative"
    assert "derivatives by l are wrong: off by up to 1" in finding.text


def test_tolerances_that_are_too_tight_are_named(subject):
    posterior = subject.measured.posterior
    tight = {name: NormalPrior(one.mean, one.sd / 4.0) for name, one in posterior.priors.items()}
    found = Subject(replace(subject.measured, posterior=replace(posterior, priors=tight)))
    draws, _, _, _ = draw_posterior(found.posterior, 500, np.random.SeedSequence(2))
    assert check_priors(found.posterior, draws).fault == "prior"


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


@pytest.mark.runs
def test_the_command_checks_a_calibration(tmp_path, call, no_pictures):
    path = calibrations.write_delta(tmp_path)
    call("check", path, "--variant", "one_rod", "--data-sets", 4, "--out", tmp_path / "out", "--workers", 1)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert list(summary["variants"]) == ["one_rod"]
    assert summary["data_origin"] == "Simulated, never measured: one machine drawn within its tolerances"
    assert "Units and order" in (tmp_path / "out" / "report.html").read_text()


def test_errors_common_to_all_rows_are_not_checked(tmp_path, call):
    path = calibrations.write_delta(tmp_path)
    calibrations.change(path, "[sampler]", FUNCTION + "[sampler]")
    code, out, complaint = call("check", path, "--variant", "all", "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "variant 'all': found errors common to all rows, expected noise of single rows" in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_unknown_variant_is_one_line(tmp_path, call):
    path = calibrations.write_delta(tmp_path)
    code, out, complaint = call("check", path, "--variant", "rods", "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "variant 'rods': unknown here, expected one of all, one_rod" in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "out").exists()
