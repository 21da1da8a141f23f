"""The page of a small experiment: whole, self-contained, escaped, and the same whenever it is written."""

from __future__ import annotations

import re

import pytest
from matplotlib.figure import Figure

from bayescal.report.blocks import Column, Statement, make_table
from bayescal.report.experiment_page import ExperimentPage, PageFigure, PageSection, write_experiment_page

WICKED = "<script>alert(1)</script> & O1 at 3 µm"
ESCAPED = "&lt;script&gt;alert(1)&lt;/script&gt; &amp; O1 at 3"


def draw() -> Figure:
    figure = Figure(figsize=(2.0, 1.0))
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
    return figure


def make_page(*figures: PageFigure, level="good", finding=WICKED, lead="Found") -> ExperimentPage:
    columns = [Column("O1", group="published"), Column("O1", group="found")]
    table = make_table(WICKED, columns, [["0.0357", WICKED]], [Statement(WICKED, "warning")])
    section = PageSection("Table <1>", (WICKED,), (table,), figures, (Statement(WICKED, "bad"),))
    verdict = (Statement(finding, level, lead),)
    return ExperimentPage("Kind", WICKED, WICKED, WICKED, WICKED, verdict, (section,), (("Machine", WICKED),))


def test_page_holds_everything_it_shows(tmp_path):
    png = PageFigure("drawn", "A caption", draw).png()
    page = write_experiment_page(
        make_page(PageFigure("a", WICKED, draw), PageFigure("b", "b", draw()), PageFigure("c", "c", png)), tmp_path
    )
    text = page.read_text(encoding="utf-8")
    assert page == tmp_path / "report.html"
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"a.png", "b.png", "c.png"}
    assert (tmp_path / "figures/c.png").read_bytes() == png
    assert png.startswith(b"\x89PNG")
    assert len(re.findall(r'<img src="data:image/png;base64,', text)) == 3
    links = re.findall(r'(?:href|src)="([^"]*)"', text)
    assert all(link.startswith(("#", "data:")) for link in links)
    assert '<th colspan="1" class="group">published</th>' in text
    assert ">0.0357<" in text
    assert not re.search(r"\{\{|\{%", text)


def test_all_text_is_escaped(tmp_path):
    text = write_experiment_page(make_page(PageFigure("a", WICKED, draw)), tmp_path).read_text(encoding="utf-8")
    assert "<script" not in text
    assert "<1>" not in text
    # heading, name, fact, origin, headline, finding, paragraph, caption, cell, three notes and captions, title, alt
    assert text.count(ESCAPED) == 14


def test_links_of_the_page_lead_somewhere(tmp_path):
    text = write_experiment_page(make_page(), tmp_path).read_text(encoding="utf-8")
    targets = re.findall(r'href="#([^"]*)"', text)
    assert targets == ["section-1"]
    assert 'id="section-1"' in text
    assert not (tmp_path / "figures").exists()


@pytest.mark.parametrize(("level", "failed"), [("good", False), ("plain", False), ("warning", False), ("bad", True)])
def test_bad_news_mark_the_verdict(tmp_path, level, failed):
    page = make_page(level=level, finding="It is so", lead="Lead")
    text = write_experiment_page(page, tmp_path).read_text(encoding="utf-8")
    assert ('class="verdict failed"' in text) is failed
    assert f'<li class="{level}"><strong>Lead.</strong> It is so</li>' in text


def test_same_page_gives_same_bytes(tmp_path):
    texts = []
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        write_experiment_page(make_page(PageFigure("a", "A", draw)), tmp_path / name)
        texts.append([(tmp_path / name / part).read_bytes() for part in ("report.html", "figures/a.png")])
    assert texts[0] == texts[1]


def test_figures_need_names_of_their_own():
    with pytest.raises(ValueError, match=r"figure 'a' stands twice"):
        make_page(PageFigure("a", "", draw), PageFigure("a", "", draw))
    with pytest.raises(ValueError, match=r"figure '\.\./a': expected letters"):
        PageFigure("../a", "", draw)
