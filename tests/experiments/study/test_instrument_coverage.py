"""Calibrations of the shipped designs by a tracker, of poses or of points, its frames known or not: intervals hold."""

from __future__ import annotations

from dataclasses import dataclass

import audit_problems as problems
import numpy as np
import pytest

from bayescal.data.instruments.read_points import PointNoise, convert_polar, spread_polar
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.machines.readings import Legs, ReadingModel, Tracker, place
from bayescal.numerics.geometry import matrix_from_rotation_vector

QUANTILE = 1.6448536269514722  # of a standard normal, 95 %
DESIGNS = {"camera_hexapod": False, "camera_hexapod_frames": True, "m2_hexapod": False}
"""Whether the frames of tracker and probe have to be found."""
TRACKED = ("camera_hexapod_frames", "m2_hexapod")
FRAMES = {
    f"{name}_{turn}{axis}": sd
    for name in ("base1", "tool")
    for turn, sd in (("", 2.0), ("r", 1.7e-3))
    for axis in "xyz"
}
ACTUATOR_NOISE = 1e-3
POSE_SD = np.array([0.01] * 3 + [9.7e-6] * 3)  # mm, rad
PROBE = np.array([[400.0, 0.0, 60.0], [-250.0, 350.0, 20.0], [-200.0, -380.0, 90.0], [50.0, 80.0, 300.0]])
STATION = np.array([2800.0, -900.0, 650.0])  # mm
TURN = matrix_from_rotation_vector(np.array([0.02, -0.03, 2.7]))  # from the station's frame to the base's
NOISE = PointNoise((), range_um=5.0, range_ppm=0.5, azimuth_arcsec=1.0, elevation_arcsec=1.5)
MISSED = 0.3  # of the points: some poses have fewer than three


@dataclass(frozen=True)
class Design:
    """A machine with its tracker, its tolerances, where it is sent to, whether points are seen instead of poses."""

    model: ReadingModel
    priors: dict[str, Prior]
    commands: np.ndarray
    by_points: bool

    def measure(self, theta: np.ndarray, rng: np.random.Generator) -> tuple[Measurements, np.ndarray] | None:
        """Return what is read of a machine (D,), and its poses; None where it does not get to all of them."""
        stood = self.commands + ACTUATOR_NOISE * rng.standard_normal(self.commands.shape)
        pose, found = self.model.locate(theta, stood)
        if not found.all():
            return None
        n_legs = self.commands.shape[1]
        seen, covariance = (self._track if self.by_points else self._look)(
            self.model.read(theta, pose)[:, n_legs:], rng
        )
        sd, n = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), len(pose)
        correlation = np.tile(np.eye(n_legs + sd.shape[1]), (n, 1, 1))
        correlation[:, n_legs:, n_legs:] = covariance / (sd[:, :, None] * sd[:, None])
        data = Measurements(
            tuple(f"C{k}" for k in range(n)),
            np.concatenate([self.commands, seen], axis=1),
            np.concatenate([np.full((n, n_legs), ACTUATOR_NOISE), sd], axis=1),
            {},
            correlation,
            np.tile(np.arange(n_legs + sd.shape[1]) < n_legs, (n, 1)),
        )
        return data, pose

    def _look(self, true: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        noise = POSE_SD * rng.standard_normal(true.shape)
        seen = Comparison(self.model.channels[self.commands.shape[1] :]).add(true, noise)
        return seen, np.tile(np.diag(POSE_SD**2), (len(true), 1, 1))

    def _track(self, true: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return points as they are read by range and angles, NaN where missed, and their covariances."""
        x, y, z = np.moveaxis((true.reshape(len(true), -1, 3) - STATION) @ TURN, -1, 0)
        polar = np.stack([np.sqrt(x**2 + y**2 + z**2), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))], axis=-1)
        read = polar + spread_polar(NOISE, polar[..., 0]) * rng.standard_normal(polar.shape)
        values, slopes = convert_polar(read)
        root = TURN @ (slopes * spread_polar(NOISE, read[..., 0])[..., None, :])
        missed = rng.random(values.shape[:2]) < MISSED
        missed[missed.all(axis=1), 0] = False
        covariance = np.zeros((len(true), true.shape[1], true.shape[1]))
        for k in range(len(PROBE)):
            own = slice(3 * k, 3 * k + 3)
            covariance[:, own, own] = root[:, k] @ np.swapaxes(root[:, k], -1, -2)
        values = np.where(missed[..., None], np.nan, STATION + values @ TURN.T)
        return values.reshape(true.shape), covariance


def read_design(name: str, by_points: bool) -> Design:
    """Return a shipped design, its instrument instead of those that it lists."""
    legs, plan = Legs(problems.read_machine(name)), problems.read_shipped(name)
    seen = [(0, point) for point in PROBE] if by_points else [(0, None)]
    model = place(legs.pick(np.arange(legs.n_legs)), {"": Tracker(("A",), seen)})
    priors = {
        name: NormalPrior(one.mean, one.sd) for name, one in plan.variant.priors.items() if name in legs.layout.names
    }
    priors |= {name: NormalPrior(0.0, sd) for name, sd in FRAMES.items()} if DESIGNS[name] else {}
    commands = plan.variant.data.values[:, plan.variant.internal]
    return Design(model, {name: priors[name] for name in model.layout.names if name in priors}, commands, by_points)


def simulate(name: str, by_points: bool, n: int, seed: int) -> np.ndarray:
    """Return z-scores (n, parameters) of the truth under n calibrations of machines of the design's tolerances."""
    design, rng, scores = read_design(name, by_points), np.random.default_rng(seed), []
    layout = design.model.layout
    free = [layout.names.index(one) for one in design.priors]
    for _ in range(n):
        theta = layout.nominal.copy()
        theta[free] += [one.sd * rng.standard_normal() for one in design.priors.values()]
        measured = design.measure(theta, rng)
        if measured is None:
            continue
        posterior = Posterior(
            CalibrationLikelihood(design.model, measured[0], 1.0, measured[1]), design.priors, NO_ERRORS
        )
        posterior = posterior.with_pose_guesses()
        y = posterior.refine_geometry(posterior.least_squares_start())
        gradient, hessian = posterior.gradient(y)
        covariance = np.linalg.inv(-hessian)
        assert gradient @ covariance @ gradient < 1e-3
        found, change = posterior.around(y)
        spread = np.sqrt(np.diagonal(change @ covariance @ change.T))
        scores.append((np.ravel(found)[free] - theta[free]) / spread[free])
    assert len(scores) > 0.9 * n
    return np.array(scores)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "by_points"), [*((name, False) for name in DESIGNS), *((name, True) for name in TRACKED)]
)
def test_ninety_percent_intervals_hold_the_truth(name, by_points):
    scores = simulate(name, by_points, 200, 2026)
    inside = np.abs(scores) < QUANTILE
    assert 0.88 < inside.mean() < 0.92
    assert inside.mean(axis=0).min() > 0.80  # five standard errors of 200 below
    np.testing.assert_allclose(np.sqrt(np.mean(scores**2)), 1.0, atol=0.03)


@pytest.mark.parametrize("by_points", [False, True])
def test_few_calibrations_hold_the_truth(by_points):
    """As many as take seconds; intervals half as wide would fail."""
    inside = np.abs(simulate("camera_hexapod_frames", by_points, 4, 3)) < QUANTILE
    assert 0.84 < inside.mean() < 0.96
