"""What the page says of poses that a posterior has not seen."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from made_up_results import TWELVE, edit_table, read_study, write_results

from bayescal.experiments.study.page.ranking import tabulate_ranking, tabulate_stacking
from bayescal.experiments.study.page.verdict import measure_error, state_prediction


@pytest.fixture
def make_results(tmp_path):
    return partial(write_results, tmp_path, variants=TWELVE)


def test_a_difference_has_the_standard_error_of_its_poses(make_results):
    study = read_study(make_results())
    table = study.table("poses").query("model_error == 'free' and use == 'calibration'")
    pointwise = table.pivot(index="pose", columns="variant", values="elpd_loo")
    difference = pointwise["beam/none"] - pointwise["six_pus/none"]
    expected = np.sqrt(len(difference) * difference.var(ddof=0))
    assert measure_error(study, "beam/none", "six_pus/none", "calibration") == pytest.approx(expected)


def test_a_lead_within_two_standard_errors_hardly_separates(make_results):
    folder = make_results()

    def scatter(table):
        chosen = (table["variant"] == "jacobian/matrix") & (table["use"] == "calibration")
        table.loc[chosen, "elpd_loo"] += np.resize([100.0, -100.0], chosen.sum())

    assert state_prediction(read_study(folder))[0].level == "good"
    edit_table(folder, "poses", scatter)
    loo = state_prediction(read_study(folder))[0]
    assert loo.level == "plain"
    assert "hardly separates the best" in loo.text


def test_the_ranking_shows_differences_with_their_errors(make_results):
    study = read_study(make_results())
    table = tabulate_ranking(study, "free")
    place = [(column.group, column.title) for column in table.columns].index(("elpd LOO", "behind the best"))
    shown = {row[1].text: row[place].text for row in table.rows}
    assert shown["stiffness/matrix"] == "0.0"
    assert shown["Jacobian/matrix"] == "−150.0 ± 4.0"


def test_refitted_poses_are_counted_and_bad_ones_warned_of(make_results):
    def refit(summary):
        summary["variants"]["jacobian/none"]["loo_refitted"] = 3

    def spoil(summary):
        refit(summary)
        summary["variants"]["beam/none"]["loo_unreliable"] = 11

    last = state_prediction(read_study(make_results(refit)))[-1]
    assert last.text.startswith("3 poses were left out by runs of their own")
    last = state_prediction(read_study(make_results(spoil, name="spoilt")))[-1]
    assert last.level == "warning"
    assert "beam/none (11 poses)" in last.text


def test_stacked_variants_stand_with_weights_and_errors(make_results):
    def stack(summary):
        fit = summary["variants"]["beam/matrix"]
        errors = {use: fit[use] for use in ("calibration", "verification")}
        summary["stacked"] = {"weights": {"beam/matrix": 0.25, "six_pus/matrix": 0.75}, **errors}

    assert tabulate_stacking(read_study(make_results())) is None
    table = tabulate_stacking(read_study(make_results(stack, name="stacked")))
    assert [row[0].text for row in table.rows] == ["6-PUS/matrix", "beam/matrix", "all, stacked"]
    assert [row[1].text for row in table.rows] == ["75", "25", "100"]
    assert all(len(row) == len(table.columns) for row in table.rows)
