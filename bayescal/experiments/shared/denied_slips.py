"""Slips that somebody looked for and that are none: data may be right that look as if something had slipped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator

from bayescal.config.sections import check_once
from bayescal.report.blocks import Statement

type DeniedSlips = Annotated[list[Literal["unit", "legs", "rows"]], AfterValidator(check_once)]


def tell_denial(field: str) -> str:
    """Return the end of a refusal: how to say that nothing has slipped."""
    return f"; if the data are right, name the kind of slip that it is not, unit, legs or rows, in {field}"


def state_denied(summary: Mapping[str, Any]) -> list[Statement]:
    """Say which slips would explain the data and were denied, from a summary's ``denied_slips``."""
    return [
        Statement(f"{text}. The config denies that; if it is so all the same, all else is wrong.", "warning", "Data")
        for text in summary.get("denied_slips", [])
    ]
