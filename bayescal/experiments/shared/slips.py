"""Slips of the data, in words: what a search found, how it is said on pages, and how a config denies it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from bayescal.experiments.runner.results import Summary
from bayescal.report.blocks import Statement
from bayescal.report.numbers import capitalise, format_significant

LARGE = "large errors"
EITHER = "tolerance or model error"
"""Tolerances stated too tight, or errors of the model: the data cannot tell."""
UNIT, LEGS, ROWS, POSES, CHANNEL, FRAME = "unit", "legs", "rows", "poses", "channel", "frame"

CORRECTED = "if corrected: "
MIN_MISFIT_RATIO = 1.5
"""Factor on the misfit below which it is not said: a single reading is one of many."""


@dataclass(frozen=True)
class FoundSlip:
    """A slip that explains the data better than they are: by how many nats, and how much smaller the misfit."""

    fault: str
    text: str
    gain: float
    factor: float | None  # None where no machine within the tolerances has the data as they are

    def say(self) -> str:
        """Return it in words."""
        return f"the data {say_factor(self.factor)} {CORRECTED}{self.text}"

    def record(self) -> dict[str, str | float | None]:
        """Return it for a summary, where an infinite gain is none."""
        return {**asdict(self), "gain": self.gain if math.isfinite(self.gain) else None}


@dataclass(frozen=True)
class MisstatedInput:
    """What is stated of noise, tolerances or errors that the data contradict: by which factor, and how surely.

    Attributes
    ----------
    fault : str
        ``noise``, ``scatter`` (noise or errors of the model from row to row), ``tolerance`` (too tight), ``tolerance
        or model error``, ``wide tolerance`` or ``large errors`` (none of these; a model error far beyond what was
        allowed for).
    text : str
        What to do.
    factor : float
        On what is stated.
    gain : float
        Nats by which the data are explained better, all causes of its kind that were tried counted; where a model error
        may be it as well, better than by neither.
    """

    fault: str
    text: str
    factor: float
    gain: float

    def say(self) -> str:
        """Return it in words."""
        if self.fault in (LARGE, EITHER):  # with all that is known of it
            return self.text
        return f"{self.text} (fits {format_significant(self.gain, 2)} nats better)"


def say_factor(factor: float | None) -> str:
    """Return how much better data fit that are corrected, as a verb."""
    if factor is None:
        return "fit only"
    return (
        f"fit {format_significant(factor, 2)} times better" if factor >= MIN_MISFIT_RATIO else "are far more probable"
    )


def tell_denial(field: str) -> str:
    """Return the end of a refusal: how to say that nothing has slipped."""
    return f"; if the data are correct, add to {field}: unit, legs, rows, poses, channel or frame"


def split_advice(text: str) -> tuple[str, str]:
    """Return what is said of data, noise or tolerances in a sentence, and what to do about it."""
    fact, _, advice = text.partition(" (or: ")[0].partition(": ")
    return f"{capitalise(fact)}.", advice and f"{capitalise(advice)}."


def state_denied(summary: Summary) -> list[Statement]:
    """Return the errors of data that would explain them and are ignored as configured."""
    return [
        Statement(
            split_advice(text.rpartition(CORRECTED)[2])[0],
            "warning",
            "Data",
            action="Ignored as configured (`ignored_data_errors`).",
        )
        for text in summary.get("ignored_data_errors", [])
    ]


def state_slip(summary: Summary) -> list[Statement]:
    """Return the probable error of data that no machine within the tolerances explains, from a summary."""
    slip = summary.get("suspected_data_error")
    if not isinstance(slip, dict):
        return []
    factor = math.nan if slip["factor"] is None else float(slip["factor"])
    text, _ = split_advice(str(slip["text"]))
    action = "Correct the data; all results depend on it."
    return [Statement(text, "bad", "Data", value=factor, limit=1.0, action=action)]
