"""What the page says must follow the numbers."""

from __future__ import annotations

import math

import pytest
from made_up_results import edit_table, read_page, read_study

from bayescal.experiments.study.page.evidence import tabulate_evidence
from bayescal.experiments.study.page.machine import tabulate_deformation
from bayescal.experiments.study.page.parameters import compare_published
from bayescal.experiments.study.page.ridges import choose_leg, rank_pairs, state_ridges
from bayescal.report.blocks import Table


def state(folder) -> str:
    """Return headline, failures and verdict as one text."""
    page = read_page(folder)
    statements = (*page.failures, *page.verdict)
    return "\n".join([page.headline, *(s.text for s in statements)])


def test_a_clear_winner_is_named_with_its_lead_and_its_odds(make_results):
    page = read_page(make_results())
    assert page.headline.startswith("Use pus with the linear deformation; largest error on 2 held-back poses 9.0 µm")
    assert not page.failures
    text = "\n".join(s.text for s in page.verdict)
    assert "pus/linear explains the measurements best, by 20.0 nat over pus/none" in text
    assert "10⁸ to 1" in text
    assert "4.0 µm mean and 9.0 µm largest position error" in text
    assert "0.0010° mean and 0.0020° largest orientation error" in text
    assert "Leave-one-out cross-validation (elpd LOO) agrees: pus/linear first, 20.0 ± 2.0 nat ahead" in text
    assert "(elpd, all together) agree: pus/linear first, 4.0 ± 1.4 nat" in text
    assert "All 4 posteriors converged" in text
    assert "ranking is stable" in text
    assert "needs the model error τ" in text


@pytest.mark.parametrize(
    ("lead", "words"),
    [(0.5, "fit equally well"), (3.0, "preferred, not decisively"), (8.0, "explains the measurements best")],
)
def test_verdict_claims_no_more_than_the_lead_bears_out(make_results, lead, words):
    def change(summary):
        summary["variants"]["pus/none"]["log_evidence"] = 120.0 - lead

    evidence = [s.text for s in read_page(make_results(change)).verdict if s.lead == "Evidence"]
    assert words in evidence[0]


def test_problems_of_either_setting_stand_before_the_headline(make_results):
    def change(summary):
        fit = summary["variants"]["pus/none"]["without_model_error"]
        fit["converged"], fit["problems"] = False, "R-hat 1.050, limit 1.01"

    page = read_page(make_results(change))
    assert [s.text for s in page.failures] == ["pus/none, without model error (τ = 0): R-hat 1.050, limit 1.01"]
    assert all(s.level == "bad" for s in page.failures)
    assert any(s.level == "bad" and "1 of 4 posteriors" in s.text for s in page.verdict)
    assert not any("All 4 posteriors converged" in s.text for s in page.verdict)


def test_disagreeing_evidences_show_even_without_a_listed_problem(make_results):
    def change(summary):
        fit = summary["variants"]["pus/linear"]
        fit["log_evidence_bridge"] = 121.5

    text = state(make_results(change))
    assert "pus/linear, with model error: the two log-evidences differ by 1.50 nat" in text
    assert "Both evidence estimators agree" not in text


def test_predictive_densities_that_disagree_are_said_so(make_results):
    def change(summary):
        summary["variants"]["pus/none"]["elpd_loo"] = 300.0
        summary["variants"]["pus/none"]["elpd"] = 90.0

    text = state(make_results(change))
    assert "(elpd LOO) disagrees: pus/none first, 130.0 ± 2.0 nat ahead of pus/linear" in text
    assert "(elpd, all together) disagree: pus/none first, 66.0 ± 1.4 nat ahead of pus/linear" in text


def test_unstable_ranking_names_where_another_variant_leads(make_results):
    folder = make_results()

    def change(table):
        table.loc[(table["variant"] == "pus/none") & (table["factor"] == 0.5), "log_evidence"] = 200.0

    edit_table(folder, "sensitivity", change)
    text = state(folder)
    assert "ranking is not stable over priors 0.5 to 2 times as wide as the study's" in text
    assert "pus/none at 0.5 ×" in text
    assert "ranking is stable" not in text


@pytest.mark.parametrize(("variant", "said"), [("pus/linear", True), ("pus/none", False)])
def test_doubtful_evidences_are_said_of_variants_that_may_be_the_best(make_results, variant, said):
    folder = make_results()

    def change(table):
        table.loc[table["variant"] == "pus/none", "log_evidence"] -= 1000.0
        table.loc[(table["variant"] == variant) & (table["factor"] == 0.5), "pareto_k"] = 0.9

    edit_table(folder, "sensitivity", change)
    assert ("evidences near the best is unreliable" in state(folder)) is said


