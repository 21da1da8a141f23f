"""What the page says follows the numbers: headline, failures and sentences, of two variants and of twelve."""

from __future__ import annotations

import io
import json
from typing import Any, NamedTuple

import numpy as np
import pytest
from made_up_results import TWELVE, TWO, read_page, read_study, set_fit, set_rows
from rich.console import Console

from bayescal.experiments.study.page.ranking import show_ranking, tabulate_effects, tabulate_ranking
from bayescal.experiments.study.page.verdict import describe_lead, measure_error, state_headline, state_verdict
from bayescal.experiments.study.terminal import show_ranking as show_on_terminal
from bayescal.report.blocks import Figure, Level, Table

MATRIX = "6-PUS, beam and stiffness with the matrix deformation"


class Case(NamedTuple):
    """What a change of numbers makes one sentence of the verdict say, found by its lead and words, apart by " … "."""

    lead: str
    level: Level
    words: str
    change: Any = None
    edits: dict[str, Any] = {}  # noqa: RUF012 - of a tuple, never changed
    variants: dict[str, tuple[float, float]] = TWO
    verification: bool = True


def raise_evidence(name: str, value: float, **others: float):
    """Return a change of the summary that sets one variant's log-evidence."""
    return set_fit(name, log_evidence=value, log_evidence_importance=value, log_evidence_bridge=value, **others)


def scatter(table):
    """Let elpd of one variant differ from that of the others by far more than on average."""
    chosen = table["variant"] == "jacobian/matrix"
    table.loc[chosen, "elpd_loo"] += np.resize([100.0, -100.0], chosen.sum())


def lower_but(variant):
    """Return a change of the evidences at other widths: one variant far behind, an unreliable one of another."""

    def change(table):
        table.loc[table["variant"] == "pus/none", "log_evidence"] -= 1000.0
        set_rows({"variant": variant, "factor": 0.5}, pareto_k=0.9)(table)

    return change


def narrow(summary, variant):
    """Let the intervals of one variant be too narrow."""
    fit = summary["variants"][variant]
    fit |= {use: fit[use] | {"interval_90_coverage": 0.4} for use in ("calibration", "verification")}


