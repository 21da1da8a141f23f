"""Plain text: none that commands a terminal or a spreadsheet, or leads a name of a file elsewhere."""

from __future__ import annotations

import re
import unicodedata

UNSEEN = ("Cc", "Cf", "Cs")
"""Categories of Unicode: controls, formats such as the marks for writing from right to left, halves of surrogates."""


def add_article(word: str) -> str:
    """Return a word, a name of a kind for example, with its indefinite article, as far as the first letter tells it."""
    return f"{'an' if word[:1].lower() in tuple('aeiou') else 'a'} {word}"


def is_plain(text: str, but: str = "") -> bool:
    """Whether a text has no character that is not seen but does something; some may be let through."""
    return not any(unicodedata.category(one) in UNSEEN and one not in but for one in text)


def make_plain(text: str, but: str = "") -> str:
    """Return a text with such characters, but for some, written as Python writes them."""
    return text if is_plain(text, but) else "".join(one if is_plain(one, but) else ascii(one)[1:-1] for one in text)


# --- cells of tables -------------------------------------------------------------------------------------------------

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""Begins what a spreadsheet takes for a formula, apostrophes that keep it from that before it."""


def guard_cell(text: str) -> str:
    """Return a text as a cell that no spreadsheet takes for a formula; numbers stay as they are."""
    return f"'{text}" if _FORMULA.match(text) and not _is_number(text) else text


def release_cell(text: str) -> str:
    """Return the text of a cell; the inverse of `guard_cell`."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# --- names of files --------------------------------------------------------------------------------------------------

LONGEST_FILE = 100


def name_file(text: str) -> str:
    """Return a text as a part of a file's name: letters, digits and ._+-, so many at most, no dot first."""
    plain = re.sub(r"[^\w.+-]", "_", text.replace("/", "-"))[:LONGEST_FILE]
    return re.sub(r"^\.+", lambda dots: "_" * len(dots[0]), plain) or "_"
