"""The posteriors of peers.py: well-posed, with data that fit no machine, with a ridge, with two modes, small."""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads
from __future__ import annotations

from dataclasses import replace

from telescope_problem import SEED, Problem, simulate, standardise  # first: sets one thread

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.priors import NormalPrior
from bayescal.inference.mode import Mode
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

SYSTEMATIC = np.array([0.02, 0.02, 0.02, 2e-4, 2e-4, 2e-4])  # mm and rad
MIRRORING = {"a_x": 2.0, "a_y": 2.0, "b_x": 2.0, "b_y": 2.0, "l": 2.0}  # mm, what is free beside u_x
NO_MACHINE = -1e10  # its log-density


def build_well() -> tuple[Problem, CalibrationPosterior]:
    """Return the problem of sampling.py."""
    problem = simulate()
    return problem, problem.posterior()


def build_misfitting() -> tuple[Problem, CalibrationPosterior]:
    """Return the same machine, measured with errors that no parameter explains."""
    problem = simulate()
    moved = problem.poses.actuators - problem.machine.mechanism.initial_actuator_positions
    wave = np.sin(np.pi * moved / problem.machine.mechanism.actuator_range + np.arange(6))
    problem = replace(problem, poses=_add(problem.poses, problem.poses, SYSTEMATIC * wave[:, ::-1]))
    return problem, problem.posterior()


def build_ridge() -> tuple[Problem, CalibrationPosterior]:
    """Return what RR-8096 frees, with its tolerance of u_x: one mode holds nearly all, with a ridge along a u_x."""
    return _build_nominal(MIRRORING | {"u_x": 0.05})


def build_multimodal() -> tuple[Problem, CalibrationPosterior]:
    """Return the same with twice the tolerance of u_x: both directions of a leg that have its gain are plausible."""
    return _build_nominal(MIRRORING | {"u_x": 0.1})


def build_lengths() -> tuple[Problem, CalibrationPosterior]:
    """Return a machine of which six lengths are unknown: few enough for nested samplers to come to an end."""
    return _build_nominal({"l": MIRRORING["l"]})


def _build_nominal(spreads: dict[str, float]) -> tuple[Problem, CalibrationPosterior]:
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
    return problem, problem.posterior(priors=priors)


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

    def __init__(self, posterior: CalibrationPosterior) -> None:
        self.posterior, self.start = posterior, posterior.sampling.start
        self.free, self.centre, self.scale = standardise(posterior)
        self.n, self.n_calls = len(self.free), 0

    def theta(self, z: Array) -> Array:
        """Return parameter vectors of z (B, n)."""
        theta = np.tile(self.start, (len(z), 1))
        theta[:, self.free] = self.centre + self.scale * z
        return theta

    def mode_shares(self, modes: list[Mode], z: Array) -> list[float]:
        """Return which share of draws (..., n) is nearest to each mode, in its own standard deviations."""
        y = self.posterior.sampling.y_from_theta(self.theta(z.reshape(-1, self.n)))
        white = [np.linalg.solve(np.linalg.cholesky(mode.covariance), (y - mode.y).T) for mode in modes]
        nearest = np.argmin([np.sum(one**2, axis=0) for one in white], axis=0)
        return [float(np.mean(nearest == k)) for k in range(len(modes))]

    def standardise(self, natural: Array) -> Array:
        """Return z of draws (..., n) in natural units."""
        return (natural - self.centre) / self.scale

    def log_likelihood(self, z: Array) -> Array:
        """Return the log-likelihood (B,); very low where there is no machine."""
        self.n_calls += len(z)
        theta = self.theta(np.atleast_2d(z))
        inside = self.posterior.likelihood.layout.inside(theta)
        theta[~inside] = self.start
        with np.errstate(all="ignore"):
            zeta = np.zeros((len(theta), 0))
            found = self.posterior.likelihood.density(theta, self.posterior.errors, zeta)
        return np.where(inside & np.isfinite(found), found, NO_MACHINE)

    def __call__(self, z: Array) -> Array:
        """Return log-likelihood plus log-prior (B,), up to a constant."""
        return self.log_likelihood(z) - 0.5 * np.sum(z**2, axis=1)

    def residuals(self, z: Array) -> Array:
        """Return whitened errors and priors of one vector, half of whose squares are about minus the log-density."""
        rows = self._find_rows(z)[0]
        return np.concatenate([np.where(np.isfinite(rows), rows, 1e3).ravel(), z])

    def jacobian(self, z: Array) -> Array:
        """Return the exact derivative of the residuals."""
        return np.concatenate([-self._find_rows(z)[1].reshape(-1, self.n), np.eye(self.n)])

    def _find_rows(self, z: Array) -> tuple[Array, Array]:
        change = np.zeros((len(self.start), self.n))
        change[self.free, np.arange(self.n)] = self.scale
        theta, errors = self.theta(z[None])[0], self.posterior.errors
        return self.posterior.likelihood.whole.reduced_rows(theta, change, errors, np.zeros(0))
