"""Twelve variants: what is tied, what is told apart, and what deformation and model are worth, each by itself."""

from __future__ import annotations

import json

import pytest
from made_up_results import TWELVE, edit_table, read_study

from bayescal.experiments.study.page.ranking import tabulate_effects, tabulate_ranking
from bayescal.experiments.study.page.soundness import title_failures
from bayescal.experiments.study.page.verdict import describe_lead, state_headline, state_verdict


def find_statement(results, lead: str, words: str = "") -> str:
    """Return the one statement of the verdict with that lead and words."""
    (text,) = (s.text for s in state_verdict(results) if s.lead == lead and words in s.text)
    return text


def raise_evidence(name: str, value: float):
    """Return a change of the summary that sets one variant's log-evidence and ranks anew."""

    def change(summary):
        fit = summary["variants"][name]
        fit["log_evidence"] = value
        fit["log_evidence_importance"] = fit["log_evidence_bridge"] = value
        summary["rankings"][0].sort(key=lambda n: -summary["variants"][n]["log_evidence"])

    return change


def test_a_tie_is_said_to_be_one(make_results):
    results = read_study(make_results(variants=TWELVE))
    assert describe_lead(results) == (
        "6-PUS, beam and stiffness with the matrix deformation fit the measurements best and equally well: "
        "0.40 nat of log-evidence between them; Jacobian/matrix follows 150.0 nat behind."
    )
    assert results.find_leaders() == ["six_pus/matrix", "beam/matrix", "stiffness/matrix"]
    assert results.split(results.chosen)[0] == "six_pus"


def test_the_headline_says_what_to_use_and_how_good_it_is(make_results):
    results = read_study(make_results(variants=TWELVE))
    assert state_headline(results) == (
        "Use 6-PUS with the matrix deformation, the simplest of three that fit equally well; largest error on 2 "
        "held-back poses 9.0 µm, mean 4.0 µm. Accuracy requirements: none stated; to judge them "
        "run an audit of this study."
    )
    told = make_results(lambda s: s.update(measurement_noise_um={"verification": 7.04}), variants=TWELVE, name="told")
    assert "mean 4.0 µm; the measurement's own noise is 7.0 µm rms." in state_headline(read_study(told))

    def simplify(summary):
        summary["variants"]["stiffness/matrix"]["n_parameters"] = 12

    simple = read_study(make_results(simplify, variants=TWELVE, name="simple"))
    assert state_headline(simple).startswith("Use stiffness with the matrix deformation, the simplest of three")
    assert simple.split(simple.chosen)[0] == "stiffness"


def test_nothing_is_advised_where_what_may_be_best_did_not_converge(make_results):
    def fail(summary):
        summary["variants"]["stiffness/matrix"] |= {"converged": False, "problems": "bulk ESS 12, limit 1000"}

    text = state_headline(read_study(make_results(fail, variants=TWELVE)))
    assert text.startswith("Use none yet: stiffness/matrix did not converge and may be better (best so far: 6-PUS with")


def test_a_tie_ends_where_the_evidence_tells_apart(make_results):
    results = read_study(make_results(raise_evidence("beam/matrix", 1503.0), variants=TWELVE))
    assert describe_lead(results).startswith("beam/matrix is preferred, not decisively, by 3.0 nat over stiffness/mat")
    assert results.split(results.chosen)[0] == "beam"


def test_an_uncertain_estimate_is_no_difference(make_results):
    def change(summary):
        raise_evidence("beam/matrix", 1503.0)(summary)
        summary["variants"]["beam/matrix"]["log_evidence_se"] = 2.0

    assert len(read_study(make_results(change, variants=TWELVE)).find_leaders()) == 3


def test_deformation_and_model_are_named_by_themselves(make_results):
    results = read_study(make_results(raise_evidence("jacobian/linear", 1300.0), variants=TWELVE))
    assert find_statement(results, "Deformation") == (
        "With the same model, matrix is ahead of linear by 290.0 nat (6-PUS, beam and stiffness) and 50.0 nat "
        "(Jacobian); of none by 300.0 nat (6-PUS, Jacobian, beam and stiffness)."
    )
    model = find_statement(results, "Model")
    assert "With the matrix deformation, 6-PUS, beam and stiffness fit equally well (0.4 nat)" in model
    assert "Jacobian 149.9 nat below 6-PUS" in model
    assert "with the linear deformation, Jacobian leads, 6-PUS, beam and stiffness 90.0 to 90.4 nat below" in model


def test_pairs_told_apart_are_counted(make_results):
    results = read_study(make_results(variants=TWELVE))
    text = find_statement(results, "Pairs")
    assert text.startswith("Of 66 pairs of variants 57 are distinguishable, by 9.6 nat or more")
    assert text.endswith("the other 9 lie within 0.4 nat.")


