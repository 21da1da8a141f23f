"""What is given of the rows slips as readings do: another unit or sign, columns exchanged, single cells wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from studies import changed_table

type Row = list[str]


def exchange(rows, first, second):
    """Exchange two cells, each by row, from one, and column."""
    (a, i), (b, j) = first, second
    rows[a][i], rows[b][j] = rows[b][j], rows[a][i]


def scale(rows, cell, factor):
    rows[cell[0]][cell[1]] = str(factor * float(rows[cell[0]][cell[1]]))


SLIPS: dict[str, tuple[Callable[[list[Row]], None], str]] = {
    "grams": (
        lambda rows: [scale(rows, (k, 2), 1000.0) for k in range(1, len(rows))],
        "what is given as mass_kg seems to be 1000 times too large",
    ),
    "exchanged": (
        lambda rows: [exchange(rows, (k, 3), (k, 4)) for k in range(1, len(rows))],
        "what is given as at_x_mm and as at_y_mm seems to be exchanged",
    ),
    "sign": (  # which does as numbering cells the other way round
        lambda rows: [scale(rows, (k, 4), -1.0) for k in range(1, len(rows))],
        "what is given as at_y_mm seems to be of the other sign",
    ),
    "two masses": (
        lambda rows: exchange(rows, (2, 2), (6, 2)),
        "rows 2 (pose 'P2') and 6 (pose 'P6') seem to have each other's mass_kg",
    ),
    "two places": (
        lambda rows: exchange(rows, (1, 3), (8, 3)),
        "rows 1 (pose 'P1') and 8 (pose 'P8') seem to have each other's at_x_mm",
    ),
    "two loads": (
        lambda rows: [exchange(rows, (7, k), (9, k)) for k in (2, 3, 4)],
        "rows 7 (pose 'P7') and 9 (pose 'P9') seem to have each other's mass_kg, at_x_mm and at_y_mm",
    ),
    "two columns": (
        lambda rows: exchange(rows, (1, 3), (1, 4)),
        "what is given as at_x_mm and as at_y_mm seems to be exchanged in row 1 (pose 'P1')",
    ),
    "a sign": (
        lambda rows: scale(rows, (8, 3), -1.0),
        "what is given as at_x_mm seems to be of the other sign in row 8 (pose 'P8')",
    ),
    "a decimal point": (
        lambda rows: scale(rows, (6, 2), 10.0),
        "what is given as mass_kg seems to be 10 times too large in row 6 (pose 'P6')",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_what_slipped_is_named(slip, case, call):
    folder, (change, expected) = case("cells_under_masses"), SLIPS[slip]

    def write(rows):
        change(rows)
        return rows

    with changed_table(folder / "readings.csv", write):
        code, out, _ = call("validate", folder / "study.toml")
    assert code == 3
    assert expected in out


def test_what_is_right_is_not_suspected(case, call):
    code, out, _ = call("validate", case("cells_under_masses") / "study.toml")
    assert code == 0
    assert "given" not in out
