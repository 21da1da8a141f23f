"""Figures as SVG: coordinates are those of the figure, and whatever matplotlib draws is there."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from html_reader import Reader
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.path import Path

from bayescal.report.pictures import render_picture
from bayescal.report.svg import write_number, write_path

NUMBERS = {0.0: "0", 0.04: "0", -0.04: "0", 0.25: ".3", -0.5: "-.5", 10.0: "10", 10.14: "10.1", -100.0: "-100"}
N_NUMBERS = {"M": 2, "m": 2, "l": 2, "h": 1, "v": 1, "q": 4, "c": 6, "z": 0}


def read_path(data: str) -> np.ndarray:
    """Return the points of a path's data, as a browser reads them, shape (N, 2)."""
    points, pen, start = [], np.zeros(2), np.zeros(2)
    for letter, rest in re.findall(r"([A-Za-z])([^A-Za-z]*)", data):
        numbers = [float(one) for one in re.findall(r"-?(?:\d+\.?\d*|\.\d+)", rest)]
        if letter == "z":
            pen = start
            continue
        n = N_NUMBERS[letter]
        assert numbers
        assert len(numbers) % n == 0
        for k in range(0, len(numbers), n):
            some = numbers[k : k + n]
            moves = {"h": [some[0], 0.0], "v": [0.0, some[0]]}.get(letter, some)
            ends = np.reshape(moves, (-1, 2)) + (0.0 if letter == "M" else pen)
            points.extend(ends)
            pen = ends[-1]
            start = pen if letter in "Mm" else start
    return np.array(points)


@pytest.mark.parametrize(("value", "text"), NUMBERS.items())
def test_numbers_are_short(value, text):
    assert write_number(value) == text


def test_numbers_do_not_depend_on_a_layouts_last_digits():
    assert {write_number(12.25 + off) for off in (-1e-9, 0.0, 1e-9)} == {"12.3"}
    paths = (Path([(0.0, 0.0), (12.25 + off, 3.0)]).cleaned() for off in (-1e-9, 0.0, 1e-9))
    assert {write_path(one) for one in paths} == {"M0 0l12.3 3"}


def test_points_of_a_path_are_where_they_were_and_errors_do_not_add_up(rng):
    steps = rng.normal(0.0, 3.0, (5000, 2)) + 0.033
    path = Path(300.0 + np.cumsum(steps, axis=0))
    assert np.abs(read_path(write_path(path.cleaned())) - path.vertices).max() < 0.0501
    curves = [Path.MOVETO, *[Path.CURVE3] * 2, *[Path.CURVE4] * 3, Path.CLOSEPOLY, Path.MOVETO, Path.LINETO]
    path = Path(rng.normal(0.0, 3.0, (len(curves), 2)), curves)
    drawn = np.array(curves) != Path.CLOSEPOLY
    assert np.abs(read_path(write_path(path.cleaned(curves=True), 2)) - path.vertices[drawn]).max() < 0.00501


def test_what_draws_nothing_is_left_out():
    steps = Path([(0, 0), (1, 0), (3, 0), (3, 0), (3, 1), (3, 4), (2, 4)])
    assert write_path(steps.cleaned()) == "M0 0h3v4h-1"
    assert write_path(Path([(0, 0), (1, 1), (5, 5)], [1, 1, 1]).cleaned()) == ""
    assert write_path(Path([(1, 1), (1, 1)]).cleaned()) == "M1 1h0"  # a dot, where ends of lines are round


def show(draw: Callable[[Figure], None]) -> str:
    """Return a figure as it stands in a page, read as a browser does."""

    def make() -> Figure:
        figure = Figure(figsize=(4.0, 3.0))
        draw(figure)
        return figure

    markup = str(render_picture(make).place("a"))
    assert markup == str(render_picture(make).place("a"))
    ids = re.findall(r' id="([^"]+)"', markup)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', markup)) == set(ids)
    assert Reader(markup).open == []
    return markup


