"""Setting a page: the template, the text filters it uses, and figures as PNG files and inside the page."""

from __future__ import annotations

import base64
import gc
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from markupsafe import Markup, escape

from bayescal.errors import InputError
from bayescal.files.atomic import write_atomically
from bayescal.report.blocks import (
    MAX_FAILURES_FIRST,
    Column,
    Fold,
    Page,
    PageSection,
    Preformatted,
    Side,
    Statement,
    Table,
    choose_first,
    make_pairs,
    make_table,
    unfold,
)
from bayescal.report.glossary import find_terms
from bayescal.report.numbers import NO_VALUE
from bayescal.report.pictures import Picture, define_glyphs, render_picture
from bayescal.report.scene import Scene
from bayescal.report.symbols import split_symbol

PAGE = "report.html"
FIGURES = "figures"
MOST_GARBAGE = 50_000  # objects, while a page is made; collections of the usual 700 take an eighth of its time


def is_of_page(name: str) -> bool:
    """Whether a file of a results directory is its page or a figure of it, which are made from the other files."""
    return name == PAGE or name.startswith(f"{FIGURES}/")


FIGURE = re.compile(rf"{FIGURES}/[A-Za-z0-9_-]+\.png")
CODE = re.compile(r"`([^`]+)`")
SUBSCRIPT = re.compile(r"(?<![\w&#;.])(Δ?[A-Za-zα-ω])_([A-Za-z0-9]{1,2})(?!\w)")
SUPERSCRIPT = re.compile(r"(?<![\w&#])([A-Za-zα-ω])\^([A-Za-z0-9])(?!\w)")


type Render = Callable[[Mapping[str, Callable[[], Picture]]], Mapping[str, Picture]]

RUN = {
    "kind": "Kind of experiment",
    "name": "Experiment",
    "config_sha256": "SHA-256 of config and inputs",
    "seed": "Seed",
    "python": "Python",
    "platform": "Platform",
}


@contextmanager
def collect_seldom() -> Iterator[None]:
    """Let garbage wait longer for its collection: figures consist of many small objects, most of which stay."""
    usual = gc.get_threshold()
    if 0 < usual[0] < MOST_GARBAGE:
        gc.set_threshold(MOST_GARBAGE, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)


def draw_in_turn(calls: Mapping[str, Callable[[], Picture]]) -> dict[str, Picture]:
    """Return what draws pictures gives, by their names."""
    return {name: call() for name, call in calls.items()}


@collect_seldom()
def write_page(
    page: Page,
    folder: Path,
    more: Sequence[PageSection] = (),
    earlier: Iterable[str] = (),
    render: Render = draw_in_turn,
) -> Path:
    """Write ``figures/*.png`` and ``report.html`` into a results directory.

    InputError where the folder of the figures is a link.

    Parameters
    ----------
    page : Page
    folder : Path
    more : sequence of Section
        Stand after the page's own, such as where the results come from.
    earlier : iterable of str
        Files that an earlier page wrote there; those of its figures that this one does not show are removed.
    render : callable
        Draws pictures of several names, side by side for instance.

    Returns
    -------
    Path
        The page; it holds its figures and its style and refers to no other file.
    """
    drawn = {one.name: one.draw for one in page.figures() if one.draw is not None}
    pictures = render({name: partial(render_picture, draw) for name, draw in drawn.items()})
    failed = tuple(Statement(one.failure, "bad") for one in pictures.values() if one.failure)
    text = render_page(page.add_failures(failed), pictures, more)
    figures = folder / FIGURES
    if figures.is_symlink():
        raise InputError(f"{figures}: found a link, expected a directory")
    for name in set(earlier) - {f"{FIGURES}/{name}.png" for name, picture in pictures.items() if picture.png}:
        if FIGURE.fullmatch(name):
            (folder / name).unlink(missing_ok=True)
    for name, picture in pictures.items():
        if not picture.png:  # it could not be drawn
            continue
        figures.mkdir(exist_ok=True)
        write_atomically(figures / f"{name}.png", picture.png)
    write_atomically(folder / PAGE, text.encode())
    return folder / PAGE


