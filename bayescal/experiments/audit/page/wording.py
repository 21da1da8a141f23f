"""How the report of an audit writes names, shares and probabilities."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from bayescal.experiments.audit.page.results import PlanChange
from bayescal.report.numbers import (
    NO_VALUE,
    count_decimals,
    format_count,
    format_fixed,
    format_plain,
    format_scientific,
    format_significant,
    join_words,
)
from bayescal.report.symbols import shown_in, split_name

CERTAIN_PROBABILITY = 0.9995
SMALLEST_SAID = {"mm": 1e-6, "rad": 5e-9}
DIRECTIONS = {
    **{f"r{axis}": f"rotation about {axis}" for axis in "xyz"},
    "position": "position (length)",
    "rotation": "rotation (angle)",
}
UNITS = {"1": "", "N mm2": "N mm²", "um": "µm", "rad": "rad"}


def name_requirement(name: str) -> str:
    """Return a requirement in words: ``rx`` is rotation about x."""
    return DIRECTIONS.get(name, name)


def name_change(change: PlanChange) -> str:
    """Return a change with a mark where the actuators do not reach that far or it cannot be."""
    return f"{change.name}{' †' if change.is_beyond_range else ''}{' ‡' if not change.is_feasible else ''}"


def name_unit(unit: str) -> str:
    """Return a unit as the report writes it, nothing for numbers."""
    return UNITS.get(unit, unit)


def format_contraction(value: float) -> str:
    """Return a contraction with two decimals; what is not quite 0 or 1 is said so."""
    if math.isnan(value):
        return NO_VALUE
    if value >= 0.995:
        return "1" if value == 1.0 else ">0.99"
    if value < 0.005:
        return "0" if value <= 0.0 else "<0.01"
    return format_fixed(value, 2)


def format_share(fraction: float) -> str:
    """Return a fraction in per cent with two significant digits, at least 0.1 %."""
    percent = 100.0 * fraction
    if math.isnan(percent):
        return NO_VALUE
    if percent < 0.1:
        return "<0.1 %"
    return f"{format_count(percent) if percent >= 99.5 else format_plain(percent, 2)} %"


def format_probability(value: float) -> str:
    """Return a probability that was counted over some thousand draws."""
    percent = 100.0 * value
    if math.isnan(value):
        return NO_VALUE
    if value >= CERTAIN_PROBABILITY:
        return ">99.9 %"
    return (
        "<0.1 %" if value <= 1.0 - CERTAIN_PROBABILITY else f"{format_fixed(percent, 0 if 5 < percent < 95 else 1)} %"
    )


def say(text: str) -> str:
    """Return a number such as ``>99.9 %`` within a sentence: more than 99.9 %."""
    return text.replace(">", "more than ").replace("<", "less than ")


def say_most(text: str) -> str:
    """Return an upper bound within a sentence: ``at most 3 %``, ``less than 0.1 %``."""
    return say(text) if text.startswith("<") else f"at most {text}"


def format_range(values: Sequence[float], write: Callable[[float], str]) -> str:
    """Return ``least to most``, one where both read alike."""
    return " to ".join(dict.fromkeys(write(x) for x in (min(values), max(values))))


def format_sd(value: float) -> str:
    """Return a standard deviation with two significant digits; tiny or huge ones with a power of ten."""
    if value and not 1e-5 <= abs(value) < 1e5:
        return format_scientific(value)
    return format_significant(value, 2)


def format_nominal(value: float, sd: float) -> str:
    """Return a nominal value to the second digit of its tolerance."""
    return format_fixed(value, min(6, count_decimals(sd))) if abs(value) < 1e6 else format_sd(value)


def list_names(names: Sequence[str], member: str = "leg") -> str:
    """Return parameters as words, a symbol with its legs: ``u_y of legs 4 and 5``."""
    legs: dict[str, list[str]] = {}
    for name in names:
        symbol, leg = split_name(name)
        legs.setdefault(symbol, []).extend([str(leg)] if leg else [])
    words = []
    for symbol, numbers in legs.items():
        which = (
            f" of {member}{'s' if len(numbers) > 1 else ''} {join_words(sorted(numbers, key=int))}" if numbers else ""
        )
        words.append(f"{symbol}{which}")
    return join_words(words)


def format_change(position: float, rotation: float, units: Mapping[str, str]) -> str:
    """Return the most by which a pose changes, in the design's units."""
    words = []
    for value, (unit, least) in zip((position, rotation), SMALLEST_SAID.items(), strict=True):
        factor, name = shown_in(unit, units)
        words.append(f"{format_sd(max(value, factor * least))} {name}".replace(" °", "°"))
    return " and ".join(words)


def count(number: int, noun: str) -> str:
    """Return ``1 pose`` or ``3 poses``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_fixed_span(low: float, high: float) -> str:
    """Return an interval about zero, ``open`` where it has no end."""
    if math.isinf(low) and math.isinf(high):
        return "open"
    low_text, high_text = ("open" if math.isinf(x) else f"{'+' if x > 0 else ''}{format_sd(x)}" for x in (low, high))
    return f"{low_text} to {high_text}"
