"""Rules that every page keeps, whatever its kind: how long findings and headlines are, and what is seen first."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html.parser import HTMLParser

from html_reader import VOID, leave_out_script

from bayescal.report.blocks import MAX_SENTENCES_FIRST, count_sentences
from bayescal.report.findings import FindingRow

MAX_FINDING_WORDS = 20
MAX_ACTION_WORDS = 12
MAX_HEADLINE_SENTENCES = 3
KEY_FIGURES = range(4, 7)
HIDDEN = ("details", "table", "nav", "header", "svg", "dl", "h2", "h3", "strong")
"""Elements whose text is no sentence, or is not seen at first sight."""


def count_words(text: str) -> int:
    """Return how many words a text has; a name in quotation marks is one."""
    return len(re.findall(r"\S*\w\S*", re.sub(r"“[^”]*”", "name", text)))


def check_findings(findings: Iterable[FindingRow], headline: str) -> None:
    """Check findings and headline of results."""
    for one in findings:
        assert count_words(one.text) <= MAX_FINDING_WORDS, f"{one.subject}: {count_words(one.text)} words: {one.text}"
        assert count_words(one.action) <= MAX_ACTION_WORDS, f"{one.subject}: {count_words(one.action)}: {one.action}"
        assert count_sentences(one.text) <= 1, f"{one.subject}: {one.text}"
    assert count_sentences(headline) <= MAX_HEADLINE_SENTENCES, headline


class FirstSight(HTMLParser):
    """Collects the paragraphs of a page above its first figure, those that no fold hides."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.paragraphs: list[str] = []
        self.is_over = False
        self.n_key_figures = 0
        self.is_key = False
        self.feed(leave_out_script(text))

    def handle_starttag(self, tag, attrs):
        self.is_over |= tag == "figure"
        self.is_key = ("class", "key-figures") in attrs if tag == "dl" else self.is_key
        self.n_key_figures += tag == "dd" and self.is_key
        if tag in ("p", "li"):
            self.paragraphs.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        if not self.is_over and "main" in self.open and self.paragraphs and not set(HIDDEN) & set(self.open):
            self.paragraphs[-1] += data

    @property
    def n_sentences(self) -> int:
        """How many sentences these are."""
        return sum(count_sentences(one) for one in self.paragraphs)


def check_first_sight(text: str, is_built_in: bool = True) -> None:
    """Check that a page, as HTML, begins with four to six figures, if of a built-in kind, and few sentences."""
    seen = FirstSight(text)
    assert seen.n_sentences <= MAX_SENTENCES_FIRST, [one for one in seen.paragraphs if one.strip()]
    assert seen.n_key_figures in KEY_FIGURES or (not is_built_in and not seen.n_key_figures)
