"""The canvas of figures: texts are as large on it as on matplotlib's own, at every resolution."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bayescal.report.canvas import Canvas

TEXTS = ("1.25", "Ägypt\nand a second, longer line", r"$\Delta a_{x}$ (mm)", "")


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
