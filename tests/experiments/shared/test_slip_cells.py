"""Single readings that are wrong are named, of tables that are right otherwise; right tables have none."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.slip_cells import weigh_cells
from bayescal.experiments.study.inputs import StudyInputs

CELL = Path(__file__).parents[2] / "cases" / "swapped_cells_masked"
PLANTS = {
    "nothing": ({}, ""),
    "two rows": ({(4, "fx_N"): (20, "fx_N"), (20, "fx_N"): (4, "fx_N")}, "rows 5 (pose '5') and 21 (pose '21')"),
    "two channels": ({(7, "fx_N"): (7, "fz_N"), (7, "fz_N"): (7, "fx_N")}, "fx and fz seem to be exchanged in row 8"),
    "sign": ({(9, "fx_N"): -1.0}, "the reading of fx in row 10 (pose '10')"),
    "point": ({(2, "fy_N"): 10.0}, "the reading of fy in row 3 (pose '3') seems to be 10 times too large"),
    "off": ({(9, "g_1_mV"): 1.07}, "row 10 (pose '10')"),
}


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """Return the folder of a force cell without any slip."""
    monkeypatch.setenv("BAYESCAL_TRUST", "1")
    folder = shutil.copytree(CELL, tmp_path / "cell")
    table = pd.read_csv(folder / "readings.csv")
    table.loc[[15, 16], "fy_N"] = table.loc[[16, 15], "fy_N"].to_numpy()
    table.to_csv(folder / "readings.csv", index=False)
    return folder


def read(folder):
    path = folder / "study_none.toml"
    return StudyInputs.load(load(path)[1], folder)


@pytest.mark.parametrize("what", PLANTS)
def test_the_cell_is_named(what, cell):
    changes, said = PLANTS[what]
    right = pd.read_csv(cell / "readings.csv")
    table = right.copy()
    for (row, column), how in changes.items():
        table.loc[row, column] = right.loc[how] if isinstance(how, tuple) else right.loc[row, column] * how
    table.to_csv(cell / "readings.csv", index=False)
    slip = read(cell).slip
    assert (slip is not None) == bool(changes)
    assert slip is None or said in slip.text


def test_gains_are_differences_of_log_densities(cell, rng):
    readings = read(cell).variants["full"].list_readings()
    here = readings.see(readings.table, np.zeros(readings.posterior.n_geometry))
    n_rows, n_channels = readings.values.shape
    white = here.whiten(np.zeros(0), columns=np.tile(np.eye(n_channels), (n_rows, 1, 1)))
    rows, cells = weigh_cells(white, n_channels)
    assert np.array_equal(rows, np.arange(n_rows))
    a, b, k = 3, 17, 4
    one = cells.gain_one(np.full((n_rows, n_channels), 2.0))[a, k]
    values = np.where(np.arange(n_rows) == a, 1.0, 0.0)[:, None] * np.ones(n_channels)
    two = cells.gain_rows(values, np.array([k]))[a, b]
    for changes, gain in (({(a, k): 2.0}, one), ({(a, k): 1.0, (b, k): -1.0}, two)):
        moved = white.rows.copy()
        for (row, channel), change in changes.items():
            moved[row, :, -1] -= change * white.rows[row, :, white.known + channel]
        changed = type(white)(moved, white.constant, white.known, 0.0, white.n_spare, white.n_lost)
        assert np.isclose(changed.weigh() - white.weigh(), gain, rtol=1e-9)