CASES = {
    "lead": Case("Evidence", "plain", "best, by 20.0 nat over pus/none … 10⁸ to 1"),
    **{
        words: Case("Evidence", "plain", words, set_fit("pus/none", log_evidence=120.0 - lead))
        for words, lead in (
            ("fit equally well", 0.5),
            ("preferred, not decisively", 3.0),
            ("explains the measurements best", 8.0),
        )
    },
    "accuracy": Case(
        "Accuracy",
        "plain",
        "4.0 µm mean and 9.0 µm largest position error … 0.0010° mean and 0.0020° largest orientation error",
    ),
    "no verification": Case("Accuracy", "plain", "used in the fit; none were held back", verification=False),
    "LOO agrees": Case(
        "Prediction", "good", "Leave-one-out cross-validation (elpd LOO) agrees: pus/linear first, 20.0 ± 2.0 nat ahead"
    ),
    "LOO disagrees": Case(
        "Prediction",
        "bad",
        "(elpd LOO) disagrees: pus/none first, 130.0 ± 2.0 nat ahead of pus/linear",
        set_fit("pus/none", elpd_loo=300.0),
    ),
    "held-back readings": Case(
        "Prediction",
        "warning",
        "Held-back readings are predicted best by pus/none, which the evidence ranks lower",
        set_fit("pus/none", elpd=90.0),
    ),
    "LOO of a tie": Case(
        "Prediction",
        "good",
        "(elpd LOO) agrees: the same 3 lead with 0.4 nat between them, 149.6 ± 6.0 nat ahead of "
        "Jacobian/matrix … no pair that the evidence distinguishes is reversed by more than two standard errors",
        variants=TWELVE,
    ),
    "LOO of another leader": Case(
        "Prediction",
        "bad",
        "disagrees: Jacobian/none first, 150.0 ± 16.0 nat ahead of stiffness/matrix",
        set_fit("jacobian/none", elpd_loo=1700.0),
        variants=TWELVE,
    ),
    "LOO hardly separates": Case(
        "Prediction", "plain", "(elpd LOO) … hardly separates the best", edits={"poses": scatter}, variants=TWELVE
    ),
    # one goes before three linear, three none and Jacobian/linear; the other passes three linear by too little
    "reversed pairs": Case(
        "Prediction",
        "good",
        "LOO … further down 7 pairs come clearly in the other order",
        (set_fit("jacobian/none", elpd_loo=1300.0), set_fit("six_pus/none", elpd_loo=1263.0)),
        variants=TWELVE,
    ),
    "refitted poses": Case(
        "Prediction",
        "plain",
        "3 poses were left out by runs of their own",
        set_fit("jacobian/none", loo_refitted=3),
        variants=TWELVE,
    ),
    "bad poses": Case(
        "Prediction",
        "warning",
        "beam/none (11 poses)",
        (set_fit("jacobian/none", loo_refitted=3), set_fit("beam/none", loo_unreliable=11)),
        variants=TWELVE,
    ),
    "deformation": Case(
        "Deformation",
        "plain",
        "With the same model, matrix is ahead of linear by 290.0 nat (6-PUS, beam and "
        "stiffness) and 50.0 nat (Jacobian); of none by 300.0 nat (6-PUS, Jacobian, beam and stiffness).",
        raise_evidence("jacobian/linear", 1300.0),
        variants=TWELVE,
    ),
    "model": Case(
        "Model",
        "plain",
        "With the matrix deformation, 6-PUS, beam and stiffness fit equally well (0.4 nat) … "
        "Jacobian 149.9 nat below 6-PUS … "
        "with the linear deformation, Jacobian leads, 6-PUS, beam and stiffness 90.0 to 90.4 nat below",
        raise_evidence("jacobian/linear", 1300.0),
        variants=TWELVE,
    ),
    "pairs": Case(
        "Pairs",
        "plain",
        "Of 66 pairs of variants 57 are distinguishable, by 9.6 nat or more … the other 9 lie within 0.4 nat.",
        variants=TWELVE,
    ),
    "convergence": Case("Checks", "good", "All 2 posteriors converged … Both evidence estimators agree"),
    "no convergence": Case(
        "Checks", "bad", "1 of 2 posteriors", set_fit("pus/none", converged=False, problems="R-hat 1.050, limit 1.01")
    ),
    "disagreeing evidences": Case(
        "Checks", "bad", "1 of 2 posteriors", set_fit("pus/linear", log_evidence_bridge=121.5)
    ),
    "stable": Case("Stability", "good", "ranking is stable"),
    "unstable": Case(
        "Stability",
        "bad",
        "ranking is not stable over priors 0.5 to 2 times as wide as the study's … pus/none at 0.5 ×",
        edits={"sensitivity": set_rows({"variant": "pus/none", "factor": 0.5}, log_evidence=200.0)},
    ),
    "unreliable": Case(
        "Stability", "warning", "evidences near the best is unreliable", edits={"sensitivity": lower_but("pus/linear")}
    ),
    "passed": Case(
        "Stability",
        "good",
        f"{MATRIX} stay first, never by less than 149.6 nat … Jacobian/none passes 4 variants at 0.5 ×",
        edits={"sensitivity": set_rows({"variant": "jacobian/none", "factor": 0.5}, log_evidence=1205.0)},
        variants=TWELVE,
    ),
    "model error": Case("Model error", "plain", "Random errors from pose to pose have τ = 4.0 [3.0, 5.0] µm"),
    "too narrow": Case(
        "Coverage", "warning", "too narrow for pus/none (40 %, verification 40 %)", lambda s: narrow(s, "pus/none")
    ),
    "wide enough": Case("Coverage", "plain", "The 90 % predictive intervals hold 90 %"),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_sentence_follows_the_numbers(case, make_results):
    folder = make_results(
        case.change, edits=case.edits, variants=case.variants, verification=case.verification, draws=False
    )
    said = [one for one in state_verdict(read_study(folder)) if one.lead == case.lead]
    (found,) = (one for one in said if all(words in one.text for words in case.words.split(" … ")))
    assert found.level == case.level
    if case.lead not in ("Prediction", "Coverage") and case.level != "warning":
        assert len(said) == 1


def test_what_is_not_so_is_not_said(make_results):
    edits = {"sensitivity": lower_but("pus/none")}
    verdict = state_verdict(read_study(make_results(edits=edits, verification=False)))
    assert not any("unreliable" in one.text or "held back for verification" in one.text for one in verdict)
    (wide,) = (one.text for one in verdict if one.text.startswith("The 90 % predictive intervals"))
    assert "too narrow" not in wide


def test_of_a_single_width_no_stability_is_claimed(make_results):
    edits = {"sensitivity": lambda table: table[table["factor"] != 0.5]}
    folder = make_results(variants=TWELVE, edits=edits)
    assert "Stability" not in {statement.lead for statement in state_verdict(read_study(folder))}


# --- headline and failures -------------------------------------------------------------------------------------------


def test_the_headline_says_what_to_use_and_how_good_it_is(make_results):
    page = read_page(make_results(name="two"))
    assert page.headline.startswith(
        "Use pus with the linear deformation; tool x 0.013 mm (standard uncertainty, k = 1)"
    )
    assert not page.failures
    assert state_headline(read_study(make_results(variants=TWELVE))) == (
        "Use 6-PUS with the matrix deformation, one of three that fit equally well; tool x 0.013 mm (standard "
        "uncertainty, k = 1), rms over the workspace; largest x 0.021 mm. Accuracy requirements: none stated; state "
        "them in [requirements]."
    )
    noise = make_results(lambda s: s.update(measurement_noise_um={"verification": 7.04}), variants=TWELVE, name="noise")
    said = " ".join(one.text for one in state_verdict(read_study(noise)))
    assert "(held back from the fit); the measurement's own noise is 7.0 µm rms." in said
    simple = make_results(set_fit("stiffness/matrix", n_parameters=12), variants=TWELVE, name="simple")
    assert state_headline(read_study(simple)).startswith("Use stiffness with the matrix deformation, the simplest of t")


def test_nothing_is_advised_where_what_may_be_best_did_not_converge(make_results):
    fail = set_fit("stiffness/matrix", converged=False, problems="bulk ESS 12, limit 1000")
    text = state_headline(read_study(make_results(fail, variants=TWELVE)))
    assert text.startswith("Use none yet: stiffness/matrix did not converge and may be better (best so far: 6-PUS with")


def test_what_did_not_converge_is_compared_nowhere(make_results):
    """The unconverged one is 97 nats better: no sentence, table or figure ranks it or its elpd against others."""
    fail = (
        raise_evidence("pus/none", 217.0, elpd_loo=400.0, elpd=300.0),
        set_fit("pus/none", converged=False, problems="bulk ESS 12, limit 1000"),
    )
    folder = make_results(fail)
    summary = json.loads((folder / "summary.json").read_text())
    summary["rankings"] = [["pus/linear", "pus/none"]]  # as studies rank
    (folder / "summary.json").write_text(json.dumps(summary))
    study = read_study(folder)
    said = {one.text for one in state_verdict(study) if one.lead not in ("Checks", "Coverage")}
    (rival,) = (text for text in said if "pus/none" in text)
    assert rival.startswith("pus/none may be better than pus/linear: its sampling did not converge")
    assert study.find_leaders() == ["pus/linear"]
    assert not any("odds" in text.lower() or "ahead" in text for text in said)
    table = tabulate_ranking(study)
    title = [(column.group, column.title) for column in table.columns]
    shown = {row[1].text: [cell.text for cell in row] for row in table.rows}
    assert shown["pus/none"][0] == "not ranked"
    for group in ("Log-evidence", "elpd LOO"):
        place = title.index((group, "behind the best"))
        assert (shown["pus/linear"][place], shown["pus/none"][place]) == ("0.0", "–")
    figure = next(one for one in show_ranking(study).blocks if isinstance(one, Figure)).draw()
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["0.0", "not converged"]
    console = Console(file=io.StringIO(), record=True, width=200)
    show_on_terminal(study.summary, console)
    printed = console.export_text()
    assert "pus/none may be better than pus/linear" in printed
    assert "97.0" not in printed


def test_of_variants_that_tie_the_one_with_fewest_unknowns_comes_first(make_results):
    study = read_study(make_results(set_fit("beam/matrix", n_parameters=9), variants=TWELVE))
    words = "beam/matrix is named first because it has the fewest unknowns (9 against 14)"
    assert describe_lead(study).endswith(f"{words}.")
    assert describe_lead(study).startswith("beam, 6-PUS and stiffness with the matrix deformation fit")
    table = tabulate_ranking(study)
    assert next(row[1].text for row in table.rows) == "beam/matrix"  # of the lowest evidence of the three
    assert any(words in one.text for one in table.notes)
    assert study.chosen == "beam/matrix"
    console = Console(file=io.StringIO(), record=True, width=200)
    show_on_terminal(study.summary, console)
    assert words in " ".join(console.export_text().split())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (set_fit("pus/none", converged=False, problems="R-hat 1.050, limit 1.01"), "pus/none: R-hat 1.050, limit 1.01"),
        (
            set_fit("pus/linear", log_evidence_bridge=121.5),
            "pus/linear: the two log-evidences differ by 1.50 nat, limit 0.1",
        ),
    ],
)
def test_problems_are_failures(make_results, change, said):
    assert [(one.text, one.level) for one in read_page(make_results(change)).failures] == [(said, "bad")]