def test_coverage_names_variants_whose_intervals_are_too_narrow(make_results):
    text = state(make_results())
    narrow = next(line for line in text.splitlines() if line.startswith("Without model error"))
    assert "too narrow" in narrow
    assert "pus/none (40 %, verification 40 %)" in narrow
    wide = next(line for line in text.splitlines() if line.startswith("With model error"))
    assert "too narrow" not in wide


def test_another_leader_without_model_error_is_a_warning(make_results):
    def change(summary):
        summary["variants"]["pus/none"]["without_model_error"]["log_evidence"] = 119.0

    page = read_page(make_results(change))
    assert any(s.level == "warning" and "pus/none leads by 29.0 nat" in s.text for s in page.verdict)


def test_missing_verification_is_said_and_leaves_no_column(make_results):
    page = read_page(make_results(verification=False))
    assert any("used in the fit; none were held back" in s.text for s in page.verdict)
    assert not any("held back for verification" in s.text for s in page.verdict)
    ranking = next(block for block in page.sections[0].blocks if isinstance(block, Table))
    titles = {(c.group, c.title) for c in ranking.columns}
    assert ("Position error, mean / max", "verification") not in titles


def test_difference_from_published_is_the_rms_over_lengths_alone(make_results):
    results = read_study(make_results())
    found = compare_published(results, "pus/linear")
    assert found.rms_mm == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert found.n_lengths == 10
    # published 0.7 and 1.6 mm at posterior offsets of 1 and 2 ± 0.16 mm: none inside
    assert (found.n_inside, found.n_known) == (0, 12)
    assert compare_published(results, "pus/none") is None


def test_published_values_inside_the_intervals_are_counted(make_results):
    folder = make_results()

    def change(table):
        chosen = (table["variant"] == "pus/linear") & (table["parameter"] == "a_x") & (table["leg"] == 2)
        table.loc[chosen, "published_offset"] = 2.1

    edit_table(folder, "least_squares", change)
    assert compare_published(read_study(folder), "pus/linear").n_inside == 1


def test_ridges_name_the_correlated_pair_and_its_leg(make_results):
    results = read_study(make_results())
    pairs = rank_pairs(results.draws["pus/linear"])
    assert set(pairs[0][:2]) == {"a_x[2]", "b_x[2]"}
    assert pairs[0][2] > 0.98
    assert choose_leg(pairs)[0] == 2
    text = state_ridges(results)[0].text
    assert "a_x of leg 2 with b_x of leg 2 (+0.99)" in text or "a_x of leg 2 with b_x of leg 2 (+1.00)" in text


def test_deflections_left_by_both_descriptions_are_stated(make_results):
    _, (statement, _) = tabulate_deformation(read_study(make_results()))
    text = statement.text
    # made of K plus 0.5 µm: that is what K leaves; κ leaves |−4 ρ2 + 0.5| and |2 ρ1 + 0.5| besides
    assert "residuals of the matrix description: 0.50 µm mean and 0.50 µm at most" in text
    assert "residuals of the linear description: 2.5 µm mean and 4.5 µm at most" in text


def test_missing_ring_targets_leave_the_section_empty(make_results):
    (section,) = (one for one in read_page(make_results(ring=False)).sections if one.anchor == "deformation")
    (figure,) = section.blocks
    assert figure.draw is None


def test_worth_of_the_exact_density_stands_beside_the_estimators(make_results):
    def change(summary):
        exact = {"shift": -1.06, "se": 0.02, "efficiency": 0.31, "pareto_k": 0.2}
        summary["variants"]["pus/linear"] |= {f"exact_density_{key}": value for key, value in exact.items()}

    corrected = tabulate_evidence(read_study(make_results(change)))
    assert "exact" in corrected.caption
    rows = [[cell.text for cell in row] for row in corrected.rows]
    assert rows[0][7:9] == ["−1.06 ± 0.02", "31"]
    assert corrected.rows[0][8].level == "bad"  # too few draws count
    assert rows[1][7:9] == ["–", "–"]


def test_without_the_exact_density_nothing_is_said_of_it(make_results):
    assert "exact" not in tabulate_evidence(read_study(make_results())).caption