def render_page(page: Page, pictures: Mapping[str, Picture], more: Sequence[PageSection] = ()) -> str:
    """Return a page as HTML with these figures by name; all text is escaped, and nothing but its own script runs."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    here = Path(__file__).parent
    environment = Environment(
        loader=FileSystemLoader(here), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"symbol": set_symbol, "bind": bind_units, "prose": make_prose(page.symbols)}
    environment.globals |= {"first_findings": choose_first, "find_terms": find_terms}
    environment.globals["max_failures"] = MAX_FAILURES_FIRST
    style = Markup((here / "page.css").read_text(encoding="utf-8"))
    blocks = [block for section in (*page.sections, *more) for block in section.blocks]
    scripts = ("page.js", "scene.js") if any(isinstance(one, Scene) for one in unfold(blocks)) else ("page.js",)
    script = Markup("\n".join((here / name).read_text(encoding="utf-8") for name in scripts))
    sections = [(one.anchor or f"section-{k}", one) for k, one in enumerate((*page.sections, *more), start=1)]
    return environment.get_template("page.html").render(
        style=style,
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii"),
        page=page,
        sections=sections,
        pictures={name: picture.place(f"f{k}", alone=False) for k, (name, picture) in enumerate(pictures.items())},
        glyphs=define_glyphs(pictures.values()),
    )


# --- text --------------------------------------------------------------------------------------------------------


def bind_units(text: str) -> str:
    """Return text in which no line breaks between a number and its unit."""
    return re.sub(r"(?<=[\d=τ]) (?=%|µm|nm\b|mm\b|nat\b|[0=±])", "\u00a0", text)


def make_prose(symbols: Sequence[str] = ()) -> Callable[[str], Markup]:
    """Return what sets running text: escaped, units bound to their numbers, symbols as the field writes them.

    Parameters such as ``kappa`` are set wherever they stand, with a leg's number as in ``a_z[3]``; others such as
    ``u_z`` and ``ρ^0`` are set by their subscripts and superscripts alone.
    """
    alternatives = "|".join(re.escape(str(escape(s))) for s in sorted(symbols, key=len, reverse=True))
    pattern = re.compile(rf"(?<![\w&#;.])({alternatives})(?:\[(\d+)\])?(?![\w\[])") if alternatives else None

    def replace(found: re.Match[str]) -> str:
        symbol = str(set_symbol(found[1]))
        if not found[2]:
            return symbol
        within = symbol.endswith("</sub>")
        return f"{symbol.removesuffix('</sub>')},{found[2]}</sub>" if within else f"{symbol}<sub>{found[2]}</sub>"

    def prose(text: str) -> Markup:
        marked = CODE.sub(r"<code>\1</code>", str(escape(bind_units(text))))
        if pattern is not None:
            marked = pattern.sub(replace, marked)
        lowered = SUBSCRIPT.sub(r"<i>\1</i><sub>\2</sub>", marked)
        return Markup(SUPERSCRIPT.sub(r"<i>\1</i><sup>\2</sup>", lowered))

    return prose


def set_symbol(symbol: str) -> Markup:
    """Return a parameter's symbol with its subscript and superscript set as such."""
    head, below, above = split_symbol(symbol)
    text = Markup("<i>{}</i>").format(head) if head != symbol or head.isalpha() else escape(symbol)
    lower = Markup("<sub>{}</sub>").format(below) if below else ""
    upper = Markup("<sup>{}</sup>").format(above) if above else ""
    return Markup("{}{}{}").format(text, lower, upper)


def show_provenance(provenance: Mapping[str, object]) -> PageSection:
    """Return the section that says what run, of which config and files, with which versions, made the results."""
    rows = [[title, str(provenance.get(key, NO_VALUE))] for key, title in RUN.items()]
    mappings = (
        _tabulate(provenance.get("versions"), "Versions.", "Package", "Version"),
        _tabulate(provenance.get("files"), "Input files.", "File", "SHA-256"),
        _tabulate(provenance.get("modules"), "Modules of others' classes.", "Module", "SHA-256"),
    )
    side = Side(tuple(table for table in mappings if table.rows))
    config = Preformatted(format_config(provenance.get("config", {})))
    return PageSection("Provenance", (make_pairs("Run.", rows), side, Fold("Config", (config,))), anchor="provenance")


def _tabulate(content: object, caption: str, key: str, value: str) -> Table:
    rows = [[str(k), str(v)] for k, v in content.items()] if isinstance(content, dict) else []
    return make_table(caption, [Column(key, kind="name"), Column(value, kind="name")], rows)


def format_config(value: object, indent: str = "") -> str:
    """Return JSON, indented; what holds no lists or objects stands on one line."""
    inner = f"{indent}  "
    if isinstance(value, dict) and any(isinstance(one, dict | list) for one in value.values()):
        lines = [f"{inner}{json.dumps(key)}: {format_config(one, inner)}" for key, one in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        lines = [f"{inner}{format_config(one, inner)}" for one in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)
