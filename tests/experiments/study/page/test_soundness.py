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
    set_fit(BEST, pulls_chi2=300.0, pulls_dof=30.0)(summary)
    summary["not_free"] = {BEST: ["a_z", "b_z"]}


@pytest.mark.parametrize(
    ("change", "edits", "lead", "level", "words"),
    [
        (
            lambda summary: summary.update(slip=SLIP),
            {},
            "Data",
            "bad",
            "they fit 41 times better if one thing is corrected: legs 2 and 3 seem to be exchanged",
        ),
        (
            MISFIT,
            {},
            "Noise",
            "bad",
            "leaves residuals 2.0 times as large as the stated noise and its model error … χ² per degree of freedom "
            "4.00 … the noise is stated too small, or every variant lacks something real",
        ),
        (set_fit(BEST, misfit_chi2=50.0, misfit_dof=200.0), {}, "Noise", "bad", "the noise is stated too large"),
        (spoil_targets, {}, "Noise", "bad", "1.7 times as much as the stated noise"),
        (
            set_fit(BEST, pulls_chi2=52.9, pulls_dof=10.0),
            {"parameters": move_far},
            "Tolerances",
            "bad",
            "from nominal are 2.3 times the stated tolerances (rms over the 10 directions that the data … "
            "farthest b_x[2] by −4.0 … tolerances are stated too tight",
        ),
        (hold, {}, "Tolerances", "bad", "Not free in this study: a_z, b_z. Give them tolerances and free them first."),
        (
            lambda summary: summary.update(misstated={**MISSTATED, "fault": "wide tolerance", "factor": 0.1}),
            {},
            "Tolerances",
            "plain",
            "12 nats",
        ),
        (lambda summary: summary.update(misstated=MISSTATED), {}, "Tolerances", "bad", "All b_x: too tight … 12 nats"),
        (
            lambda summary: summary.update(misstated={**MISSTATED, "fault": "noise"}),
            {},
            "Noise",
            "bad",
            "12 nats",
        ),
        (lambda summary: summary.update(misstated=LARGE), {}, "Size of errors", "warning", "0.2 mm … odds of 31 to 1"),
        (
            None,
            err_by(1.1),
            "Bounds",
            "bad",
            "4 of 4 position and orientation errors of poses held back … where 0.2 are expected",
        ),
    ],
)
def test_a_fault_is_the_first_thing_said(make_results, change, edits, lead, level, words):
    study = read_study(make_results(change, edits=edits, variants=TWELVE, draws=False))
    found, *others = state_soundness(study)
    assert state_verdict(study)[0] == found
    assert (found.lead, found.level) == (lead, level)
    assert all(one in found.text for one in words.split(" … "))
    assert has_warnings(study) == (level != "plain")
    rejected = "32 of 224 measured targets (14.3 %) were rejected"
    assert [one.text.startswith(rejected) for one in others] == [True] * (change is spoil_targets)


@pytest.mark.parametrize(
    ("change", "edits"),
    [
        (None, {}),
        (set_fit("jacobian/none", misfit_chi2=1e5), {}),  # of a variant that is not the best
        (None, err_by(0.5)),  # none of a few beyond their bounds
        (set_fit(BEST, pulls_chi2=2.0, pulls_dof=30.0), {}),  # near nominal, as one whose model error hides it is, too
        (None, err_by(1.1, "calibration")),  # judged are those that were held back
    ],
)
def test_of_sound_results_nothing_is_said(make_results, change, edits):
    study = read_study(make_results(change, edits=edits, variants=TWELVE))
    assert state_soundness(study) == []
    coverage = [one.text for one in state_verdict(study) if one.lead == "Coverage"]
    assert any("0 of 4 position and orientation errors" in text for text in coverage)


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
    assert "200 of 200 position errors of poses that were fitted lie beyond" in found.text


def test_where_no_instrument_saw_the_tool_nothing_is_said_of_bounds(make_results):
    none = {"pose_errors": lambda table: table.iloc[:0]}
    study = read_study(make_results(hide_poses(), edits=none, variants=TWELVE))
    assert state_soundness(study) == []
    assert not any(one.lead == "Coverage" for one in state_verdict(study))


@pytest.mark.parametrize(
    ("chi2", "level", "mark"),
    [(200.0, "good", "verdict"), (338.0, "plain", "verdict doubtful"), (800.0, "plain", "verdict failed")],
)
def test_nothing_is_called_good_without_a_word_of_warning(make_results, chi2, level, mark):
    folder = make_results(set_fit(BEST, misfit_chi2=chi2, misfit_dof=200.0), variants=TWELVE)
    (checks,) = (one for one in state_verdict(read_study(folder)) if one.lead == "Checks")
    assert checks.level == level
    assert ("what speaks against it is said above" in checks.text) == (level == "plain")
    assert f'class="{mark}"' in render_text(folder)


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
    assert said["a_x"] == ("the prior decides", "plain")
    assert said["b_x"] == ("prior and measurements pull apart in leg 2", "warning")
    assert said["l"] == ("the measurements decide", "plain")
