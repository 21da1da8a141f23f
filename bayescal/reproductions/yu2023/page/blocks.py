"""What the pages of simulated calibrations share."""

from __future__ import annotations

import math

from bayescal.report.blocks import Cell, Section, Statement
from bayescal.report.numbers import format_percent, format_significant

TAIL = 0.025  # a published figure with less beside it is marked
ANGLES = (
    "Pose errors, measurement noise and the indices that select poses are in the paper's coordinates, position and the "
    "angles α, β, γ about fixed axes; only the workspace is a box of rotation vectors."
)

type PageParts = tuple[str, tuple[Statement, ...], tuple[Section, ...]]
"""Headline, verdict and sections of a page."""


def share_cell(share: float) -> Cell:
    """Return how many repeats lie below a published figure, marked where it is in a tail; empty where there is none."""
    if math.isnan(share):
        return Cell("")
    return Cell(format_percent(share, 1), "plain" if TAIL <= share <= 1.0 - TAIL else "warning")


def format_range(low: float, high: float, digits: int = 3) -> str:
    """Return ``low to high``."""
    return f"{format_significant(low, digits)} to {format_significant(high, digits)}"
