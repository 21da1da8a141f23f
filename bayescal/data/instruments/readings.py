"""Readings of instruments as rows that compare with the poses they should have seen.

A pose is seen from S stations, each with a frame of its own against the base, through a tool on the platform: station s
sees T_s = T_base,s T_platform T_tool. The rows of a pose are residuals, read minus expected, whose noise is normal with
a known covariance. Poses may have fewer rows than others: rows beyond them are zero, with a unit variance that belongs
to nothing.

Of poses, whole or in part, the position is compared coordinate by coordinate. A rotation that is measured whole is
compared as a rotation: the residual is the rotation vector from the expected to the measured one, and the covariance is
that of this vector. Of a rotation that is measured in part nothing but some coordinates of its rotation vector is
known; these are compared as they stand.

Of tracked points a station knows the coordinates of every point it sees, each with a covariance. To first order in the
noise the points of a rigid probe tell no more than six numbers of a pose and station, the components of the whitened
residuals along the columns of the whitened rigid Jacobian; where the points of a station determine a pose, these are
the rows, and what is left over only says whether the points fit together. Where they do not, one or two points or
points on a line, every coordinate is a row. The density is that of all coordinates in mm, with what is left over at the
best fit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.rigid_fit import weighted_rigid_transform
from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_left_inverse_jacobian,
    compute_rigid_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)


@dataclass(frozen=True, eq=False)
class Rows:
    """Readings of P poses in at most K rows, as the likelihood takes them."""

    covariance: Array  # (P, K, K): of the rows' noise; unit where a pose has no row
    log_constant: Array  # (P,): what the log-density has besides the rows' square and log-determinant
    # (P, 6, K): from rows to the pose error as seen, measured minus expected, mm and rad; zero rows where it is not
    # measured
    to_pose: Array
    measured: np.ndarray  # (P, 6): which coordinates of the pose error the rows determine
    count: np.ndarray  # (P,): how many rows each pose has

    def select(self, chosen: np.ndarray) -> Rows:
        """Return the rows of some poses."""
        return Rows(**{name: value[chosen] for name, value in vars(self).items()})


class Instrument(ABC):
    """Readings of an instrument at P poses.

    Attributes
    ----------
    names : tuple of str
        Of the P poses.
    actuators : ndarray, shape (P, N)
        Actuator positions, mm.
    rows : Rows
    """

    names: tuple[str, ...]
    actuators: Array
    rows: Rows

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.names)

    @property
    @abstractmethod
    def n_stations(self) -> int:
        """Number of stations S, each with a frame of its own."""

    @property
    @abstractmethod
    def poses(self) -> MeasuredPoses:
        """The poses as read, base frame, all frames as they should be; NaN where a pose is not determined."""

    @abstractmethod
    def residuals(self, position: Array, rotation: Array) -> Array:
        """Return read minus expected rows, shape (..., P, K).

        Parameters
        ----------
        position, rotation : ndarray, shapes (..., S, P, 3) and (..., S, P, 3, 3)
            Poses of the tool as each station should see them, base frame, mm.
        """

    @abstractmethod
    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the derivative of `residuals` by the poses seen (S, P, 3), (S, P, 3, 3), shape (S, P, K, 6).

        Poses change by a displacement and by the rotation vector of a rotation from the left.
        """

    @abstractmethod
    def select(self, chosen: np.ndarray) -> Self:
        """Return the readings of some poses."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what was read and how well it fits in itself, for the summary."""

    def is_whole(self) -> bool:
        """Whether every pose is determined by its readings."""
        return bool(self.rows.measured.all())


