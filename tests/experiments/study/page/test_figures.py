"""What the figures show follows the tables, and stays legible with twelve variants."""

from __future__ import annotations

import re
import warnings
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest
from made_up_results import PUBLICATION, TWELVE, read_page, read_study, render_text, set_rows, write_results
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex

from bayescal.experiments.study.page.machine import (
    choose_flexure,
    draw_flexure,
    find_magnification,
    locate_joints,
    measure_moves,
)
from bayescal.experiments.study.page.styles import DEFORMATION_COLOURS, assign_styles, list_keys
from bayescal.report.blocks import Table
from bayescal.report.pictures import render_picture
from bayescal.report.style import RC

pytestmark = pytest.mark.runs


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the results directory that all tests of this file read."""
    change = set_rows(
        {"variant": "beam/linear", "use": "calibration"},
        position_error_mm=[0.010, 0.020, 0.030, 0.080],
        orientation_error_deg=[0.010, 0.020, 0.030, 0.040],
    )
    shown = {"flexure": True, "publication": PUBLICATION, "edits": {"pose_errors": change}}
    return write_results(tmp_path_factory.mktemp("twelve"), variants=TWELVE, **shown)


@pytest.fixture(scope="module")
def twelve(folder):
    return read_study(folder)


@pytest.fixture(scope="module")
def page(folder):
    return read_page(folder)


def draw(page, name):
    """Return one figure of a page, drawn."""
    (one,) = (one for one in page.figures() if one.name == name)
    with rc_context(RC):
        figure = one.draw()
        FigureCanvasAgg(figure).draw()
    return figure


@pytest.fixture(scope="module")
def drawn(page):
    """Return the page's figures by name, each drawn once for all tests of this file."""
    return cache(partial(draw, page))


def list_texts(figure) -> list[str]:
    return [text.get_text() for axes in figure.axes for text in axes.texts]


def test_every_figure_is_drawn_without_a_warning(page):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        images = {one.name: render_picture(one.draw).png for one in page.figures()}
    assert set(images) == {
        *("errors", "errors_none", "errors_linear", "errors_matrix", "bounds", "parameters", "hardpoints", "flexure"),
        *("ridges", "deflections", "tau", "sensitivity", "poses"),
        *("ranks", "pareto_k", "before_after"),
    }
    assert all(image.startswith(b"\x89PNG") for image in images.values())


# --- bars of the errors ----------------------------------------------------------------------------------------------


def test_bars_reach_the_largest_error_and_the_line_is_the_mean(drawn):
    figure = drawn("errors_linear")
    for axes, largest, mean in zip(figure.axes, (80.0, 0.040), (35.0, 0.025), strict=True):
        heights = [bar.get_height() for bar in axes.patches]  # calibration of each model, then verification
        assert heights[2] == pytest.approx(largest)  # beam is the third model
        lines = [float(segment[0, 1]) for line in axes.collections for segment in line.get_segments()]
        assert lines[2] == pytest.approx(mean)
        assert max(lines[k] for k in range(8) if k != 2) < 0.5 * mean
    assert "35/\n80" in list_texts(figure)
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == [
        "6-PUS",
        "Jacobian",
        "beam",
        "stiffness",
    ]
    assert [axes.get_ylabel() for axes in figure.axes] == ["Position error (µm)", "Orientation error (°)"]


@pytest.mark.parametrize(("angle", "factor", "label"), [("mrad", np.pi / 0.18, "mrad"), ("arcsec", 3600.0, "arcsec")])
def test_orientation_errors_of_tables_and_figures_are_in_the_configs_unit(make_results, drawn, angle, factor, label):
    def change(summary):
        summary["units"]["angle"] = angle

    page = read_page(make_results(change, variants=TWELVE))
    own, usual = draw(page, "errors_none").axes[1], drawn("errors_none").axes[1]
    assert own.get_ylabel() == f"Orientation error ({label})"
    heights = [[bar.get_height() for bar in axes.patches] for axes in (own, usual)]
    np.testing.assert_allclose(heights[0], factor * np.array(heights[1]))
    tables = [block for section in page.sections for block in section.blocks if isinstance(block, Table)]
    units = {c.unit for table in tables[:1] for c in table.columns if c.group.startswith("Orientation")}
    assert units == {label}


