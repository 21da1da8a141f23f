"""Claims of the publication and their verdicts."""

from __future__ import annotations

import pandas as pd
import pytest
from made_up_results import edit_table, render_text

from bayescal.errors import InputError
from bayescal.experiments.study.page.claims import list_counts, state_claims, tabulate_claims
from bayescal.experiments.study.page.results import read_results
from bayescal.experiments.study.page.verdict import state_verdict


def test_claims_are_counted_apart_from_own_findings(make_results):
    results = read_results(make_results(claims=True))
    counts = {title: [(cell.text, cell.level) for cell in cells] for title, cells in list_counts(results)}
    assert counts == {
        "Stated by the publication": [("2 hold", "good"), ("2 do not hold", "bad"), ("1 not testable", "plain")],
        "Found beyond it": [("1 does not hold", "bad")],
    }
    (statement,) = state_claims(results)
    assert statement.text == "Of 5 claims of the publication, 2 hold, 2 do not hold and 1 not testable."


def test_claims_stand_by_section_in_order(make_results):
    tables = tabulate_claims(read_results(make_results(claims=True)))
    assert [table.caption for table in tables] == [
        "Section 2.3",
        "Section 7.1.1",
        "Sections 10.2, 11",
        "Beyond the publication: findings of this project",
    ]
    assert [row[1].text for row in tables[0].rows] == ["Motors place within a_x.", "It turns by 1e-6 deg."]
    first, second = tables[0].rows
    assert [cell.text for cell in first] == ["holds", "Motors place within a_x.", "6 µm", "5.9 µm"]
    assert first[1].more == "Worst signs. (small)"
    assert second[3].text == "0.00200 deg"  # the value stands in where nothing is written
    assert [cell.text for cell in tables[1].rows[1]] == ["not testable", "The real platform stays stiff.", "–", "–"]


def test_a_changed_verdict_changes_mark_count_and_page(make_results):
    folder = make_results(claims=True)

    def change(table):
        table.loc[table["claim"] == "small", "verdict"] = "does not hold"

    edit_table(folder, "claims", change)
    text = render_text(folder)
    assert '<span class="badge bad">3 do not hold</span>' in text
    assert text.count('<span class="badge good">holds</span>') == 1
    assert text.count('<span class="badge bad">does not hold</span>') == 4
    assert "Of 5 claims of the publication, 1 holds, 3 do not hold and 1 not testable." in text


def test_claims_are_escaped_and_open_on_a_click(make_results):
    text = render_text(make_results(claims=True))
    assert "<summary>Motors place within <i>a</i><sub>x</sub>.</summary><p>Worst signs. (small)</p>" in text
    assert "Seen &lt;i&gt;twice&lt;/i&gt;." in text
    assert 'href="#claims"' in text


def test_without_claims_there_is_no_section(make_results):
    results = read_results(make_results())
    assert (list_counts(results), state_claims(results), tabulate_claims(results)) == ([], [], [])
    assert "Publication" not in {statement.lead for statement in state_verdict(results)}
    text = render_text(make_results(name="page"))
    assert 'id="claims"' not in text
    assert "#claims" not in text


def test_an_empty_table_of_claims_leaves_no_section(make_results):
    folder = make_results(claims=True)
    path = folder / "tables" / "claims.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    assert 'id="claims"' not in render_text(folder)


def test_a_verdict_that_is_none_is_named(make_results):
    folder = make_results(claims=True)
    edit_table(folder, "claims", lambda table: table.replace({"verdict": {"holds": "maybe"}}, inplace=True))
    with pytest.raises(
        InputError, match=r"claims\.csv: claim late: verdict: found 'maybe', expected one of holds, does"
    ):
        read_results(folder)


def test_a_missing_column_is_named(make_results):
    folder = make_results(claims=True)
    path = folder / "tables" / "claims.csv"
    pd.read_csv(path).drop(columns="why").to_csv(path, index=False)
    with pytest.raises(InputError, match="found no column 'why'"):
        read_results(folder)