def draw_marks(figure: Figure) -> None:
    axes = figure.subplots()
    axes.scatter([1.0, 2.0, np.nan, 3.0], [1.0, 2.0, 2.0, 3.0], c=["red", "blue", "red", "red"])
    axes.scatter([1.0, 2.0], [3.0, 3.0], s=[10.0, 30.0])
    axes.scatter([2.0], [1.0])
    axes.plot([1.0, np.nan, 3.0], [2.5, 2.5, 2.5], "o-", label="line")


def test_every_mark_has_its_value():
    markup = show(draw_marks)
    titles = re.findall(r"<title>([^<]*)</title>", markup)
    assert titles == ["1; 1", "2; 2", "3; 3", "3; 1", "3; 2", "1; 2", "line; 2.5; 1", "line; 2.5; 3"]
    assert len(re.findall(r"<use [^>]*><title>", markup)) == 8


def test_shapes_beyond_the_axes_are_clipped_and_no_others():
    def draw(figure: Figure, most: float) -> None:
        axes = figure.subplots()
        axes.plot([0.0, 2.0], [1.0, 2.0])
        axes.set_xlim(-1.0, most)

    assert "clip-path" not in show(lambda figure: draw(figure, 3.0))
    markup = show(lambda figure: draw(figure, 1.0))
    assert re.findall(r' clip-path="url\(#([^"]*)\)"', markup) == re.findall(r'<clipPath id="([^"]*)"><rect ', markup)

    def draw_within_circle(figure: Figure) -> None:
        axes = figure.subplots()
        (line,) = axes.plot([0.0, 2.0], [1.0, 2.0])
        line.set_clip_path(Circle((1.0, 1.5), 0.5, transform=axes.transData))

    assert re.search(r'<clipPath id="[^"]*"><path d="M', show(draw_within_circle))


def test_pixels_hatches_dashes_and_mathematics_are_there():
    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        left.imshow([[0.0, 1.0], [1.0, 0.0]])
        right.bar([0, 1], [1.0, 2.0], hatch="//", alpha=0.5)
        right.plot([0.0, 1.0], "--", solid_joinstyle="miter", dash_capstyle="round")
        right.set_title("$a_{x}$")
        right.text(0.5, 0.5, "turned", rotation=30)

    markup = show(draw)
    for part in ("<image ", "<pattern ", "stroke-dasharray=", 'stroke-linecap="round"', ' opacity=".5"', "rotate(-30)"):
        assert part in markup, part
    assert re.search(r'<use href="#O\w+" transform="translate\([\d.-]+ [\d.-]+\)scale\(\.?\d+\)"/>', markup)


def test_meshes_contours_and_arrows_are_areas():
    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        figure.colorbar(left.pcolormesh(np.arange(6.0).reshape(2, 3)), ax=left)
        right.contourf(np.add.outer(np.arange(5.0) ** 2, np.arange(5.0)))
        right.annotate("here", (1.0, 1.0), (3.0, 3.0), arrowprops={"arrowstyle": "->"})

    markup = show(draw)
    filled = re.findall(r'<path d="([^"]*)" fill="(#\w+)"', markup)
    assert len({colour for _, colour in filled}) > 6 + 200  # of the mesh, and of the bar beside it


def test_texts_that_stand_twice_are_written_once():
    def draw(figure: Figure) -> None:
        figure.subplots()
        for at in (0.2, 0.4, 0.6):
            figure.text(0.1, at, "twice")
        figure.text(0.1, 0.8, "twice", color="red")

    markup = show(draw)
    uses = re.findall(r'<use href="#(a-t\d+)" x="[\d.]+" y="[\d.]+"/>', markup)
    assert sorted(Counter(uses).values())[-1] == 3
    assert markup.count('fill="red"') + markup.count('fill="#f00"') == 1


def test_what_svg_has_nothing_for_is_a_fine_png():
    def draw() -> Figure:
        figure = Figure(figsize=(4.0, 3.0))
        figure.subplots().tripcolor([0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 2.0, 3.0], shading="gouraud")
        return figure

    assert str(render_picture(draw).place("a")).startswith("<img ")