def test_a_page_in_degrees_has_no_other_unit_of_angles(make_results, drawn):
    text = render_text(make_results(variants=TWELVE))
    assert not re.search(r"\b(mdeg|mrad|µrad|arcsec|rad)\b", text)
    for name in ("errors", "errors_linear", "parameters", "ridges"):
        labels = [label for axes in drawn(name).axes for label in (axes.get_xlabel(), axes.get_ylabel())]
        assert not [label for label in labels if "rad" in label or "mdeg" in label]


def test_all_deformations_have_the_same_axes(page, drawn):
    figures = [drawn(f"errors_{name}") for name in ("none", "linear", "matrix")]
    for k in (0, 1):
        assert len({figure.axes[k].get_ylim() for figure in figures}) == 1
    assert figures[0].axes[0].get_ylim()[1] > 80
    captions = [one.caption for one in page.figures() if one.name.startswith("errors_")]
    assert [number for caption in captions for number in (15, 16, 17) if f"figure {number}" in caption] == [15, 16, 17]


def test_a_single_model_has_its_deformations_in_one_figure(make_results):
    page = read_page(make_results())
    assert [one.name for one in page.figures() if one.name.startswith("errors_")] == ["errors_all"]
    figure = draw(page, "errors_all")
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["pus/none", "pus/linear"]


def test_without_verification_poses_there_is_one_bar_each(make_results):
    figure = draw(read_page(make_results(variants=TWELVE, verification=False)), "errors_none")
    assert len(figure.axes[0].patches) == 4


# --- the ranking as a figure -----------------------------------------------------------------------------------------


def test_the_ranking_figure_has_a_row_per_variant_in_order(drawn):
    figure = drawn("errors")
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels[:4] == ["6-PUS/matrix", "beam/matrix", "stiffness/matrix", "Jacobian/matrix"]
    assert len(labels) == 12
    assert [text for text in list_texts(figure) if text.startswith(("0.0", "−"))][:4] == [
        "−0.1",
        "−0.4",
        "0.0",
        "−150.0",
    ]
    bars = [
        bar for bar in figure.axes[0].patches if to_hex(bar.get_facecolor()).upper() in DEFORMATION_COLOURS.values()
    ]
    assert [round(bar.get_width(), 1) for bar in bars[:4]] == [0.1, 0.4, 0.0, 150.0]


@pytest.mark.parametrize("name", ["errors", "bounds", "errors_none", "tau", "parameters", "hardpoints"])
def test_tick_labels_and_numbers_do_not_cover_each_other(drawn, name):
    figure = drawn(name)
    for axes in figure.axes:
        rows = [label.get_window_extent() for label in axes.get_yticklabels() if label.get_text()]
        rows.sort(key=lambda box: box.y0)
        assert all(low.y1 <= high.y0 + 1 for low, high in pairwise(rows))
        columns = [label.get_window_extent() for label in axes.get_xticklabels() if label.get_text()]
        columns.sort(key=lambda box: box.x0)
        assert all(left.x1 <= right.x0 for left, right in pairwise(columns))
        if name == "errors_none":
            texts = [text.get_window_extent() for text in axes.texts]
            assert not any(one.overlaps(other) for k, one in enumerate(texts) for other in texts[k + 1 :])


def test_poses_beyond_their_bounds_are_counted(drawn, twelve):
    texts = [text.get_text() for text in drawn("bounds").axes[0].texts]
    names = twelve.ranking
    for name, n_beyond in (("beam/linear", "4"), ("beam/none", "1")):
        assert re.findall(r"[\d.]+", texts[names.index(name)]) == [n_beyond, "6", "6.5"]


# --- parameters and joints -------------------------------------------------------------------------------------------