def test_effects_are_tabulated_with_letters_of_the_groups(make_results):
    table = tabulate_effects(read_study(make_results(variants=TWELVE)))
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert rows["6-PUS"] == ["−300.1 D", "−290.1 C", "−0.1 A", "+300.0", "+290.0", "–", "–", "–"]
    assert rows["Jacobian"][:3] == ["−450.0 F", "−440.0 E", "−150.0 B"]
    assert rows["Jacobian"][-3:] == ["−149.9", "−149.9", "−149.9"]
    assert tabulate_effects(read_study(make_results(name="one_model"))) is None


def test_names_of_the_files_are_said(make_results):
    notes = [s.text for s in tabulate_ranking(read_study(make_results(variants=TWELVE)), "free").notes]
    assert notes == ["In config and results 6-PUS is six_pus and Jacobian is jacobian: 6-PUS/matrix is six_pus/matrix."]


def test_groups_hold_what_lies_within_a_nat_of_their_best(make_results):
    results = read_study(make_results(raise_evidence("beam/matrix", 1498.95), variants=TWELVE))
    names = ["six_pus/matrix", "beam/matrix", "stiffness/matrix"]
    assert results.group(names) == [["six_pus/matrix", "stiffness/matrix"], ["beam/matrix"]]


def test_the_same_leaders_in_prediction_agree(make_results):
    results = read_study(make_results(variants=TWELVE))
    text = find_statement(results, "Prediction", "LOO")
    assert "agrees: the same 3 lead with 0.4 nat between them, 149.6 ± 6.0 nat ahead of Jacobian/matrix" in text
    assert "no pair that the evidence distinguishes is reversed by more than two standard errors" in text


def test_a_leader_that_predicts_badly_is_not_hidden(make_results):
    def change(summary):
        summary["variants"]["jacobian/none"]["elpd_loo"] = 1700.0
        summary["variants"]["jacobian/matrix"]["elpd"] = 300.0

    results = read_study(make_results(change, variants=TWELVE))
    loo = next(s for s in state_verdict(results) if "LOO" in s.text)
    assert loo.level == "bad"
    assert "disagrees: Jacobian/none first, 150.0 ± 16.0 nat ahead of stiffness/matrix" in loo.text
    held = find_statement(results, "Prediction", "held back")
    assert "hardly separate the best" in held


def test_reversed_pairs_further_down_are_counted(make_results):
    def change(summary):
        # one goes before three linear, three none and Jacobian/linear; the other passes three linear by too little
        summary["variants"]["jacobian/none"]["elpd_loo"] = 1300.0
        summary["variants"]["six_pus/none"]["elpd_loo"] = 1263.0

    results = read_study(make_results(change, variants=TWELVE))
    assert "further down 7 pairs come clearly in the other order" in find_statement(results, "Prediction", "LOO")


def test_who_passes_whom_at_another_tolerance_is_named(make_results):
    folder = make_results(variants=TWELVE)

    def change(table):
        table.loc[(table["variant"] == "jacobian/none") & (table["factor"] == 0.5), "log_evidence"] = 1205.0

    edit_table(folder, "sensitivity", change)
    text = find_statement(read_study(folder), "Stability")
    assert "6-PUS, beam and stiffness with the matrix deformation stay first, never by less than 149.6 nat" in text
    assert "Jacobian/none passes 4 variants at 0.5 ×" in text


def test_of_a_single_tolerance_no_stability_is_claimed(make_results):
    folder = make_results(variants=TWELVE)
    path = folder / "tables" / "sensitivity.csv"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if ",0.5," not in line))
    provenance = json.loads((folder / "provenance.json").read_text())
    provenance.pop("table_rows", None)  # of the table as it was
    (folder / "provenance.json").write_text(json.dumps(provenance))
    assert "Stability" not in {statement.lead for statement in state_verdict(read_study(folder))}


def test_leaders_without_model_error_are_compared_as_a_group(make_results):
    results = read_study(make_results(variants=TWELVE))
    text = find_statement(results, "Model error")
    assert "need the model error τ: without it their log-evidence falls by 30.0 nat" in text
    assert "With τ = 0 everywhere the same 3 lead by 149.6 nat, within 0.4 nat." in text


@pytest.mark.parametrize(
    ("free", "words"), [(True, "Do not rely on these numbers yet"), (False, "all without model error; the ranking")]
)
def test_failures_say_whether_they_reach_the_ranking(make_results, free, words):
    def change(summary):
        fit = summary["variants"]["jacobian/none"]
        (fit if free else fit["without_model_error"])["converged"] = False

    assert words in title_failures(read_study(make_results(change, variants=TWELVE)))


def test_names_of_variants(make_results):
    results = read_study(make_results(variants=TWELVE))
    assert results.label("six_pus/matrix") == "6-PUS/matrix"
    assert results.name_variants(["six_pus/none", "beam/none"]) == "6-PUS and beam without deformation"
    assert results.name_variants(["six_pus/none", "beam/matrix"], "or") == "6-PUS/none or beam/matrix"


def test_a_model_has_the_title_that_the_study_gives_it(make_results):
    results = read_study(make_results(lambda summary: summary["models"].update(beam="beam theory"), variants=TWELVE))
    assert "6-PUS, beam theory and stiffness with the matrix deformation" in describe_lead(results)
