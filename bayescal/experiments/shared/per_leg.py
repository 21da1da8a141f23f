"""One value for all legs, or one for each."""

from __future__ import annotations

from bayescal.errors import InputError


def spread_over_legs(value: float | list[float], n: int, symbol: str) -> list[float]:
    """Return one value per leg; InputError for a list of another length."""
    values = value if isinstance(value, list) else [value] * n
    if len(values) != n:
        expected = "1" if n == 1 else f"1 or {n}, one per leg"
        raise InputError(f"parameters.{symbol}: found {len(values)} values, expected {expected}")
    return values
