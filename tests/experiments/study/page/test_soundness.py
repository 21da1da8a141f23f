"""Verdicts on stated noise, tolerances and bounds: each fault is said first with its cause, and nothing else is."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from made_up_results import TWELVE, hide_poses, read_study, render_text, set_fit, set_rows
from scipy import stats

from bayescal.experiments.shared.soundness import ChiSquare
from bayescal.experiments.study.page.evidence import tabulate_power_scaling
from bayescal.experiments.study.page.soundness import has_warnings, judge_bounds, state_soundness
from bayescal.experiments.study.page.verdict import state_verdict

pytestmark = pytest.mark.runs

BEST = "stiffness/matrix"
MISFIT = set_fit(BEST, misfit_chi2=800.0, misfit_dof=200.0)
MISSTATED = {"fault": "tolerance", "text": "all b_x: too tight", "factor": 10.0, "gain": 12.0}
LARGE = {"fault": "large errors", "text": "readings need 0.2 mm (so limited less probable); odds of 31 to 1: a gear"}
LARGE |= {"factor": 10.0, "gain": 300.0}
SLIP = {"fault": "legs", "text": "legs 2 and 3 seem to be exchanged", "gain": 900.0, "factor": 41.3}


def err_by(share, use="verification"):
    """Return a change of the errors of the best variant's poses, as a share of their bounds."""
    errors = {"position_error_mm": share * 0.0065, "orientation_error_deg": share * 0.002}
    return {"pose_errors": set_rows({"variant": BEST, "use": use}, **errors)}


def spoil_targets(summary):
    summary["pose_extraction"] |= {"chi2_per_dof": 2.9, "dof": 400.0, "n_targets": 224}
    summary["pose_extraction"]["rejected_targets"] = [f"C01/base/{k}" for k in range(32)]


def move_far(table):
    mine = (table["variant"] == BEST) & (table["parameter"] == "b_x[2]")
    table.loc[mine, "mean"] = table.loc[mine, "nominal"] - 8.0


def hold(summary):
    set_fit(BEST, prior_chi2=300.0, prior_dof=30.0)(summary)
    summary["not_free"] = {BEST: ["a_z", "b_z"]}


def misstate(**changes):
    """Return a change of the summary by which an input is stated wrong."""
    return lambda summary: summary.update(misstated=MISSTATED | changes)


@pytest.mark.parametrize(
    ("change", "edits", "lead", "level", "value"),
    [
        (lambda summary: summary.update(suspected_data_error=SLIP), {}, "Data", "bad", 41.3),
        (MISFIT, {}, "Noise", "bad", 2.0),
        (set_fit(BEST, misfit_chi2=50.0, misfit_dof=200.0), {}, "Noise", "bad", 0.5),
        (spoil_targets, {}, "Noise", "bad", 2.9**0.5),
        (set_fit(BEST, prior_chi2=52.9, prior_dof=10.0), {"parameters": move_far}, "Tolerances", "bad", 2.3),
        (None, {"parameters": move_far}, "Tolerances", "warning", 4.0),
        (hold, {}, "Tolerances", "bad", 10.0**0.5),
        (misstate(fault="wide tolerance", factor=0.1), {}, "Tolerances", "plain", 0.1),
        (misstate(), {}, "Tolerances", "bad", 10.0),
        (misstate(fault="tolerance or model error"), {}, "Tolerances", "warning", 10.0),
        (misstate(fault="noise"), {}, "Noise", "bad", 10.0),
        (lambda summary: summary.update(misstated=LARGE), {}, "Size of errors", "warning", 10.0),
        (None, err_by(1.1), "Bounds", "bad", 1.0),
    ],
)
def test_a_fault_is_the_first_finding(make_results, change, edits, lead, level, value):
    study = read_study(make_results(change, edits=edits, variants=TWELVE, draws=False))
    found, *others = state_soundness(study)
    assert state_verdict(study)[0] == found
    assert (found.lead, found.level) == (lead, level)
    assert found.value == pytest.approx(value, rel=1e-3)
    assert has_warnings(study) == (level != "plain")
    assert [one.lead for one in others] == {spoil_targets: ["Noise"], hold: ["Tolerances"]}.get(change, [])