LOG_TWO_PI = float(np.log(2.0 * np.pi))
COORDINATES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, eq=False)
class PoseReadings(Instrument):
    """Poses read by one instrument."""

    names: tuple[str, ...]
    actuators: Array  # (P, N): mm
    # (P, 6): position (mm) and rotation vector (rad) of the tool in the instrument's frame; NaN where not measured
    values: Array
    # (P, 6, 6): of position (mm) and of the error's rotation vector (rad), instrument's axes; only what was measured
    # counts
    covariance: Array
    rows: Rows = field(init=False)

    def __post_init__(self) -> None:
        """Build the rows: what was not measured is no row."""
        measured = np.isfinite(self.values)
        both = measured[:, :, None] & measured[:, None, :]
        covariance = np.where(both, self.covariance, np.eye(DEGREES_OF_FREEDOM))
        constant = -0.5 * LOG_TWO_PI * measured.sum(axis=1)
        rows = Rows(covariance, constant, np.eye(6) * measured[:, None, :], measured, measured.sum(axis=1))
        object.__setattr__(self, "rows", rows)

    @property
    def n_stations(self) -> int:
        """One."""
        return 1

    @cached_property
    def _rotation(self) -> tuple[np.ndarray, Array]:
        """Which rotations are measured whole, shape (P,), and the rotations (P, 3, 3), level where they are not."""
        whole = self.rows.measured[:, 3:].all(axis=1)
        return whole, matrix_from_rotation_vector(np.where(whole[:, None], self.values[:, 3:], 0.0))

    @cached_property
    def poses(self) -> MeasuredPoses:
        """The poses as read; NaN where a coordinate is not measured."""
        whole, rotation = self._rotation
        rotation = np.where(whole[:, None, None], rotation, np.nan)
        both = self.rows.measured[:, :, None] & self.rows.measured[:, None, :]
        covariance = np.where(both, self.covariance, np.nan)
        return MeasuredPoses(self.names, self.values[:, :3], rotation, covariance, self.actuators)

    def residuals(self, position: Array, rotation: Array) -> Array:
        """Return measured minus expected coordinates, shape (..., P, 6); see `Instrument.residuals`."""
        position, rotation = position[..., 0, :, :], rotation[..., 0, :, :, :]
        whole, measured = self._rotation
        turn = rotation_vector_from_matrix(measured @ np.swapaxes(rotation, -1, -2))
        if not whole.all():
            turn = np.where(whole[:, None], turn, self.values[:, 3:] - rotation_vector_from_matrix(rotation))
        return np.where(self.rows.measured, np.concatenate([self.values[:, :3] - position, turn], axis=-1), 0.0)

    def slopes(self, position: Array, rotation: Array) -> Array:
        """Return the derivative by the pose seen, shape (1, P, 6, 6); see `Instrument.slopes`."""
        whole, _ = self._rotation
        turn = self.residuals(position, rotation)[..., 3:]
        turned = -np.swapaxes(compute_left_inverse_jacobian(turn), -1, -2)
        partial = -compute_left_inverse_jacobian(rotation_vector_from_matrix(rotation[0]))
        result = np.zeros((self.n_poses, DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM))
        result[:, :3, :3] = -np.eye(3)
        result[:, 3:, 3:] = np.where(whole[:, None, None], turned, partial)
        return (result * self.rows.measured[:, :, None])[None]

    def select(self, chosen: np.ndarray) -> PoseReadings:
        """Return the readings of some poses."""
        names = tuple(np.asarray(self.names)[chosen])
        return PoseReadings(names, self.actuators[chosen], self.values[chosen], self.covariance[chosen])

    def describe(self) -> dict[str, Any]:
        """Return which coordinates were measured."""
        count = self.rows.measured.sum(axis=0).tolist()
        return {"measured_coordinates": dict(zip(COORDINATES, count, strict=True))}


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
    """Points read by S stations, in the base frame by the stations' nominal places."""

    names: tuple[str, ...]
    actuators: Array  # (P, N): mm
    stations: tuple[str, ...]  # names of the S stations and the Q points
    points: tuple[str, ...]
    probe: Array  # (Q, 3): points on the tool, platform frame, mm
    values: Array  # (P, S, Q, 3): points as read, base frame, mm; NaN where a point was not seen
    covariance: Array  # (P, S, Q, 3, 3): of the coordinates, base frame, mm²; only those of points seen count
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


UNLIKE, ALIKE = 0.5, 0.2  # misfits as shares of the expected change
ASTRAY = 0.3  # of the distance of points from their station
LENGTHS = {1e3: "metres", 1e-3: "micrometres", 25.4: "inches"}
ANGLES = {180.0 / np.pi: "radians", np.pi / 180.0: "sixtieths of degrees"}


def check_units(machine: Machine, instrument: Instrument, path: Path) -> None:
    """Raise InputError where another unit explains readings that the nominal machine does not."""
    found = solve_forward_kinematics(machine, machine.layout.nominal, instrument.actuators, check=False)
    if isinstance(instrument, PoseReadings):
        turn = rotation_vector_from_matrix(found.rotation)
        _compare(instrument.values[:, :3], found.position, LENGTHS, "positions", "mm", path)
        _compare(instrument.values[:, 3:], turn, ANGLES, "rotation vectors", "degrees", path)
    elif isinstance(instrument, PointReadings):
        points = found.position[:, None] + np.einsum("pij,qj->pqi", found.rotation, instrument.probe)
        expected = np.broadcast_to(points[:, None], instrument.values.shape)
        flat = instrument.values.reshape(len(points), -1), expected.reshape(len(points), -1)
        _compare(*flat, LENGTHS, "points", "mm", path)


def _compare(found: Array, expected: Array, units: dict[float, str], what: str, unit: str, path: Path) -> None:
    """Compare changes from pose to pose, shapes (P, n), NaN where there is no reading; constant offsets are frames'."""
    known = np.isfinite(found)
    count = np.maximum(known.sum(axis=0), 1)
    centred = [np.where(known, x, 0.0) - np.where(known, x, 0.0).sum(axis=0) / count for x in (found, expected)]
    change, wanted = (np.where(known, x, 0.0) for x in centred)
    spread = float(np.linalg.norm(wanted))
    if np.linalg.norm(change - wanted) <= UNLIKE * spread:
        return
    for factor, word in units.items():
        if np.linalg.norm(factor * change - wanted) < ALIKE * spread:
            raise InputError(f"{path}: found {what} that change from pose to pose as if in {word}, expected {unit}")


def check_places(machine: Machine, readings: PointReadings, places: Array, path: Path) -> None:
    """Raise InputError where points lie nowhere near where the nominal machine and stations (S, 3) have them."""
    found = solve_forward_kinematics(machine, machine.layout.nominal, readings.actuators, check=False)
    points = found.position[:, None] + np.einsum("pij,qj->pqi", found.rotation, readings.probe)
    for s, name in enumerate(readings.stations):
        seen = readings.seen[:, s]
        if not seen.any():
            raise InputError(f"{path}: found no point of station {name!r}, expected one at least")
        off = np.linalg.norm(readings.values[:, s] - points, axis=-1)[seen]
        away = np.linalg.norm(points - places[s], axis=-1)[seen]
        rms, distance = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(away**2)))
        if rms > ASTRAY * distance:
            raise InputError(
                f"{path}: station {name!r}: found its points {rms:.4g} mm (rms) from where the nominal machine has "
                f"them, expected less than {ASTRAY * distance:.4g} mm: angles in degrees, lengths in mm, the station's "
                "own place and direction"
            )
