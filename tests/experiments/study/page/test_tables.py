"""Tables and sections of the page: published values, claims, ridges, deformation, symbols, evidence, model errors."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from made_up_results import PUBLICATION, TWELVE, read_page, read_study, render_text, set_fit, set_rows, write_draws

from bayescal.errors import InputError
from bayescal.experiments.study.page.data import (
    list_counts,
    list_symbols,
    show_claims,
    show_notation,
    state_claims,
    tabulate_claims,
)
from bayescal.experiments.study.page.evidence import EXACT, show_evidence, show_tau_scale, tabulate_evidence
from bayescal.experiments.study.page.machine import _group_by_azimuth, tabulate_deformation
from bayescal.experiments.study.page.parameters import (
    compare_published,
    fold_parameters,
    list_remarks,
    state_agreement,
    tabulate_parameters,
    tabulate_published,
)
from bayescal.experiments.study.page.ridges import choose_leg, rank_pairs, state_ridges
from bayescal.report.blocks import Table

HEXAPOD = {"six_ups/none": (120.0, 1.0), "six_ups/linear": (118.0, 1.0)}
TELESCOPE = {"six_pus/none": (120.0, 1.0), "six_pus/linear": (118.0, 1.0)}


def read_texts(table: Table) -> dict[str, list[str]]:
    """Return the rows of a table by their first cells."""
    return {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}


# --- published values ------------------------------------------------------------------------------------------------


def publish(variant, symbol, values):
    """Return a change of least squares: one published row, and the difference from it."""

    def change(table):
        set_rows({"variant": variant, "parameter": symbol}, published_offset=values)(table)
        table["difference"] = table["offset"] - table["published_offset"]

    return {"least_squares": change}


def test_difference_from_published_is_the_rms_over_lengths_alone(make_results):
    study = read_study(make_results())
    found = compare_published(study, "pus/linear")
    assert found.rms_mm == pytest.approx(math.sqrt((0.3**2 + 0.4**2) / 2))
    assert found.n_lengths == 10
    # published 0.7 and 1.6 mm at posterior offsets of 1 and 2 ± 0.16 mm: none inside
    assert (found.n_inside, found.n_known) == (0, 12)
    assert compare_published(study, "pus/none") is None
    edits = {"least_squares": set_rows({"variant": "pus/linear", "parameter": "a_x", "leg": 2}, published_offset=2.1)}
    assert compare_published(read_study(make_results(edits=edits, name="inside")), "pus/linear").n_inside == 1


def test_every_variant_has_its_published_table_with_it(make_results):
    groups = fold_parameters(read_study(make_results(variants=TWELVE)))
    titles = ["Without deformation", "With the linear deformation", "With the matrix deformation"]
    assert [title for title, _ in groups] == titles
    folds = [fold for _, folds in groups for fold in folds]
    names = [fold.title.partition(":")[0] for fold in folds]
    assert names[:2] == ["Table 5(a), 6-PUS/none", "Table 5(b), Jacobian/none"]
    assert [fold.is_open for fold in folds] == [False] * 12
    assert "squares 0.35 mm" in folds[0].title
    few = [fold for _, folds in fold_parameters(read_study(make_results(name="few"))) for fold in folds]
    assert [fold.is_open for fold in few] == [True, True]


def test_a_changed_value_appears_in_table_and_difference(make_results):
    edits = publish("beam/linear", "b_y", [0.123, -4.567])
    table = tabulate_parameters(read_study(make_results(variants=TWELVE, edits=edits)), "beam/linear")
    assert table.rows[12][0].text == "b_y"
    assert {row[2].text: [cell.text for cell in row[3:]] for row in table.rows[12:16]} == {
        "posterior mean ± sd": ["+2.00 ± 0.10", "+4.00 ± 0.10"],
        "least squares": ["+1.00", "+2.00"],
        "published": ["+0.12", "−4.57"],
        "least squares − published": ["+0.88", "+6.57"],
    }


def test_the_overview_is_the_rms_per_table(make_results):
    edits = publish("jacobian/matrix", "kappa", [1.0 - 3e-3, 2.0 - 4e-3])
    table = tabulate_published(read_study(make_results(variants=TWELVE, edits=edits)))
    groups = ["", "Table 5, without deformation", "Table 6, linear deformation", "Table 7, matrix deformation"]
    assert [group for group, _ in table.groups] == groups
    assert [column.title for column in table.columns[1:3]] == ["a, b, l", "kappa"]
    rows = read_texts(table)
    assert list(rows) == ["6-PUS", "Jacobian", "beam", "stiffness"]
    assert rows["6-PUS"] == ["0.35", "7000"] * 3
    assert rows["Jacobian"] == [*["0.35", "7000"] * 2, "0.35", "3.5"]


def test_a_table_is_named_where_values_are_printed(make_results):
    """A publication may have a table of a variant that frees more, with which nothing of it can be compared."""
    study = read_study(make_results(variants=TWELVE))
    (fold, *_) = (fold for _, folds in fold_parameters(study) for fold in folds)
    assert fold.title.startswith("Table")
    edits = {"least_squares": lambda table: table.assign(published_offset=np.nan, difference=np.nan)}
    bare = read_study(make_results(variants=TWELVE, edits=edits, name="bare"))
    (fold, *_) = (fold for _, folds in fold_parameters(bare) for fold in folds)
    assert not fold.title.startswith("Table")


def test_without_published_tables_there_is_no_overview(make_results):
    study = read_study(make_results(variants=TWELVE, published=False))
    assert tabulate_published(study) is None
    (fold, *_) = (fold for _, folds in fold_parameters(study) for fold in folds)
    assert "published" not in fold.title
    assert not fold.title.startswith("Table")
    assert {row[2].text for row in fold.blocks[0].rows} == {"posterior mean ± sd", "least squares"}


@pytest.mark.parametrize(("share", "remarks"), [(0.1, 1), (0.2, 1), (0.5, 0), (1.0, 0)])
def test_a_row_printed_far_too_small_is_remarked(make_results, share, remarks):
    def change(table):
        set_rows({"parameter": "kappa"}, offset=[4.1e-3, 6.1e-3] * 12, published_offset=[4e-3, 6e-3] * 12)(table)
        publish("beam/matrix", "kappa", [4e-3 * share, 6e-3 * share])["least_squares"](table)

    found = list_remarks(read_study(make_results(variants=TWELVE, edits={"least_squares": change})))
    assert len(found) == remarks
    if share == 0.1:
        assert all(one in found[0].text for one in ("table 7(c)", "beam/matrix", "0.10·10⁻³", "4.7·10⁻³"))
    if share == 0.2:
        assert "10⁻³" not in found[0].text


def test_posteriors_of_tied_variants_are_compared(make_results):
    def change(table):
        mine = table["variant"] == "stiffness/matrix"
        table.loc[mine & (table["parameter"] == "l[2]"), "mean"] += 0.25  # sd 0.1
        table.loc[mine & (table["parameter"] == "b_y[2]"), ["parameter", "mean"]] = ["l_b[1]", 1e3]  # the others' none

    study = read_study(make_results(variants=TWELVE, edits={"parameters": change}))
    (statement,) = state_agreement(study)
    group = study.name_variants([f"{model}/matrix" for model in ("six_pus", "beam", "stiffness")])
    assert re.search(rf"{group} .*2\.50 sd \({study.name_parameter('l[2]')}\)", statement.text)


# --- claims ----------------------------------------------------------------------------------------------------------


def test_claims_are_counted_apart_from_own_findings(make_results):
    study = read_study(make_results(claims=True))
    counts = {title: [(cell.text, cell.level) for cell in cells] for title, cells in list_counts(study)}
    assert counts == {
        "Publication": [("2 hold", "good"), ("2 do not hold", "bad"), ("1 not testable", "plain")],
        "Beyond it": [("1 does not hold", "bad")],
    }
    (statement,) = state_claims(study)
    assert (statement.value, statement.limit) == (2, 5)
    section = show_claims(study)
    assert section.title == f"Claims of {PUBLICATION['source']}"
    assert [block.title for block in section.blocks[:2]] == list(counts)


def test_claims_are_by_section_in_order(make_results):
    claims = read_study(make_results(claims=True)).table("claims")
    table, given = tabulate_claims(claims), claims.set_index("claim")
    own = "Project findings"
    assert table.headings == {0: "Section 2.3", 2: "Section 7.1.1", 4: "Sections 10.2, 11", 5: own}
    first, second, _, other, *_ = table.rows
    assert [cell.text for cell in first] == given.loc["small", ["verdict", "statement", "expected", "found"]].tolist()
    assert first[1].more == f"{given.loc['small', 'reason']} (small)"
    assert second[1].text == given.loc["wrong", "statement"]
    assert second[3].text == "0.00200 deg"  # the value stands in where nothing is written
    assert [cell.text for cell in other] == [*given.loc["open", ["verdict", "statement"]], "–", "–"]


@pytest.mark.parametrize(
    ("change", "verdict", "found"),
    [
        (
            lambda summary: summary.pop("publication"),
            "holds",
            r"summary\.json: publication:",
        ),
        (None, "maybe", r"claims\.csv, line 2: verdict: found 'maybe', expected holds, does"),
    ],
)
def test_claims_at_fault_are_named(make_results, change, verdict, found):
    edits = {"claims": set_rows({"verdict": "holds"}, verdict=verdict)}
    with pytest.raises(InputError, match=found):
        read_study(make_results(change, claims=True, edits=edits))


def test_a_changed_verdict_changes_mark_count_and_page(make_results):
    edits = {"claims": set_rows({"claim": "small"}, verdict="does not hold")}
    text = render_text(make_results(claims=True, edits=edits))
    assert '<span class="badge bad">3 do not hold</span>' in text
    assert text.count('<span class="badge good">holds</span>') == 1
    assert text.count('<span class="badge bad">does not hold</span>') == 4
    # escaped, and open on a click
    assert " <i>a</i><sub>x</sub>.</summary><p>Worst signs. (small)</p>" in text
    assert "Seen &lt;i&gt;twice&lt;/i&gt;." in text
    assert 'href="#claims"' in text


@pytest.mark.parametrize("empty", [False, True])
def test_without_claims_there_is_no_section(make_results, empty):
    folder = make_results(claims=empty, edits={"claims": lambda table: table.iloc[:0]} if empty else {})
    study = read_study(folder)
    assert (list_counts(study), state_claims(study), show_claims(study)) == ([], [], None)
    text = render_text(folder)
    assert 'id="claims"' not in text
    assert "#claims" not in text


# --- ridges ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def hexapod(make_results):
    return make_results(variants=HEXAPOD, ring=False, published=False, drive="strut")


def test_ridges_name_the_correlated_pair_and_its_leg(make_results):
    study = read_study(make_results())
    pairs = rank_pairs(study.draws["pus/linear"])
    assert set(pairs[0][:2]) == {"a_x[2]", "b_x[2]"}
    assert pairs[0][2] > 0.98
    assert choose_leg(pairs)[0] == 2
    assert re.search(r"\ba_x\D*2\D*\bb_x\D*2 \(\+(0\.99|1\.00)\)", state_ridges(study)[0].text)


def test_a_ridge_of_three_is_counted_where_no_pair_shows_it(hexapod):
    """Of three parameters only the sum is measured: pairs correlate by -1/2, two combinations stay as they were."""
    rng = np.random.default_rng(1)
    free = 2.0 * rng.standard_normal((3, 4000))  # prior sd 2 mm
    free -= free.mean(axis=0)
    free += 0.01 * rng.standard_normal(4000)
    study = read_study(hexapod)
    study.draws["six_ups/none"] = dict(zip(("a_x[1]", "b_x[1]", "l[1]"), free, strict=True))
    pairs, combinations = state_ridges(study)
    assert " 0 of 3 " in pairs.text
    assert [word for word in combinations.text.split() if word.isdigit()] == ["3", "2", "1", "1"]


def test_model_errors_are_no_combination_of_the_geometry(hexapod):
    write_draws(hexapod / "posterior" / "six_ups-none.nc")
    study = read_study(hexapod)
    geometry = [name for name in study.draws["six_ups/none"] if not name.startswith("tau")]
    assert f" {len(geometry)} principal axes" in state_ridges(study)[-1].text


# --- deformation and joints ------------------------------------------------------------------------------------------


def test_deflections_left_by_both_descriptions_are_stated(make_results):
    _, (statement, _) = tabulate_deformation(read_study(make_results()))
    # made of K plus 0.5 µm: that is what K leaves; κ leaves |−4 ρ2 + 0.5| and |2 ρ1 + 0.5| besides
    assert re.search(r"linear: .*\b2\.5 .*\b4\.5 .*matrix: .*\b0\.50 .*\b0\.50 ", statement.text)


def test_deformation_has_a_section_only_where_it_was_seen(hexapod, make_results):
    (section,) = (
        one for one in read_page(make_results(ring=False, name="two")).sections if one.anchor == "deformation"
    )
    assert [figure.draw for figure in section.blocks] == [None]
    assert 'id="deformation"' not in render_text(hexapod)
    assert 'href="#deformation"' not in render_text(hexapod)
    seen = make_results(variants=HEXAPOD, ring=True, published=False, drive="strut", name="seen")
    assert 'id="deformation"' in render_text(seen)


def test_points_in_one_direction_share_a_name():
    azimuth = np.radians([-25.0, -18.5, 20.0, 30.0, 90.0, 89.9])
    points = pd.DataFrame({"leg": [3, 6, 1, 2, 4, 5], "x": np.cos(azimuth), "y": np.sin(azimuth)})
    groups = _group_by_azimuth(points.iloc[np.argsort(azimuth)])
    assert [sorted(legs) for legs, _ in groups] == [[3, 6], [1], [2], [4, 5]]
    assert groups[0][1] == pytest.approx(math.radians(-21.75))


# --- symbols and figures of a publication ----------------------------------------------------------------------------


def test_notation_of_a_hexapod_has_its_symbols(hexapod, make_results):
    symbols = [symbol for symbol, _ in list_symbols(read_study(hexapod))]
    assert symbols == ["a", "b", "l", "rho", "kappa", "tau"]  # no direction u, no rho0, no K
    rigid = make_results(variants={"six_ups/none": (120.0, 1.0)}, ring=False, drive="strut", name="rigid")
    assert "kappa" not in [symbol for symbol, _ in list_symbols(read_study(rigid))]


def test_figures_and_symbols_are_those_of_a_publication_where_there_is_one(hexapod, make_results):
    telescope = make_results(variants=TELESCOPE, publication=PUBLICATION, name="telescope")
    captions, alone = (
        "\n".join(one.caption for one in read_page(folder).figures() if one.draw is not None)
        for folder in (telescope, hexapod)
    )
    assert "(after " not in alone
    for number in ("figures 15 to 17", "figure 18", "figure 7"):
        assert f"(after {PUBLICATION['source']} {number})" in captions
    (table,) = show_notation(read_study(hexapod)).blocks
    assert [column.title for column in table.columns] == ["Symbol", "Meaning"]
    study = read_study(telescope)
    assert {"u", "rho0", "K"} <= {symbol for symbol, _ in list_symbols(study)}
    table, citation = show_notation(study).blocks
    assert [column.title for column in table.columns] == ["Symbol", "Meaning", PUBLICATION["source"]]
    where = {symbol: place for symbol, (_, place) in read_texts(table).items()}
    assert (where["rho0"], where["kappa"], where["tau"]) == ("eq. 9", "eq. 1", "–")
    assert citation == PUBLICATION["citation"]


# --- evidence --------------------------------------------------------------------------------------------------------


def test_benefit_of_the_exact_density_is_next_to_the_estimators(make_results):
    exact = {"log_shift": -1.06, "log_shift_se": 0.02, "efficiency": 0.31, "pareto_k": 0.2}
    change = set_fit("pus/linear", **{f"linearisation_{key}": value for key, value in exact.items()})
    table = tabulate_evidence(read_study(make_results(change)))
    assert EXACT in table.caption
    assert [cell.text for cell in table.rows[0]][6:8] == ["−1.06 ± 0.02", "31"]
    assert table.rows[0][7].level == "bad"  # too few draws count
    assert [cell.text for cell in table.rows[1]][6:8] == ["–", "–"]
    assert EXACT not in tabulate_evidence(read_study(make_results(name="none"))).caption


@pytest.mark.parametrize(
    ("leads", "level", "cells"),
    [
        ({1.0: 5.0, 10.0: 20.0, 100.0: 0.5}, "good", "105.0 (1) 120.0 (1) 100.5 (1)"),
        ({1.0: -3.0, 3.0: -8.0, 10.0: 20.0}, "warning", "97.0 (2)"),
        ({1.0: np.nan, 10.0: 20.0}, "plain", "–"),
        ({1.0: -9.0, 10.0: 0.5}, "good", "91.0 (2)"),  # ties are no order
    ],
)
def test_the_scale_of_the_model_errors_prior_is_a_finding_where_the_order_depends_on_it(
    make_results, leads, level, cells
):
    study = read_study(make_results())
    assert show_tau_scale(study) == []
    names = ("pus/linear", "pus/none")
    rows = [(name, scale, 100.0 + lead * (name == names[0])) for scale, lead in leads.items() for name in names]
    table = pd.DataFrame(rows, columns=["variant", "scale", "log_evidence"])
    table = table.assign(unit="um", prior_scale=10.0, efficiency=1.0, pareto_k=0.0)
    study = replace(study, tables={**study.tables, "tau_scale": table})
    statement, shown = show_tau_scale(study)
    assert statement.level == level
    assert [column.title for column in shown.columns][1:] == [f"{scale:g} µm" for scale in sorted(leads)]
    assert " ".join(cell.text for cell in shown.rows[0][1:]).startswith(cells)
    assert statement in show_evidence(study).blocks
