"""What an instrument tracked at each pose of a platform: poses, whole or in part, or points on it from stations.

Of poses, the position is compared coordinate by coordinate, and a rotation that is measured whole as a rotation: its
covariance is that of the rotation vector from the expected to the measured one.

Of tracked points a station knows the coordinates of every point it sees, each with a covariance. To first order in the
noise the points of a rigid probe tell no more than a pose; where a station's points determine one at every pose at
which it saw any, that pose is what it read. Where they do not, one or two points or points on a line, every coordinate
is a reading.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.rigid_fit import is_collinear, weighted_rigid_transform
from bayescal.errors import InputError
from bayescal.machines.readings import POSE
from bayescal.numerics.geometry import (
    DEGREES_OF_FREEDOM,
    Array,
    compute_rigid_jacobian,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)


class StationObservation(NamedTuple):
    """What one station saw of one thing at P poses, in the base frame by the station's nominal place."""

    station: int
    point: Array | None  # (3,): of the platform, mm; None for a pose
    values: Array  # (P, c): c coordinates, a position or a pose, mm and rad; NaN where not measured
    covariance: Array  # (P, c, c)


class TrackedReadings(ABC):
    """What an instrument tracked at P poses."""

    names: tuple[str, ...]  # of the P poses
    actuators: Array  # (P, N): actuator positions, mm
    stations: tuple[str, ...]  # names of the S stations, each with a frame of its own
    values: Array  # (P, ...): as read; NaN where nothing was

    @property
    @abstractmethod
    def poses(self) -> MeasuredPoses:
        """The poses as read, base frame, all frames as they should be; NaN where a coordinate is not determined."""

    @abstractmethod
    def see(self, each_point: bool = False) -> list[StationObservation]:
        """Return what was seen, station by station; every point by itself where these are asked for."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what was read and how well it fits in itself, for the summary."""

    @abstractmethod
    def check_units(self, expected: Array, path: Path) -> None:
        """Raise InputError where another unit explains readings that the nominal machine's poses (P, 6) do not.

        Position and rotation vector of its tool, mm and rad; NaN where it cannot stand.
        """

    def is_whole(self) -> bool:
        """Whether every pose is determined by its readings."""
        return self.poses.is_whole()


@dataclass(frozen=True, eq=False)
class TrackedPoses(TrackedReadings):
    """Poses read by one instrument."""

    names: tuple[str, ...]
    actuators: Array  # (P, N): mm
    # (P, 6): position (mm) and rotation vector (rad) of the tool in the instrument's frame; NaN where not measured
    values: Array
    # (P, 6, 6): of position (mm) and of the error's rotation vector (rad), instrument's axes; only what was measured
    # counts
    covariance: Array
    stations: tuple[str, ...] = ("",)

    @cached_property
    def poses(self) -> MeasuredPoses:
        """The poses as read; NaN where a coordinate is not measured."""
        measured = np.isfinite(self.values)
        whole = measured[:, 3:].all(axis=1)
        rotation = matrix_from_rotation_vector(np.where(whole[:, None], self.values[:, 3:], 0.0))
        rotation = np.where(whole[:, None, None], rotation, np.nan)
        covariance = np.where(measured[:, :, None] & measured[:, None, :], self.covariance, np.nan)
        return MeasuredPoses(self.names, self.values[:, :3], rotation, covariance, self.actuators)

    def see(self, each_point: bool = False) -> list[StationObservation]:
        """Return the poses."""
        del each_point
        return [StationObservation(0, None, self.values, self.covariance)]

    def describe(self) -> dict[str, Any]:
        """Return which coordinates were measured."""
        count = np.isfinite(self.values).sum(axis=0).tolist()
        return {"measured_coordinates": dict(zip(POSE, count, strict=True))}

    def check_units(self, expected: Array, path: Path) -> None:
        """Compare positions and rotation vectors."""
        _compare(self.values[:, :3], expected[:, :3], LENGTHS, "positions", "mm", path)
        _compare(self.values[:, 3:], expected[:, 3:], ANGLES, "rotation vectors", "degrees", path)


ITERATIONS = 20
SETTLED = 1e-10
FLAT = 1e-6  # of the largest singular value of a cloud's Jacobian, lengths in units of its size: no pose below


@dataclass(frozen=True, eq=False)
class _StationFit:
    """The pose of points that one or several stations saw together, by weighted least squares."""

    position: Array
    rotation: Array
    covariance: Array
    square: float
    n_coordinates: int


