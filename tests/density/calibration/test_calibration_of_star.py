"""A calibration of Sliding Star from its own readings beside the kind that does nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from reading_machines import EXPERIMENT

from bayescal.experiments.calibration.inputs import read_inputs
from bayescal.experiments.calibration.schema import CalibrationConfig
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.self_calibration.inputs import read_inputs as read_self_calibration

LENGTHS = ("x_P", "y_P", "l", "xi_B", "eta_B")
SETS = {"s8": ["s", "phi"], "s12": ["s", "phi", "psi"]}


@pytest.fixture(scope="module")
def star():
    """Return the shipped self-calibration's inputs."""
    return read_self_calibration(load_experiment(EXPERIMENT / "study.toml"), EXPERIMENT)


def calibrate(star, name):
    """Return the posterior of the same readings, tolerances and fixed frames by the calibration of any machine."""
    model = star.model
    free = star.posterior(star.variants[name]).names
    assert not set(free) & set(model.frame_parameters())
    parameters = {symbol: {"prior": "normal", "sd": 0.3} for symbol in LENGTHS}
    parameters |= {"beta": {"prior": "normal", "sd": 0.05}, "phi0": {"prior": "normal", "sd": 2.0}}
    parameters |= {"psi0": {"prior": "normal", "sd": 2.0}}
    x, y, phi = model.home
    sensors = {"s": {"noise_um": 1.0}, "phi": {"noise_arcsec": 1.0}, "psi": {"noise_arcsec": 1.0}}
    content = {
        "kind": "calibration",
        "name": "star",
        "title": "star",
        "seed": 1,
        "origin": {"status": "simulated", "text": "one machine"},
        "machine": "machine.toml",
        "data": [{"file": "data/readings.csv"}],
        "sensors": {kind: sensors[kind] for kind in SETS[name]},
        "parameters": parameters,
        "workspace": {
            "x": [x - 200.0, x + 200.0],
            "y": [y - 200.0, y + 200.0],
            "phi": [np.degrees(phi) - 30.0, np.degrees(phi) + 30.0],
        },
        "variants": [{"name": name, "title": name, "sensors": SETS[name], "free": list(free)}],
    }
    return read_inputs(CalibrationConfig.model_validate(content), EXPERIMENT).variants[name].posterior()


@pytest.mark.parametrize("name", SETS)
def test_both_kinds_have_the_same_density(star, name, rng):
    """Up to what poses are off by where H is taken for constant: 0.3 deviations of a reading."""
    expected, found = star.posterior(star.variants[name]), calibrate(star, name)
    assert found.names == expected.names
    np.testing.assert_allclose(found.prior_sd, expected.prior_sd, rtol=1e-12)
    mode = expected.approach()
    np.testing.assert_allclose(found.approach(), mode, rtol=0, atol=1e-5)
    deviation = np.sqrt(np.diag(np.linalg.inv(-expected.gradient(mode)[1])))
    y = mode + deviation * rng.standard_normal((20, len(mode)))
    y[10:] += 0.1 * rng.standard_normal((10, len(mode)))
    np.testing.assert_array_equal(found.log_prior(y), expected.log_prior(y))
    for one in (found, found.anchored()):
        apart = one.log_density(y) - expected.log_density(y)
        np.testing.assert_allclose(apart[:10], 0.0, rtol=0, atol=1e-4)
        np.testing.assert_allclose(apart[10:] / expected.log_density(y[10:]), 0.0, rtol=0, atol=1e-6)
    gradient, hessian = found.gradient(y[0])
    other, information = expected.gradient(y[0])
    np.testing.assert_allclose(gradient, other, rtol=0, atol=1e-4 / deviation.min())
    np.testing.assert_allclose(hessian, information, rtol=1e-4, atol=1e-5 * np.abs(information).max())
