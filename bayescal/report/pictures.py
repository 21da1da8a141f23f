"""Figures as they stand in a page: SVG with the values of its points where that is smaller, else a fine PNG."""

from __future__ import annotations

import base64
import io
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from markupsafe import Markup, escape

from bayescal.report.figure_text import TIP, describe_figure, mark_points
from bayescal.report.style import RC
from bayescal.report.symbols import LONGEST_NAME, LONGEST_TEXT, make_label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI, FINE_DPI = 120, 192
POINTS = 72.0  # an inch
FINER = 2.2  # how much larger a PNG of twice the resolution is at most
HASHED = re.compile(r'( id="|href="#|url\(#)([a-z]+[0-9a-f]{10})(?=["\)])')  # ids of clips and marks in an SVG
LEAST_SCALE = 0.8  # of a figure on a small screen, which scrolls; letters of 6.5 points are read then


@dataclass(frozen=True)
class Picture:
    """A drawn figure."""

    png: bytes  # the figure as a file
    markup: str = ""  # as it stands in a page, escaped; without its name, see `place`
    failure: str = ""  # why there is none, where it could not be drawn

    def place(self, name: str) -> Markup:
        """Return the markup with the ids of its parts made the figure's own."""
        if self.failure:
            return escape(self.failure)
        ids = r'(\bid="|href="#|url\(#)'  # before them a name, which is letters, digits, _ and -
        return Markup(re.sub(ids, rf"\g<1>{name}-", self.markup))


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
        Canvas(figure)
        figure.set_dpi(DPI)
        _lay_out(figure)
        png = _save(figure, "png", DPI)
        return Picture(png, _make_markup(figure, FINER * len(png) * 4 / 3))


def _shorten(figure: Figure) -> None:
    """Cut a figure's texts, which others may have written, before their sizes are asked for."""
    from matplotlib.legend import Legend
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(formatter := axis.get_major_formatter(), FuncFormatter):  # names at ticks are one, too
                formatter.func = partial(_write_tick, formatter.func)
    names = {id(text) for one in figure.findobj(Legend) for text in one.get_texts()}
    for text in figure.findobj(Text):
        text.set_text(make_label(text.get_text(), LONGEST_NAME if id(text) in names else LONGEST_TEXT))


def _write_tick(write: Callable[[float, int | None], str], value: float, place: int | None = None) -> str:
    return make_label(str(write(value, place)), LONGEST_NAME)


def _make_markup(figure: Figure, most: float) -> str:
    """Return a laid-out figure as SVG, or beyond ``most`` bytes as a fine PNG if smaller."""
    width, height = figure.get_size_inches() * DPI
    alt, tips = describe_figure(figure), mark_points(figure)
    drawn = tidy_svg(_save(figure, "svg", POINTS).decode(), tips)
    size = f'width="{width:.0f}" height="{height:.0f}" style="min-width:{LEAST_SCALE * width:.0f}px"'
    if len(drawn) > most:
        fine = _save(figure, "png", FINE_DPI)
        if len(fine) * 4 / 3 < len(drawn):
            source = base64.b64encode(fine).decode("ascii")
            return Markup(f'<img {size} src="data:image/png;base64,{source}" alt="{escape(alt)}">')
    box = f"0 0 {width * POINTS / DPI:g} {height * POINTS / DPI:g}"
    return Markup(f'<svg {size} viewBox="{box}" role="img" aria-label="{escape(alt)}">{drawn}</svg>')


def _lay_out(figure: Figure) -> None:
    """Give a figure's panels their places for good; saving it would draw it once more to do so."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine("none")


def _save(figure: Figure, kind: str, dpi: float) -> bytes:
    buffer = io.BytesIO()
    nothing = {"Software": None} if kind == "png" else dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(buffer, format=kind, dpi=dpi, metadata=nothing)
    return buffer.getvalue()


def tidy_svg(text: str, tips: Mapping[str, list[str]]) -> str:
    """Return what is inside an SVG of matplotlib's whose text is drawn as glyphs, without what a page does not need.

    ``tips`` has by the id of a group what its marks stand for.
    """
    inside = text[text.index(">", text.index("<svg")) + 1 : text.rindex("</svg>")]
    inside = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>|<style[^>]*>.*?</style>", "", inside, flags=re.DOTALL)
    inside = re.sub(r' (?:d|x|y)="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), inside)
    inside = re.sub(r"\s*\n\s*", "\n", inside).replace("; ", ";").replace(": ", ":")
    used = set(re.findall(r'href="#([^"]+)"', inside)) | set(re.findall(r"url\(#([^)]+)\)", inside)) | set(tips)
    inside = re.sub(r' id="([^"]+)"', lambda found: found[0] if found[1] in used else "", inside)
    # matplotlib names clips and marks by a hash of floats, whose last digits the layout does not repeat
    numbers: dict[str, str] = {}
    inside = re.sub(HASHED, lambda found: found[1] + numbers.setdefault(found[2], f"s{len(numbers)}"), inside)
    for name, texts in tips.items():
        inside = _insert_tips(inside, name, texts)
    return inside.replace("<defs>\n</defs>\n", "").strip()


def _insert_tips(inside: str, name: str, texts: list[str]) -> str:
    """Return the SVG with a title in each mark of a group; none where its marks are not one for each text."""
    mark = f'<g id="{name}">'
    begin = inside.find(mark)
    if begin < 0:
        return inside
    end = _find_end(inside, begin)
    group = inside[begin + len(mark) : end]
    titles = [f"<title>{escape(text)}</title>" for text in texts]
    uses = re.findall(r"<use [^>]*/>", group)
    if len(texts) == 1 and len(uses) != 1:
        group = f"{titles[0]}{group}"
    elif len(uses) == len(texts):
        left = iter(titles)
        group = re.sub(r"<use ([^>]*)/>", lambda found: f"<use {found[1]}>{next(left)}</use>", group)
    return f'{inside[:begin]}<g class="{TIP.rstrip("-")}">{group}{inside[end:]}'


def _find_end(text: str, begin: int) -> int:
    """Return where the group that begins there closes."""
    depth = 0
    for found in re.finditer(r"<g[ >]|</g>", text[begin:]):
        depth += -1 if found[0] == "</g>" else 1
        if depth == 0:
            return begin + found.start()
    return len(text)
