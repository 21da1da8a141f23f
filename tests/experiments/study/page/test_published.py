"""Published tables stand beside what was found."""

from __future__ import annotations

import pytest
from made_up_results import TWELVE, edit_config, edit_table, read_study

from bayescal.experiments.study.page.parameters import (
    fold_parameters,
    list_remarks,
    name_table,
    state_agreement,
    tabulate_parameters,
    tabulate_published,
)


def set_published(folder, variant, symbol, values) -> None:
    """Set one published row, and the difference from it."""

    def change(table):
        chosen = (table["variant"] == variant) & (table["parameter"] == symbol)
        table.loc[chosen, "published_offset"] = values
        table.loc[chosen, "difference"] = table.loc[chosen, "offset"] - table.loc[chosen, "published_offset"]

    edit_table(folder, "least_squares", change)


def test_every_variant_has_its_published_table_beside_it(make_results):
    results = read_study(make_results(variants=TWELVE))
    groups = fold_parameters(results)
    assert [title for title, _ in groups] == [
        "Without deformation",
        "With the linear deformation",
        "With the matrix deformation",
    ]
    folds = [fold for _, folds in groups for fold in folds]
    assert [fold.title.partition(":")[0] for fold in folds[:2]] == [
        "Table 5(a), 6-PUS/none",
        "Table 5(b), Jacobian/none",
    ]
    assert len(folds) == 12
    assert not any(fold.is_open for fold in folds)
    assert "least squares 0.35 mm rms from the published lengths" in folds[0].title


def test_a_few_variants_are_shown_at_once(make_results):
    folds = [fold for _, folds in fold_parameters(read_study(make_results())) for fold in folds]
    assert [fold.is_open for fold in folds] == [True, True]


def test_a_changed_value_appears_in_table_and_difference(make_results):
    folder = make_results(variants=TWELVE)
    set_published(folder, "beam/linear", "b_y", [0.123, -4.567])
    table = tabulate_parameters(read_study(folder), "beam/linear")
    lines = {row[2].text: [cell.text for cell in row[3:]] for row in table.rows[12:16]}
    assert table.rows[12][0].text == "b_y"
    assert lines["posterior mean ± sd"] == ["+2.00 ± 0.10", "+4.00 ± 0.10"]
    assert lines["least squares"] == ["+1.00", "+2.00"]
    assert lines["published"] == ["+0.12", "−4.57"]
    assert lines["least squares − published"] == ["+0.88", "+6.57"]


def test_the_overview_is_the_rms_per_table(make_results):
    folder = make_results(variants=TWELVE)
    set_published(folder, "jacobian/matrix", "kappa", [1.0 - 3e-3, 2.0 - 4e-3])
    table = tabulate_published(read_study(folder))
    assert [group for group, _ in table.groups] == [
        "",
        "Table 5, without deformation",
        "Table 6, linear deformation",
        "Table 7, matrix deformation",
    ]
    assert [column.title for column in table.columns[1:3]] == ["a, b, l", "kappa"]
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in table.rows}
    assert list(rows) == ["6-PUS", "Jacobian", "beam", "stiffness"]
    assert rows["6-PUS"] == ["0.35", "7000"] * 3
    assert rows["Jacobian"] == [*["0.35", "7000"] * 2, "0.35", "3.5"]


def test_without_published_tables_there_is_no_overview(make_results):
    results = read_study(make_results(variants=TWELVE, published=False))
    assert tabulate_published(results) is None
    folds = [fold for _, folds in fold_parameters(results) for fold in folds]
    assert "published" not in folds[0].title
    assert {row[2].text for row in folds[0].blocks[0].rows} == {"posterior mean ± sd", "least squares"}


@pytest.mark.parametrize(("share", "remarks"), [(0.1, 1), (0.2, 1), (0.5, 0), (1.0, 0)])
def test_a_row_printed_far_too_small_is_remarked(make_results, share, remarks):
    folder = make_results(variants=TWELVE)
    for name in TWELVE:
        values = [4e-3, 6e-3] if name != "beam/matrix" else [4e-3 * share, 6e-3 * share]
        set_published(folder, name, "kappa", values)

    def change(table):
        chosen = table["parameter"] == "kappa"
        table.loc[chosen, "offset"] = [4.1e-3, 6.1e-3] * 12
        table.loc[chosen, "difference"] = table.loc[chosen, "offset"] - table.loc[chosen, "published_offset"]

    edit_table(folder, "least_squares", change)
    found = list_remarks(read_study(folder))
    assert len(found) == remarks
    if share == 0.1:
        assert found[0].text == (
            "The κ of table 7(c), beam/matrix, is printed at 0.10 of the other models' size (rms); ten times the "
            "printed values lie 0.10·10⁻³ rms from least squares, the printed ones 4.7·10⁻³: they may have been "
            "printed in another unit."
        )
    if share == 0.2:
        assert "ten times" not in found[0].text


@pytest.mark.parametrize(
    ("published", "name"),
    [
        ("published/table7c.csv", "table 7(c)"),
        ("C:\\data\\table_12_b.csv", "table 12(b)"),
        ("mine.csv", "mine"),
        (None, ""),
    ],
)
def test_a_table_is_named_after_its_file(make_results, published, name):
    folder = make_results()
    edit_config(folder, lambda config: config["variants"][0].update(published=published))
    assert name_table(read_study(folder), "pus/none") == name


def test_posteriors_of_tied_variants_are_compared(make_results):
    folder = make_results(variants=TWELVE)

    def change(table):
        mine = (table["variant"] == "stiffness/matrix") & (table["model_error"] == "free")
        table.loc[mine & (table["parameter"] == "l[2]"), "mean"] += 0.25  # sd 0.1
        table.loc[mine & (table["parameter"] == "b_y[2]"), ["parameter", "mean"]] = ["l_b[1]", 1e3]  # the others' none

    edit_table(folder, "parameters", change)
    (statement,) = state_agreement(read_study(folder))
    assert "6-PUS, beam and stiffness with the matrix deformation by at most 2.50 sd (l of leg 2)" in statement.text
