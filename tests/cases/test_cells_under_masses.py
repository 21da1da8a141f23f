"""A machine without coordinates whose channels move by what is given: its uses work, or say in a line why not."""

from __future__ import annotations

import re

import numpy as np
import pytest
from studies import run_little

import bayescal as bc
from bayescal.calibrated.verify.plan import list_candidates
from bayescal.files.csv_tables import read_table

GIVEN = ["mass_kg", "at_x_mm", "at_y_mm"]


def test_requirements_are_refused_by_a_line_that_ends(case, call):
    code, _, complaint = call("next-pose", case("cells_under_masses") / "study.toml", "--require", "u=0.1")
    assert code == 2
    assert complaint.strip().endswith("requirements: found 'u', expected one of none: no tool")


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_uses_take_the_rows_that_calibrated_it(case, call):
    folder = case("cells_under_masses")
    code, complaint, out = run_little(call, folder / "study.toml")
    assert code in (0, 3), complaint
    exported = folder / "exported"
    assert call("export", out, "--out", exported, "--allow-unconverged")[0] == 0
    known = read_table(folder / "readings.csv", None).numbers(GIVEN)
    for path in (out, exported):
        _, given = list_candidates(bc.load_calibrated(path, trust=True), 0.9)
        np.testing.assert_allclose(np.column_stack([given[name] for name in GIVEN]), known)
    code, said, _ = call("verify", out, "--out", folder / "plan.csv", "--allow-unconverged")
    assert code == 0
    assert re.search(r"^[123] poses?: shift of", said, re.MULTILINE)
    (folder / "loads.csv").write_text("pose,mass_kg,at_x_mm,at_y_mm\nP1,10,0,0\n")
    assert call("compensate", exported, folder / "loads.csv", "--allow-unconverged")[0] == 0
    code, _, complaint = call("predict", exported, folder / "loads.csv", "--allow-unconverged")
    assert code == 2
    assert "bayescal compensate" in complaint


def test_a_constructor_without_options_is_named_with_what_it_takes(case, call):
    folder = case("cells_under_masses")
    text = (folder / "cells.py").read_text()
    (folder / "cells.py").write_text(f"{text}\n    def __init__(self):\n        pass\n")
    code, _, complaint = call("validate", folder / "study.toml")
    assert code == 2
    assert "__init__(self, config)" in complaint
