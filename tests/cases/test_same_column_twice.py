"""A target that was exported twice: columns that are the same to the last digit have one noise."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize("command", ["validate", "run"])
def test_columns_are_named(case, call, command):
    folder = case("same_column_twice")
    code, out, err = call(command, folder / "study.toml")
    assert code == 2
    assert "columns mx_2_mm and mx_1_mm" in out + err
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
    assert "are equal" not in "".join(call("validate", folder / "study.toml")[1:])


@pytest.fixture
def cell(case):
    """A force cell whose second bridge was exported as the first one: what bridges read may be commands."""
    folder = case("own_term_shrinks_gains")

    def write(repeat):
        cells = [line.split(",") for line in (folder / "readings.csv").read_text().splitlines()]
        for row in cells[1:]:
            row[2] = repeat(float(row[1]))
        (folder / "readings.csv").write_text("\n".join(",".join(row) for row in cells) + "\n")
        return folder / "study.toml"

    return write


def test_own_channels_that_repeat_others_are_named_where_the_data_fit(cell, call):
    code, out, _ = call("validate", cell(repr))
    assert code == 0
    assert "columns g_2_mV and g_1_mV" in out


def test_a_sensor_that_always_reads_the_same_is_named_where_the_data_fit(case, call):
    folder = case("own_term_shrinks_gains")
    cells = [line.split(",") for line in (folder / "readings.csv").read_text().splitlines()]
    for row in cells[1:]:
        row[1] = "0.463"
    (folder / "readings.csv").write_text("\n".join(",".join(row) for row in cells) + "\n")
    code, out, _ = call("validate", folder / "study.toml")
    assert code == 0
    assert "but column g_1_mV" in out


@pytest.fixture
def delta(tmp_path):
    from calibrations import write_delta

    return write_delta(tmp_path)


@pytest.mark.parametrize(("factor", "said"), [(1.0, "are equal"), (2.5, "times s_1_mm")])
def test_own_channels_that_repeat_others_are_named_where_they_do_not(factor, said, delta, call):
    from studies import changed_table

    def repeat(rows):
        first, second = rows[0].index("s_1_mm"), rows[0].index("s_2_mm")
        for row in rows[1:]:
            row[second] = repr(factor * float(row[first]))
        return rows

    with changed_table(next(delta.parent.rglob("readings.csv")), repeat):
        code, out, complaint = call("validate", delta)
    assert code in (2, 3)
    assert complaint.count("\n") == 1
    assert said in out + complaint
