"""A page of the kit: whole, self-contained, escaped, and the same whenever it is written."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import struct
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from html_reader import Reader, leave_out_script
from matplotlib import rc_context
from matplotlib.figure import Figure as Drawing

from bayescal.errors import InputError
from bayescal.report import page as setting
from bayescal.report.blocks import (
    Absent,
    Block,
    Card,
    Cell,
    Column,
    Counts,
    Definitions,
    Figure,
    Fold,
    Heading,
    KeyFigure,
    Page,
    PageSection,
    Preformatted,
    Side,
    Statement,
    choose_first,
    count_sentences,
    make_table,
)
from bayescal.report.page import format_config, make_prose, render_page, set_symbol, show_provenance, write_page
from bayescal.report.pictures import Picture, render_picture
from bayescal.report.scene import Scene, SceneLine, ScenePoint, choose_magnification

pytestmark = pytest.mark.usefixtures("pictures")

WICKED = "<script>alert(1)</script> & O1 at 3 µm"
ESCAPED = "&lt;script&gt;alert(1)&lt;/script&gt; &amp; O1 at 3"
COLUMNS = (Column("O1", group="published"), Column("O1", group="found"))
WICKED_TABLE = make_table(WICKED, COLUMNS, [["0.0357", WICKED]], [Statement(WICKED, "warning")])


def draw() -> Drawing:
    drawing = Drawing(figsize=(2.0, 1.0))
    drawing.subplots().plot([0.0, 1.0], [0.0, 1.0])
    return drawing


def make_page(*blocks: Block, level="good", finding=WICKED, lead="Found") -> Page:
    section = PageSection("Table <1>", (WICKED, WICKED_TABLE, *blocks, Statement(WICKED, "bad")))
    verdict = (Statement(finding, level, lead),)
    return Page("Kind", WICKED, WICKED, WICKED, WICKED, verdict, (section,), (("Machine", WICKED),))


def test_page_holds_everything_it_shows(tmp_path):
    path = write_page(make_page(Figure("a", WICKED, draw), Fold("More", (Figure("b", "b", draw),))), tmp_path)
    text = path.read_text(encoding="utf-8")
    assert path == tmp_path / "report.html"
    assert {one.name for one in tmp_path.iterdir()} == {"report.html", "figures"}
    assert {one.name for one in (tmp_path / "figures").iterdir()} == {"a.png", "b.png"}
    assert (tmp_path / "figures/a.png").read_bytes() == render_picture(draw).png
    assert render_picture(draw).png.startswith(b"\x89PNG")
    assert len(re.findall(r'<svg [^>]*role="img"', text)) == 2
    reader = Reader(text)
    assert reader.open == []
    assert all(reference.startswith(("#", "data:")) for reference in reader.references)
    assert not re.search(r"url\((?!#)|@import|src=\"(?!data:)", text)
    assert '<th colspan="1" scope="colgroup" class="group">published</th>' in text
    assert ">0.0357<" in text
    assert not re.search(r"\{\{|\{%", text)


def test_all_text_is_escaped(tmp_path):
    text = write_page(make_page(Figure("a", WICKED, draw)), tmp_path).read_text(encoding="utf-8")
    assert text.count("<script") == 1
    assert "<1>" not in text
    # heading, name, fact, origin, headline, finding, paragraph, caption, cell, two notes, the figure's caption, title
    assert text.count(ESCAPED) == 13


@pytest.mark.parametrize(
    ("block", "times"),
    [
        (Fold(WICKED, (WICKED,)), 2),
        (Heading(WICKED), 1),
        (Absent(WICKED), 1),
        (Counts(WICKED, (Cell(WICKED),)), 2),
        (Preformatted(WICKED), 1),
        (Definitions(((WICKED, WICKED),)), 2),
        (Side((WICKED_TABLE,)), 3),
        (Card("a", WICKED, (Cell(WICKED),), WICKED, (WICKED,), WICKED, (WICKED,)), 6),
        (Figure("b", "", None, WICKED), 1),
        (replace(WICKED_TABLE, headings={0: WICKED}), 4),
        (make_table("", COLUMNS, [[Cell(WICKED, badge=True), Cell("")]]), 1),
        (make_table("", [Column("", kind="text")], [[Cell(WICKED, more=WICKED)]]), 2),
    ],
    ids=lambda value: type(value).__name__,
)
def test_text_of_every_block_is_shown_and_escaped(block, times):
    without, text = render_page(make_page(), {}), render_page(make_page(block), {})
    assert text.count("<script") == 1
    assert text.count(ESCAPED) == without.count(ESCAPED) + times
    assert Reader(text).open == []


def test_failures_stand_before_the_headline():
    failed = replace(make_page(), failures=(Statement(WICKED, "bad"),))
    text = render_page(failed, {})
    assert 'class="verdict bad"' in text
    places = [text.index(word) for word in ("Not reliable:", f"<li>{ESCAPED}", 'class="headline"')]
    assert places == sorted(places)


def test_links_of_the_page_lead_somewhere(tmp_path):
    more = PageSection("Provenance", (), anchor="provenance")
    text = write_page(make_page(), tmp_path, [more]).read_text(encoding="utf-8")
    targets = re.findall(r'href="#([^"]*)"', text)
    assert targets == ["verdict", "section-1", "provenance", "glossary"]
    assert all(f'id="{target}"' in text for target in targets)
    assert not (tmp_path / "figures").exists()


@pytest.mark.parametrize("level", ["good", "plain", "warning", "bad"])
def test_the_verdict_is_as_good_as_its_worst_finding(level):
    text = render_page(make_page(level=level, finding="It is so", lead="Lead"), {})
    assert f'class="verdict {level}"' in text
    assert f'<li class="{level}"><strong>Lead.</strong> It is so</li>' in text


def test_the_first_row_has_figures_with_units_and_colours():
    text = render_page(replace(make_page(), key_figures=(KeyFigure(WICKED, WICKED, WICKED, "warning"),)), {})
    (row,) = re.findall(r'<dl class="key-figures">(.*?)</dl>', text, re.DOTALL)
    assert row.count('<div class="warning">') == 1
    assert unescape(row).count(unescape(ESCAPED)) == 3


def test_same_page_gives_same_bytes(tmp_path):
    contents = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        write_page(make_page(Figure("a", "A", draw)), tmp_path / name)
        contents.append([(tmp_path / name / part).read_bytes() for part in ("report.html", "figures/a.png")])
    assert contents[0] == contents[1]
    assert not any(mark in contents[0][1] for mark in (b"Software", b"tEXtDate"))


def test_figures_of_an_earlier_page_are_removed(tmp_path):
    (tmp_path / "figures").mkdir()
    for name in ("old", "mine"):
        (tmp_path / "figures" / f"{name}.png").write_bytes(b"")
    write_page(make_page(Figure("a", "A", draw)), tmp_path, earlier=["figures/old.png", "figures/a.png", "table.csv"])
    assert {one.name for one in (tmp_path / "figures").iterdir()} == {"a.png", "mine.png"}


def test_nothing_is_written_through_links(tmp_path):
    folder, other = tmp_path / "results", tmp_path / "other"
    (folder / "figures").mkdir(parents=True)
    other.write_bytes(b"precious")
    for name in ("report.html", "report.html.tmp", "figures/a.png"):
        (folder / name).symlink_to(other)
    write_page(make_page(Figure("a", "A", draw)), folder)
    assert other.read_bytes() == b"precious"
    assert "<html" in (folder / "report.html").read_text()
    elsewhere = tmp_path / "elsewhere"
    (folder / "figures").rename(elsewhere)
    (folder / "figures").symlink_to(elsewhere)
    with pytest.raises(InputError, match="a link"):
        write_page(make_page(Figure("b", "B", draw)), folder)
    assert not (elsewhere / "b.png").exists()


def test_a_figure_is_the_same_whatever_matplotlibrc_says():
    plain = render_picture(draw)
    with rc_context({"text.usetex": True, "axes.facecolor": "red", "figure.figsize": (2, 2)}):
        assert render_picture(draw) == plain


def test_figures_need_names_of_their_own():
    with pytest.raises(ValueError, match=r"figure 'a' .*twice"):
        make_page(Figure("a", "", draw), Fold("", (Figure("a", "", draw),)))
    with pytest.raises(ValueError, match=r"figure '\.\./a':"):
        Figure("../a", "", draw)


def test_provenance_without_input_files_shows_no_empty_table():
    section = show_provenance({"versions": {"numpy": "2.0"}, "files": {}})
    tables = next(block.tables for block in section.blocks if isinstance(block, Side))
    assert [table.caption for table in tables] == ["Versions."]


def test_what_is_folded_on_screen_is_open_in_print():
    style = (Path(setting.__file__).parent / "page.css").read_text(encoding="utf-8")
    print_rules = style[style.index("@media print") :]
    assert re.search(r"details::details-content \{[^}]*content-visibility: visible;[^}]*\}", print_rules)


# --- figures and verdicts --------------------------------------------------------------------------------------------


def test_a_figure_tells_its_values_and_what_is_seen():
    def bars() -> Drawing:
        drawing = Drawing(figsize=(3.0, 1.0))
        axes = drawing.subplots()
        axes.barh([0, 1], [3.0, 8.6])
        axes.plot([1.0, 2.0], [0, 1], "D", label="τ = 0")
        axes.set_yticks([0, 1], ["six_pus", "<beam>"])
        axes.set_xlabel("Error (µm)")
        return drawing

    picture = render_picture(bars)
    markup = picture.place("errors")
    assert markup.startswith("<svg ")
    assert "<title>&lt;beam&gt;; Error (µm) 8.6</title>" in markup
    assert "<title>τ = 0; six_pus; Error (µm) 1</title>" in markup
    label = r'aria-label="[^"]*Error \(µm\)[^"]* 0 to 9;[^"]*six_pus and &lt;beam&gt;;[^"]*τ = 0\."'
    assert re.search(label, markup)
    ids = re.findall(r' id="([^"]+)"', markup)
    assert ids
    assert all(one.startswith("errors-") or one in picture.glyphs for one in ids)
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', markup)) <= set(ids)
    assert Reader(markup).open == []


def find_ids(text: str) -> tuple[list[str], set[str]]:
    """Return the ids of a page's pictures, and what they refer to."""
    drawn = "".join(re.findall(r"<svg.*?</svg>", text, re.DOTALL))
    return re.findall(r' id="([^"]+)"', drawn), set(re.findall(r'(?:href="#|url\(#)([^")]+)', drawn))


