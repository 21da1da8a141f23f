"""Machines seen by their own sensors: small ones, linear ones, and readings with their poses as unknowns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.read import read_sliding_platform
from bayescal.machines.readings import Channel, Coordinate, Given, ReadingModel, Readings, SlidingPlatform
from bayescal.machines.readings.base import NOTHING
from bayescal.machines.readings.schema import PlanarPosesConfig, ReadingSensorConfig, ReadingTolerancesConfig
from bayescal.reproductions.sika2008.reading_machine import build_sensors, draw_poses, free_parameters
from bayescal.reproductions.sika2008.sensor_sets import SensorSet

EXPERIMENT = Path(__file__).parents[1] / "experiments" / "sliding_star"
TOLERANCES = ReadingTolerancesConfig(length_mm=0.3, angle_deg=0.05, zero_deg=2.0)
SENSORS = {
    "s": ReadingSensorConfig(noise_um=1.0),
    "phi": ReadingSensorConfig(noise_arcsec=1.0),
    "psi": ReadingSensorConfig(noise_arcsec=1.0),
}
WORKSPACE = PlanarPosesConfig(n_poses=12, position_mm=200.0, angle_deg=30.0)
SETS = {4: ("s",), 8: ("s", "phi"), 12: ("s", "phi", "psi")}


def workspace_volume(config: PlanarPosesConfig) -> float:
    """Return the volume that poses may lie in, mm² rad."""
    return float((2 * config.position_mm) ** 2 * 2 * np.radians(config.angle_deg))


def sliding_star() -> SlidingPlatform:
    """Return the shipped machine of four legs."""
    return read_sliding_platform(EXPERIMENT / "machine.toml")


def star_of(n_legs: int) -> SlidingPlatform:
    """Return the same with another number of legs, a turn's n-th apart."""
    around = 2 * np.pi * np.arange(n_legs) / n_legs
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    first, second = 100.0 * ring[:2]
    along = (second - first) / np.linalg.norm(second - first)
    own = np.array([along, [-along[1], along[0]]])
    points = (100.0 * ring - first) @ own.T
    home = np.array([*first, np.arctan2(along[1], along[0])])
    ahead = np.full(n_legs, True)
    legs = np.full(n_legs, 800.0)
    return SlidingPlatform("star", 600.0 * ring, around + np.pi / 2, legs, points, -own @ first, home, ahead)


def small_posterior(
    names: Iterable[str],
    n_poses: int,
    seed: int,
    model: SlidingPlatform | None = None,
    tolerances: ReadingTolerancesConfig = TOLERANCES,
    common: Iterable[str] = (),
    terms: tuple[ErrorTerm, ...] = (),
) -> CalibrationPosterior:
    """Return the posterior of a machine drawn within its tolerances, from readings with noise."""
    model = model or sliding_star()
    rng = np.random.default_rng(seed)
    sensors = build_sensors(model, SENSORS, names)
    free = free_parameters(model, sensors.names, tolerances)
    pose = draw_poses(model, WORKSPACE.model_copy(update={"n_poses": n_poses}), rng)
    theta = free.draw(rng, 1)[0]
    measured = sensors.read(theta, pose) + sensors.noise * rng.standard_normal((n_poses, len(sensors.chosen)))
    likelihood = star_density(sensors, measured, pose)
    tied = {symbol: tuple(model.layout.names[k] for k in model.layout.index[symbol]) for symbol in common}
    shared = {member: symbol for symbol, members in tied.items() for member in members}
    priors: dict[str, Prior] = {}
    for place, scale in zip(free.places, free.scale, strict=True):
        name = model.layout.names[place]
        priors.setdefault(shared.get(name, name), NormalPrior(float(free.centre[place]), float(scale)))
    return Posterior(likelihood, priors, Errors(terms), common=tied)


