"""Which findings of a verdict are seen at first sight, on a page and on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from bayescal.report.blocks import Statement

MOST_FINDINGS = 5
URGENCY = {"bad": 0, "warning": 1}


def choose_first(findings: Sequence[Statement]) -> tuple[list[Statement], list[Statement]]:
    """Return what stands in the verdict at first sight and what is folded, both in their order.

    At most five are seen: bad news before warnings, warnings before the rest, else what comes first.
    """
    ranked = sorted(range(len(findings)), key=lambda k: (URGENCY.get(findings[k].level, 2), k))
    first = set(ranked[:MOST_FINDINGS])
    return [findings[k] for k in sorted(first)], [findings[k] for k in sorted(set(ranked) - first)]


def count_folded(folded: Sequence[Statement]) -> str:
    """Return where the rest of the findings is, in a line of the terminal."""
    return f"{len(folded)} more finding{'s' if len(folded) > 1 else ''} in the report"