def test_pictures_of_a_page_share_their_glyphs(tmp_path):
    text = write_page(make_page(*(Figure(name, "", draw) for name in "abc")), tmp_path).read_text(encoding="utf-8")
    ids, used = find_ids(text)
    every = re.findall(r' id="([^"]+)"', leave_out_script(text))
    assert len(every) == len(set(every))
    assert set(ids) == used  # everything that is defined is drawn, and the other way round
    glyphs = render_picture(draw).glyphs
    assert glyphs
    assert all(text.count(glyph) == 1 for glyph in glyphs.values())
    alone = render_picture(draw).place("a")
    ids, used = find_ids(alone)
    assert used == set(ids) >= set(glyphs)


def test_a_picture_of_pixels_needs_no_glyphs():
    page = make_page(Figure("a", "", draw))
    assert 'class="glyphs"' in render_page(page, {"a": render_picture(draw)})
    assert 'class="glyphs"' not in render_page(page, {"a": Picture(b"", "<img>")})
    assert 'class="glyphs"' not in render_page(make_page(), {})


def test_a_cloud_that_is_smaller_as_pixels_is_a_fine_png():
    def cloud() -> Drawing:
        drawing = Drawing(figsize=(2.0, 1.0))
        drawing.subplots().plot(*np.random.default_rng(1).standard_normal((2, 4000)), ".")
        return drawing

    picture = render_picture(cloud)
    assert picture.markup.startswith('<img width="240" height="120"')
    data = re.search(r'src="data:image/png;base64,([^"]+)" alt="', picture.markup)
    assert data is not None
    assert base64.b64decode(data[1])[16:24] == struct.pack(">II", 384, 192)


