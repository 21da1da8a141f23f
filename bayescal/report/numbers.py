"""Numbers as text: the rounding of the report stands here and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Sequence

MICROMETRES = 1e3  # in a millimetre
PER_MILLE = 1e3  # dimensionless parameters are shown in 1e-3

NO_VALUE = "–"
MINUS = "−"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

MAX_LISTED_NAMES = 3
"""Names in a sentence; more are counted."""
MOST_DECIMALS = 12
"""What is smaller is shown as zero: rounding of a cosine, say."""


def format_fixed(value: float | None, decimals: int, sign: bool = False) -> str:
    """Return a number with fixed decimals and a true minus sign; a dash where there is none."""
    if value is None or math.isnan(value):
        return NO_VALUE
    if math.isinf(value):
        return f"{MINUS if value < 0 else ''}∞"
    text = f"{value:{'+' if sign else ''}.{decimals}f}"
    if float(text) == 0.0:
        text = text.lstrip("+-")
    return text.replace("-", MINUS)


def format_significant(value: float | None, digits: int = 3) -> str:
    """Return a number with significant digits, never fewer than its integer part has."""
    if value is None or not math.isfinite(value):
        return format_fixed(value, 0)
    return format_fixed(value, count_decimals(value, digits))


def count_decimals(value: float, digits: int = 2) -> int:
    """Return how many decimals show that many significant digits of a value; none for zero or infinite ones."""
    if abs(value) < 0.5 * 10.0**-MOST_DECIMALS or not math.isfinite(value):
        return 0
    return min(MOST_DECIMALS, max(0, digits - 1 - math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))))


def format_estimate(mean: float | None, sd: float | None, decimals: int | None = None, sign: bool = False) -> str:
    """Return ``mean ± sd``, by default to the second digit of the sd."""
    if mean is None or sd is None or not (math.isfinite(mean) and math.isfinite(sd)):
        return format_fixed(mean, 2)
    places = count_decimals(sd) if decimals is None else decimals
    return f"{format_fixed(mean, places, sign)} ± {format_fixed(sd, places)}"


def format_pair(first: float | None, second: float | None, digits: int = 3) -> str:
    """Return ``first / second``."""
    return f"{format_significant(first, digits)} / {format_significant(second, digits)}"


def format_percent(fraction: float | None, decimals: int = 0) -> str:
    """Return a fraction as per cent."""
    return NO_VALUE if fraction is None or math.isnan(fraction) else f"{format_fixed(100 * fraction, decimals)} %"


def format_odds(nats: float) -> str:
    """Return the odds that a difference of log-evidences stands for."""
    power = nats / math.log(10.0)
    if power >= 6.0:
        return f"10{str(math.floor(power)).translate(SUPERSCRIPTS)} to 1"
    odds = math.exp(nats)
    return f"{odds:.1f} to 1" if odds < 10 else f"{float(f'{odds:.1e}'):,.0f} to 1"


def format_span(values: list[float], decimals: int = 1) -> str:
    """Return ``smallest to largest``, one number where both read alike."""
    return " to ".join(dict.fromkeys(format_fixed(x, decimals) for x in (min(values), max(values))))


def capitalise(text: str) -> str:
    """Return text that begins with a capital letter; names within it stay as they are."""
    return f"{text[:1].upper()}{text[1:]}"


def join_words(words: Sequence[str], between: str = "and") -> str:
    """Return ``a, b and c``."""
    return f" {between} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def name_some(names: Sequence[str], between: str = "and") -> str:
    """Return names as words, of many the first ones and how many more there are."""
    more = [f"{len(names) - MAX_LISTED_NAMES} more"] if len(names) > MAX_LISTED_NAMES else []
    return join_words([*names[:MAX_LISTED_NAMES], *more], "and" if more else between)


def format_plain(value: float, digits: int = 6, separator: str = "") -> str:
    """Return a number with up to that many digits and no zeros at its end, as a setting or a tick is written.

    ``separator``, a comma, stands between thousands.
    """
    return f"{value:{separator}.{digits}g}".replace("-", MINUS)


def format_count(number: float) -> str:
    """Return a whole number with commas between thousands."""
    return f"{number:,.0f}"


def format_scientific(value: float | None, digits: int = 2) -> str:
    """Return a number with a power of ten on one line, ``3.3e4``."""
    if value is None or not math.isfinite(value):
        return format_fixed(value, 0)
    mantissa, power = _split_power(value, digits)
    return f"{mantissa}e{power}".replace("-", MINUS)


def format_power(value: float | None, digits: int = 2) -> str:
    """Return a number of any size, large and small ones as ``3.3·10⁴``."""
    if value is None or value == 0.0 or not math.isfinite(value) or 1e-2 <= abs(value) < 1e3:
        return format_significant(value, digits)
    mantissa, power = _split_power(value, digits)
    return f"{'' if mantissa == '1' else f'{mantissa}·'}10{str(power).translate(SUPERSCRIPTS)}".replace("-", MINUS)


def _split_power(value: float, digits: int) -> tuple[str, int]:
    mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
    return mantissa, int(power)
