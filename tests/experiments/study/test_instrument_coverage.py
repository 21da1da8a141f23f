"""Calibrations by the shipped designs' own instruments, through a study's density: intervals hold the truth."""

import numpy as np
import pytest
import studies

from bayescal.data.instruments.poses import PoseReadings
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.posterior import ModelError, Posterior
from bayescal.density.priors import NormalPrior
from bayescal.experiments.audit.inputs import read_inputs
from bayescal.experiments.audit.load import load_audit
from bayescal.identifiability.calibration import simulate_measurements
from bayescal.identifiability.fits import Fitter
from bayescal.numerics.geometry import rotation_vector_from_matrix

DESIGNS = ("camera_hexapod", "camera_hexapod_frames", "m2_hexapod")
QUANTILE = 1.6448536269514722  # of a standard normal, 95 %


def calibrate(knowledge, readings, actuator_noise):
    """Return mode and covariance, in units of the tolerances, of what an instrument read."""
    layout = InstrumentLikelihood(knowledge.machine, readings, actuator_noise)
    centre = dict(zip(knowledge.layout.names, knowledge.centre, strict=True))
    priors = {name: NormalPrior(float(centre[name]), sd) for name, sd in knowledge.priors.items()}
    posterior = Posterior(layout, priors, ModelError(None), knowledge.fixed)
    assert posterior.names == knowledge.names
    y = posterior.polish(posterior.approach())
    gradient, hessian = posterior.gradient(y)
    covariance = np.linalg.inv(-hessian)
    assert gradient @ covariance @ gradient < 1e-3
    return y, covariance


def simulate(design, n, seed):
    """Return z-scores (n, parameters) of the truth under n calibrations of machines of the design's tolerances."""
    config = load_audit(studies.EXPERIMENTS / "audit" / f"{design}.toml")
    inputs = read_inputs(config, studies.EXPERIMENTS / "audit")
    knowledge, plan = inputs.knowledge, inputs.plan
    fitter, rng = Fitter(knowledge, plan), np.random.default_rng(seed)
    truth = rng.standard_normal((n, len(knowledge.names)))
    measured, good = simulate_measurements(fitter, truth, rng)
    covariance = np.linalg.inv(fitter.seen)
    names = tuple(f"C{k}" for k in range(plan.n_poses))
    scores = []
    for k in np.flatnonzero(good):
        turn = rotation_vector_from_matrix(measured.rotation[k])
        values = np.concatenate([measured.position[k], turn], axis=1)
        readings = PoseReadings(names, measured.actuators[k], values, covariance)
        y, spread = calibrate(knowledge, readings, plan.actuator_noise)
        scores.append((y - truth[k]) / np.sqrt(np.diagonal(spread)))
    assert good.mean() > 0.95
    return np.array(scores)


@pytest.mark.slow
@pytest.mark.parametrize("design", DESIGNS)
def test_ninety_percent_intervals_hold_the_truth(design):
    scores = simulate(design, 200, 2026)
    inside = np.abs(scores) < QUANTILE
    assert 0.88 < inside.mean() < 0.92
    assert inside.mean(axis=0).min() > 0.80  # five standard errors of 200 below
    np.testing.assert_allclose(np.sqrt(np.mean(scores**2)), 1.0, atol=0.03)


def test_few_calibrations_hold_the_truth():
    """As many as take seconds; intervals half as wide would fail."""
    inside = np.abs(simulate("camera_hexapod_frames", 4, 3)) < QUANTILE
    assert 0.84 < inside.mean() < 0.96
