"""The report of a machine on struts says nothing that holds for RR-8096's telescope alone, and counts what it knows."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from made_up_results import render_text, write_draws

from bayescal.experiments.study.page.figures.joints import _group_by_azimuth
from bayescal.experiments.study.page.illustrations import list_illustrations
from bayescal.experiments.study.page.notation import list_symbols, name_sources
from bayescal.experiments.study.page.parameter_tables import state_ridges
from bayescal.experiments.study.page.results import Results, read_results

HEXAPOD = {"six_ups/none": (120.0, 1.0), "six_ups/linear": (118.0, 1.0)}
TELESCOPE = {"six_pus/none": (120.0, 1.0), "six_pus/linear": (118.0, 1.0)}


@pytest.fixture
def hexapod(make_results):
    return make_results(variants=HEXAPOD, ring=False, published=False)


def list_captions(results: Results) -> str:
    return "\n".join(one.caption for one in list_illustrations(results) if one.draw is not None)


def test_figures_of_a_hexapod_follow_no_figure_of_the_telescope(hexapod, make_results):
    assert "RR-8096" not in list_captions(read_results(hexapod))
    telescope = read_results(make_results(variants=TELESCOPE, name="telescope"))
    for number in ("figures 15 to 17", "figure 18", "figure 7"):
        assert f"RR-8096 {number}" in list_captions(telescope)


def test_notation_of_a_hexapod_has_its_symbols_and_sources(hexapod, make_results):
    results = read_results(hexapod)
    symbols = {symbol: where for symbol, _, where in list_symbols(results)}
    assert list(symbols) == ["a", "b", "l", "rho", "kappa", "tau"]  # no direction u, no rho0, no K
    assert symbols["l"].startswith("Yu 2023 eq. 3")
    assert symbols["kappa"] == "RR-8096 eq. 1"
    assert "Appl. Sci." in name_sources(results)
    assert "RR-8096" in name_sources(results)
    rigid = read_results(make_results(variants={"six_ups/none": (120.0, 1.0)}, ring=False, name="rigid"))
    assert "kappa" not in [symbol for symbol, _, _ in list_symbols(rigid)]
    assert "RR-8096" not in name_sources(rigid)
    telescope = read_results(make_results(variants=TELESCOPE, name="telescope"))
    assert {"u", "rho0", "K"} <= {symbol for symbol, _, _ in list_symbols(telescope)}


def test_deformation_has_a_section_only_where_it_was_seen(hexapod, make_results):
    assert 'id="deformation"' not in render_text(hexapod)
    assert 'href="#deformation"' not in render_text(hexapod)
    seen = make_results(variants=HEXAPOD, ring=True, published=False, name="seen")
    assert 'id="deformation"' in render_text(seen)


def test_no_deformation_is_called_so_where_it_leads(make_results):
    three = HEXAPOD | {"six_ups/matrix": (100.0, 1.0)}
    text = render_text(make_results(variants=three, ring=False))
    assert "no deformation is ahead of linear by 2.0" in text.replace("\u00a0", " ")


def test_a_ridge_of_three_is_counted_where_no_pair_shows_it(hexapod):
    """Of three parameters only the sum is measured: pairs correlate by -1/2, two combinations stay as they were."""
    rng = np.random.default_rng(1)
    free = 2.0 * rng.standard_normal((3, 4000))  # prior sd 2 mm
    free -= free.mean(axis=0)
    free += 0.01 * rng.standard_normal(4000)
    results = read_results(hexapod)
    results.draws["six_ups/none"] = dict(zip(("a_x[1]", "b_x[1]", "l[1]"), free, strict=True))
    pairs, combinations = state_ridges(results)
    assert "None of the 3 pairs exceeds 0.9" in pairs.text
    assert "Of the 3 independent combinations" in combinations.text
    assert "2 keep more than half of their prior variance, 1 less than 1 %" in combinations.text


def test_model_errors_are_no_combination_of_the_geometry(hexapod):
    write_draws(hexapod / "posterior" / "six_ups-none.nc")
    results = read_results(hexapod)
    geometry = [name for name in results.draws["six_ups/none"] if not name.startswith("tau")]
    assert f"Of the {len(geometry)} independent combinations" in state_ridges(results)[-1].text


def test_points_in_one_direction_share_a_name():
    azimuth = np.radians([-25.0, -18.5, 20.0, 30.0, 90.0, 89.9])
    points = pd.DataFrame({"leg": [3, 6, 1, 2, 4, 5], "x": np.cos(azimuth), "y": np.sin(azimuth)})
    groups = _group_by_azimuth(points.iloc[np.argsort(azimuth)])
    assert [sorted(legs) for legs, _ in groups] == [[3, 6], [1], [2], [4, 5]]
    assert groups[0][1] == pytest.approx(math.radians(-21.75))
