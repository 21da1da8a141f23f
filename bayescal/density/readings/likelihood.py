"""The density of readings, the poses at which they were taken being unknown and eliminated.

With a pose that may lie anywhere in a workspace of volume V, the density of its readings is, to first order about the
pose v̂ that explains them best,

    p(s | d) = 1/V ∫ N(s; h(v, d), Σ) dv = N(r̂; 0, Σ) (2π)^(q/2) |HᵀΣ⁻¹H|^(-1/2) / V,   r̂ = s - h(v̂, d).

r̂ lives in the left null space of Σ^(-1/2) H, where its covariance is the projection of Σ. The poses of a measurement
are so many that sampling them with the parameters is hopeless; that it would give the same is tested.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from bayescal.density.elimination import find_step, half_log_volume
from bayescal.density.readings.left_over import LeftOver
from bayescal.density.readings.poses import SensorSet, find_poses
from bayescal.numerics.geometry import Array

BATCH = 64
CHORD_TOLERANCE = 1e-7  # mm and rad; a digit or more of it are gone with the step, the rest enters the density squared
MAX_CHORDS = 25
STEP = 1e-4  # of the prior's standard deviation, for the slope of the volume


class ReadingLikelihood:
    """Log-density of the readings at P poses for batches of machines.

    Parameters
    ----------
    sensors : SensorSet
    measured : ndarray, shape (P, K)
        Readings, mm and rad.
    start : ndarray, shape (P, q)
        Poses from which the search begins: the commanded ones.
    volume : float
        V, mm and rad: a pose lies anywhere in the workspace alike.
    """

    def __init__(self, sensors: SensorSet, measured: Array, start: Array, volume: float) -> None:
        self.sensors, self.measured, self._volume = sensors, measured, volume
        nominal = sensors.model.layout.nominal
        self._start = find_poses(sensors, nominal, measured, start).pose
        here = sensors.linearise(nominal, self._start, with_parameters=False)
        self._gain = np.linalg.pinv(here.by_pose)
        n, q = len(sensors.chosen), sensors.n_coordinates
        self.constant = -np.log(sensors.noise).sum() - 0.5 * (n - q) * np.log(2 * np.pi) - np.log(volume)

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.measured)

    def select(self, which: np.ndarray) -> ReadingLikelihood:
        """Return the density of the readings at some of the poses."""
        return ReadingLikelihood(self.sensors, self.measured[which], self._start[which], self._volume)

    def anchored(self, theta: Array) -> ReadingLikelihood:
        """Return the same density whose search starts where a machine (D,) explains the readings.

        Chords G end where G r = 0. So do (G H)⁻¹ G, with the H of that machine, and for machines near it they take few.
        """
        found, pose = copy(self), self.find_poses(theta[None])[0][0]
        slope = self.sensors.linearise(theta, pose, with_parameters=False).by_pose
        if np.isfinite(slope).all():
            found._start, found._gain = pose, np.linalg.solve(self._gain @ slope, self._gain)
        return found

    def find_poses(self, theta: Array) -> tuple[Array, Array]:
        """Return the poses (B, P, q) that machines (B, D) explain the readings with, and what is left (B, P, K).

        The chord method: H changes so little from machine to machine that a fixed inverse gains two digits a step.
        Where it ends the rest is orthogonal to another machine's H, so that the last step is Gauss and Newton's.
        """
        return self._stand(theta)[:2]

    def leave_over(self, theta: Array) -> LeftOver:
        """Return what the best poses leave of the readings with machines (B, D)."""
        _, error, slope = self._stand(theta)
        noise = self.sensors.noise
        present = np.ones(self.measured.shape, dtype=bool)
        return LeftOver(error, slope, present, np.inf, lambda reading: reading / noise, lambda white: white * noise)

    def _stand(self, theta: Array) -> tuple[Array, Array, Array]:
        """Return the same, and H (B, P, K, q)."""
        machines = theta[:, None]
        pose = np.broadcast_to(self._start, (len(theta), *self._start.shape))
        white = self.measured / self.sensors.noise
        for _ in range(MAX_CHORDS):
            error = white - self.sensors.read(machines, pose) / self.sensors.noise
            step = np.einsum("pqk,bpk->bpq", self._gain, error)
            pose = pose + step
            if not np.any(np.abs(step) > CHORD_TOLERANCE):
                break
        here = self.sensors.linearise(machines, pose, with_parameters=False)
        error = white - here.values
        step, left = find_step(here.by_pose, error)
        return pose + step, left, here.by_pose

    def pointwise(self, theta: Array) -> Array:
        """Return the log-density of each pose's readings, (B, D) to (B, P), -inf where a machine cannot stand."""
        result = np.empty((len(theta), self.n_poses))
        for start in range(0, len(theta), BATCH):
            part = slice(start, start + BATCH)
            _, error, slope = self._stand(theta[part])
            square = np.einsum("bpk,bpk->bp", error, error)
            result[part] = self.constant - 0.5 * square - half_log_volume(slope)
        result[~np.isfinite(result)] = -np.inf
        return result

    def __call__(self, theta: Array) -> Array:
        """Return the log-likelihood, (B, D) to (B,)."""
        return self.pointwise(theta).sum(axis=1)

    def volume_slope(self, theta: Array, scale: Array) -> Array:
        """Return the derivative of -½ Σ log |HᵀΣ⁻¹H| along moves, by central differences, at θ (D,).

        Parameters
        ----------
        theta : ndarray, shape (D,)
        scale : ndarray, shape (n, D)
            The moves.

        Returns
        -------
        ndarray, shape (n,)
        """
        n = len(scale)
        points = theta + STEP * np.concatenate([scale, -scale])
        values = np.concatenate(
            [
                -half_log_volume(self._stand(part)[2]).sum(axis=1)
                for part in np.array_split(points, max(1, len(points) // BATCH))
            ]
        )
        return np.asarray((values[:n] - values[n:]) / (2 * STEP))

    def linearise(self, theta: Array) -> tuple[Array, Array]:
        """Return r̂, shape (P, K), and its derivative -(1 - H H⁺) A, shape (P, K, D), in units of the noise, at θ (D,).

        r̂ being orthogonal to H, the gradient of ½ |r̂|² found with it is exact.
        """
        pose, error = self.find_poses(theta[None])
        here = self.sensors.linearise(theta, pose[0])
        moved = here.by_pose @ (np.linalg.pinv(here.by_pose) @ here.by_parameters)
        return error[0], moved - here.by_parameters
