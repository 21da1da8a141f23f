"""A study of a machine on struts, from its simulated twin to the report."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import hexapods
import pandas as pd
import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.run import run_experiment
from bayescal.report.pictures import Picture

pytestmark = pytest.mark.runs


@pytest.fixture(scope="module", params=hexapods.LIMITS)
def folder(request, tmp_path_factory) -> Path:
    """Return a folder with a tiny study of a hexapod."""
    folder = tmp_path_factory.mktemp(request.param)
    hexapods.write_hexapod_study(folder, request.param)
    return folder


@pytest.fixture(scope="module")
def results(folder) -> Path:
    """Return the results of the study, pictures not drawn."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
        return run_experiment(load_experiment(folder / "study.toml"), folder, folder / "results", workers=1).out


@pytest.fixture(scope="module")
def variants(results) -> dict[str, Any]:
    return json.loads((results / "summary.json").read_text())["variants"]


def test_rigid_twin_is_found_rigid(variants, results):
    """With one model error for all legs; a deformation of a hundredth of the stroke is far from the data."""
    assert {name: fit["n_parameters"] for name, fit in variants.items()} == {"six_ups/none": 13, "six_ups/linear": 13}
    gap = variants["six_ups/none"]["log_evidence"] - variants["six_ups/linear"]["log_evidence"]
    assert gap > 50


def test_posterior_holds_the_twin(results):
    """Of M2's fourth strut, which lies along x, only the sum of both is known: 1 / √2 of their prior sd remains."""
    parameters = studies.read_posterior(results, "six_ups/none")
    for symbol, values in hexapods.TRUE_OFFSETS.items():
        for leg, offset in enumerate(values, start=1):
            found = parameters[f"{symbol}[{leg}]"]
            assert abs(found["mean"] - found["nominal"] - offset) < 5 * found["sd"]
            assert found["sd"] < 0.75 * found["prior_sd"]


def test_verification_poses_are_predicted_within_the_noise(variants):
    assert variants["six_ups/none"]["verification"]["position_error_mm"]["max"] < 0.03


def test_least_squares_finds_the_twin(results):
    table = pd.read_csv(results / "tables" / "least_squares.csv").query("variant == 'six_ups/none'")
    lengths = table[table["parameter"] == "l"]
    assert lengths["offset"].to_numpy() == pytest.approx(hexapods.TRUE_OFFSETS["l"], abs=0.1)
    assert table["converged"].all()
    assert table["leg_residual_rms_um"].max() < 10


def test_report_is_written_without_the_claims_of_another_machine(results):
    page = (results / "report.html").read_text()
    assert "6-UPS/none" in page
    assert "hardpoints.png" not in page  # a_y and b are not free
    assert not (results / "tables" / "claims.csv").exists()
    assert 'id="claims"' not in page


def test_a_model_of_another_drive_is_refused(folder, tmp_path):
    studies.write_texts(tmp_path, {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*.toml")})
    studies.write_texts(tmp_path, {str(p.relative_to(folder)): p.read_text() for p in folder.glob("data/*.csv")})
    path = tmp_path / "study.toml"
    studies.edit(path, 'model = "six_ups"', 'model = "stiffness"')
    with pytest.raises(InputError) as caught:
        studies.load_study(path)
    assert str(caught.value).startswith(f"{tmp_path / 'mechanism.toml'}: model 'stiffness': found struts in mechanism ")
    assert str(caught.value).endswith(", expected six_ups")
