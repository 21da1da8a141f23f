"""A variant of a study of legs as a check sees it: whole poses, measured to a plan of actuator positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.errors import ModelError
from bayescal.density.legs import LegPosterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import UniformPrior
from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.derivatives import check_derivatives
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.faults.modes import list_starts
from bayescal.experiments.check.faults.noise import check_noise
from bayescal.experiments.check.subject import TRIES, Subject, state_slips
from bayescal.experiments.shared.leg_slips import (
    REREAD,
    LegData,
    Suspect,
    list_leg_slips,
    list_pose_units,
    state_error,
)
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.search_memory import list_search
from bayescal.experiments.shared.slips import find_slip, list_unnoticed
from bayescal.inference.mode import Mode, find_modes
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector


@dataclass(frozen=True, eq=False)
class LegSubject(Subject):
    """A variant of a study of legs.

    Attributes
    ----------
    measured : MeasuredVariant
        With its model error.
    """

    measured: MeasuredVariant

    @property
    def posterior(self) -> LegPosterior:
        """The posterior of the measured data."""
        return self.measured.posterior

    @property
    def n_poses(self) -> int:
        """How many poses were measured."""
        return self.measured.poses.n_poses

    def likelihood(self, poses: MeasuredPoses, chosen: np.ndarray | None = None) -> PoseLikelihood:
        """Return the density of other poses of the plan, once or twice over; the first may have other noise.

        With ``chosen``, shape (Q,), they are those of the plan's poses alone.
        """
        variance = self.measured.actuator_variance
        if variance is not None and chosen is not None:
            variance = variance[chosen]
        elif variance is not None:
            variance = np.tile(variance, (poses.n_poses // self.n_poses, 1))
        return PoseLikelihood(self.measured.machine, poses, self.measured.actuator_noise, variance)

    def posterior_of(self, poses: MeasuredPoses, with_model_error: bool = True) -> LegPosterior:
        """Return the posterior of other poses of the plan."""
        error = self.posterior.errors.model_error if with_model_error else ModelError(None)
        errors = replace(self.posterior.errors, terms=(error, *self.posterior.errors.terms[1:]))
        return replace(self.posterior, likelihood=self.likelihood(poses), errors=errors)

    def theta_of(self, natural: Array) -> tuple[Array, Array]:
        """Return θ (D,) and τ (N,) of parameters and model errors in natural units, shape (n,)."""
        posterior = self.posterior
        theta, n = posterior.sampling.start.copy(), posterior.n_geometry
        theta[posterior.sampling.free] = natural[:n]
        tau = natural[n:] if len(natural) > n else np.zeros(1)
        return theta, np.broadcast_to(tau, (posterior.likelihood.n_legs,)).copy()

    def with_poses(self, poses: MeasuredPoses) -> LegSubject:
        """Return the same variant as if other poses had been measured."""
        return LegSubject(replace(self.measured, poses=poses, posterior=self.posterior_of(poses)))

    def list_arrays(self) -> list[Sequence[float]]:
        """Return those of a posterior of poses."""
        return list_search(self.posterior)

    def draw_case(self, rng: np.random.Generator) -> tuple[Array, LegPosterior]:
        """Return a truth and the posterior of poses that are measured of it."""
        truth, poses = self.simulate_from_prior(rng)
        return truth, self.posterior_of(poses)

    def repeat(self, natural: Array, y: Array, rng: np.random.Generator) -> LegPosterior:
        """Return the posterior of the measured poses and of simulated ones."""
        simulated = self.simulate(natural, rng)
        if simulated is None:
            raise NumericalError("a draw of the posterior cannot take the poses")
        return self.posterior_of(join_poses(self.measured.poses, simulated))

    def check_derivatives(self, rng: np.random.Generator) -> Finding:
        """Return whether closures' derivatives are those of differences."""
        return check_derivatives(self, rng)

    def check_noise(self, mode: Mode) -> Finding:
        """Return whether the noise of poses and actuators is as stated."""
        alone = find_modes(self.posterior_of(self.measured.poses, with_model_error=False))[0]
        return check_noise(self, alone)

    def list_starts(self, best: Array, rng: np.random.Generator) -> list[Array]:
        """Return machines with mirrored actuators, and some of the priors."""
        return list_starts(self.posterior, best, rng)

    def check_slips(self) -> Finding:
        """Return whether another unit, sign, order or convention of actuators or poses explains the data better."""
        poses, start = self.measured.poses, self.measured.machine.mechanism.initial_actuator_positions
        data = LegData(poses.actuators, poses)

        def likelihood_of(moved: LegData, chosen: np.ndarray) -> PoseLikelihood:
            assert moved.poses is not None
            some = chosen if len(chosen) < self.n_poses else None
            return self.likelihood(replace(moved.poses, actuators=moved.actuators), some)

        suspect = Suspect(likelihood_of, self.posterior.sampling.coordinates, data, state_error(self.measured))
        slips = [*list_leg_slips(data, start), *list_pose_units(data)]
        found = find_slip(suspect.weigh, data, [replace(one, least=0.0, tried_from=0.0) for one in slips], 0.0)
        return state_slips(found, list_unnoticed(suspect.weigh, slips, REREAD) if found is None else (0, []))

    def draw_prior(self, rng: np.random.Generator) -> Array:
        """Return parameters and model errors drawn from their priors, natural units, shape (n,)."""
        posterior = self.posterior
        values = []
        for name in posterior.names[: posterior.n_geometry]:
            prior = posterior.priors[name]
            if isinstance(prior, UniformPrior):
                values.append(rng.uniform(prior.lower, prior.upper))
            else:
                values.append(rng.normal(prior.mean, prior.sd))
        scale = posterior.errors.model_error.scale
        errors = 0.0 if scale is None else scale
        return np.concatenate([values, np.abs(rng.normal(0.0, errors, posterior.n_parameters - len(values)))])

    def simulate_from_prior(
        self, rng: np.random.Generator, with_model_error: bool = True
    ) -> tuple[Array, MeasuredPoses]:
        """Return a truth drawn from the priors, or one without model error, and what would be measured of it.

        Raises
        ------
        NumericalError
            Where hardly any draw of the priors is a machine that can take the poses.
        """
        for _ in range(TRIES):
            truth = self.draw_prior(rng)
            truth[self.posterior.n_geometry :] *= with_model_error
            poses = self.simulate(truth, rng)
            if poses is not None:
                return truth, poses
        raise NumericalError(f"simulation: found no machine that takes the poses in {TRIES} draws of the priors")

    def simulate(self, truth: Array, rng: np.random.Generator) -> MeasuredPoses | None:
        """Return what is measured of a true machine, all noise as stated; None where it cannot take the poses.

        The platform goes where the machine takes it. Encoders err by σ_ρ, and by what the model errors τ and the
        deformation leave of each leg's closure, at the true machine; the measured pose errs by Σ.
        """
        machine, plan = self.measured.machine, self.measured.poses
        theta, tau = self.theta_of(truth)
        if not machine.layout.inside(theta[None])[0]:
            return None
        found = solve_forward_kinematics(machine, theta, plan.actuators, check=False)
        if not found.converged.all():
            return None
        actuators = plan.actuators
        if actuators.shape[1] > DEGREES_OF_FREEDOM:  # redundant legs stand where they close
            held = solve_inverse_kinematics(machine, theta, found.position, found.rotation, check=False)
            if not held.converged.all():
                return None
            actuators = held.actuators
        by_actuators = machine.linearise(theta, found.position, found.rotation, actuators).actuators
        error = self._draw_errors(by_actuators, tau, rng)
        normal = rng.standard_normal((self.n_poses, DEGREES_OF_FREEDOM))
        noise = np.einsum("pij,pj->pi", np.linalg.cholesky(plan.covariance), normal)
        rotation = matrix_from_rotation_vector(noise[:, 3:]) @ found.rotation
        return MeasuredPoses(plan.names, found.position + noise[:, :3], rotation, plan.covariance, actuators - error)

    def _draw_errors(self, by_actuators: Array, tau: Array, rng: np.random.Generator) -> Array:
        """Return what encoders and legs err by in terms of actuators, shape (P, N), mm."""
        variance = self.measured.actuator_variance
        spread = np.sqrt(tau**2 + (0.0 if variance is None else variance))
        own = np.diagonal(by_actuators, axis1=-2, axis2=-1)
        legs = own * spread * rng.standard_normal(own.shape)
        moved = np.linalg.solve(by_actuators, legs[..., None])[..., 0]
        return self.measured.actuator_noise * rng.standard_normal(own.shape) + moved


def join_poses(one: MeasuredPoses, other: MeasuredPoses) -> MeasuredPoses:
    """Return two measurements of the same plan as one."""
    both = (one, other)
    return MeasuredPoses(
        one.names + tuple(f"{name} again" for name in other.names),
        np.concatenate([poses.position for poses in both]),
        np.concatenate([poses.rotation for poses in both]),
        np.concatenate([poses.covariance for poses in both]),
        np.concatenate([poses.actuators for poses in both]),
    )