@pytest.mark.parametrize(
    ("change", "edits"),
    [
        (None, {}),
        (set_fit("jacobian/none", misfit_chi2=1e5), {}),  # of a variant that is not the best
        (None, err_by(0.5)),  # none of a few beyond their bounds
        (set_fit(BEST, prior_chi2=2.0, prior_dof=30.0), {}),  # near nominal, as one whose model error hides it is, too
        (None, err_by(1.1, "calibration")),  # judged are those that were held back
    ],
)
def test_of_sound_results_nothing_is_said(make_results, change, edits):
    study = read_study(make_results(change, edits=edits, variants=TWELVE))
    assert state_soundness(study) == []
    assert 0.0 in [one.value for one in state_verdict(study) if one.lead == "Coverage"]


def test_of_poses_that_were_fitted_only_too_many_beyond_their_bounds_are_a_fault(make_results):
    """A posterior that has seen 200 poses lies nearer to them than to new ones: none beyond is no wonder."""

    def repeat(share):
        def change(table):
            many = pd.concat([table] * 50, ignore_index=True)
            return many.assign(position_error_mm=share * 0.0065, orientation_error_deg=float("nan"))

        return {"pose_errors": change}

    few = read_study(make_results(edits=repeat(0.5), variants=TWELVE, verification=False, name="few"))
    assert state_soundness(few) == []
    many = read_study(make_results(edits=repeat(1.1), variants=TWELVE, verification=False, name="many"))
    (found,) = state_soundness(many)
    assert (found.lead, found.value) == ("Bounds", 1.0)


def test_where_no_instrument_saw_the_tool_nothing_is_said_of_bounds(make_results):
    none = {"pose_errors": lambda table: table.iloc[:0]}
    study = read_study(make_results(hide_poses(), edits=none, variants=TWELVE))
    assert state_soundness(study) == []
    assert not any(one.lead == "Coverage" for one in state_verdict(study))


@pytest.mark.parametrize(("chi2", "level"), [(338.0, "warning"), (800.0, "bad")])
def test_the_page_is_as_good_as_its_worst_finding(make_results, chi2, level):
    folder = make_results(set_fit(BEST, misfit_chi2=chi2, misfit_dof=200.0), variants=TWELVE)
    assert f'class="verdict {level}"' in render_text(folder)


def test_none_of_92_poses_beyond_their_bounds_is_rare():
    assert judge_bounds(0, 92, 92) == pytest.approx(0.95**92)
    assert judge_bounds(0, 92, 92) < 0.01 < judge_bounds(0, 46, 46)
    assert judge_bounds(14, 92, 92) == pytest.approx(stats.binom.sf(13, 92, 0.05))
    assert judge_bounds(14, 92, 46) == judge_bounds(7, 46, 46)  # a position and an orientation are one trial
    assert judge_bounds(0, 0, 0) == 1.0


@pytest.mark.parametrize("dof", [5, 72, 200])
def test_chi_squares_raise_false_alarms_as_rarely_as_they_claim(dof):
    values = stats.chi2.rvs(dof, size=20_000, random_state=1)
    alarms = np.mean([ChiSquare(float(value), dof).is_off for value in values])
    assert alarms < 2e-3
    assert ChiSquare(float(stats.chi2.ppf(1e-5, dof)), dof).is_off
    assert ChiSquare(float(stats.chi2.isf(1e-5, dof)), dof).is_off


def test_power_scaling_says_what_decides(make_results):
    study = read_study(make_results(variants=TWELVE))
    table = tabulate_power_scaling(study.table("parameters", study.best_name))
    said = {row[0].text: (row[3].text, row[3].level) for row in table.rows}
    assert said["a_x"] == ("prior-dominated", "plain")
    assert said["b_x"][0].endswith("leg 2")
    assert said["b_x"][1] == "warning"
    assert said["l"] == ("data-dominated", "plain")
