"""What a check of one kind of fault says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

type Level = Literal["good", "warning", "bad"]


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes
    ----------
    check : str
        What was looked at, in a word or two.
    fault : str
        Its name; empty where there is none.
    level : str
        ``good``, ``warning`` or ``bad``.
    text : str
        In a sentence or two, with what to do.
    """

    check: str
    fault: str
    level: Level
    text: str
