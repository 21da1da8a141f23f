"""Tables of published values, which the report sets beside what is found."""

from __future__ import annotations

from pathlib import Path

from bayescal.errors import InputError
from bayescal.files.csv_tables import read_table

FACTORS = {"mm": 1.0, "1": 1.0, "1e-3": 1e-3}


def read_published(path: Path, n_legs: int) -> dict[tuple[str, int], float]:
    """Return published offsets from nominal by symbol and leg; lengths in mm.

    Raises
    ------
    InputError
        For a table that is none, or a unit other than mm, 1 and 1e-3.
    """
    legs = [f"leg{k}" for k in range(1, n_legs + 1)]
    table = read_table(path, ("parameter", "unit", *legs))
    values, found = table.numbers(legs), {}
    for row, (symbol, unit) in enumerate(zip(table.text("parameter"), table.text("unit"), strict=True)):
        if unit not in FACTORS:
            raise InputError(f"{table.where(row)}: unit: found {unit!r}, expected one of {', '.join(FACTORS)}")
        for leg, value in enumerate(values[row], start=1):
            found[symbol, leg] = float(value * FACTORS[unit])
    return found
