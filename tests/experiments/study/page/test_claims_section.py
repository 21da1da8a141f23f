"""Claims of the publication and their verdicts."""

from __future__ import annotations

import json

import pytest
from made_up_results import PUBLICATION, edit_table, read_study, render_text

from bayescal.errors import InputError
from bayescal.experiments.study.page.data import list_counts, show_claims, state_claims, tabulate_claims
from bayescal.experiments.study.page.verdict import state_verdict


def test_claims_are_counted_apart_from_own_findings(make_results):
    results = read_study(make_results(claims=True))
    counts = {title: [(cell.text, cell.level) for cell in cells] for title, cells in list_counts(results)}
    assert counts == {
        "Stated by the publication": [("2 hold", "good"), ("2 do not hold", "bad"), ("1 not testable", "plain")],
        "Found beyond it": [("1 does not hold", "bad")],
    }
    (statement,) = state_claims(results)
    assert statement.text == "Of 5 claims of the publication, 2 hold, 2 do not hold and 1 not testable."


def test_claims_stand_by_section_in_order(make_results):
    table = tabulate_claims(read_study(make_results(claims=True)).table("claims"))
    assert table.headings == {
        0: "Section 2.3",
        2: "Section 7.1.1",
        4: "Sections 10.2, 11",
        5: "Beyond the publication: findings of this project",
    }
    first, second, _, other, *_ = table.rows
    assert [row[1].text for row in (first, second)] == ["Motors place within a_x.", "It turns by 1e-6 deg."]
    assert [cell.text for cell in first] == ["holds", "Motors place within a_x.", "6 µm", "5.9 µm"]
    assert first[1].more == "Worst signs. (small)"
    assert second[3].text == "0.00200 deg"  # the value stands in where nothing is written
    assert [cell.text for cell in other] == ["not testable", "The real platform stays stiff.", "–", "–"]


def test_claims_are_headed_by_their_source(make_results):
    section = show_claims(read_study(make_results(claims=True)))
    assert section.title == f"Claims of {PUBLICATION['source']}"
    assert [block.title for block in section.blocks[:2]] == ["Stated by the publication", "Found beyond it"]


def test_claims_without_a_source_are_an_error(make_results):
    folder = make_results(lambda summary: summary.pop("publication"), claims=True)
    with pytest.raises(InputError, match=r"summary\.json: publication: found nothing, expected the one whose claims"):
        read_study(folder)


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
    results = read_study(make_results())
    assert (list_counts(results), state_claims(results), show_claims(results)) == ([], [], None)
    assert "Publication" not in {statement.lead for statement in state_verdict(results)}
    text = render_text(make_results(name="page"))
    assert 'id="claims"' not in text
    assert "#claims" not in text


def test_an_empty_table_of_claims_leaves_no_section(make_results):
    folder = make_results(claims=True)
    path = folder / "tables" / "claims.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    provenance = json.loads((folder / "provenance.json").read_text())
    provenance["table_rows"]["tables/claims.csv"] = 0
    (folder / "provenance.json").write_text(json.dumps(provenance))
    assert 'id="claims"' not in render_text(folder)


def test_a_verdict_that_is_none_is_named(make_results):
    folder = make_results(claims=True)
    edit_table(folder, "claims", lambda table: table.replace({"verdict": {"holds": "maybe"}}, inplace=True))
    with pytest.raises(
        InputError, match=r"claims\.csv: claim late: verdict: found 'maybe', expected one of holds, does"
    ):
        read_study(folder)
