"""What the page says follows the numbers: headline, failures and sentences, of two variants and of twelve."""

from __future__ import annotations

import io
import json
import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from made_up_results import TWELVE, TWO, read_page, read_study, set_fit, set_rows
from rich.console import Console

from bayescal.experiments.study.page.ranking import show_ranking, tabulate_effects, tabulate_ranking
from bayescal.experiments.study.page.verdict import measure_error, state_headline, state_verdict
from bayescal.experiments.study.terminal import show_ranking as show_on_terminal
from bayescal.report.blocks import Figure, Level, Table


class Case(NamedTuple):
    """What a change of numbers makes one finding of the verdict: its lead, level and value."""

    lead: str
    level: Level
    value: float | None = None
    change: Any = None
    edits: dict[str, Any] = {}  # noqa: RUF012 - of a tuple, never changed
    variants: dict[str, tuple[float, float]] = TWO


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
    "lead": Case("Evidence", "plain", 20.0),
    "tie": Case("Evidence", "plain", 0.5, set_fit("pus/none", log_evidence=119.5)),
    "not decisive": Case("Evidence", "plain", 3.0, set_fit("pus/none", log_evidence=117.0)),
    "position error": Case("Accuracy", "plain", 9.0),
    "orientation error": Case("Accuracy", "plain", 0.002),
    "measurement noise": Case(
        "Accuracy", "plain", 7.04, lambda s: s.update(measurement_noise_um={"verification": 7.04}), variants=TWELVE
    ),
    "LOO agrees": Case("Prediction", "good", 20.0),
    "LOO disagrees": Case("Prediction", "bad", 130.0, set_fit("pus/none", elpd_loo=300.0)),
    "held-back readings": Case("Prediction", "warning", 90.0, set_fit("pus/none", elpd=90.0)),
    "LOO of a tie": Case("Prediction", "good", 149.6, variants=TWELVE),
    "LOO of another leader": Case(
        "Prediction", "bad", 150.0, set_fit("jacobian/none", elpd_loo=1700.0), variants=TWELVE
    ),
    "LOO hardly separates": Case("Prediction", "plain", edits={"poses": scatter}, variants=TWELVE),
    "bad poses": Case("Prediction", "warning", 11.0, set_fit("beam/none", n_loo_bad_k=11), variants=TWELVE),
    "pairs": Case("Pairs", "plain", 57.0, variants=TWELVE),
    "convergence": Case("Checks", "good"),
    "no convergence": Case("Checks", "bad", 1.0, set_fit("pus/none", converged=False, problems="R-hat 1.050")),
    "disagreeing evidences": Case("Checks", "bad", 1.0, set_fit("pus/linear", log_evidence_bridge=121.5)),
    "stable": Case("Stability", "good"),
    "unstable": Case(
        "Stability",
        "bad",
        edits={"sensitivity": set_rows({"variant": "pus/none", "factor": 0.5}, log_evidence=200.0)},
    ),
    "unreliable": Case("Stability", "warning", 1.0, edits={"sensitivity": lower_but("pus/linear")}),
    "model error": Case("Model error", "plain", 4.0),
    "too narrow": Case("Coverage", "warning", 0.4, lambda s: narrow(s, "pus/none")),
    "wide enough": Case("Coverage", "plain", 0.9),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_finding_follows_the_numbers(case, make_results):
    study = read_study(make_results(case.change, edits=case.edits, variants=case.variants, draws=False))
    said = [one for one in state_verdict(study) if one.lead == case.lead]
    assert any(
        one.level == case.level and (case.value is None or one.value == pytest.approx(case.value, rel=1e-3))
        for one in said
    ), said


def test_evidences_far_behind_are_not_called_unreliable(make_results):
    edits = {"sensitivity": lower_but("pus/none")}
    verdict = state_verdict(read_study(make_results(edits=edits, verification=False)))
    assert not [one for one in verdict if one.lead == "Stability" and one.level == "warning"]
    assert not [one for one in verdict if one.lead == "Coverage" and one.level == "warning"]