def star_density(
    sensors: SensorSet, measured: np.ndarray, start: np.ndarray, volume: float | None = None
) -> CalibrationLikelihood:
    """Return the density of readings (P, K), poses looked for from some (P, 3)."""
    names = tuple(f"C{k + 1}" for k in range(len(measured)))
    data = Measurements(names, measured, np.broadcast_to(sensors.noise, measured.shape))
    space = workspace_volume(WORKSPACE) if volume is None else volume
    return CalibrationLikelihood(sensors.model.pick(sensors.chosen), data, space, start)


def sensors_of(likelihood: CalibrationLikelihood) -> SensorSet:
    """Return the sensors of a density whose noise is that of the first pose."""
    return SensorSet(likelihood.model, np.arange(len(likelihood.model.channels)), likelihood.sd[0])


def find_poses_of(likelihood: CalibrationLikelihood, theta: np.ndarray) -> np.ndarray:
    """Return the poses (B, P, q) that machines (B, D) explain the readings with, the noise as stated."""
    own = np.broadcast_to(likelihood.sd, (len(theta), *likelihood.sd.shape))
    return likelihood.stand(theta, likelihood.whiten(own, np.zeros((len(theta), 1, own.shape[-1])))).pose


class JointTarget:
    """Parameters and all poses as unknowns: the density whose integral over the poses the product takes in its head.

    Coordinates are the parameters' as in the posterior, then each pose's three, about where the machine as expected
    would stand, in units of what noise makes them uncertain by.
    """

    def __init__(self, posterior: CalibrationPosterior) -> None:
        self.posterior = posterior
        likelihood = posterior.likelihood
        self.sensors, self.measured = sensors_of(likelihood), likelihood.data.values
        self.start = find_poses_of(likelihood, posterior.sampling.start[None])[0]
        slope = self.sensors.linearise(posterior.sampling.start, self.start, with_parameters=False).by_pose
        self.unit = np.linalg.cholesky(np.linalg.inv(np.swapaxes(slope, 1, 2) @ slope))
        self.n_poses = len(self.measured)
        k = len(self.sensors.chosen)
        volume = self.n_poses * np.log(workspace_volume(WORKSPACE))
        noise = self.n_poses * (np.log(self.sensors.noise).sum() + 0.5 * k * np.log(2 * np.pi))
        self.constant = -volume - noise + np.linalg.slogdet(self.unit)[1].sum()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.posterior.names, *(f"v{k}" for k in range(3 * self.n_poses)))

    @property
    def n_parameters(self) -> int:
        return len(self.names)

    @property
    def n_geometry(self) -> int:
        return len(self.names)

    def split(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return machines (B, D) and poses (B, P, 3)."""
        own = self.posterior.n_parameters
        steps = y[..., own:].reshape(*y.shape[:-1], self.n_poses, 3)
        return self.posterior.theta(y[..., :own]), self.start + np.einsum("pij,...pj->...pi", self.unit, steps)

    def join(self, y: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Return coordinates of parameters (B, n) and poses (B, P, 3)."""
        steps = np.linalg.solve(self.unit, (pose - self.start)[..., None])[..., 0]
        return np.concatenate([y, steps.reshape(len(y), -1)], axis=1)

    def natural(self, y: np.ndarray) -> np.ndarray:
        return y

    def residual(self, y: np.ndarray) -> np.ndarray:
        theta, pose = self.split(y)
        return (self.measured - self.sensors.read(theta[..., None, :], pose)) / self.sensors.noise

    def log_density(self, y: np.ndarray) -> np.ndarray:
        own = self.posterior.n_parameters
        square = (self.residual(y) ** 2).sum(axis=(-1, -2))
        found = self.posterior.log_prior(y[..., :own]) - 0.5 * square + self.constant
        return np.where(np.isfinite(found), found, -np.inf)

    def rows(self, y: np.ndarray) -> np.ndarray:
        """Return the derivative of the residuals, shape (P K, n)."""
        theta, pose = self.split(y)
        here = self.sensors.linearise(theta, pose)
        own = self.posterior.n_parameters
        result = np.zeros((self.n_poses, len(self.sensors.chosen), len(y)))
        result[..., :own] = -here.by_parameters @ self.posterior.around(y)[1].T.T
        for p in range(self.n_poses):
            result[p, :, own + 3 * p : own + 3 * p + 3] = -here.by_pose[p] @ self.unit[p]
        return result.reshape(-1, len(y))

    def gradient(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, own = self.rows(y), self.posterior.n_parameters
        prior = np.where(np.arange(len(y)) < own, 1.0, 0.0)
        return -rows.T @ self.residual(y).ravel() - prior * y, -rows.T @ rows - np.diag(prior)

    def newton(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.gradient(y)

    def approach(self) -> np.ndarray:
        return self.polish(np.zeros(self.n_parameters))

    def polish(self, y: np.ndarray) -> np.ndarray:
        own = self.posterior.n_parameters
        prior = np.eye(own, len(y))
        return least_squares(
            lambda x: np.concatenate([self.residual(x).ravel(), x[:own]]),
            y,
            lambda x: np.concatenate([self.rows(x), prior]),
            xtol=1e-14,
            ftol=1e-14,
        ).x

    def jumps(self, y: np.ndarray) -> list:
        return []

    def funnel_errors(self, y: np.ndarray) -> np.ndarray:
        return np.empty((*y.shape[:-1], 0))

    def groups(self) -> list:
        return []

    def curved_ridges(self) -> list:
        return []

    def finer(self) -> None:
        return None

    def funnel(self, y: np.ndarray) -> None:
        return None


@dataclass(frozen=True, eq=False)
class LinearModel(ReadingModel):
    """Readings that are linear in the pose and in the parameters: h = H v + A d."""

    by_pose: np.ndarray
    by_parameters: np.ndarray

    @cached_property
    def layout(self) -> ParameterLayout:
        return ParameterLayout((ParameterBlock("d", (0.0,) * self.by_parameters.shape[1]),))

    @cached_property
    def sensors(self) -> tuple[Channel, ...]:
        return tuple(Channel(f"s[{k + 1}]", "mm") for k in range(len(self.by_pose)))

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(Coordinate(f"v{k}", "mm") for k in range(self.by_pose.shape[1]))

    def read(self, theta: np.ndarray, pose: np.ndarray, given: Given = NOTHING) -> np.ndarray:
        return self.take(pose @ self.by_pose.T + theta @ self.by_parameters.T)

    def linearise(
        self, theta: np.ndarray, pose: np.ndarray, with_parameters: bool = True, given: Given = NOTHING
    ) -> Readings:
        values = pose @ self.by_pose.T + theta @ self.by_parameters.T
        shapes = [np.broadcast_to(x, (*values.shape[:-1], *x.shape)) for x in (self.by_pose, self.by_parameters)]
        return Readings(values, *shapes).pick(self.places)

    def rotation(self, *_: object) -> np.ndarray:
        raise NotImplementedError

    def tool(self, theta: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        raise NotImplementedError


def gaussian_log_evidence(
    sensors: SensorSet, measured: np.ndarray, pose: np.ndarray, moves: np.ndarray, volume: float
) -> float:
    """Return the evidence of readings that are linear about a machine at poses, in closed form.

    Parameters are ``moves`` (n, D) times standard normals; poses are flat in the volume.
    """
    nominal = sensors.model.layout.nominal
    here = sensors.linearise(nominal, pose)
    rest, slopes, constant = [], [], 0.0
    for p in range(len(pose)):
        basis = null_space(here.by_pose[p].T)
        rest.append(basis.T @ (measured[p] / sensors.noise - here.values[p]))
        slopes.append(basis.T @ here.by_parameters[p] @ moves.T)
        constant -= 0.5 * np.linalg.slogdet(here.by_pose[p].T @ here.by_pose[p])[1]
        constant -= np.log(sensors.noise).sum() + np.log(volume)
    slope = np.concatenate(slopes)
    covariance = np.eye(len(slope)) + slope @ slope.T
    return constant + float(multivariate_normal.logpdf(np.concatenate(rest), cov=covariance))
