"""Plain text: none that commands a terminal or turns round what is read, and words with their article."""

from __future__ import annotations

import unicodedata

UNSEEN = ("Cc", "Cf", "Cs")
"""Categories of Unicode: controls, formats such as the marks for writing from right to left, halves of surrogates."""


def add_article(word: str) -> str:
    """Return a word, a name of a kind for example, with its indefinite article, as far as the first letter tells it."""
    return f"{'an' if word[:1].lower() in tuple('aeiou') else 'a'} {word}"


def is_plain(text: str, but: str = "") -> bool:
    """Whether a text has no character that is not seen but does something; some may be let through."""
    return not any(unicodedata.category(one) in UNSEEN and one not in but for one in text)


def make_plain(text: str) -> str:
    """Return a text with such characters written as Python writes them."""
    return "".join(one if is_plain(one) else ascii(one)[1:-1] for one in text)
