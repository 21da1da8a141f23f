"""What the symbols of a planar platform on sliding legs mean, for pages that use them."""

from __future__ import annotations

from collections.abc import Iterable

from bayescal.report.blocks import Column, Table, make_table

MEANINGS = {
    "x_P": "where the guide of a leg begins: its carriage reads zero there; base frame",
    "y_P": "likewise",
    "beta": "direction of a guide, angle from the x axis of the base",
    "l": "length of a leg, from the joint of its carriage to that of the platform",
    "xi_B": "joint of a leg on the platform, platform frame",
    "eta_B": "likewise",
    "phi0": "angle at which the sensor between guide and leg reads zero",
    "psi0": "angle at which the sensor between leg and platform reads zero",
    "xi_V": "the tool's centre, platform frame",
    "eta_V": "likewise",
}
READINGS = (
    ("s", "way of a carriage along its guide"),
    ("phi", "angle between guide and leg, read at the carriage"),
    ("psi", "angle between leg and platform, read at the platform"),
)
CAPTION = "Symbols; a leg's number stands behind them. Last what the sensors read."


def tabulate_symbols(symbols: Iterable[str]) -> tuple[Table, ...]:
    """Return the table of those symbols that such a machine has, and what its sensors read; none of other machines."""
    used = set(symbols)
    rows = [[symbol, meaning] for symbol, meaning in MEANINGS.items() if symbol in used]
    if "x_P" not in used:
        return ()
    columns = (Column("Symbol", kind="symbol"), Column("Meaning", kind="text"))
    return (make_table(CAPTION, columns, [*rows, *(list(one) for one in READINGS)]),)
