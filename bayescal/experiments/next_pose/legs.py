"""The next pose of a machine on legs: whole measured poses, candidates and workspace by actuator positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.next_pose.state import Shown, State, Subject
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.search_memory import list_search
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.remaining import LegsRemaining, move_draws
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.inference.updating import Belief
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, compute_pose_error, rotation_vector_from_matrix
from bayescal.pose_selection.next_pose import find_unmeasured
from bayescal.report.numbers import format_fixed, format_significant

DRAWS = 8
"""Arrays of all draws by parameters, and at every pose of the workspace."""
SEEN, PLACED = 6, 4
"""Arrays of all candidates by legs and parameters where they are placed and seen, and of their poses."""
APART = 0.02  # of the actuators' range: closer to a measured pose, a candidate would be the same again


@dataclass(frozen=True, eq=False)
class LegsSubject(Subject):
    """A variant of a machine on legs.

    Attributes
    ----------
    measured : MeasuredVariant
    requirements : list of Requirement
    workspace, candidates : ndarray, shapes (W, N) and (C, N)
        Actuator positions, mm.
    """

    measured: MeasuredVariant
    requirements: list[Requirement]
    workspace: Array
    candidates: Array

    @property
    def posterior(self) -> LegPosterior:
        """Of the poses measured so far."""
        return self.measured.posterior

    @property
    def n_poses(self) -> int:
        """How many these are."""
        return self.measured.poses.n_poses

    @property
    def n_workspace(self) -> int:
        """Number of poses that stand for the workspace."""
        return len(self.workspace)

    @property
    def home(self) -> Array:
        """Actuator positions at home, shape (N,), mm."""
        return self.measured.machine.mechanism.initial_actuator_positions

    @property
    def allowed(self) -> np.ndarray:
        """Which candidates have not been measured, shape (C,)."""
        reach = self.measured.machine.mechanism.actuator_range
        return find_unmeasured(self.candidates, self.measured.poses.actuators, APART * reach)

    def first(self, n: int) -> LegsSubject:
        """Return the same after the first n of its poses."""
        return replace(self, measured=take_poses(self.measured, n))

    def know(self, belief: Belief, seed: int) -> LegsState:
        """Return what is known by a belief."""
        return LegsState(belief, seed, self)

    def list_arrays(self, n_draws: int) -> list[Sequence[float]]:
        """Return what it holds; see `estimate_arrays`."""
        n_legs, n = len(self.home), self.posterior.n_parameters
        return [
            *list_candidates(len(self.candidates), n_legs, self.measured.machine.layout.size),
            *list_search(self.posterior),
            (DRAWS, n_draws, n),
            (DRAWS, self.n_workspace, n_legs, n),
        ]

    def list_shown(self) -> list[Shown]:
        """Return displacements of the actuators and where the platform will be."""
        legs = range(1, len(self.home) + 1)
        moves = [Shown(f"displacement_{leg}_mm", str(leg), "mm", "Displacement of actuator", 3) for leg in legs]
        platform = [Shown(f"{axis}_mm", axis, "mm", "Platform, expected", 2) for axis in "xyz"]
        return [*moves, *platform, *(Shown(f"r{a}_deg", f"r{a}", "deg", "Platform, expected", 3) for a in "xyz")]


@dataclass(frozen=True, eq=False)
class LegsState(State):
    """A machine on legs after the poses measured so far; its parameters in units of their tolerances."""

    legs: LegsSubject

    @property
    def subject(self) -> LegsSubject:
        """The variant."""
        return self.legs

    @property
    def measured(self) -> MeasuredVariant:
        """The variant's poses."""
        return self.legs.measured

    @cached_property
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""
        return self.measured.posterior.theta(self.belief.draws)

    @cached_property
    def model_error(self) -> Array:
        """Model errors of the draws, with what the measured part of a deformation leaves, shape (S, N), mm."""
        posterior = self.measured.posterior
        tau = np.broadcast_to(
            posterior.errors.tau(posterior.zeta(self.belief.draws)), (len(self.theta), len(self.legs.home))
        )
        return np.sqrt(tau**2 + self.measured.left_variance)

    @property
    def _free(self) -> np.ndarray:
        return self.measured.posterior.sampling.free

    @cached_property
    def knowledge(self) -> Knowledge:
        """The machine as calibrated, with its tolerances."""
        posterior = self.measured.posterior
        names = posterior.names[: posterior.n_geometry]
        return know(self.measured, dict(zip(names, self.calibrated[self._free].tolist(), strict=True)))

    @cached_property
    def plan(self) -> Plan:
        """How a further pose would be measured: as well as those so far on average."""
        information = np.linalg.inv(self.measured.poses.covariance).mean(axis=0)
        error = float(np.sqrt(np.mean(self.model_error**2)))
        nowhere = np.empty((0, len(self.legs.home)))
        return Plan(nowhere, (), self.measured.actuator_noise, error, pose_information=information[None])

    @cached_property
    def covariance(self) -> Array:
        """Of the parameters, in units of the tolerances, shape (m, m)."""
        posterior = self.measured.posterior
        m = posterior.n_geometry
        change = posterior.sampling.jacobian(self.calibrated)[self._free] / self.knowledge.sd[:, None]
        return np.asarray(change @ self.belief.covariance[:m, :m] @ change.T)

    @cached_property
    def seen(self) -> Sensitivity:
        """Derivatives of the machine as calibrated at the candidates."""
        return compute_sensitivity(self.knowledge, self.legs.candidates)

    @cached_property
    def rows(self) -> Array:
        """What each candidate says of the parameters, shape (C, k, m), in units of noise and tolerances."""
        return np.asarray(self.seen.rows(self.plan) * self.knowledge.sd)

    @cached_property
    def slope(self) -> Array:
        """The workspace's poses by the parameters in units of the tolerances, shape (W, 6, m)."""
        return compute_sensitivity(self.knowledge, self.legs.workspace).slope * self.knowledge.sd

    @cached_property
    def remaining(self) -> LegsRemaining:
        """Errors over the workspace."""
        noise = self.measured.actuator_noise
        machine, workspace = self.measured.machine, self.legs.workspace
        return LegsRemaining(machine, self.calibrated, workspace, noise, self.model_error, self.seed)

    @property
    def stays(self) -> str:
        """Actuators and model errors, in words."""
        error = format_significant(1e3 * float(np.sqrt(np.mean(self.model_error**2))), 2)
        return f"actuators and model errors stay ({error} µm a leg, root mean square, by what is known today)"

    def move(self, covariance: Array) -> Array:
        """Return the draws (S, D) as they would be with another covariance of the parameters, (m, m)."""
        theta, sd = self.theta.copy(), self.knowledge.sd
        apart = (theta - self.calibrated)[:, self._free] / sd
        theta[:, self._free] = self.calibrated[self._free] + move_draws(apart, self.covariance, covariance) * sd
        return theta

    def predict(self, reference: State) -> tuple[Array, Array]:
        """Return predicted poses against another variant's, (C, 6), and the covariance of measured ones."""
        assert isinstance(reference, LegsState)
        slope = self.seen.slope * self.knowledge.sd
        noise = self.seen.pose_noise(self.plan) + np.linalg.inv(self.plan.information(self.seen.poses))
        pose, other = self.seen.poses, reference.seen.poses
        apart = compute_pose_error(pose.position, pose.rotation, other.position, other.rotation)
        return apart, slope @ self.covariance @ np.swapaxes(slope, -1, -2) + noise

    def list_poses(self, chosen: np.ndarray) -> dict[str, Array]:
        """Return displacements and positions of the actuators, and where the platform will be."""
        actuators, poses = self.legs.candidates[chosen], self.seen.poses
        turned = np.degrees(rotation_vector_from_matrix(poses.rotation[chosen]))
        legs = range(1, actuators.shape[1] + 1)
        columns = {f"displacement_{leg}_mm": actuators[:, leg - 1] - self.legs.home[leg - 1] for leg in legs}
        columns |= {f"rho_{leg}_mm": actuators[:, leg - 1] for leg in legs}
        columns |= {f"{axis}_mm": poses.position[chosen][:, k] for k, axis in enumerate("xyz")}
        return columns | {f"r{axis}_deg": turned[:, k] for k, axis in enumerate("xyz")}

    def describe_pose(self, candidate: int) -> str:
        """Return how far to displace the actuators."""
        moves = ", ".join(format_fixed(float(x), 3) for x in self.legs.candidates[candidate] - self.legs.home)
        return f"Displace the actuators from their initial positions by {moves} mm."


def list_candidates(n: int, n_legs: int, n_parameters: int) -> list[Sequence[float]]:
    """Return the arrays of candidates; see `estimate_arrays`."""
    return [(SEEN, n, n_legs, n_parameters + n_legs), (PLACED, n, DEGREES_OF_FREEDOM, n_parameters)]


def know(measured: MeasuredVariant, centre: dict[str, float]) -> Knowledge:
    """Return a measured machine with its tolerances, where its parameters are expected at values of their own."""
    posterior = measured.posterior
    names = posterior.names[: posterior.n_geometry]
    means = {name: measured.priors[name].mean for name in names}
    return Knowledge(
        measured.machine, {name: measured.priors[name].sd for name in names}, {**measured.fixed, **means, **centre}
    )


def take_poses(measured: MeasuredVariant, n: int) -> MeasuredVariant:
    """Return the variant after the first n of its poses."""
    some, variance = measured.poses.select(np.arange(n)), measured.actuator_variance
    variance = None if variance is None else variance[:n]
    likelihood = PoseLikelihood(measured.machine, some, measured.actuator_noise, variance)
    posterior = replace(measured.posterior, likelihood=likelihood)
    return replace(measured, poses=some, posterior=posterior, actuator_variance=variance)
