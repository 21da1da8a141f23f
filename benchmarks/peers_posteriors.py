"""The posteriors of peers.py: well-posed, with data that fit no machine, with a ridge, with two modes, small."""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

from dataclasses import replace

from telescope_problem import SEED, Problem, simulate  # first: sets one thread

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.errors import ModelError
from bayescal.density.legs import LegPosterior, build_leg_posterior
from bayescal.density.priors import NormalPrior
from bayescal.inference.mode import Mode
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

SYSTEMATIC = np.array([0.02, 0.02, 0.02, 2e-4, 2e-4, 2e-4])  # mm and rad
MIRRORING = {"a_x": 2.0, "a_y": 2.0, "b_x": 2.0, "b_y": 2.0, "l": 2.0}  # mm, what is free beside u_x
NO_MACHINE = -1e10  # its log-density


def build_well() -> tuple[Problem, LegPosterior]:
    """Return the problem of sampling.py."""
    problem = simulate()
    return problem, problem.posterior()


def build_misfitting() -> tuple[Problem, LegPosterior]:
    """Return the same machine, measured with errors that no parameter explains."""
    problem = simulate()
    moved = problem.poses.actuators - problem.machine.mechanism.initial_actuator_positions
    wave = np.sin(np.pi * moved / problem.machine.mechanism.actuator_range + np.arange(6))
    problem = replace(problem, poses=_add(problem.poses, problem.poses, SYSTEMATIC * wave[:, ::-1]))
    return problem, problem.posterior()


def build_ridge() -> tuple[Problem, LegPosterior]:
    """Return what RR-8096 frees, with its tolerance of u_x: one mode holds nearly all, with a ridge along a u_x."""
    return _build_nominal(MIRRORING | {"u_x": 0.05})


def build_multimodal() -> tuple[Problem, LegPosterior]:
    """Return the same with twice the tolerance of u_x: both directions of a leg that have its gain are plausible."""
    return _build_nominal(MIRRORING | {"u_x": 0.1})


def build_lengths() -> tuple[Problem, LegPosterior]:
    """Return a machine of which six lengths are unknown: few enough for nested samplers to come to an end."""
    return _build_nominal({"l": MIRRORING["l"]})


def _build_nominal(spreads: dict[str, float]) -> tuple[Problem, LegPosterior]:
    """Return a machine that is nominal but for symbols with these prior standard deviations, which are free."""
    problem, rng = simulate(), np.random.default_rng(SEED + 7)
    machine = problem.machine
    theta = machine.layout.nominal.copy()
    for symbol, sd in spreads.items():
        theta[machine.layout.index[symbol]] += 0.3 * rng.normal(size=6) * sd
    reached = solve_forward_kinematics(machine, theta, problem.poses.actuators)
    noise = rng.normal(size=(problem.poses.n_poses, 6)) * np.sqrt(np.diagonal(problem.poses.covariance[0]))
    problem = Problem(machine, _add(problem.poses, reached, noise), theta)
    priors = {
        name: NormalPrior(prior.mean, spreads[name.partition("[")[0]])
        for name, prior in problem.priors().items()
        if name.partition("[")[0] in spreads
    }
    return problem, build_leg_posterior(problem.likelihood(), priors, ModelError(None))


def _add(poses: MeasuredPoses, at, error: Array) -> MeasuredPoses:
    """Return poses measured at others' position and rotation, with errors (P, 6)."""
    rotation = matrix_from_rotation_vector(error[:, 3:]) @ at.rotation
    return replace(poses, position=at.position + error[:, :3], rotation=rotation)


BUILD = {
    "well": build_well,
    "misfitting": build_misfitting,
    "ridge": build_ridge,
    "multimodal": build_multimodal,
    "lengths": build_lengths,
}


class PlainDensity:
    """The posterior over standardised parameters z, normalised as bayescal's evidence is."""

    def __init__(self, posterior: LegPosterior) -> None:
        self.posterior, coordinates = posterior, posterior.sampling.coordinates
        self.start, self.free, self.scale = coordinates.start, coordinates.free, coordinates.scale
        self.n = len(self.free)
        self._whitening = np.linalg.inv(np.linalg.cholesky(posterior.likelihood.error_covariance(np.zeros(6))))
        self.n_calls = 0

    def theta(self, z: Array) -> Array:
        """Return parameter vectors of z (B, n)."""
        theta = np.tile(self.start, (len(z), 1))
        theta[:, self.free] += self.scale * z
        return theta

    def mode_shares(self, modes: list[Mode], z: Array) -> list[float]:
        """Return which share of draws (..., n) is nearest to each mode, in its own standard deviations."""
        y = self.posterior.sampling.y_from_theta(self.theta(z.reshape(-1, self.n)))
        white = [np.linalg.solve(np.linalg.cholesky(mode.covariance), (y - mode.y).T) for mode in modes]
        nearest = np.argmin([np.sum(one**2, axis=0) for one in white], axis=0)
        return [float(np.mean(nearest == k)) for k in range(len(modes))]

    def standardise(self, natural: Array) -> Array:
        """Return z of draws (..., n) in natural units."""
        return (natural - self.start[self.free]) / self.scale

    def log_likelihood(self, z: Array) -> Array:
        """Return the log-likelihood (B,); very low where there is no machine."""
        self.n_calls += len(z)
        theta = self.theta(np.atleast_2d(z))
        inside = self.posterior.likelihood.layout.inside(theta)
        theta[~inside] = self.start
        with np.errstate(all="ignore"):
            found = self.posterior.likelihood(theta, np.zeros(6))
        return np.where(inside & np.isfinite(found), found, NO_MACHINE)

    def __call__(self, z: Array) -> Array:
        """Return log-likelihood plus log-prior (B,), up to a constant."""
        return self.log_likelihood(z) - 0.5 * np.sum(z**2, axis=1)

    def residuals(self, z: Array) -> Array:
        """Return whitened errors and priors of one vector, of which half the squares are minus the log-density."""
        rows = self.posterior.likelihood.errors(self.theta(z[None]))[0]
        white = np.einsum("pij,pj->pi", self._whitening, np.where(np.isfinite(rows), rows, 1e3)).ravel()
        return np.concatenate([white, z])

    def jacobian(self, z: Array) -> Array:
        """Return the exact derivative of the residuals."""
        _, slope = self.posterior.likelihood.error_jacobian(self.theta(z[None])[0])
        white = (self._whitening @ slope[..., self.free]) * self.scale
        return np.concatenate([white.reshape(-1, self.n), np.eye(self.n)])
