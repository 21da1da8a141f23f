"""A self-calibration whose sensors err by functions of what they read: what the user gets."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pandas as pd
import pytest
from reading_studies import describe_variant, load_small, write_small
from rich.console import Console
from saved_trees import read_tree

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.run import run_experiment
from bayescal.numerics.units import ARCSECOND

pytestmark = pytest.mark.runs

SLOPES = np.array([80.0, -50.0, 120.0]) * ARCSECOND  # of the angles, which go some 0.4 rad to either side
BLOCK = """
[model_error]
kernel_scale_um = 10.0
kernel_scale_arcsec = 30.0
kernel_sensors = ["s", "phi"]

[sampler]"""


def spoil(path) -> None:
    """Make the encoders of legs and carriages err in proportion to what they read."""
    table = pd.read_csv(path, comment="#")
    for k, slope in enumerate(SLOPES, start=1):
        table[f"phi_{k}_rad"] += slope * table[f"phi_{k}_rad"]
    head = [line for line in path.read_text().splitlines() if line.startswith("#")]
    path.write_text("\n".join([*head, table.to_csv(index=False, float_format="%.9f")]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return where a self-calibration with and without such errors has run."""
    here = tmp_path_factory.mktemp("sensors")
    kernel = 'model_error = "linear"'
    sensors = ["s", "phi", "psi"]
    path = write_small(here, describe_variant("plain", sensors), describe_variant("errors", sensors, kernel))
    path.write_text(path.read_text().replace("[sampler]", BLOCK, 1))
    spoil(here / "data" / "readings.csv")
    finished = run_experiment(load_experiment(path), here, here / "out")
    finished.show(Console(file=io.StringIO(), width=120))
    return here


def test_tables_tell_which_sensors_err(folder):
    table = pd.read_csv(folder / "out" / "functions.csv").set_index("sensor")
    assert list(table.index) == [f"{kind}[{k}]" for kind in ("s", "phi") for k in (1, 2, 3)]
    assert set(table["variant"]) == {"errors"}
    assert table.loc["phi[1]", "present"] > 0.99
    readings = load_small(folder / "study.toml").table
    used = readings.values[~readings.verification]
    for k, slope in enumerate(SLOPES, start=1):
        size = abs(slope) / ARCSECOND * np.sqrt(np.mean(used[:, 3 + k - 1] ** 2))
        low, high = table.loc[f"phi[{k}]", ["rms_low", "rms_high"]]
        assert low - 4.0 * (high - low) < size < high + 4.0 * (high - low)


def test_curves_go_through_zero_at_home_and_have_intervals(folder):
    curves = pd.read_csv(folder / "out" / "function_curves.csv")
    assert (curves["low"] <= curves["high"]).all()
    one = curves[curves["sensor"] == "phi[3]"]
    slope = np.polyfit(one["reading"], one["mean"], 1)[0]
    assert slope == pytest.approx(SLOPES[2] / ARCSECOND, rel=0.4)


def test_evidence_and_intervals_know_the_errors(folder):
    summary = json.loads((folder / "out" / "summary.json").read_text())
    plain, errors = (summary["variants"][name] for name in ("plain", "errors"))
    assert summary["rankings"] == [["errors", "plain"]]
    assert errors["log_evidence"] > plain["log_evidence"] + 10.0
    assert errors["elpd"] > plain["elpd"] + 2.0
    assert errors["tool_after_um"] > plain["tool_after_um"]
    assert errors["tool_calibrated_error_um"] is None
    parameters = pd.read_csv(folder / "out" / "parameters.csv")
    sd = {name: rows["sd"].mean() for name, rows in parameters.groupby("variant")}
    assert sd["errors"] > sd["plain"]


def test_page_and_posterior_have_them(folder):
    page = re.sub(r"base64,[^\"]*", "", (folder / "out" / "report.html").read_text())
    assert "Errors that are functions" in page
    assert "sensors phi err by functions of what they read" in page
    assert not re.search(r"\bnan\b|None", page)
    assert (folder / "out" / "figures" / "functions_errors.png").exists()
    tree = read_tree(folder / "out" / "posterior" / "errors.nc")
    assert float(tree["posterior/sigma_g(phi)"].min()) >= 0.0
    for group in ("log_likelihood", "log_prior", "sample_stats"):
        for values in tree[group].data_vars.values():
            assert values.dtype.kind != "f" or np.isfinite(values.to_numpy()).all()
