"""Machines seen by their own sensors: small ones, linear ones, and readings with their poses as unknowns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal
from sliding_platforms import WORKSPACE, sliding_star

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.machines.readings import Channel, Coordinate, FunctionModel, Given, ReadingModel, Readings
from bayescal.machines.readings.base import NO_CONDITIONS
from bayescal.numerics.units import ARCSECOND, MICROMETRE


class Tolerances(NamedTuple):
    """Standard deviations of lengths and places, of guide angles, of zeros of angle sensors, mm and rad."""

    length: float
    angle: float
    zero: float

    def scale(self, model: ReadingModel, names: Iterable[str]) -> np.ndarray:
        """Return those of all parameters (D,): zero for what these sensors do not see, and for what defines frames."""
        layout, free = model.layout, set(model.seen_parameters(names)) - set(model.machine.frame_parameters())
        kinds = [name.partition("[")[0] for name in layout.names]
        angles = [self.zero if kind in ("phi0", "psi0") else self.angle for kind in kinds]
        scale = np.where(np.array(layout.units) == "mm", self.length, angles)
        return np.where(np.isin(layout.names, list(free)), scale, 0.0)


TOLERANCES = Tolerances(0.3, float(np.radians(0.05)), float(np.radians(2.0)))


def draw_machines(model: ReadingModel, scale: np.ndarray, rng: np.random.Generator, n: int) -> np.ndarray:
    """Return machines (n, D) within standard deviations (D,) of nominal."""
    theta, free = np.tile(model.layout.nominal, (n, 1)), np.flatnonzero(scale)
    theta[:, free] += scale[free] * rng.standard_normal((n, len(free)))
    return theta


@dataclass(frozen=True, eq=False)
class Sensors:
    """A machine with some of its sensors, each with its noise (K,), mm and rad."""

    model: ReadingModel
    noise: np.ndarray

    @classmethod
    def of(cls, model: ReadingModel, names: Iterable[str]) -> Sensors:
        """Return some sensors with a noise of 1 µm or 1 arcsec each."""
        picked = model.pick(model.select(names))
        return cls(picked, np.array([MICROMETRE if one.unit == "mm" else ARCSECOND for one in picked.channels]))

    def measure(self, theta: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return readings (P, K) with their noise."""
        return self.model.read(theta, pose) + self.noise * rng.standard_normal((len(pose), len(self.noise)))

    def linearise(self, theta: np.ndarray, pose: np.ndarray, with_parameters: bool = True) -> Readings:
        """Return readings and derivatives in units of the noise."""
        found, scale = self.model.linearise(theta, pose, with_parameters), self.noise[:, None]
        by_parameters = found.by_parameters / scale if with_parameters else found.by_parameters
        return Readings(found.values / self.noise, found.by_pose / scale, by_parameters)


def small_posterior(
    names: Iterable[str],
    n_poses: int,
    seed: int,
    model: FunctionModel | None = None,
    tolerances: Tolerances = TOLERANCES,
    common: Iterable[str] = (),
    terms: tuple[ErrorTerm, ...] = (),
) -> CalibrationPosterior:
    """Return the posterior of a machine drawn within its tolerances, from readings with noise."""
    model = model or sliding_star()
    rng = np.random.default_rng(seed)
    sensors, scale = Sensors.of(model, names), tolerances.scale(model, names)
    pose = replace(WORKSPACE, n_poses=n_poses).draw(model, rng)
    theta = draw_machines(model, scale, rng, 1)[0]
    likelihood = star_density(sensors, sensors.measure(theta, pose, rng), pose)
    tied = {symbol: tuple(model.layout.names[k] for k in model.layout.index[symbol]) for symbol in common}
    shared = {member: symbol for symbol, members in tied.items() for member in members}
    priors: dict[str, Prior] = {}
    for place in np.flatnonzero(scale):
        name, nominal = model.layout.names[place], float(model.layout.nominal[place])
        priors.setdefault(shared.get(name, name), NormalPrior(nominal, float(scale[place])))
    return Posterior(likelihood, priors, ErrorModel(terms), common=tied)


def star_density(
    sensors: Sensors, measured: np.ndarray, start: np.ndarray, volume: float = WORKSPACE.volume
) -> CalibrationLikelihood:
    """Return the density of readings (P, K), poses looked for from some (P, 3)."""
    names = tuple(f"C{k + 1}" for k in range(len(measured)))
    data = Measurements(names, measured, np.broadcast_to(sensors.noise, measured.shape))
    return CalibrationLikelihood(sensors.model, data, volume, start)


def sensors_of(likelihood: CalibrationLikelihood) -> Sensors:
    """Return the sensors of a density whose noise is that of the first pose."""
    return Sensors(likelihood.model, likelihood.sd[0])


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
        k = len(self.sensors.noise)
        volume = self.n_poses * np.log(WORKSPACE.volume)
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
        return (self.measured - self.sensors.model.read(theta[..., None, :], pose)) / self.sensors.noise

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
        result = np.zeros((self.n_poses, len(self.sensors.noise), len(y)))
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

    def least_squares_start(self) -> np.ndarray:
        return self.refine_geometry(np.zeros(self.n_parameters))

    def refine_geometry(self, y: np.ndarray) -> np.ndarray:
        own = self.posterior.n_parameters
        prior = np.eye(own, len(y))
        return least_squares(
            lambda x: np.concatenate([self.residual(x).ravel(), x[:own]]),
            y,
            lambda x: np.concatenate([self.rows(x), prior]),
            xtol=1e-14,
            ftol=1e-14,
        ).x

    def mode_candidates(self, y: np.ndarray) -> list:
        return []

    def funnel_errors(self, y: np.ndarray) -> np.ndarray:
        return np.empty((*y.shape[:-1], 0))

    def groups(self) -> list:
        return []

    def curved_ridges(self) -> list:
        return []

    def exact(self) -> None:
        return None

    def linear_geometry(self, y: np.ndarray) -> None:
        return None

    def scale_dependence(self, y: np.ndarray) -> None:
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

    def read(self, theta: np.ndarray, pose: np.ndarray, given: Given = NO_CONDITIONS) -> np.ndarray:
        return self.take(pose @ self.by_pose.T + theta @ self.by_parameters.T)

    def linearise(
        self, theta: np.ndarray, pose: np.ndarray, with_parameters: bool = True, given: Given = NO_CONDITIONS
    ) -> Readings:
        values = pose @ self.by_pose.T + theta @ self.by_parameters.T
        shapes = [np.broadcast_to(x, (*values.shape[:-1], *x.shape)) for x in (self.by_pose, self.by_parameters)]
        return Readings(values, *shapes).pick(self.places)

    def rotation(self, *_: object) -> np.ndarray:
        raise NotImplementedError

    def tool(self, *_: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        raise NotImplementedError


def gaussian_log_evidence(
    sensors: Sensors, measured: np.ndarray, pose: np.ndarray, moves: np.ndarray, volume: float
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