def test_parameters_show_the_first_of_the_best_models(drawn):
    figure = drawn("parameters")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["6-PUS/none", "6-PUS/linear", "6-PUS/matrix", "prior, central 90 %", "published"]
    means = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert [line.get_ydata().tolist() for line in means] == [
        pytest.approx([3.0, 6.0]),
        pytest.approx([2.0, 4.0]),
        pytest.approx([1.0, 2.0]),
    ]


def test_moves_of_the_joints_are_measured_over_all_points(twelve):
    joints = locate_joints(twelve.geometry)
    assert joints.groupby(["variant", "point"]).size().eq(2).all()
    # every coordinate moves by the shift in leg 1, by twice the shift in leg 2: rms of √2 and √8
    moves = measure_moves(joints)
    assert moves["six_pus/matrix"] == pytest.approx(np.sqrt(5.0))
    assert moves["six_pus/none"] == pytest.approx(3 * np.sqrt(5.0))


def test_joints_have_a_mark_per_deformation(drawn, twelve):
    figure = drawn("hardpoints")
    joints = locate_joints(twelve.geometry)
    factor = find_magnification(joints)
    base = joints[(joints["point"] == "a") & joints["variant"].str.startswith("six_pus/")].set_index(["variant", "leg"])
    drawn = {line.get_marker(): line for line in figure.axes[0].lines if line.get_linestyle() == "None"}
    assert set(drawn) == {".", "o", "x", "^"}
    for marker, name in (("o", "none"), ("x", "linear"), ("^", "matrix")):
        rows = base.loc[f"six_pus/{name}"]
        assert drawn[marker].get_xdata() == pytest.approx((rows["x"] + factor * rows["dx"]).to_numpy())
        assert drawn[marker].get_ydata() == pytest.approx((rows["y"] + factor * rows["dy"]).to_numpy())
    assert drawn["o"].get_markerfacecolor() == "none"
    assert drawn["."].get_xdata() == pytest.approx(base.loc["six_pus/none"]["x"].to_numpy())
    legend = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert legend == ["none: 6.7 mm", "linear: 4.5 mm", "matrix: 2.2 mm"]
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title.partition(":")[0] for title in titles] == ["6-PUS", "6-PUS", "Jacobian", "beam", "stiffness"]


# --- flexure ---------------------------------------------------------------------------------------------------------


def test_the_longest_flexure_is_shown_with_both_errors(twelve):
    rows = choose_flexure(twelve.table("flexure"))
    assert set(rows["flexure_length_mm"]) == {10.0}
    assert rows["pivot_error_nm"].iloc[-1] == pytest.approx(254.0)
    with rc_context(RC):
        left, right = draw_flexure(rows).axes
    pivot, beam, circle = left.lines
    assert pivot.get_xdata()[-1] == pytest.approx(0.762)
    assert beam.get_xdata()[-1] == pytest.approx(0.508)
    assert circle.get_xdata()[-1] == pytest.approx(0.508, rel=1e-3)
    low, high = left.get_xlim()
    assert (pivot.get_xdata()[-1] - beam.get_xdata()[-1]) / (high - low) > 0.25  # told apart on the page
    assert [text.get_text().partition(": ")[2] for text in right.texts] == ["254 nm", "0.00051 nm"]
    assert right.get_yscale() == "log"


def test_without_flexures_their_figure_is_left_out(make_results):
    assert "flexure" not in {one.name for one in read_page(make_results()).figures()}


# --- styles ----------------------------------------------------------------------------------------------------------


def test_many_variants_are_told_by_colour_and_marker(twelve):
    styles = assign_styles(twelve)
    assert len({(style.colour, style.marker) for style in styles.values()}) == 12
    labels = [handle.get_label() for handle in list_keys(styles)]
    assert labels == ["none", "linear", "matrix", "6-PUS", "Jacobian", "beam", "stiffness"]
    few = {name: styles[name] for name in list(TWELVE)[:3]}
    assert [handle.get_label() for handle in list_keys(few)] == ["6-PUS/none", "6-PUS/linear", "6-PUS/matrix"]
