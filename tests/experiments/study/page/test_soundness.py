"""Verdicts on stated noise, tolerances and bounds: each fault is said first with its cause, and nothing else is."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from made_up_results import TWELVE, edit_table, read_study, render_text, write_results
from scipy import stats

from bayescal.experiments.shared.chi_square import ChiSquare
from bayescal.experiments.study.page.checks import tabulate_power_scaling
from bayescal.experiments.study.page.soundness import has_warnings, judge_bounds, state_soundness
from bayescal.experiments.study.page.verdict import state_verdict

pytestmark = pytest.mark.runs

BEST = "stiffness/matrix"


@pytest.fixture
def make_results(tmp_path):
    return partial(write_results, tmp_path, variants=TWELVE)


def say(folder) -> dict[str, str]:
    """Return what is said of noise, tolerances and bounds by its lead and level."""
    return {f"{s.lead} {s.level}": s.text for s in state_soundness(read_study(folder))}


def set_chi2(name, chi2, dof, setting):
    def change(summary):
        fit = summary["variants"][BEST]
        one = fit if setting == "free" else fit["without_model_error"]
        one |= {f"{name}_chi2": chi2, f"{name}_dof": dof}

    return change


def test_a_slip_of_the_data_is_the_first_thing_said(make_results):
    slip = {"fault": "legs", "text": "legs 2 and 3 seem to be exchanged", "gain": 900.0, "factor": 41.3}
    first = state_verdict(read_study(make_results(change=lambda summary: summary.update(slip=slip))))[0]
    assert (first.lead, first.level) == ("Data", "bad")
    assert "they fit 41 times better if one thing is corrected: legs 2 and 3 seem to be exchanged" in first.text


def test_of_sound_results_nothing_is_said(make_results):
    assert say(make_results()) == {}


def test_residuals_twice_the_noise_are_said_first(make_results):
    results = read_study(make_results(set_chi2("misfit", 800.0, 200.0, "zero")))
    first = state_verdict(results)[0]
    assert (first.lead, first.level) == ("Noise", "bad")
    assert "leaves residuals 2.0 times as large as the stated noise" in first.text
    assert "χ² per degree of freedom 4 without model error" in first.text or "4.00" in first.text
    assert "the noise is stated too small, or every variant lacks something real" in first.text


def test_nothing_is_called_good_without_a_word_beside_it(make_results):
    def checks(folder):
        (found,) = (s for s in state_verdict(read_study(folder)) if s.lead == "Checks")
        return found

    assert checks(make_results()).level == "good"
    doubtful = checks(make_results(set_chi2("misfit", 800.0, 200.0, "zero"), name="doubtful"))
    assert doubtful.level == "plain"
    assert "what speaks against it stands above" in doubtful.text


def test_a_doubtful_page_is_not_marked_as_a_good_one(make_results):
    assert 'class="verdict"' in render_text(make_results())
    for chi2, mark in ((338.0, "doubtful"), (800.0, "failed")):
        text = render_text(make_results(set_chi2("misfit", chi2, 200.0, "zero"), name=mark))
        assert f'class="verdict {mark}"' in text


def test_dimensions_that_nothing_frees_are_named_where_tolerances_do_not_fit(make_results):
    def change(summary):
        set_chi2("pulls", 300.0, 30.0, "free")(summary)
        summary["not_free"] = {BEST: ["a_z", "b_z"]}

    (text,) = say(make_results(change)).values()
    assert text.endswith("Not free in this study: a_z, b_z. Give them tolerances and free them first.")


def test_tolerances_wider_than_needed_are_no_doubt(make_results):
    study = read_study(make_results(set_chi2("pulls", 2.0, 30.0, "free")))
    (statement,) = state_soundness(study)
    assert statement.level == "plain"
    assert "wider than this machine needs" in statement.text
    assert not has_warnings(study)


def test_residuals_of_half_the_noise_are_said(make_results):
    found = say(make_results(set_chi2("misfit", 50.0, 200.0, "zero")))
    assert "the noise is stated too large" in found["Noise bad"]


def test_misfit_of_a_variant_that_is_not_the_best_is_no_fault_of_the_noise(make_results):
    def change(summary):
        summary["variants"]["jacobian/none"]["without_model_error"]["misfit_chi2"] = 1e5

    assert say(make_results(change)) == {}


def test_tolerances_that_the_machine_leaves_are_said_with_the_farthest_parameter(make_results):
    folder = make_results(set_chi2("pulls", 5.29 * 10, 10.0, "free"))

    def change(table):
        mine = (table["variant"] == BEST) & (table["parameter"] == "b_x[2]")
        table.loc[mine, "mean"] = table.loc[mine, "nominal"] - 8.0

    edit_table(folder, "parameters", change)
    found = say(folder)["Tolerances bad"]
    assert "from nominal are 2.3 times the stated tolerances (rms over the 10 directions that the data" in found
    assert "farthest b_x[2] by −4.0" in found
    assert "tolerances are stated too tight" in found


def test_scatter_of_targets_and_rejected_ones_are_said(make_results):
    def change(summary):
        summary["pose_extraction"] |= {"chi2_per_dof": 2.9, "dof": 400.0, "n_targets": 224}
        summary["pose_extraction"]["rejected_targets"] = [f"C01/base/{k}" for k in range(32)]

    statements = [s.text for s in state_soundness(read_study(make_results(change)))]
    assert "1.7 times as much as the stated noise" in statements[0]
    assert "32 of 224 measured targets (14.3 %) were rejected" in statements[1]


def set_pits(table, value):
    """Give errors of the best variant a place in their predictions."""
    chosen = table["variant"] == BEST
    table.loc[chosen, ["position_pit", "orientation_pit"]] = value


def test_all_errors_beyond_their_bounds_are_said(make_results):
    folder = make_results()
    edit_table(folder, "poses", partial(set_pits, value=0.99))
    assert "12 of 12 position and orientation errors" in say(folder)["Bounds bad"]
    assert "where 0.6 are expected" in say(folder)["Bounds bad"]


def test_none_of_a_few_beyond_their_bounds_is_no_fault_but_counted(make_results):
    folder = make_results()
    edit_table(folder, "poses", partial(set_pits, value=0.5))
    assert say(folder) == {}
    coverage = [s.text for s in state_verdict(read_study(folder)) if s.lead == "Coverage"]
    assert any("0 of 12 position and orientation errors" in text for text in coverage)


def test_none_of_46_poses_beyond_both_bounds_is_rare():
    assert judge_bounds(0, 92) == pytest.approx(0.95**92)
    assert judge_bounds(0, 92) < 0.01 < judge_bounds(0, 46)
    assert judge_bounds(14, 92) == pytest.approx(stats.binom.sf(13, 92, 0.05))
    assert judge_bounds(0, 0) == 1.0


@pytest.mark.parametrize("dof", [5, 72, 200])
def test_chi_squares_raise_false_alarms_as_rarely_as_they_claim(dof):
    values = stats.chi2.rvs(dof, size=20_000, random_state=1)
    alarms = np.mean([ChiSquare(float(value), dof).is_off for value in values])
    assert alarms < 2e-3
    assert ChiSquare(float(stats.chi2.ppf(1e-5, dof)), dof).is_off
    assert ChiSquare(float(stats.chi2.isf(1e-5, dof)), dof).is_off


def test_power_scaling_says_what_decides(make_results):
    results = read_study(make_results())
    free = results.table("parameters", results.best_name).query("model_error == 'free'")
    table = tabulate_power_scaling(free)
    said = {row[0].text: (row[3].text, row[3].level) for row in table.rows}
    assert said["a_x"] == ("the prior decides", "plain")
    assert said["b_x"] == ("prior and measurements pull apart in leg 2", "warning")
    assert said["l"] == ("the measurements decide", "plain")
