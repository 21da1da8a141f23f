"""Columns that are given of the rows slip as readings do: another unit or sign, two of them exchanged."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from studies import changed_table

type Row = list[str]

SLIPS: dict[str, tuple[Callable[[Row], Row], str]] = {
    "grams": (
        lambda row: [*row[:2], str(1000 * float(row[2])), *row[3:]],
        "what is given as mass_kg seems to be 1000 times too large",
    ),
    "exchanged": (
        lambda row: [*row[:3], row[4], row[3], *row[5:]],
        "what is given as at_x_mm and as at_y_mm seems to be exchanged",
    ),
    "sign": (
        lambda row: [*row[:4], str(-float(row[4])), *row[5:]],
        "what is given as at_y_mm seems to be of the other sign",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_what_slipped_is_named(slip, case, call):
    folder, (change, expected) = case("cells_under_masses"), SLIPS[slip]
    with changed_table(folder / "readings.csv", lambda rows: [rows[0], *map(change, rows[1:])]):
        code, out, _ = call("validate", folder / "study.toml")
    assert code == 3
    assert expected in out  # the other sign does as numbering cells the other way round


def test_what_is_right_is_not_suspected(case, call):
    code, out, _ = call("validate", case("cells_under_masses") / "study.toml")
    assert code == 0
    assert "given" not in out
