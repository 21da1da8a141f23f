"""Calibrations by the shipped designs' own instruments, through a study's density: intervals hold the truth."""

import audit_problems as problems
import numpy as np
import pytest

from bayescal.data.instruments.read_points import PointNoise, convert_polar, spread_polar
from bayescal.data.instruments.readings import PointReadings, PoseReadings
from bayescal.density.errors import ModelError
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import build_leg_posterior
from bayescal.density.priors import NormalPrior
from bayescal.identifiability.calibration import simulate_measurements
from bayescal.identifiability.fits import Fitter
from bayescal.machines.frames import N_FRAME_PARAMETERS, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

DESIGNS = ("camera_hexapod", "camera_hexapod_frames", "m2_hexapod")
TRACKED = ("camera_hexapod_frames", "m2_hexapod")  # frames of station and probe unknown, and known
QUANTILE = 1.6448536269514722  # of a standard normal, 95 %


PROBE = np.array([[400.0, 0.0, 60.0], [-250.0, 350.0, 20.0], [-200.0, -380.0, 90.0], [50.0, 80.0, 300.0]])
STATION = np.array([2800.0, -900.0, 650.0])  # mm
TURN = matrix_from_rotation_vector(np.array([0.02, -0.03, 2.7]))  # from the station's frame to the base's
TRACKER = PointNoise((), range_um=5.0, range_ppm=0.5, azimuth_arcsec=1.0, elevation_arcsec=1.5)
MISSED = 0.3  # of the points: some poses have fewer than three


def calibrate(knowledge, readings, actuator_noise):
    """Return mode and covariance, in units of the tolerances, of what an instrument read."""
    layout = InstrumentLikelihood(knowledge.machine, readings, actuator_noise)
    centre = dict(zip(knowledge.layout.names, knowledge.centre, strict=True))
    priors = {name: NormalPrior(float(centre[name]), sd) for name, sd in knowledge.priors.items()}
    posterior = build_leg_posterior(layout, priors, ModelError(None), knowledge.fixed)
    assert posterior.names == knowledge.names
    y = posterior.polish(posterior.approach())
    gradient, hessian = posterior.gradient(y)
    covariance = np.linalg.inv(-hessian)
    assert gradient @ covariance @ gradient < 1e-3
    return y, covariance


def simulate(design, n, seed):
    """Return z-scores (n, parameters) of the truth under n calibrations of machines of the design's tolerances."""
    knowledge, plan = problems.describe_shipped(design)
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


def track(position, rotation, rng):
    """Return points (P, Q, 3) as a tracker reads them by range and angles, base frame, NaN where missed, covariances.

    ``position`` (P, 3) and ``rotation`` (P, 3, 3) are those of the probe as it truly stands.
    """
    places = position[:, None] + np.einsum("pij,qj->pqi", rotation, PROBE)
    x, y, z = np.moveaxis((places - STATION) @ TURN, -1, 0)
    true = np.stack([np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
    read = true + spread_polar(TRACKER, true[..., 0]) * rng.standard_normal(true.shape)
    values, slopes = convert_polar(read)
    root = TURN @ (slopes * spread_polar(TRACKER, read[..., 0])[..., None, :])
    values = STATION + values @ TURN.T
    missed = rng.random(values.shape[:2]) < MISSED
    missed[missed.all(axis=1), 0] = False
    return np.where(missed[..., None], np.nan, values), root @ np.swapaxes(root, -1, -2)


def simulate_tracked(design, n, seed):
    """Return z-scores as `simulate` does, of calibrations by points that one station tracks."""
    knowledge, plan = problems.describe_shipped(design)
    assert plan.model_error == 0.0
    fitter, rng = Fitter(knowledge, plan), np.random.default_rng(seed)
    truth = rng.standard_normal((n, len(knowledge.names)))
    theta = fitter.theta(truth)
    stood = plan.actuators + plan.actuator_noise * rng.standard_normal((n, *plan.actuators.shape))
    found = solve_forward_kinematics(knowledge.machine, theta[:, None, :-N_FRAME_PARAMETERS], stood, check=False)
    good = knowledge.layout.inside(theta) & found.converged.all(axis=1)
    position, rotation = move_frames(theta[:, -N_FRAME_PARAMETERS:], found.position, found.rotation)
    names, points = tuple(f"C{k}" for k in range(plan.n_poses)), tuple(f"P{k}" for k in range(len(PROBE)))
    scores = []
    for k in np.flatnonzero(good):
        values, covariance = track(position[k], rotation[k], rng)
        seen = (names, plan.actuators, ("A",), points, PROBE, values[:, None], covariance[:, None])
        y, spread = calibrate(knowledge, PointReadings(*seen), plan.actuator_noise)
        scores.append((y - truth[k]) / np.sqrt(np.diagonal(spread)))
    assert good.mean() > 0.95
    return np.array(scores)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("simulated", "design", "seed"),
    [*((simulate, one, 2026) for one in DESIGNS), *((simulate_tracked, one, 2027) for one in TRACKED)],
)
def test_ninety_percent_intervals_hold_the_truth(simulated, design, seed):
    scores = simulated(design, 200, seed)
    inside = np.abs(scores) < QUANTILE
    assert 0.88 < inside.mean() < 0.92
    assert inside.mean(axis=0).min() > 0.80  # five standard errors of 200 below
    np.testing.assert_allclose(np.sqrt(np.mean(scores**2)), 1.0, atol=0.03)


@pytest.mark.parametrize("simulated", [simulate, simulate_tracked])
def test_few_calibrations_hold_the_truth(simulated):
    """As many as take seconds; intervals half as wide would fail."""
    inside = np.abs(simulated("camera_hexapod_frames", 4, 3)) < QUANTILE
    assert 0.84 < inside.mean() < 0.96
