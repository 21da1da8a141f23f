"""Pages of machines that are no models of legs: struts, lines, and joints that are nobody's members."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_results import TWO, hide_poses, read_page, read_study, set_rows

from bayescal.experiments.study.page.errors import show_outliers, state_outliers
from bayescal.experiments.study.page.parameters import show_parameters, state_undetermined
from bayescal.experiments.study.page.ridges import state_ridges
from bayescal.experiments.study.page.styles import assign_styles, list_keys
from bayescal.report.blocks import Figure, Fold, Table, unfold

ELEVEN = {f"set {k}": (100.0 - k, 1.0) for k in range(11)}
BEST = "pus/linear"


def be(member):
    """Return a change of a summary: a machine with such members, of which no kinematic models are compared."""

    def change(summary):
        del summary["models"]
        del summary["drive"]
        summary["member"] = member

    return change


def list_tables(section):
    return [block for block in unfold(section.blocks) if isinstance(block, Table)]


def test_parameters_of_struts_are_shown_strut_by_strut(make_results):
    study = read_study(make_results(be("strut"), published=False, ring=False))
    section = show_parameters(study)
    first, *_ = list_tables(section)
    assert [column.title for column in first.columns][-2:] == ["strut 1", "strut 2"]
    assert not any("leg " in getattr(block, "text", "") for block in section.blocks)
    assert "strut 2" in state_ridges(study)[0].text
    assert any(isinstance(block, Fold) and block.title.startswith("Parameters of ") for block in section.blocks)


def test_joints_of_a_machine_without_members_are_shown_one_by_one(make_results):
    study = read_study(make_results(be("leg"), published=False, ring=False))
    (table,) = list_tables(show_parameters(study))
    assert [row[0].text for row in table.rows][:2] == ["a_x[1]", "a_x[2]"]
    assert "a_x[2] with b_x[2]" in state_ridges(study)[0].text


def test_a_page_of_tables_without_an_instrument_is_whole(make_results):
    none = {"pose_errors": lambda table: table.iloc[:0]}
    page = read_page(make_results((be("line"), hide_poses()), edits=none, published=False, ring=False))
    anchors = {section.anchor for section in page.sections}
    assert "errors" not in anchors
    assert {"ranking", "parameters", "outliers", "ridges", "evidence", "diagnostics"} <= anchors
    ranking = next(figure for figure in page.figures() if figure.name == "errors")
    assert len(ranking.draw().axes) == 1


def test_orientations_that_nobody_measured_have_no_panel(make_results):
    alone = {"pose_errors": lambda table: table.assign(orientation_error_deg=np.nan, orientation_bound_95_deg=np.nan)}
    page = read_page(make_results(be("line"), edits=alone, published=False, ring=False))
    panels = {figure.name: len(figure.draw().axes) for figure in page.figures() if figure.name.startswith("errors")}
    assert panels == {"errors": 2, "errors_all": 1}
    assert [one.unit for one in page.verdict if one.lead == "Accuracy"] == ["µm"]


def test_only_poses_that_an_instrument_saw_are_counted(make_results):
    def hide(table):
        columns = ["position_error_mm", "position_bound_95_mm", "orientation_error_deg", "orientation_bound_95_deg"]
        table.loc[table["pose"] == "V0", columns] = np.nan

    page = read_page(make_results(edits={"pose_errors": hide}))
    assert any(" 1 verification pose." in one.text for one in page.verdict if one.lead == "Accuracy")
    assert any(" of 2 errors" in one.text for one in page.verdict if one.lead == "Coverage")


def test_a_variant_whose_poses_nobody_saw_is_left_out_of_the_errors_alone(make_results):
    seen = {"pose_errors": lambda table: table[table["variant"] == BEST]}
    page = read_page(make_results(hide_poses("pus/none"), edits=seen))
    figures = {figure.name: figure.draw() for figure in page.figures() if figure.name in ("errors_all", "bounds")}
    assert [label.get_text() for label in figures["errors_all"].axes[0].get_xticklabels()] == [BEST]
    assert [label.get_text() for label in figures["bounds"].axes[0].get_yticklabels()] == [BEST]


def test_variants_that_are_no_models_have_a_colour_or_marker_each(make_results):
    def rename(summary):
        be("strut")(summary)
        for name, fit in summary["variants"].items():
            fit["title"] = name

    names = {f"{name}/none": value for name, value in ELEVEN.items()}
    styles = assign_styles(read_study(make_results(rename, variants=names, published=False, ring=False)))
    assert len({(style.colour, style.marker) for style in styles.values()}) == len(ELEVEN)
    assert [key.get_label() for key in list_keys(styles)] == [style.label for style in styles.values()]


# --- poses that the others contradict --------------------------------------------------------------------------------


def test_poses_that_the_others_contradict_are_named_and_drawn(make_results):
    odd = {"poses": set_rows({"variant": BEST, "pose": "C2"}, is_outlier=True, chi2=150.0, robust_weight=0.01)}
    study = read_study(make_results(edits=odd))
    (statement,) = state_outliers(study)
    assert statement.value == 1.0
    assert "C2" in statement.action
    section = show_outliers(study)
    (table,) = list_tables(section)
    assert [cell.text for cell in table.rows[0]] == ["C2", "6", "5.0", "0.01"]
    (figure,) = (block for block in section.blocks if isinstance(block, Figure))
    assert sorted(bar.get_height() for bar in figure.draw().axes[0].patches)[-1] == pytest.approx(5.0)


def test_where_outliers_are_expected_it_is_said_that_there_are_none(make_results):
    def expect(summary):
        for name in TWO:
            summary["variants"][name]["has_outliers"] = True

    counted = {"poses": set_rows({"variant": BEST, "pose": "C1"}, robust_weight=0.93)}
    (statement,) = state_outliers(read_study(make_results(expect, edits=counted)))
    assert (statement.level, statement.value) == ("good", 0.93)
    assert state_outliers(read_study(make_results(name="plain"))) == []


def test_what_is_poorly_determined_is_named_of_legs_too(make_results):
    weak = {"parameters": set_rows({"variant": BEST, "parameter": "l[2]"}, verdict="weak")}
    (statement,) = state_undetermined(read_study(make_results(edits=weak)))
    assert (statement.level, statement.text.partition(":")[0]) == ("warning", "l[2]")
    (sure,) = state_undetermined(read_study(make_results(name="sure")))
    assert sure.level == "good"
