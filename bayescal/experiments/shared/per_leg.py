"""One value for all legs, or one for each."""

from __future__ import annotations

from bayescal.errors import InputError
from bayescal.limits import WIDTH_BOUNDS


def spread_over_legs(value: float | list[float], n: int, symbol: str, field: str = "parameters") -> list[float]:
    """Return one value per leg; InputError for a list of another length."""
    values = value if isinstance(value, list) else [value] * n
    if len(values) != n:
        expected = "1" if n == 1 else f"1 or {n}, one per leg"
        raise InputError(f"{field}.{symbol}: found {len(values)} values, expected {expected}")
    return values


def spread_widths(value: float | list[float], n: int, symbol: str, unit: str, factor: float = 1.0) -> list[float]:
    """Return the width of a prior for each leg, as the config has it.

    Parameters
    ----------
    value : float or list of float
        As the config has it.
    n : int
    symbol, unit : str
        Of the parameter.
    factor : float
        From the config's unit to the parameter's, in which a width is judged.

    Raises
    ------
    InputError
        For a list of another length, and a width that nobody means in this unit.
    """
    widths = spread_over_legs(value, n, symbol)
    smallest, largest = WIDTH_BOUNDS.get(unit, (0.0, float("inf")))
    for width in (factor * one for one in widths):
        if not smallest <= width <= largest:
            found = f"{width:g}" if unit == "1" else f"{width:g} {unit}"
            raise InputError(
                f"parameters.{symbol}: found a tolerance of {found}, expected between {smallest:g} and {largest:g}"
            )
    return widths
