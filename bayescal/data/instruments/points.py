"""Points on the platform that stations track: a laser tracker's reflectors, a measuring machine's balls.

A station knows the coordinates of every point it sees, each with a covariance. To first order in the noise the points
of a rigid probe tell no more than six numbers of a pose and station, the components of the whitened residuals along the
columns of the whitened rigid Jacobian; where the points of a station determine a pose, these are the rows, and what is
left over only says whether the points fit together. Where they do not, one or two points or points on a line, every
coordinate is a row. The density is that of all coordinates in mm, with what is left over at the best fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bayescal.data.instruments.base import Instrument, Rows
from bayescal.data.instruments.poses import LOG_TWO_PI
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.rigid_fit import weighted_rigid_transform
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_rigid_jacobian,
    matrix_from_rotation_vector,
)

ITERATIONS = 20
SETTLED = 1e-10
FLAT = 1e-6  # of the largest singular value of a cloud's Jacobian, lengths in units of its size: no pose below


@dataclass(frozen=True, eq=False)
class _Fit:
    """The pose of points that one or several stations saw together, by weighted least squares."""

    position: Array
    rotation: Array
    covariance: Array
    square: float
    n_coordinates: int


@dataclass(frozen=True, eq=False)
class PointReadings(Instrument):
    """Points read by S stations, in the base frame by the stations' nominal places.

    Attributes
    ----------
    names : tuple of str
    actuators : ndarray, shape (P, N)
        mm.
    stations, points : tuple of str
        Names of the S stations and the Q points.
    probe : ndarray, shape (Q, 3)
        Points on the tool, platform frame, mm.
    values : ndarray, shape (P, S, Q, 3)
        Points as read, base frame, mm; NaN where a point was not seen.
    covariance : ndarray, shape (P, S, Q, 3, 3)
        Of the coordinates, base frame, mm²; only those of points seen count.
    """

    names: tuple[str, ...]
    actuators: Array
    stations: tuple[str, ...]
    points: tuple[str, ...]
    probe: Array
    values: Array
    covariance: Array
    rows: Rows = field(init=False)
    weights: Array = field(init=False)  # (S, P, K, Q, 3): rows of each station from the residuals of its points

    def __post_init__(self) -> None:
        """Reduce the points of every pose and station to rows."""
        weights, constant = self._reduce()
        object.__setattr__(self, "weights", weights)
        to_pose, measured = self._find_poses(weights)
        n_rows = weights.shape[2]
        covariance = np.broadcast_to(np.eye(n_rows), (self.n_poses, n_rows, n_rows))
        count = weights.any(axis=(0, 3, 4)).sum(axis=1)
        object.__setattr__(self, "rows", Rows(covariance, constant, to_pose, measured, count))

    @property
    def n_stations(self) -> int:
        """Number of stations S."""
        return len(self.stations)

    @cached_property
    def seen(self) -> np.ndarray:
        """Which points were seen, shape (P, S, Q)."""
        return np.isfinite(self.values).all(axis=-1)

    @cached_property
    def _whitening(self) -> Array:
        """Inverse Cholesky factors of the points' covariances, shape (P, S, Q, 3, 3)."""
        covariance = np.where(self.seen[..., None, None], self.covariance, np.eye(3))
        return np.linalg.inv(np.linalg.cholesky(covariance))

    # --- fits ----------------------------------------------------------------------------------------------------

    def _fit(self, pose: int, stations: list[int]) -> _Fit | None:
        """Return the pose of what some stations saw at a pose together; None where their points do not tell it."""
        seen = self.seen[pose, stations]
        station, point = np.nonzero(seen)
        probe = self.probe[point]
        values = self.values[pose, stations][station, point]
        white = self._whitening[pose, stations][station, point]
        if len(point) < 3 or not _is_spread(probe):
            return None
        position, rotation = weighted_rigid_transform(probe, values, np.ones(len(point)))
        for _ in range(ITERATIONS):
            jacobian = (white @ compute_rigid_jacobian(probe, rotation)).reshape(-1, DEGREES_OF_FREEDOM)
            residual = np.einsum("qij,qj->qi", white, values - position - probe @ rotation.T).ravel()
            normal = jacobian.T @ jacobian
            step = np.linalg.solve(normal, jacobian.T @ residual)
            position, rotation = position + step[:3], matrix_from_rotation_vector(step[3:]) @ rotation
            if np.abs(step).max() < SETTLED:
                break
        residual = np.einsum("qij,qj->qi", white, values - position - probe @ rotation.T)
        return _Fit(position, rotation, np.linalg.inv(normal), float(np.sum(residual**2)), residual.size)

    @cached_property
    def _fits(self) -> list[list[_Fit | None]]:
        """Fits of each station (S) at each pose (P)."""
        return [[self._fit(p, [s]) for s in range(self.n_stations)] for p in range(self.n_poses)]

    @cached_property
    def _together(self) -> list[_Fit | None]:
        """Fits of all stations together at each pose."""
        if self.n_stations == 1:
            return [fits[0] for fits in self._fits]
        return [self._fit(p, list(range(self.n_stations))) for p in range(self.n_poses)]

    def _reduce(self) -> tuple[Array, Array]:
        """Return the weights (S, P, K, Q, 3) of the rows and the constant of the density (P,)."""
        parts: list[list[Array]] = []
        constant = np.zeros(self.n_poses)
        for p, fits in enumerate(self._fits):
            parts.append([])
            for s, fit in enumerate(fits):
                point = np.flatnonzero(self.seen[p, s])
                white = np.zeros((len(point), 3, len(self.points), 3))
                white[np.arange(len(point)), :, point] = self._whitening[p, s, point]
                flat = white.reshape(3 * len(point), len(self.points), 3)
                own = np.diagonal(self._whitening[p, s, point], axis1=-2, axis2=-1)
                constant[p] += float(np.log(own).sum()) - 0.5 * LOG_TWO_PI * own.size
                if fit is not None and len(flat) > DEGREES_OF_FREEDOM:
                    jacobian = np.einsum("rqi,qij->rj", flat, compute_rigid_jacobian(self.probe, fit.rotation))
                    basis = np.linalg.qr(jacobian)[0]
                    flat = np.einsum("rk,rqi->kqi", basis, flat)
                    constant[p] -= 0.5 * fit.square
                parts[-1].append(flat)
        return self._stack(parts), constant

    def _stack(self, parts: list[list[Array]]) -> Array:
        """Return the rows of all stations one below the other, zeros below those of a pose that has fewer."""
        n_rows = max(sum(len(part) for part in one) for one in parts)
        weights = np.zeros((self.n_stations, self.n_poses, n_rows, len(self.points), 3))
        for p, one in enumerate(parts):
            start = 0
            for s, part in enumerate(one):
                weights[s, p, start : start + len(part)] = part
                start += len(part)
        return weights

    def _find_poses(self, weights: Array) -> tuple[Array, np.ndarray]:
        """Return what takes rows to pose errors (P, 6, K) and which coordinates it gives (P, 6).

        Where the points do not tell the pose, the mean residual of the points seen stands for the position's error.
        """
        n_rows = weights.shape[2]
        to_pose = np.zeros((self.n_poses, DEGREES_OF_FREEDOM, n_rows))
        measured = np.zeros((self.n_poses, DEGREES_OF_FREEDOM), dtype=bool)
        for p, fit in enumerate(self._together):
            if fit is not None:
                jacobian = np.einsum("skqi,qij->kj", weights[:, p], compute_rigid_jacobian(self.probe, fit.rotation))
                to_pose[p], measured[p] = np.linalg.pinv(jacobian), True
            else:
                shift = np.tile(np.eye(3), (self.n_stations, len(self.points), 1, 1)) * self.seen[p, ..., None, None]
                moved = np.einsum("skqi,sqij->kj", weights[:, p], shift)
                to_pose[p, :3], measured[p, :3] = np.linalg.pinv(moved), True
        return to_pose, measured

    @cached_property
    def poses(self) -> MeasuredPoses:
        """The poses that the points of all stations together tell, NaN where they tell none."""
        n = self.n_poses
        position, rotation = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
        covariance = np.full((n, DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM), np.nan)
        for p, fit in enumerate(self._together):
            if fit is not None:
                position[p], rotation[p], covariance[p] = fit.position, fit.rotation, fit.covariance
        return MeasuredPoses(self.names, position, rotation, covariance, self.actuators)

    # --- rows ----------------------------------------------------------------------------------------------------

    def residuals(self, position: Array, rotation: Array) -> Array:
        """Return read minus expected rows, shape (..., P, K); see `Instrument.residuals`."""
        expected = position[..., None, :] + np.einsum("...ij,qj->...qi", rotation, self.probe)
        read = np.swapaxes(np.where(self.seen[..., None], self.values, 0.0), 0, 1)
        missed = np.swapaxes(self.seen, 0, 1)[..., None]
        misfit = (read - expected) * missed
        weights = np.moveaxis(self.weights, 0, 1).swapaxes(1, 2)  # (P, K, S, Q, 3)
        n_poses, n_rows = weights.shape[:2]
        flat = np.moveaxis(misfit, -4, -3).reshape(*misfit.shape[:-4], n_poses, -1)
        result: Array = np.einsum("pkr,...pr->...pk", weights.reshape(n_poses, n_rows, -1), flat, optimize=True)
        return result

    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the derivative by the poses seen, shape (S, P, K, 6); see `Instrument.slopes`."""
        del position
        jacobian = compute_rigid_jacobian(self.probe, rotation)
        result: Array = -np.einsum("spkqi,spqij->spkj", self.weights, jacobian, optimize=True)
        return result

    def select(self, chosen: np.ndarray) -> PointReadings:
        """Return the readings of some poses."""
        names = tuple(np.asarray(self.names)[chosen])
        return PointReadings(
            names,
            self.actuators[chosen],
            self.stations,
            self.points,
            self.probe,
            self.values[chosen],
            self.covariance[chosen],
        )

    def describe(self) -> dict[str, Any]:
        """Return what was seen, and how well the points of each station fit together."""
        fits = [fit for one in self._fits for fit in one if fit is not None and fit.n_coordinates > DEGREES_OF_FREEDOM]
        dof = sum(fit.n_coordinates - DEGREES_OF_FREEDOM for fit in fits)
        return {
            "stations": list(self.stations),
            "points": list(self.points),
            "n_seen": int(self.seen.sum()),
            "n_missed": int((~self.seen).sum()),
            "chi2_per_dof": sum(fit.square for fit in fits) / dof if dof else None,
        }


def _is_spread(points: Array) -> bool:
    """Whether points (n, 3) do not lie on a line."""
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[0] > 0.0 and extent[1] > FLAT * extent[0])
