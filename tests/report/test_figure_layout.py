"""Figures as they stand in a page; and the canvas, on which texts are as large as on matplotlib's own."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from bayescal.report.canvas import Canvas
from bayescal.report.pictures import render_picture

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


def test_a_figure_has_ids_of_its_own():
    markup = str(render_picture(draw_shared).place("errors", alone=False))
    ids = re.findall(r' id="([^"]+)"', markup)
    assert markup.count("<svg") == 1
    assert ids
    assert len(ids) == len(set(ids))
    assert all(one.startswith("errors-") for one in ids)


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


@pytest.mark.parametrize(("ground", "mode"), [("white", "RGB"), ("none", "RGBA")])
def test_a_png_has_the_canvas_pixels_and_an_opacity_only_where_it_is_needed(ground, mode):
    figure = Figure(figsize=(2.0, 1.5), dpi=100.0, facecolor=ground)
    figure.text(0.1, 0.5, "text")
    canvas = Canvas(figure)
    image = Image.open(io.BytesIO(canvas.save()))
    assert (image.mode, image.size) == (mode, (200, 150))
    assert np.allclose(image.info["dpi"], 100.0, atol=0.01)
    assert np.array_equal(image.convert("RGBA"), canvas.buffer_rgba())
