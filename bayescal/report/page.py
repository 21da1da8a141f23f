"""Setting a page: templates, the text filters they use, and figures as PNG files and inside the page."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.figure import Figure

from bayescal.report.blocks import FigureBlock
from bayescal.report.style import RC
from bayescal.report.symbols import split_symbol

DPI = 120


@dataclass(frozen=True)
class Illustration:
    """A figure to draw, or the reason why it cannot be drawn; ``section`` is where it belongs."""

    name: str
    caption: str
    draw: Callable[[], Figure] | None
    reason: str = ""
    section: str = ""


def render_png(draw: Callable[[], Figure]) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with rc_context(RC):  # type: ignore[arg-type]  # its keys are a literal type of three hundred names
        draw().savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def draw_figures(illustrations: Sequence[Illustration], folder: Path) -> dict[str, FigureBlock]:
    """Draw the figures that can be drawn; those of an earlier report that can no longer be drawn are removed."""
    folder.mkdir(exist_ok=True)
    blocks = {}
    for one in illustrations:
        path, source = folder / f"{one.name}.png", None
        if one.draw is None:
            path.unlink(missing_ok=True)
        else:
            image = render_png(one.draw)
            path.write_bytes(image)
            source = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
        blocks[one.name] = FigureBlock(one.name, one.caption, source, one.reason, one.section)
    return blocks


def render_template(
    template: str, prose: Callable[[str], Markup], styles: Sequence[str] = ("report.css",), **values: Any
) -> str:
    """Return a page as HTML; all text is escaped.

    Parameters
    ----------
    template : str
        Name of a template beside this module.
    prose : callable
        Sets running text.
    styles : sequence of str
        Names of style sheets beside this module.
    **values
        What the template shows.
    """
    here = Path(__file__).parent
    environment = Environment(
        loader=FileSystemLoader(here), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"symbol": set_symbol, "bind": bind_units, "prose": prose}
    style = Markup("".join((here / name).read_text(encoding="utf-8") for name in styles))
    return environment.get_template(template).render(style=style, **values)


def write_page(page: Path, text: str) -> Path:
    """Write a page so that it is there whole or not at all."""
    temporary = page.with_name(f"{page.name}.tmp")
    temporary.write_text(text, encoding="utf-8")
    return temporary.replace(page)


def bind_units(text: str) -> str:
    """Return text in which no line breaks between a number and its unit."""
    return re.sub(r"(?<=[\d=τ]) (?=%|µm|nm\b|mm\b|mdeg\b|nat\b|[0=±])", "\u00a0", text)


def set_prose(text: str) -> Markup:
    """Return running text with units bound to their numbers and symbols such as ``a_x`` and ``ρ^0`` set as such."""
    escaped = str(escape(bind_units(text)))
    lowered = re.sub(r"(?<![\w&#])(Δ?[A-Za-zα-ω])_([A-Za-z0-9]{1,2})(?!\w)", r"<i>\1</i><sub>\2</sub>", escaped)
    return Markup(re.sub(r"(?<![\w&#])([A-Za-zα-ω])\^([A-Za-z0-9])(?!\w)", r"<i>\1</i><sup>\2</sup>", lowered))


def set_symbol(symbol: str) -> Markup:
    """Return a parameter's symbol with its subscript and superscript set as such."""
    head, below, above = split_symbol(symbol)
    text = Markup("<i>{}</i>").format(head) if head != symbol or head.isalpha() else escape(symbol)
    lower = Markup("<sub>{}</sub>").format(below) if below else ""
    upper = Markup("<sup>{}</sup>").format(above) if above else ""
    return Markup("{}{}{}").format(text, lower, upper)