# --- groups of variants ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "lead", "leaders"),
    [
        (
            (),
            f"{MATRIX} fit the measurements best and equally well: "
            "0.40 nat of log-evidence between them; Jacobian/matrix follows 150.0 nat behind.",
            ["six_pus/matrix", "beam/matrix", "stiffness/matrix"],
        ),
        (
            raise_evidence("beam/matrix", 1503.0),
            "beam/matrix is preferred, not decisively, by 3.0 nat over stiffness/mat",
            ["beam/matrix"],
        ),
        (
            raise_evidence("beam/matrix", 1503.0, log_evidence_se=2.0),  # an uncertain estimate is no difference
            MATRIX,
            ["six_pus/matrix", "beam/matrix", "stiffness/matrix"],
        ),
        (
            raise_evidence("beam/matrix", 1498.95),  # within a nat of the best, not of each other
            "6-PUS and stiffness with the matrix deformation fit",
            ["six_pus/matrix", "stiffness/matrix"],
        ),
        (
            lambda summary: summary["models"].update(beam="beam theory"),
            "6-PUS, beam theory and stiffness with the matrix deformation",
            ["six_pus/matrix", "beam/matrix", "stiffness/matrix"],
        ),
    ],
)
def test_a_tie_ends_where_the_evidence_distinguishes(make_results, change, lead, leaders):
    study = read_study(make_results(change, variants=TWELVE, draws=False))
    assert describe_lead(study).startswith(lead)
    assert study.find_leaders() == leaders
    assert study.group(["six_pus/matrix", "beam/matrix", "stiffness/matrix"])[0] == leaders
    assert study.split(study.chosen)[0] == leaders[0].partition("/")[0]


