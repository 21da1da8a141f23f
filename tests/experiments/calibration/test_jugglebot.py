"""A measured Stewart platform: what its shipped study says, and that validation names a gear that is wrong."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import studies

FOLDER = studies.EXPERIMENTS / "jugglebot"

pytestmark = pytest.mark.runs


def test_validation_names_the_wrong_gear_of_the_machine_as_drawn(call):
    """A factor on the noise and errors in proportion to all travels compete with the gain of leg 1."""
    code, said, _ = call("validate", FOLDER / "drawn.toml")
    assert code == 3
    factor = re.search(r"corrected: readings of rho\[1\] seem to be ([\d.]+) times the expected ones", said)
    assert float(factor[1]) == pytest.approx(1.0 / (1.0 - 0.061), abs=0.005)
    assert "free gain[1] in [parameters]" in said


def test_a_measured_platform_is_calibrated_as_shipped(call, tmp_path):
    code, said, warned = call("run", FOLDER / "study.toml", "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    assert "the measured poses lie 55.0 mm" in said + warned
    findings = pd.read_csv(tmp_path / "out" / "tables" / "findings.csv")["text"]
    assert findings.str.contains(r"The measured poses lie 55\.0 mm .* from nominal").any()
    assert findings.str.contains(r"gain\[1\] lies .* times its tolerance from nominal").any()

    variants = pd.read_csv(tmp_path / "out" / "tables" / "variants.csv").set_index("variant")
    evidence = variants["log_evidence"]
    assert variants["converged"].all()
    assert evidence["gain_1"] - evidence["rigid"] == pytest.approx(410.0, abs=10.0)
    assert evidence["gains"] - evidence["gain_1"] == pytest.approx(26.0, abs=3.0)
    parameters = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv").set_index(["variant", "parameter"])["mean"]
    gains = np.array([parameters["gains", f"gain[{leg}]"] for leg in range(1, 7)])
    assert gains[0] == pytest.approx(1.0 - 0.061, abs=0.003)
    assert np.abs(gains[1:] - 1.0).max() < 0.01
    residuals = pd.read_csv(tmp_path / "out" / "tables" / "residuals.csv")
    residuals = residuals[residuals["channel"].str.startswith("rho")]
    rms = residuals.groupby("variant")["residual"].apply(lambda own: float(np.sqrt(np.mean(own**2))))
    assert rms["gains"] < 0.45
    assert rms["rigid"] > 0.6
    predicted = pd.read_csv(tmp_path / "out" / "tables" / "predictions.csv")
    inside = predicted.groupby("variant")["in_interval_90"].mean()
    assert inside.between(0.85, 0.97).all()