def test_of_a_single_width_no_stability_is_claimed(make_results):
    edits = {"sensitivity": lambda table: table[table["factor"] != 0.5]}
    folder = make_results(variants=TWELVE, edits=edits)
    assert "Stability" not in {statement.lead for statement in state_verdict(read_study(folder))}


# --- headline and failures -------------------------------------------------------------------------------------------


def test_the_headline_names_the_variant_to_use(make_results):
    two, all_alike = make_results(name="two"), make_results(variants=TWELVE)
    simple = make_results(set_fit("stiffness/matrix", n_parameters=12), variants=TWELVE, name="simple")
    for folder, name in ((two, "pus with .*linear"), (all_alike, "6-PUS .*matrix"), (simple, "stiffness .*matrix")):
        assert re.search(rf"\b{name} deformation", state_headline(read_study(folder)))
    assert not read_page(two).failures


def test_nothing_is_advised_where_what_may_be_best_did_not_converge(make_results):
    fail = set_fit("stiffness/matrix", converged=False, problems="bulk ESS 12, limit 1000")
    study = read_study(make_results(fail, variants=TWELVE))
    assert ("warning", 1.0) in [(one.level, one.value) for one in state_verdict(study) if one.lead == "Evidence"]
    assert "none yet" in state_headline(study)


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
    assert len([text for text in said if "pus/none" in text]) == 1
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
    assert "97.0" not in printed


def test_of_variants_that_tie_the_one_with_fewest_unknowns_comes_first(make_results):
    study = read_study(make_results(set_fit("beam/matrix", n_parameters=9), variants=TWELVE))
    table = tabulate_ranking(study)
    assert next(row[1].text for row in table.rows) == "beam/matrix"  # of the lowest evidence of the three
    assert study.chosen == "beam/matrix"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (set_fit("pus/none", converged=False, problems="R-hat 1.050, limit 1.01"), "pus/none: R-hat 1.050, limit 1.01"),
        (
            set_fit("pus/linear", log_evidence_bridge=121.5),
            "pus/linear: log-evidences differ by 1.50 nat, limit 0.1",
        ),
    ],
)
def test_problems_are_failures(make_results, change, said):
    assert [(one.text, one.level) for one in read_page(make_results(change)).failures] == [(said, "bad")]


# --- groups of variants ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "leaders"),
    [
        ((), ["six_pus/matrix", "beam/matrix", "stiffness/matrix"]),
        (raise_evidence("beam/matrix", 1503.0), ["beam/matrix"]),
        (
            raise_evidence("beam/matrix", 1503.0, log_evidence_se=2.0),  # an uncertain estimate is no difference
            ["six_pus/matrix", "beam/matrix", "stiffness/matrix"],
        ),
        (
            raise_evidence("beam/matrix", 1498.95),  # within a nat of the best, not of each other
            ["six_pus/matrix", "stiffness/matrix"],
        ),
    ],
)
def test_a_tie_ends_where_the_evidence_distinguishes(make_results, change, leaders):
    study = read_study(make_results(change, variants=TWELVE, draws=False))
    assert study.find_leaders() == leaders
    assert study.group(["six_pus/matrix", "beam/matrix", "stiffness/matrix"])[0] == leaders
    assert study.split(study.chosen)[0] == leaders[0].partition("/")[0]


def test_names_of_variants(make_results):
    study = read_study(make_results(variants=TWELVE, draws=False))
    assert study.label("six_pus/matrix") == "6-PUS/matrix"
    assert study.name_variants(["six_pus/none", "beam/none"]).startswith("6-PUS and beam ")
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


def test_without_verification_poses_the_ranking_has_no_column_of_them(make_results):
    page = read_page(make_results(verification=False))
    ranking = next(one for section in page.sections for one in section.blocks if isinstance(one, Table))
    assert "verification" not in {column.title for column in ranking.columns}


def test_a_difference_has_the_standard_error_of_its_poses(make_results):
    study = read_study(make_results(variants=TWELVE))
    pointwise = study.table("poses").pivot(index="pose", columns="variant", values="elpd_loo")
    difference = pointwise["beam/none"] - pointwise["six_pus/none"]
    expected = np.sqrt(len(difference) * difference.var(ddof=0))
    assert measure_error(study, "beam/none", "six_pus/none") == pytest.approx(expected)
