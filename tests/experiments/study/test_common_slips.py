"""Slips that all of the machine's own channels have in common."""

from __future__ import annotations

import re

import pandas as pd
import pytest

from bayescal.projects.start import start_project

pytestmark = pytest.mark.runs


@pytest.fixture
def study(tmp_path):
    start_project(tmp_path / "mine", "hexapod", "poses")
    return tmp_path / "mine" / "study.toml"


def change_actuators(study, change):
    """Change the table of actuator positions."""
    path = study.parent / "data" / "actuators.csv"
    table = pd.read_csv(path, comment="#")
    change(table)
    table.to_csv(path, index=False)


def test_a_zero_that_all_channels_have_in_common_is_named(study, call):
    """Legs homed 8 mm elsewhere; six tolerances of lengths, or a frame, would be other causes."""

    def shift(table):
        table.loc[:, table.columns.str.startswith("rho")] += 8.0

    change_actuators(study, shift)
    code, said, _ = call("validate", study)
    assert code == 3
    size = re.search(r"corrected: readings of all rho seem to have another zero, \+([\d.]+) mm off in all rows", said)
    assert float(size[1]) == pytest.approx(8.0, abs=1.0)  # lengths within their tolerance do the rest
