"""How far a calibrated machine errs over its workspace, by draws of what is known of it.

The calibrated machine predicts its poses by the posterior mean of its parameters; a draw of the posterior stands for
the true one. At a pose the closure of the draw, f(θ, pose, ρ), is what its legs miss, and the pose errs by -A⁻¹ f
with A = ∂f/∂pose at the calibrated machine; where that is as good as its tangent by θ, the tangent takes its place.
Actuators and the draw's own model errors τ err besides, as in `bayescal.identifiability.sensitivity`. Requirements hold
where no pose of the workspace exceeds a limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayescal.errors import NumericalError
from bayescal.identifiability.requirements import Requirement
from bayescal.machines.kinematics import ForwardKinematics, Machine, solve_forward_kinematics
from bayescal.machines.models.base import Linearisation
from bayescal.numerics.geometry import Array

CHUNK = 250  # draws at a time
LOOKS = 100  # draws of which it is seen whether they leave the tangent
BENT = 0.1  # of the errors' spread: off the tangent by more, draws are followed by their closures
ROUNDING = 1e-9  # mm and rad


@dataclass(frozen=True, eq=False)
class Remaining:
    """Poses at which a calibrated machine is to be accurate.

    Attributes
    ----------
    machine : Machine
    theta : ndarray, shape (D,)
        The calibrated machine.
    actuators : ndarray, shape (W, N)
        mm.
    actuator_noise : float
        σ_ρ, mm.
    model_error : ndarray, shape (S, N)
        Model errors τ of the draws that stand for the true machine, mm.
    seed : int
        Of what actuators and model err by: the same at every call, so that differences are not chance.
    """

    machine: Machine
    theta: Array
    actuators: Array
    actuator_noise: float
    model_error: Array
    seed: int

    def find_largest(self, requirements: Sequence[Requirement], theta: Array) -> Array:
        """Return the largest error anywhere in the workspace, in shares of each of R limits.

        Parameters
        ----------
        requirements : sequence of Requirement
        theta : ndarray, shape (S, D)
            True machines.

        Returns
        -------
        ndarray, shape (S, R)
            Infinite for a machine that cannot take the poses.

        Raises
        ------
        NumericalError
            Where the calibrated machine cannot.
        """
        bent = self._leaves_tangent(theta[:LOOKS])
        rows = []
        for k in range(0, len(theta), CHUNK):
            part = slice(k, k + CHUNK)
            error = (self._follow if bent else self._project)(theta[part])
            error += self._noise[..., part]
            of_draws = error.transpose(2, 0, 1)
            shares = np.stack([(r.take(of_draws) / r.limit).max(axis=1) for r in requirements], axis=1)
            rows.append(np.where(np.isfinite(shares), shares, np.inf))
        return np.concatenate(rows)

    @cached_property
    def _poses(self) -> ForwardKinematics:
        found = solve_forward_kinematics(self.machine, self.theta, self.actuators, check=False)
        if not found.converged.all():
            raise NumericalError("workspace: found poses that the calibrated machine cannot take, expected none")
        return found

    @cached_property
    def _here(self) -> Linearisation:
        return self.machine.linearise(self.theta, self._poses.position, self._poses.rotation, self.actuators)

    @cached_property
    def _gain(self) -> Array:
        """A⁻¹, shape (W, 6, N)."""
        return np.linalg.pinv(self._here.pose)

    @cached_property
    def _slope(self) -> Array:
        """Pose by parameters, shape (W 6, D)."""
        slope = -(self._gain @ self._here.parameters)
        return slope.reshape(-1, slope.shape[-1])

    @cached_property
    def _noise(self) -> Array:
        """What actuators and model err by, shape (W, 6, S), mm and rad."""
        rng, gain, by_actuators = np.random.default_rng(self.seed), self._gain, self._here.actuators
        shape = (*self.actuators.shape, len(self.model_error))
        noise: Array = (gain @ by_actuators * self.actuator_noise) @ rng.standard_normal(shape)
        if self.model_error.any():
            by_legs = gain * np.diagonal(by_actuators, axis1=-2, axis2=-1)[:, None, :]
            noise += by_legs @ (rng.standard_normal(shape) * self.model_error.T)
        return noise

    def _project(self, theta: Array) -> Array:
        """Return the errors of machines (s, D) by their tangent, shape (W, 6, s)."""
        error = self._slope @ (theta - self.theta).T
        return np.asarray(error.reshape(len(self.actuators), -1, len(theta)))

    def _follow(self, theta: Array) -> Array:
        """Return the errors of machines (s, D) by their closures, shape (W, 6, s); NaN where there is none."""
        machine, poses = self.machine, self._poses
        closure = machine.model.bind(machine.layout, poses.position, poses.rotation, machine.basis(self.actuators))
        with np.errstate(all="ignore"):  # far out numbers overflow
            return np.asarray(-(self._gain @ closure.evaluate(np.asfortranarray(theta)).transpose(1, 0, 2)))

    def _leaves_tangent(self, theta: Array) -> bool:
        """Return whether machines (s, D) err otherwise than their tangent says."""
        followed = self._follow(theta)
        off, spread = (
            np.sqrt(np.mean(error**2, axis=-1)).max(axis=0) for error in (followed - self._project(theta), followed)
        )
        return not bool(np.all(off <= BENT * spread + ROUNDING))


@dataclass(frozen=True, eq=False)
class Standing:
    """How R requirements stand.

    Attributes
    ----------
    largest : ndarray, shape (S, R)
        Largest error of each draw, in shares of the limits.
    """

    largest: Array

    @property
    def probability(self) -> float:
        """That all of them hold."""
        return float(np.mean((self.largest <= 1.0).all(axis=1)))

    @property
    def standard_error(self) -> float:
        """Of the probability, by the number of draws."""
        p = self.probability
        return float(np.sqrt(p * (1.0 - p) / len(self.largest)))

    @property
    def probabilities(self) -> Array:
        """That each of them holds, shape (R,)."""
        return np.asarray(np.mean(self.largest <= 1.0, axis=0))

    def bound(self, probability: float) -> Array:
        """Return the errors in shares of the limits that are kept everywhere with a probability, shape (R,)."""
        return np.asarray(np.quantile(self.largest, probability, axis=0, method="higher"))


def move_draws(draws: Array, before: Array, after: Array) -> Array:
    """Return draws (S, n) about zero with a covariance (n, n) taken to another one, the same normal numbers in both."""
    old, new = np.linalg.cholesky(before), np.linalg.cholesky(after)
    return np.asarray(draws @ np.linalg.solve(old.T, new.T))
