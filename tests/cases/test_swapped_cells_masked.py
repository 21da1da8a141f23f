"""Two loads that stand in each other's row: 90 standard deviations, and nothing else."""

from __future__ import annotations

import pytest

ROWS = "rows 16 (pose '16') and 17 (pose '17') seem to have each other's fy"


@pytest.mark.parametrize("study", ["study", "study_none"])
def test_the_cells_are_named(case, call, study):
    code, out, _ = call("validate", case("swapped_cells_masked") / f"{study}.toml")
    assert code == 3
    assert ROWS in out


def test_who_looked_may_deny_it(case, call):
    study = case("swapped_cells_masked") / "study.toml"
    study.write_text(f'ignored_data_errors = ["rows"]\n{study.read_text()}')
    code, out, _ = call("validate", study)
    assert code == 0
    assert ROWS in out


@pytest.mark.parametrize("study", ["study", "study_none"])
def test_mended_loads_are_not_suspected(case, call, study):
    folder = case("swapped_cells_masked")
    table = folder / "readings.csv"
    rows = [line.split(",") for line in table.read_text().splitlines()]
    place = next(k for k, name in enumerate(rows[0]) if name.startswith("fy"))
    rows[16][place], rows[17][place] = rows[17][place], rows[16][place]
    table.write_text("\n".join(",".join(row) for row in rows))
    assert call("validate", folder / f"{study}.toml")[0] == 0
