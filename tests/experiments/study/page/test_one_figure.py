"""The same quantity is the same figure wherever a page says it: of committed studies of legs and of another machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayescal.experiments.runner.results import read_results
from bayescal.experiments.shared.knowledge_page import show_next, state_next
from bayescal.experiments.study.page.build import build_page
from bayescal.experiments.study.page.ranking import tabulate_ranking
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.tables import compute_contraction
from bayescal.report.blocks import Table, unfold

RESULTS = Path(__file__).parents[4] / "results"


@pytest.mark.parametrize("name", ["telescope", "hangprinter"])
def test_a_contraction_is_that_of_the_standard_deviations_beside_it(name):
    rows = StudyResults.of(read_results(RESULTS / name)).table("parameters")
    expected = compute_contraction(rows["sd"].to_numpy(), rows["prior_sd"].to_numpy())
    np.testing.assert_allclose(rows["contraction"], expected, atol=1e-7)


def test_the_best_pose_promises_the_same_in_the_verdict_and_in_the_table():
    tables, said = read_results(RESULTS / "hangprinter").tables, 0
    for variant in tables["next"]["variant"].unique():
        (section,) = show_next(tables, variant)
        (table,) = (one for one in unfold(section.blocks) if isinstance(one, Table))
        for statement in state_next(tables, variant):
            first = next(row for row in table.rows if f"({row[0].text} sensors)" in statement.text)
            assert first[-1].text == f"{statement.value:.1f} %"
            said += 1
    assert said > 0


def test_nothing_is_promised_of_poses_whose_gain_is_not_known():
    """Of a tool that no pose tells more of, for instance: neither a fault nor a promise."""
    tables = dict(read_results(RESULTS / "hangprinter").tables)
    variant = tables["next"]["variant"].iloc[0]
    tables["next"] = tables["next"].assign(variance_reduction=float("nan"))
    assert show_next(tables, variant) == []
    assert state_next(tables, variant) == []


def test_the_distance_from_nominal_is_one_figure():
    results = read_results(RESULTS / "telescope")
    study, fit = StudyResults.of(results), results.summary["variants"]
    table = tabulate_ranking(study)
    column = next(k for k, one in enumerate(table.columns) if one.unit == "tolerances")
    shown = {cell.text: row[column].text for row in table.rows for cell in row[:2]}
    assert f"{fit[study.best_name]['distance_from_nominal_prior_sd']:.2g}" in shown[study.label(study.best_name)]
    said = [one.value for one in build_page(results).verdict if one.lead == "Tolerances" and one.level == "bad"]
    assert [f"{one:.2g}" for one in said] == [shown[study.label(study.best_name)]] * len(said)
