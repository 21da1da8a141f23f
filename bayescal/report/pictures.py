"""Figures as they stand in a page: SVG with the values of its points where that is smaller, else a fine PNG."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from bayescal.report.figure_text import describe_figure, mark_points
from bayescal.report.style import RC
from bayescal.report.symbols import LONGEST_NAME, LONGEST_TEXT, make_label

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

DPI, FINE_DPI = 120, 192
POINTS = 72.0  # an inch
OWN = "\0"  # what the ids of a figure's own parts begin with until it has its place
FINER = 2.2  # how much larger a PNG of twice the resolution is at most
LEAST_SCALE = 0.8  # of a figure on a small screen, which scrolls; letters of 6.5 points are read then


@dataclass(frozen=True)
class Picture:
    """A drawn figure."""

    png: bytes  # the figure as a file
    markup: str = ""  # as it stands in a page, escaped; without its name and its glyphs, see `place`
    failure: str = ""  # why there is none, where it could not be drawn
    glyphs: Mapping[str, str] = field(default_factory=dict)  # definitions by the ids that the markup refers to

    def place(self, name: str, alone: bool = True) -> Markup:
        """Return the markup with the ids of its parts made the figure's own.

        Its glyphs are with it where it stands ``alone``; figures of a page share those of `define_glyphs`.
        """
        if self.failure:
            return escape(self.failure)
        markup = self.markup.replace(OWN, f"{name}-")
        if alone and self.glyphs:
            head, inside = markup.split(">", 1)
            markup = f"{head}><defs>{''.join(self.glyphs.values())}</defs>{inside}"
        return Markup(markup)


def define_glyphs(pictures: Iterable[Picture]) -> Markup:
    """Return an SVG that shows nothing and defines the glyphs of all pictures once; empty where there are none."""
    glyphs = {name: glyph for picture in pictures for name, glyph in picture.glyphs.items()}
    defined = "".join(glyphs[name] for name in sorted(glyphs))
    return Markup(f'<svg class="glyphs" aria-hidden="true"><defs>{defined}</defs></svg>' if defined else "")


def render_picture(draw: Callable[[], Figure]) -> Picture:
    """Return a figure as PNG and as it stands in a page; the same figure gives the same bytes."""
    from matplotlib import rc_context, rcdefaults, rcParams  # a second to import, for those who draw

    from bayescal.report.canvas import Canvas

    with rc_context(), warnings.catch_warnings():
        for said in (
            "Glyph .* missing",
            "constrained_layout not applied",
        ):  # of names that others chose
            warnings.filterwarnings("ignore", said)
        rcdefaults()  # whatever somebody's matplotlibrc says
        rcParams.update(RC)  # type: ignore[arg-type]  # its keys are a literal type of three hundred names
        figure = draw()
        _shorten(figure)
        canvas = Canvas(figure)
        figure.set_dpi(DPI)
        _lay_out(figure)
        png, svg = canvas.draw_both(mark_points(figure))
        width, height = figure.get_size_inches() * DPI
        size = f'width="{width:.0f}" height="{height:.0f}" style="min-width:{LEAST_SCALE * width:.0f}px"'
        alt, inside = escape(describe_figure(figure)), svg.write()
        if not svg.is_whole or len(inside) > FINER * len(png) * 4 / 3:
            figure.set_dpi(FINE_DPI)
            fine = canvas.save()
            if not svg.is_whole or len(fine) * 4 / 3 < len(inside):
                source = base64.b64encode(fine).decode("ascii")
                return Picture(png, f'<img {size} src="data:image/png;base64,{source}" alt="{alt}">')
        box = f'viewBox="0 0 {width * POINTS / DPI:g} {height * POINTS / DPI:g}"'
        drawn = f'<svg {size} {box} fill="none" stroke-linejoin="round" role="img" aria-label="{alt}">{inside}</svg>'
        return Picture(png, drawn, glyphs=svg.glyphs)


def _shorten(figure: Figure) -> None:
    """Cut a figure's texts, which others may have written, before their sizes are asked for."""
    from matplotlib.axis import Axis
    from matplotlib.legend import Legend
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter

    left: list[Artist] = [figure]
    names = set[int]()
    while left:
        one = left.pop()
        if isinstance(one, Text):
            one.set_text(make_label(one.get_text(), LONGEST_NAME if id(one) in names else LONGEST_TEXT))
        elif isinstance(one, Axis):  # texts at its ticks are made by its formatter
            if isinstance(formatter := one.get_major_formatter(), FuncFormatter):  # names at ticks are one, too
                formatter.func = partial(_write_tick, formatter.func)
            left += [one.label, one.offsetText]
            continue
        elif isinstance(one, Legend):
            names |= {id(text) for text in one.get_texts()}
        left += one.get_children()


def _write_tick(write: Callable[[float, int | None], str], value: float, place: int | None = None) -> str:
    return make_label(str(write(value, place)), LONGEST_NAME)


def _lay_out(figure: Figure) -> None:
    """Give a figure's panels their places for good; saving it would draw it once more to do so."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")