def test_few_sentences_are_seen_at_first_the_bad_ones_among_them():
    levels = ["plain"] * 8 + ["good", "warning", "good", "bad"]
    findings = tuple(Statement(str(k), level) for k, level in enumerate(levels))
    page = replace(make_page(), verdict=findings)
    shown, folded = choose_first(page)
    assert [one.text for one in shown] == ["0", "1", "2", "3", "4", "9", "11"]  # and the headline
    assert len(shown) + len(folded) == len(findings)
    assert f"<summary>{len(folded)} more findings" in render_page(page, {})
    several = replace(page, headline="One. Two. Three.", failures=(Statement("Four", "bad"),) * 9)
    assert [one.text for one in choose_first(several)[0]] == ["9", "11"]


@pytest.mark.parametrize(
    ("text", "n"), [("", 0), ("One", 1), ("x = 0.3 mm.", 1), ("One (eq. 6). Two.", 2), ("P > 0.9. “Best” is first.", 2)]
)
def test_sentences_are_counted(text, n):
    assert count_sentences(text) == n


def test_terms_that_a_page_uses_are_explained_at_its_end():
    text = render_page(make_page("The posterior's sd is 0.5 nat wide."), {})
    listed = re.findall(r'<dt data-words="([^"|]+)', text)
    assert listed == sorted(listed, key=str.lower)
    assert {"posterior", "sd", "nat"} <= set(listed)
    assert "R-hat" not in listed


