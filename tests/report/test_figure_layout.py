"""Figures for a phone, panels below each other; and the canvas, on which texts are as large as on matplotlib's own."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayescal.report.canvas import Canvas
from bayescal.report.pictures import render_picture
from bayescal.report.stacked import NARROW, measure_panels, needs_stacking, stack_panels
from bayescal.report.style import RC

TEXTS = ("1.25", "Ägypt\nand a second, longer line", r"$\Delta a_{x}$ (mm)", "")


def draw_shared() -> Figure:
    figure = Figure(figsize=(9.4, 2.4))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, word in ((left, "Left"), (right, "Right, with a title that is longer than a phone is wide, by far")):
        axes.barh([0, 1], [1.0, 2.0], label="bars of some length")
        axes.set_title(word)
        axes.set_xlabel("Error (µm)")
    left.set_yticks([0, 1], ["stiff", "a variant with a name that takes more than its share of the width"])
    left.set_ylabel("Variant")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def stack(draw) -> Figure:
    with rc_context(RC):
        wide, figure = draw(), draw()
        wide.draw_without_rendering()
        stack_panels(figure, *measure_panels(wide))
        figure.draw_without_rendering()
    return figure


def test_panels_stand_below_each_other_with_what_they_shared():
    figure = stack(draw_shared)
    upper, lower = figure.axes
    assert figure.get_figwidth() == NARROW
    assert lower.get_position().y1 < upper.get_position().y0
    assert abs(lower.get_position().x0 - upper.get_position().x0) < 0.01
    for axes in figure.axes:
        names = [text.get_text() for text in axes.get_yticklabels() if text.get_visible()]
        assert names[0] == "stiff"
        assert "\n" in names[1]
        assert axes.get_ylabel() == "Variant"
    assert "\n" in lower.get_title("left")
    assert len(figure.legends) == 1


def test_nothing_stands_outside_of_the_page():
    figure = stack(draw_shared)
    box = figure.get_tightbbox()
    assert box.x0 > -0.05
    assert box.x1 < NARROW + 0.05


def test_small_panels_stay_side_by_side():
    def draw() -> Figure:
        figure = Figure(figsize=(4.0, 1.2))
        for axes in figure.subplots(1, 3):
            axes.plot([0.0, 1.0])
        return figure

    axes = stack(draw).axes
    assert len({round(one.get_position().x0, 2) for one in axes}) == 2
    assert len({round(one.get_position().y0, 2) for one in axes}) == 2


def test_figures_narrow_enough_have_one_form():
    small = Figure(figsize=(3.6, 2.0))
    small.subplots().plot(np.arange(3.0))
    assert not needs_stacking(small)
    assert render_picture(lambda: small).stacked == ""


def test_a_wide_figure_has_two_forms_of_its_own():
    picture = render_picture(draw_shared)
    markup = str(picture.place("errors"))
    assert re.findall(r'<svg class="(\w+)"', markup) == ["wide", "narrow"]
    ids = re.findall(r' id="([^"]+)"', markup)
    assert len(ids) == len(set(ids))


def test_names_that_do_not_meet_are_not_turned_though_some_reach_lower():
    def draw() -> Figure:
        figure = Figure(figsize=(9.4, 2.2))
        for axes in figure.subplots(1, 2):
            axes.bar(range(4), [1.0, 2.0, 1.5, 1.0])
            axes.set_xticks(range(4), ["6-PUS", "Jacobian", "beam", "stiffness"])
            for k, height in enumerate((1.0, 2.0, 1.5, 1.0)):
                axes.annotate("9.2/26", (k, height), (0, 2), textcoords="offset points", ha="center", fontsize=7)
        return figure

    for axes in stack(draw).axes:
        assert {text.get_rotation() for text in axes.get_xticklabels()} == {0.0}
        assert all(text.get_visible() for text in axes.texts)


def test_an_empty_place_of_a_grid_takes_no_room():
    def draw(empty: int) -> Figure:
        figure = Figure(figsize=(9.4, 4.0))
        panels = figure.subplots(2, 2).ravel()
        for axes in panels[: 4 - empty]:
            axes.plot([0.0, 1.0])
        for axes in panels[4 - empty :]:
            axes.set_axis_off()
        return figure

    full, less = (stack(lambda empty=empty: draw(empty)) for empty in (0, 1))
    assert less.get_figheight() < 0.8 * full.get_figheight()
    assert [axes.get_visible() for axes in less.axes] == [True, True, True, False]


def measure(canvas: type[FigureCanvasAgg], dpi: float) -> np.ndarray:
    figure = Figure(figsize=(4.0, 3.0), dpi=dpi)
    canvas(figure)
    texts = [
        figure.text(0.3, 0.4, text, fontsize=size, rotation=angle, family=family)
        for text in TEXTS
        for size, angle, family in ((7.0, 0.0, "sans-serif"), (9.5, 90.0, "serif"), (9.5, 25.0, "sans-serif"))
    ]
    return np.array([text.get_window_extent().extents for text in texts])


@pytest.mark.parametrize("dpi", [72.0, 120.0, 192.0])
def test_texts_are_as_large_as_on_matplotlibs_own_canvas(dpi):
    assert np.array_equal(measure(Canvas, dpi), measure(FigureCanvasAgg, dpi))


def test_pictures_are_those_of_matplotlibs_own_canvas():
    drawn = []
    for canvas in (Canvas, FigureCanvasAgg):
        figure = Figure(figsize=(2.0, 1.5), layout="constrained")
        axes = figure.subplots()
        axes.plot([0.0, 1.0], label="line")
        axes.set_title("Title\nof two lines")
        axes.legend()
        canvas(figure).draw()
        drawn.append(np.asarray(figure.canvas.buffer_rgba()).copy())
    assert np.array_equal(*drawn)


def test_a_figure_of_another_size_has_a_renderer_of_that_size():
    figure = Figure(figsize=(2.0, 1.5), dpi=100.0)
    canvas = Canvas(figure)
    first = canvas.get_renderer()
    assert canvas.get_renderer() is first
    figure.set_size_inches(3.0, 1.5)
    assert (canvas.get_renderer().width, canvas.get_renderer().height) == (300, 150)


def test_a_layout_that_differs_in_its_last_digits_gives_the_same_bytes():
    """Matplotlib names clips by a hash of their corners."""

    def draw(off: float) -> Figure:
        figure = Figure(figsize=(4.0 + off, 2.4))
        axes = figure.subplots()
        axes.plot([0.0, 1.0], [0.0, 1.0], "o")
        return figure

    first, second = (render_picture(lambda off=off: draw(off)) for off in (0.0, 1e-12))
    assert "<svg" in first.markup
    assert first.markup == second.markup