def test_names_of_variants(make_results):
    study = read_study(make_results(variants=TWELVE, draws=False))
    assert study.label("six_pus/matrix") == "6-PUS/matrix"
    assert study.name_variants(["six_pus/none", "beam/none"]) == "6-PUS and beam without deformation"
    assert study.name_variants(["six_pus/none", "beam/matrix"], "or") == "6-PUS/none or beam/matrix"


# --- the ranking -----------------------------------------------------------------------------------------------------


def test_effects_are_tabulated_with_letters_of_the_groups(make_results):
    table = tabulate_effects(read_study(make_results(variants=TWELVE)))
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert rows["6-PUS"] == ["−300.1 D", "−290.1 C", "−0.1 A", "+300.0", "+290.0", "–", "–", "–"]
    assert rows["Jacobian"][:3] == ["−450.0 F", "−440.0 E", "−150.0 B"]
    assert rows["Jacobian"][-3:] == ["−149.9", "−149.9", "−149.9"]
    assert tabulate_effects(read_study(make_results(name="one_model"))) is None


def test_the_ranking_shows_differences_with_their_errors_and_names_of_the_files(make_results):
    table = tabulate_ranking(read_study(make_results(variants=TWELVE)))
    place = [(column.group, column.title) for column in table.columns].index(("elpd LOO", "behind the best"))
    shown = {row[1].text: row[place].text for row in table.rows}
    assert shown["stiffness/matrix"] == "0.0"
    assert shown["Jacobian/matrix"] == "−150.0 ± 4.0"
    assert [one.text for one in table.notes if "Stacking" not in one.text] == [
        "In config and results 6-PUS is six_pus and Jacobian is jacobian: 6-PUS/matrix is six_pus/matrix."
    ]


def test_without_verification_poses_the_ranking_has_no_column_of_them(make_results):
    page = read_page(make_results(verification=False))
    ranking = next(one for section in page.sections for one in section.blocks if isinstance(one, Table))
    assert ("Position error, mean / max", "verification") not in {(c.group, c.title) for c in ranking.columns}


def test_a_difference_has_the_standard_error_of_its_poses(make_results):
    study = read_study(make_results(variants=TWELVE))
    pointwise = study.table("poses").pivot(index="pose", columns="variant", values="elpd_loo")
    difference = pointwise["beam/none"] - pointwise["six_pus/none"]
    expected = np.sqrt(len(difference) * difference.var(ddof=0))
    assert measure_error(study, "beam/none", "six_pus/none") == pytest.approx(expected)
