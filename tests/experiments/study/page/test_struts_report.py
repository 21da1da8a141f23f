"""The page of a machine on struts speaks of struts and of no publication, and counts what the machine has."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from made_up_results import PUBLICATION, read_page, read_study, render_text, write_draws

from bayescal.experiments.study.page.data import list_symbols, show_notation
from bayescal.experiments.study.page.machine import _group_by_azimuth
from bayescal.experiments.study.page.ridges import state_ridges
from bayescal.report.blocks import Page

HEXAPOD = {"six_ups/none": (120.0, 1.0), "six_ups/linear": (118.0, 1.0)}
TELESCOPE = {"six_pus/none": (120.0, 1.0), "six_pus/linear": (118.0, 1.0)}


@pytest.fixture
def hexapod(make_results):
    return make_results(variants=HEXAPOD, ring=False, published=False, drive="strut")


def list_captions(page: Page) -> str:
    return "\n".join(one.caption for one in page.figures() if one.draw is not None)


def test_figures_follow_those_of_a_publication_where_there_is_one(hexapod, make_results):
    assert "after" not in list_captions(read_page(hexapod))
    telescope = make_results(variants=TELESCOPE, publication=PUBLICATION, name="telescope")
    for number in ("figures 15 to 17", "figure 18", "figure 7"):
        assert f"(after {PUBLICATION['source']} {number})" in list_captions(read_page(telescope))


def test_notation_of_a_hexapod_has_its_symbols(hexapod, make_results):
    symbols = [symbol for symbol, _ in list_symbols(read_study(hexapod))]
    assert symbols == ["a", "b", "l", "rho", "kappa", "tau"]  # no direction u, no rho0, no K
    rigid = make_results(variants={"six_ups/none": (120.0, 1.0)}, ring=False, drive="strut", name="rigid")
    assert "kappa" not in [symbol for symbol, _ in list_symbols(read_study(rigid))]
    telescope = read_study(make_results(variants=TELESCOPE, name="telescope"))
    assert {"u", "rho0", "K"} <= {symbol for symbol, _ in list_symbols(telescope)}


def test_notation_says_where_a_publication_defines_a_symbol(hexapod, make_results):
    (alone,) = show_notation(read_study(hexapod)).blocks
    assert [column.title for column in alone.columns] == ["Symbol", "Meaning"]
    telescope = make_results(variants=TELESCOPE, publication=PUBLICATION, name="telescope")
    table, citation = show_notation(read_study(telescope)).blocks
    assert [column.title for column in table.columns] == ["Symbol", "Meaning", PUBLICATION["source"]]
    where = {row[0].text: row[2].text for row in table.rows}
    assert (where["rho0"], where["kappa"], where["tau"]) == ("eq. 9", "eq. 1", "–")
    assert citation == PUBLICATION["citation"]


def test_deformation_has_a_section_only_where_it_was_seen(hexapod, make_results):
    assert 'id="deformation"' not in render_text(hexapod)
    assert 'href="#deformation"' not in render_text(hexapod)
    seen = make_results(variants=HEXAPOD, ring=True, published=False, drive="strut", name="seen")
    assert 'id="deformation"' in render_text(seen)


def test_no_deformation_is_called_so_where_it_leads(make_results):
    three = HEXAPOD | {"six_ups/matrix": (100.0, 1.0)}
    text = render_text(make_results(variants=three, ring=False, drive="strut"))
    assert "no deformation is ahead of linear by 2.0" in text.replace("\u00a0", " ")


def test_a_ridge_of_three_is_counted_where_no_pair_shows_it(hexapod):
    """Of three parameters only the sum is measured: pairs correlate by -1/2, two combinations stay as they were."""
    rng = np.random.default_rng(1)
    free = 2.0 * rng.standard_normal((3, 4000))  # prior sd 2 mm
    free -= free.mean(axis=0)
    free += 0.01 * rng.standard_normal(4000)
    results = read_study(hexapod)
    results.draws["six_ups/none"] = dict(zip(("a_x[1]", "b_x[1]", "l[1]"), free, strict=True))
    pairs, combinations = state_ridges(results)
    assert "None of the 3 pairs exceeds 0.9" in pairs.text
    assert "Of the 3 independent combinations" in combinations.text
    assert "2 retain more than half of their prior variance, 1 less than 1 %" in combinations.text


def test_model_errors_are_no_combination_of_the_geometry(hexapod):
    write_draws(hexapod / "posterior" / "six_ups-none.nc")
    results = read_study(hexapod)
    geometry = [name for name in results.draws["six_ups/none"] if not name.startswith("tau")]
    assert f"Of the {len(geometry)} independent combinations" in state_ridges(results)[-1].text


def test_points_in_one_direction_share_a_name():
    azimuth = np.radians([-25.0, -18.5, 20.0, 30.0, 90.0, 89.9])
    points = pd.DataFrame({"leg": [3, 6, 1, 2, 4, 5], "x": np.cos(azimuth), "y": np.sin(azimuth)})
    groups = _group_by_azimuth(points.iloc[np.argsort(azimuth)])
    assert [sorted(legs) for legs, _ in groups] == [[3, 6], [1], [2], [4, 5]]
    assert groups[0][1] == pytest.approx(math.radians(-21.75))
