"""Sizes of errors are lengths where the tool has lengths, and multiples of the noise elsewhere, whatever says them."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from studies import edit, run_little

from bayescal.experiments.selftest.faults import check_noise
from bayescal.experiments.selftest.inputs import read_selftest
from bayescal.experiments.selftest.kind import configure_selftest
from bayescal.experiments.shared.error_sizes import find_units

CELL = Path(__file__).parents[2] / "cases" / "own_term_shrinks_gains"
LITTLE_NOISE = "g = { noise = 0.01 }"


@pytest.fixture
def cell(tmp_path) -> Path:
    """A force cell's study: no length anywhere."""
    path = shutil.copytree(CELL, tmp_path / "cell") / "study.toml"
    edit(path, "[[variants]]", "[model_error]\nterms = ['random', 'smooth']\n\n[[variants]]")
    return path


def test_a_check_says_them_in_units_that_the_machine_has(cell):
    edit(cell, "g = { noise = 0.03 }", LITTLE_NOISE)
    (subject,) = read_selftest(configure_selftest(cell, [], None, None), cell.parent).subjects.values()
    found = check_noise(subject.measured)
    assert "× noise" in found.text
    assert " mm" not in found.text


def test_what_is_no_size_keeps_its_unit(cell):
    (subject,) = read_selftest(configure_selftest(cell, [], None, None), cell.parent).subjects.values()
    posterior = subject.posterior
    factor, units = find_units(
        posterior.likelihood.model, ("tau", "sigma_positioning", "L_g", "k_x[1]"), ("mm", "mm", "1", "1")
    )
    assert units == ("noise", "noise", "1", "1")
    assert factor.tolist() == [100.0, 100.0, 1.0, 1.0]  # ten micrometres inside are one standard deviation


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_a_study_states_them_in_units_that_the_machine_has(cell, call):
    import xarray as xr

    cell.write_text(
        cell.read_text() + "\n[sensitivity]\nprior_width_factors = []\n"
    )  # none is computed then, and nothing is lost
    code, complaint, out = run_little(call, cell)
    assert code in (0, 3), complaint
    assert "lost" not in (out / "summary.json").read_text()
    assert not (out / "tables" / "sensitivity.csv").is_file()
    rows = pd.read_csv(out / "tables" / "parameters.csv", comment="#").set_index("parameter")
    assert set(rows.loc[["tau", "sigma_smooth"], "unit"]) == {"noise"}
    for name in ("model_error", "model_error_members", "model_error_poses", "model_error_alone", "tau_scale"):
        table = pd.read_csv(out / "tables" / f"{name}.csv", comment="#")
        assert set(table["unit"]) == {"noise"}
        assert not [column for column in table if column.endswith("_um")]
    sizes = pd.read_csv(out / "tables" / "model_error.csv", comment="#").set_index("term")
    assert rows.loc["tau", "q05"] < sizes.loc["random", "median"] < rows.loc["tau", "q95"]
    assert rows.loc["tau", "prior_sd"] == pytest.approx(np.sqrt(1.0 - 2.0 / np.pi), rel=1e-3)  # of a half-normal one
    tree = xr.open_datatree(next((out / "posterior").glob("*.nc")), engine="h5netcdf").load()
    assert tree["posterior"]["tau"].attrs["units"] == "noise"
    assert float(tree["posterior"]["tau"].mean()) == pytest.approx(rows.loc["tau", "mean"], rel=0.2)
    page = (out / "report.html").read_text()
    assert "× noise" in page
    text = re.sub(r"(?s)<(script|style|svg|pre).*?</\1>|<[^>]+>", " ", page)
    assert not re.search(r"\b(mm|µm|arcsec)\b", text)
