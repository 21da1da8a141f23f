"""The report's tables 5 to 7: what it identified, by kinematic model and deformation, as offsets from nominal."""

from __future__ import annotations

from pathlib import Path

from bayescal.errors import InputError
from bayescal.files.csv_tables import read_table

FOLDER = Path(__file__).resolve().parents[1] / "published"
NUMBERS = {"none": "5", "linear": "6", "matrix": "7"}
"""Of the tables, by deformation."""
LETTERS = {"six_pus": "a", "jacobian": "b", "beam": "c", "stiffness": "d"}
"""Of their parts, by kinematic model."""
FILES = {
    f"{model}/{deformation}": FOLDER / f"table{number}{letter}.csv"
    for model, letter in LETTERS.items()
    for deformation, number in NUMBERS.items()
}
"""By variant."""
N_LEGS = 6
FACTORS = {"mm": 1.0, "1": 1.0, "1e-3": 1e-3}


def read_published(path: Path) -> dict[tuple[str, int], float]:
    """Return published offsets from nominal by symbol and leg; lengths in mm.

    Raises
    ------
    InputError
        For a table that is none, or a unit other than mm, 1 and 1e-3.
    """
    legs = [f"leg{k}" for k in range(1, N_LEGS + 1)]
    table = read_table(path, ("parameter", "unit", *legs))
    values, found = table.numbers(legs), {}
    for row, (symbol, unit) in enumerate(zip(table.text("parameter"), table.text("unit"), strict=True)):
        if unit not in FACTORS:
            raise InputError(f"{table.where(row)}: unit: found {unit!r}, expected one of {', '.join(FACTORS)}")
        for leg, value in enumerate(values[row], start=1):
            found[symbol, leg] = float(value * FACTORS[unit])
    return found
