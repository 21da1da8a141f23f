"""What is known after some poses, of one variant: its posterior, what error remains, and what a further pose does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.experiments.next_pose.inputs import know
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.remaining import Remaining, Standing, move_draws
from bayescal.identifiability.requirements import Requirement, find_limits
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.inference.updating import Belief, update
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.criteria import IOptimality


@dataclass(frozen=True, eq=False)
class State:
    """A variant after the poses measured so far.

    Attributes
    ----------
    measured : MeasuredVariant
    belief : Belief
    requirements : list of Requirement
    workspace : ndarray, shape (W, N)
        Actuator positions, mm.
    seed : int
    """

    measured: MeasuredVariant
    belief: Belief
    requirements: list[Requirement]
    workspace: Array
    seed: int

    @cached_property
    def theta(self) -> Array:
        """Draws of the true machine, shape (S, D)."""
        return self.measured.posterior.theta(self.belief.draws)

    @cached_property
    def calibrated(self) -> Array:
        """The machine as calibrated, the posterior mean, shape (D,)."""
        return np.asarray(self.theta.mean(axis=0))

    @cached_property
    def model_error(self) -> Array:
        """Model errors of the draws, with what the measured part of a deformation leaves, shape (S, N), mm."""
        tau = np.broadcast_to(
            self.measured.posterior.errors.tau(self.measured.posterior.zeta(self.belief.draws)),
            (len(self.theta), self.n_legs),
        )
        return np.sqrt(tau**2 + self.measured.left_variance)

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.measured.machine.mechanism.n_legs

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
        nowhere = np.empty((0, self.n_legs))
        return Plan(nowhere, (), self.measured.actuator_noise, error, pose_information=information[None])

    @cached_property
    def covariance(self) -> Array:
        """Of the parameters, in units of the tolerances, shape (m, m)."""
        posterior = self.measured.posterior
        m = posterior.n_geometry
        change = posterior.sampling.jacobian(self.calibrated)[self._free] / self.knowledge.sd[:, None]
        return np.asarray(change @ self.belief.covariance[:m, :m] @ change.T)

    # --- the requirements ----------------------------------------------------------------------------------------

    @cached_property
    def _remaining(self) -> Remaining:
        return Remaining(
            self.measured.machine,
            self.calibrated,
            self.workspace,
            self.measured.actuator_noise,
            self.model_error,
            self.seed,
        )

    @cached_property
    def standing(self) -> Standing:
        """How the requirements stand."""
        return Standing(self._remaining.find_largest(self.requirements, self.theta))

    @cached_property
    def at_best(self) -> Standing:
        """How they would stand were the geometry known exactly."""
        exact = np.broadcast_to(self.calibrated, self.theta.shape)
        return Standing(self._remaining.find_largest(self.requirements, exact))

    def after(self, covariance: Array) -> Standing:
        """Return how they are expected to stand with another covariance of the parameters, (m, m)."""
        theta, sd = self.theta.copy(), self.knowledge.sd
        apart = (theta - self.calibrated)[:, self._free] / sd
        theta[:, self._free] = self.calibrated[self._free] + move_draws(apart, self.covariance, covariance) * sd
        return Standing(self._remaining.find_largest(self.requirements, theta))

    # --- further poses -------------------------------------------------------------------------------------------

    def see(self, actuators: Array) -> Sensitivity:
        """Return the derivatives of the machine as calibrated at actuator positions (C, N), mm."""
        return compute_sensitivity(self.knowledge, actuators)

    @cached_property
    def criterion(self) -> IOptimality:
        """What makes the poses of the workspace surest, in units of the requirements."""
        there = self.see(self.workspace)
        limits = find_limits(self.requirements, there, self.knowledge.sd)
        return IOptimality(self.plan, workspace=there, sd=self.knowledge.sd, limits=limits)

    def rows(self, sensitivity: Sensitivity) -> Array:
        """Return what further poses would tell, shape (C, k, m), in units of noise and tolerances."""
        return self.criterion.rows(self.knowledge, sensitivity)


def find_state(
    measured: MeasuredVariant,
    start: Array | None,
    requirements: list[Requirement],
    workspace: Array,
    n_draws: int,
    seed: int,
    *,
    anew: bool = True,
) -> State:
    """Return what is known after a variant's poses, updated from the mode before the last of them; see `update`."""
    belief = update(measured.posterior, start, n_draws, seed, anew=anew)
    return State(measured, belief, requirements, workspace, seed)
