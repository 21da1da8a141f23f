"""What a page says of data that a slip explains many times better than they stand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_significant


def state_slip(summary: Mapping[str, Any]) -> list[Statement]:
    """Say what may have happened to data that no machine within the tolerances explains, from a summary's ``slip``."""
    slip = summary.get("slip")
    if not isinstance(slip, dict):
        return []
    text = (
        f"No machine within the tolerances comes near the data; they fit {format_significant(slip['factor'], 2)} times "
        f"better if one thing is put right: {slip['text']}. What else is said here rests on data that seem to be wrong."
    )
    return [Statement(text, "bad", "Data")]
