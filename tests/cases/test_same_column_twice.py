"""A target that was exported twice: columns that are the same to the last digit have one noise."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize("command", ["validate", "run"])
def test_columns_are_named(case, call, command):
    folder = case("same_column_twice")
    code, out, err = call(command, folder / "study.toml")
    assert code == 2
    assert "columns mx_2_mm and mx_1_mm are the same in all rows" in out + err
    assert "columns my_2_mm and my_1_mm" in out + err
    assert not (folder / "results").exists()


def test_one_other_digit_is_enough(case, call):
    folder = case("same_column_twice")
    lines = (folder / "readings.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines]
    for k, row in enumerate(cells[1:]):  # as a target beside the first one whose noise is its own
        row[5] = f"{float(row[3]) + 0.5 * (-1) ** k:.4f}"
        row[6] = f"{float(row[4]) + 0.5 * (-1) ** (k // 2):.4f}"
    (folder / "readings.csv").write_text("\n".join(",".join(row) for row in cells))
    assert "are the same" not in "".join(call("validate", folder / "study.toml")[1:])
