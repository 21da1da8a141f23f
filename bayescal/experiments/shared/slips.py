"""Slips of the data, in words: what a search found, how it is said on pages, and how a config denies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator

from bayescal.config.sections import check_once
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_significant

LARGE = "large errors"
UNIT, LEGS, ROWS, POSES, CHANNEL, FRAME = "unit", "legs", "rows", "poses", "channel", "frame"

BETTER = 1.5
"""Factor on the misfit below which it is not said: a single reading is one of many."""
FAR = 3.0
"""Factor on the misfit from which on no machine is said to come near the data."""

type DeniedSlips = Annotated[
    list[Literal["unit", "legs", "rows", "poses", "channel", "frame"]], AfterValidator(check_once)
]


@dataclass(frozen=True)
class FoundSlip:
    """A slip that explains the data better than they are: by how many nats, and how much smaller the misfit."""

    fault: str
    text: str
    gain: float
    factor: float | None  # None where no machine within the tolerances has the data as they are

    def say(self) -> str:
        """Return it in words."""
        return f"the data {say_factor(self.factor)} if corrected: {self.text}"

    def record(self) -> dict[str, str | float | None]:
        """Return it for a summary, where an infinite gain is none."""
        return {**asdict(self), "gain": self.gain if np.isfinite(self.gain) else None}


@dataclass(frozen=True)
class Misstated:
    """What is stated of noise, tolerances or errors that the data contradict: by which factor, and how surely.

    Attributes
    ----------
    fault : str
        ``noise``, ``scatter`` (noise or errors of the model from row to row), ``tolerance`` (too tight), ``wide
        tolerance`` or ``large errors`` (none of these; a model error far beyond what was allowed for).
    text : str
        What to do.
    factor : float
        On what is stated.
    gain : float
        Nats by which the data are explained better, all causes of its kind that were tried counted.
    """

    fault: str
    text: str
    factor: float
    gain: float

    def say(self) -> str:
        """Return it in words."""
        if self.fault == LARGE:  # with all that is known of it
            return self.text
        return f"{self.text} (the data are explained better by {format_significant(self.gain, 2)} nats)"


def say_factor(factor: float | None) -> str:
    """Return how much better data fit that are corrected, as a verb."""
    if factor is None:
        return "fit only"
    return f"fit {format_significant(factor, 2)} times better" if factor >= BETTER else "are far more probable"


def tell_denial(field: str) -> str:
    """Return the end of a refusal: how to say that nothing has slipped."""
    kinds = "unit, legs, rows, poses, channel or frame"
    return f"; if the data are right, name the kind of slip that it is not, {kinds}, in {field}"


def state_denied(summary: Mapping[str, Any]) -> list[Statement]:
    """Say which slips would explain the data and were denied, from a summary's ``denied_slips``."""
    return [
        Statement(f"{text}. The config denies that; if it is so all the same, all else is wrong.", "warning", "Data")
        for text in summary.get("denied_slips", [])
    ]


def state_slip(summary: Mapping[str, Any]) -> list[Statement]:
    """Say what may have happened to data that no machine within the tolerances explains, from a summary's ``slip``."""
    slip = summary.get("slip")
    if not isinstance(slip, dict):
        return []
    far = slip["factor"] is None or slip["factor"] > FAR
    text = (
        f"{'No machine within the tolerances comes near the data; they' if far else 'The data'} "
        f"{say_factor(slip['factor'])} if one thing is corrected: {slip['text']}. All other results rest on data that "
        "seem to be wrong."
    )
    return [Statement(text, "bad", "Data")]