@dataclass(frozen=True, eq=False)
class TrackedPoints(TrackedReadings):
    """Points read by S stations, in the base frame by the stations' nominal places."""

    names: tuple[str, ...]
    actuators: Array  # (P, N): mm
    stations: tuple[str, ...]  # names of the S stations and the Q points
    points: tuple[str, ...]
    probe: Array  # (Q, 3): points on the tool, platform frame, mm
    values: Array  # (P, S, Q, 3): points as read, base frame, mm; NaN where a point was not seen
    covariance: Array  # (P, S, Q, 3, 3): of the coordinates, base frame, mm²; only those of points seen count

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.names)

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

    def _fit(self, pose: int, stations: list[int]) -> _StationFit | None:
        """Return the pose of what some stations saw at a pose together; None where their points do not tell it."""
        seen = self.seen[pose, stations]
        station, point = np.nonzero(seen)
        probe = self.probe[point]
        values = self.values[pose, stations][station, point]
        white = self._whitening[pose, stations][station, point]
        if len(point) < 3 or is_collinear(probe, FLAT):
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
        return _StationFit(position, rotation, np.linalg.inv(normal), float(np.sum(residual**2)), residual.size)

    @cached_property
    def _fits(self) -> list[list[_StationFit | None]]:
        """Fits of each station (S) at each pose (P)."""
        return [[self._fit(p, [s]) for s in range(len(self.stations))] for p in range(self.n_poses)]

    @cached_property
    def poses(self) -> MeasuredPoses:
        """The poses that the points of all stations together tell, NaN where they tell none."""
        every = list(range(len(self.stations)))
        fits = [one[0] if len(every) == 1 else self._fit(p, every) for p, one in enumerate(self._fits)]
        return MeasuredPoses(self.names, *self._gather(fits), self.actuators)

    def _gather(self, fits: Sequence[_StationFit | None]) -> tuple[Array, Array, Array]:
        """Return positions (P, 3), rotations (P, 3, 3) and covariances (P, 6, 6) of fits; NaN where there is none."""
        n = self.n_poses
        position, rotation = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
        covariance = np.full((n, DEGREES_OF_FREEDOM, DEGREES_OF_FREEDOM), np.nan)
        for p, fit in enumerate(fits):
            if fit is not None:
                position[p], rotation[p], covariance[p] = fit.position, fit.rotation, fit.covariance
        return position, rotation, covariance

    def see(self, each_point: bool = False) -> list[StationObservation]:
        """Return each station's poses where its points determine them all, otherwise its points."""
        found = []
        for s in range(len(self.stations)):
            fits = [one[s] for one in self._fits]
            determined = (fit is not None or not seen.any() for fit, seen in zip(fits, self.seen[:, s], strict=True))
            if not each_point and all(determined):
                position, rotation, covariance = self._gather(fits)
                found.append(
                    StationObservation(s, None, np.concatenate([position, turn_of(rotation)], axis=1), covariance)
                )
            else:
                found += [
                    StationObservation(s, point, self.values[:, s, q], self.covariance[:, s, q])
                    for q, point in enumerate(self.probe)
                ]
        return found

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

    def check_units(self, expected: Array, path: Path) -> None:
        """Compare points."""
        points = np.broadcast_to(_move(self.probe, expected)[:, None], self.values.shape)
        n = self.n_poses
        _compare(self.values.reshape(n, -1), points.reshape(n, -1), LENGTHS, "points", "mm", path)


def turn_of(rotation: Array) -> Array:
    """Return rotation vectors (..., 3) of rotations (..., 3, 3); NaN where these are."""
    known = np.isfinite(rotation).all(axis=(-1, -2))[..., None]
    return np.where(known, rotation_vector_from_matrix(np.where(known[..., None], rotation, np.eye(3))), np.nan)


UNLIKE, SIMILAR = 0.5, 0.2  # misfits as shares of the expected change
MAX_RANGE_FRACTION = 0.3  # of the distance of points from their station
LENGTHS = {1e3: "metres", 1e-3: "micrometres", 25.4: "inches"}
ANGLES = {180.0 / np.pi: "radians", np.pi / 180.0: "sixtieths of degrees"}


def _compare(found: Array, expected: Array, units: dict[float, str], what: str, unit: str, path: Path) -> None:
    """Compare changes from pose to pose, shapes (P, n), NaN where there is no reading; constant offsets are frames'."""
    known = np.isfinite(found) & np.isfinite(expected)
    count = np.maximum(known.sum(axis=0), 1)
    centred = [np.where(known, x, 0.0) - np.where(known, x, 0.0).sum(axis=0) / count for x in (found, expected)]
    change, wanted = (np.where(known, x, 0.0) for x in centred)
    spread = float(np.linalg.norm(wanted))
    if np.linalg.norm(change - wanted) <= UNLIKE * spread:
        return
    for factor, word in units.items():
        if np.linalg.norm(factor * change - wanted) < SIMILAR * spread:
            raise InputError(f"{path}: found {what} that look like {word}, expected {unit}")


def _move(probe: Array, expected: Array) -> Array:
    """Return points (Q, 3) of the tool at poses (P, 6), base frame, (P, Q, 3)."""
    known = np.where(np.isfinite(expected), expected, 0.0)
    points = known[:, None, :3] + np.einsum("pij,qj->pqi", matrix_from_rotation_vector(known[:, 3:]), probe)
    return np.where(np.isfinite(expected).all(axis=1)[:, None, None], points, np.nan)


def check_places(expected: Array, readings: TrackedPoints, places: Array, path: Path) -> None:
    """Raise InputError where points lie nowhere near where nominal poses (P, 6) and stations (S, 3) have them."""
    points = _move(readings.probe, expected)
    for s, name in enumerate(readings.stations):
        seen = readings.seen[:, s]
        if not seen.any():
            raise InputError(f"{path}: found no point of station {name!r}, expected one")
        seen = seen & np.isfinite(points).all(axis=-1)
        if not seen.any():
            continue
        off = np.linalg.norm(readings.values[:, s] - points, axis=-1)[seen]
        away = np.linalg.norm(points - places[s], axis=-1)[seen]
        rms, distance = float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(away**2)))
        if rms > MAX_RANGE_FRACTION * distance:
            raise InputError(
                f"{path}: station {name!r}: found points {rms:.4g} mm (rms) from nominal, expected "
                f"less than {MAX_RANGE_FRACTION * distance:.4g}: check units and the station's place"
            )