def test_nothing_runs_but_the_pages_own_script():
    text = render_page(make_page(), {})
    script = re.search(r"<script>(.*)</script>", text, re.DOTALL)
    assert script is not None
    digest = base64.b64encode(hashlib.sha256(script[1].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text
    assert "default-src 'none'" in text
    assert len(script[1]) < 15_000


# --- machines in space -----------------------------------------------------------------------------------------------


def make_scene() -> Scene:
    points = [ScenePoint(f"<b> {k}", "base", ((100.0 * k, 0.0, 10.0), (0.0, 50.0 * k, 0.0))) for k in range(3)]
    points[1] = replace(points[1], offset=(0.5, 0.0, 0.0))
    lines = (SceneLine((0, 1, 2), "base", closed=True),)
    return Scene("machine", "Turn it.", WICKED, tuple(points), lines, ("home", "<P1>"), (("a", (0, 1)),), 20.0)


def test_a_machine_can_be_turned_and_is_seen_without_a_script():
    text = render_page(make_page(make_scene()), {})
    assert re.search(r"<b> 1: 100, 0, 10 mm;.* 0\.5, 0, 0 mm", unescape(text))
    assert text.count('class="moved"') == 1
    data = re.search(r'data-scene="([^"]+)"', text)
    assert data is not None
    content = json.loads(unescape(data[1]))
    assert content["poses"] == ["home", "<P1>"]
    assert content["points"][1]["offset"] == [0.5, 0.0, 0.0]
    assert "svg[data-scene]" not in render_page(make_page(), {})
    assert len((Path(setting.__file__).parent / "scene.js").read_bytes()) < 15_000


def test_offsets_are_magnified_to_be_seen():
    assert choose_magnification(make_scene().points) == 50.0
    assert choose_magnification([ScenePoint("a", "base", ((0.0, 0.0, 0.0),))]) == 0.0


# --- text ------------------------------------------------------------------------------------------------------------


def test_symbols_are_set_with_sub_and_superscripts():
    assert set_symbol("a_x") == "<i>a</i><sub>x</sub>"
    assert set_symbol("kappa") == "<i>κ</i>"
    assert set_symbol("rho0") == "<i>ρ</i><sup>0</sup>"
    assert set_symbol("s0") == "<i>s</i><sub>0</sub>"
    assert set_symbol("<b>") == "&lt;b&gt;"


def test_symbols_in_running_text_are_set_and_all_else_is_escaped():
    prose = make_prose()
    assert prose("a_x of 3 mm & ρ^0") == "<i>a</i><sub>x</sub> of 3\u00a0mm &amp; <i>ρ</i><sup>0</sup>"
    assert prose("table_5 six_pus k_12") == "table_5 six_pus <i>k</i><sub>12</sub>"
    assert prose("<b> a_b>") == "&lt;b&gt; <i>a</i><sub>b</sub>&gt;"


def test_the_config_is_shown_as_it_was_given():
    config = {"a": [1, 2], "b": {"c": [{"d": "x [ y ]"}, 0.5], "e": {}}, "f": []}
    assert json.loads(format_config(config)) == config
