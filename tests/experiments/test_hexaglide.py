"""The shipped hexaglide end to end: an audit, poses and sensors."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import studies
import telescope_machines as machines

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import Legs

HEXAGLIDE = studies.EXPERIMENTS / "hexaglide"


def test_readings_and_their_derivatives(rng):
    """Encoders and inclinometers on carriages' legs, far along the rails."""
    model = Legs(machines.build_machine("none", load_mechanism(HEXAGLIDE / "mechanism.toml")), inclined=True)
    theta = model.layout.nominal
    pose = model.home_pose + np.array([230.0, 20.0, -15.0, 0.02, -0.03, 0.01])
    here = model.linearise(theta, pose)
    steps = np.array([0.1] * 3 + [1e-3] * 3)
    by_pose = machines.central_difference(lambda x: model.read(theta, x), pose, 0.01 * steps)
    np.testing.assert_allclose(here.by_pose, by_pose, rtol=1e-5, atol=1e-7)
    spread = np.where(np.array(model.layout.units) == "mm", 1e-2, 1e-4)
    by_parameters = machines.central_difference(lambda x: model.read(x, pose), theta, spread)
    np.testing.assert_allclose(here.by_parameters, by_parameters, rtol=1e-4, atol=1e-5)


def shorten(text: str, **values: object) -> str:
    """Return a config with numbers replaced by key."""
    for key, value in values.items():
        text, n = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        assert n == 1, key
    return text


@pytest.mark.slow
def test_audit_runs_tiny(tmp_path):
    folder = tmp_path / "hexaglide"
    folder.mkdir()
    for file in ("mechanism.toml", "calibration_configurations.csv"):
        (folder / file).write_text((HEXAGLIDE / file).read_text())
    text = shorten((HEXAGLIDE / "audit.toml").read_text(), n_simulated_calibrations=4, n_prior_draws=3)
    path = folder / "audit.toml"
    path.write_text(text + "\n[sweep]\nnoise = [1.0]\nposes = [30]\nworkspace = [1.0]\n")
    run_experiment(load_experiment(path), folder, tmp_path / "out", workers=1)
    found = pd.read_csv(tmp_path / "out" / "tables" / "combinations.csv").set_index("pivot")["sentence"]
    assert all("a_x" in sentence for pivot, sentence in found.items() if pivot.startswith("rho0"))
    assert found.index.str.startswith("rho0").any()
