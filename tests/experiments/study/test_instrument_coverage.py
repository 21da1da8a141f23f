"""Calibrations by the shipped designs' own instruments, through a study's density: intervals hold the truth."""

import audit_problems as problems
import numpy as np
import pytest
from bayescal.density.errors import ModelError
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import build_leg_posterior

from bayescal.data.instruments.read_points import PointNoise, convert_polar, spread_polar
from bayescal.data.instruments.readings import PointReadings, PoseReadings
from bayescal.density.priors import NormalPrior
from bayescal.machines.frames import frame_blocks, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

DESIGNS = ("camera_hexapod", "camera_hexapod_frames", "m2_hexapod")
TRACKED = ("camera_hexapod_frames", "m2_hexapod")  # frames of station and probe unknown, and known
ACTUATOR_NOISE = 1e-3  # mm
QUANTILE = 1.6448536269514722  # of a standard normal, 95 %


PROBE = np.array([[400.0, 0.0, 60.0], [-250.0, 350.0, 20.0], [-200.0, -380.0, 90.0], [50.0, 80.0, 300.0]])
STATION = np.array([2800.0, -900.0, 650.0])  # mm
TURN = matrix_from_rotation_vector(np.array([0.02, -0.03, 2.7]))  # from the station's frame to the base's
TRACKER = PointNoise((), range_um=5.0, range_ppm=0.5, azimuth_arcsec=1.0, elevation_arcsec=1.5)
MISSED = 0.3  # of the points: some poses have fewer than three


class Shipped:
    """A shipped hexapod as those take it who know legs alone, with frames of instrument and tool."""

    def __init__(self, design):
        plan = problems.read_shipped(design)
        self.machine = problems.read_machine(design)
        self.layout = self.machine.layout.extend(frame_blocks(1))
        self.priors = {}
        for one, sd in zip(plan.names, plan.sd, strict=True):
            symbol, _, number = one.removeprefix("laser_tracker_").partition("[")
            frame, turned = {"frame": "base", "target": "tool"}.get(symbol.removesuffix("_r")), symbol.endswith("_r")
            axis = "xyz"[int(number[:-1]) - 1] if frame else ""
            name = f"{frame}_{'r' * turned}{axis}" if frame else one
            self.priors[name] = NormalPrior(float(self.layout.nominal[self.layout.names.index(name)]), float(sd))
        self.names = tuple(name for name in self.layout.names if name in self.priors)
        self.actuators = plan.variant.data.values[:, plan.variant.internal]

    def stand(self, n, rng):
        """Return n machines off by (n, m) tolerances, which take all poses, and where these are seen."""
        moves, theta = rng.standard_normal((n, len(self.names))), np.tile(self.layout.nominal, (n, 1))
        free = [self.layout.names.index(name) for name in self.names]
        theta[:, free] += moves * [self.priors[name].sd for name in self.names]
        stood = self.actuators + ACTUATOR_NOISE * rng.standard_normal((n, *self.actuators.shape))
        size = self.machine.layout.size
        found = solve_forward_kinematics(self.machine, theta[:, None, :size], stood, check=False)
        good = self.layout.inside(theta) & found.converged.all(axis=1)
        assert good.mean() > 0.95
        position, rotation = move_frames(theta[:, size:], found.position, found.rotation)
        return moves[good], position[good], rotation[good]

    def calibrate(self, readings):
        """Return mode and covariance, in units of the tolerances, of what an instrument read."""
        layout = InstrumentLikelihood(self.machine, readings, ACTUATOR_NOISE)
        posterior = build_leg_posterior(layout, self.priors, ModelError(None), {})
        assert posterior.names == self.names
        y = posterior.polish(posterior.approach())
        gradient, hessian = posterior.gradient(y)
        covariance = np.linalg.inv(-hessian)
        assert gradient @ covariance @ gradient < 1e-3
        return y, covariance


def simulate(design, n, seed):
    """Return z-scores (n, parameters) of the truth under n calibrations of machines of the design's tolerances."""
    shipped, rng = Shipped(design), np.random.default_rng(seed)
    truth, position, rotation = shipped.stand(n, rng)
    names = tuple(f"C{k}" for k in range(len(shipped.actuators)))
    covariance = np.tile(
        np.linalg.inv(problems.TRACKER.information(position[0, :1], rotation[0, :1])), (len(names), 1, 1)
    )
    noise = rng.standard_normal((*position.shape[:2], 6)) * np.sqrt(np.diagonal(covariance[0]))
    scores = []
    for k, moves in enumerate(truth):
        turn = rotation_vector_from_matrix(matrix_from_rotation_vector(noise[k, :, 3:]) @ rotation[k])
        values = np.concatenate([position[k] + noise[k, :, :3], turn], axis=1)
        y, spread = shipped.calibrate(PoseReadings(names, shipped.actuators, values, covariance))
        scores.append((y - moves) / np.sqrt(np.diagonal(spread)))
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
    shipped, rng = Shipped(design), np.random.default_rng(seed)
    truth, position, rotation = shipped.stand(n, rng)
    names, points = tuple(f"C{k}" for k in range(len(shipped.actuators))), tuple(f"P{k}" for k in range(len(PROBE)))
    scores = []
    for k, moves in enumerate(truth):
        values, covariance = track(position[k], rotation[k], rng)
        seen = (names, shipped.actuators, ("A",), points, PROBE, values[:, None], covariance[:, None])
        y, spread = shipped.calibrate(PointReadings(*seen))
        scores.append((y - moves) / np.sqrt(np.diagonal(spread)))
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
