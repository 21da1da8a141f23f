"""Writing a study's report: figures as PNG files and one self-contained HTML page."""

from __future__ import annotations

import base64
import re
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from bayescal.report.blocks import FigureBlock
from bayescal.report.context import ReportContext, build_context
from bayescal.report.illustrations import list_illustrations, render_png
from bayescal.report.results import Results, read_results
from bayescal.report.symbols import split_symbol

PAGE = "report.html"


def write_report(folder: Path) -> Path:
    """Write ``figures/*.png`` and ``report.html`` into a results directory, from that directory alone.

    Parameters
    ----------
    folder : Path
        Results of a study. Without its posterior files the figures that need draws are left out.

    Returns
    -------
    Path
        The page; it holds its figures and its style and refers to no other file.

    Raises
    ------
    InputError
        Where a file is missing or not what a study writes; nothing is written then.
    """
    results = read_results(folder)
    figures = _draw_figures(results, folder / "figures")
    page = folder / PAGE
    temporary = page.with_name(f"{PAGE}.tmp")
    temporary.write_text(render_page(build_context(results, figures)), encoding="utf-8")
    temporary.replace(page)
    return page


def _draw_figures(results: Results, folder: Path) -> dict[str, FigureBlock]:
    """Draw the figures that can be drawn; those of an earlier report that can no longer be drawn are removed."""
    folder.mkdir(exist_ok=True)
    blocks = {}
    for one in list_illustrations(results):
        path, source = folder / f"{one.name}.png", None
        if one.draw is None:
            path.unlink(missing_ok=True)
        else:
            image = render_png(one.draw)
            path.write_bytes(image)
            source = f"data:image/png;base64,{base64.b64encode(image).decode('ascii')}"
        blocks[one.name] = FigureBlock(one.name, one.caption, source, one.reason, one.section)
    for path in folder.glob("errors_*.png"):
        if path.stem not in blocks:
            path.unlink()
    return blocks


def render_page(context: ReportContext) -> str:
    """Return the report as HTML; all text is escaped."""
    here = Path(__file__).parent
    environment = Environment(
        loader=FileSystemLoader(here), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"symbol": set_symbol, "bind": bind_units, "prose": set_prose}
    style = Markup((here / "report.css").read_text(encoding="utf-8"))
    return environment.get_template("template.html").render(report=context, style=style)


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
