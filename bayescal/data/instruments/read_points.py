"""Tables of tracked points: what stations saw, where the points sit on the platform, where the stations stand.

A point is seen by its coordinates in the station's frame, or by range, azimuth and elevation:

    x = r cos(el) cos(az),  y = r cos(el) sin(az),  z = r sin(el).

Polar readings become coordinates, their noise to first order a covariance; at a range of 10 m and 1 arcsec the second
order is 0.1 nm.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.data.actuators import Columns, check_calibration, read_actuators
from bayescal.data.instruments.read_poses import (
    OTHER_COLUMNS,
    QUATERNION,
    VECTOR,
    PoseRecords,
    check_positive,
    check_same_poses,
    choose_noise,
    name_covariances,
    read_covariances,
    read_rotation_vectors,
)
from bayescal.data.instruments.readings import TrackedPoints
from bayescal.errors import InputError
from bayescal.files.csv_tables import CsvTable, read_table
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector
from bayescal.numerics.units import ARCSECOND, MICROMETRE

CARTESIAN = ("x_mm", "y_mm", "z_mm")
POLAR = ("range_mm", "azimuth_deg", "elevation_deg")
SAME = ("sd_um",)
DEVIATIONS = ("sd_x_um", "sd_y_um", "sd_z_um")
POLAR_DEVIATIONS = ("sd_range_um", "sd_azimuth_arcsec", "sd_elevation_arcsec")
ONLY_STATION = "station"


@dataclass(frozen=True)
class PointNoise:
    """Standard deviations of all points where the table does not state them."""

    point_um: tuple[float, ...] = ()  # of each coordinate in the station's frame; empty where they are polar
    range_um: float = 0.0  # of the range, constant and per range; the sum of both
    range_ppm: float = 0.0
    azimuth_arcsec: float = 0.0
    elevation_arcsec: float = 0.0

    @property
    def is_polar(self) -> bool:
        """Whether ranges and angles are stated."""
        return self.azimuth_arcsec > 0.0


@dataclass(frozen=True, eq=False)
class Stations:
    """Where S stations stand: positions (S, 3) in mm and rotations (S, 3, 3) from the station to the base frame."""

    names: tuple[str, ...]
    position: Array
    rotation: Array


def read_points(
    path: Path, probe: Path, stations: Path | None, actuators: Path, noise: PointNoise, columns: Columns
) -> tuple[TrackedPoints, PoseRecords]:
    """Return tracked points, and when they were taken, with actuator positions of these columns.

    InputError for unknown columns, poses, stations or points, points that stand twice, a pose without any, a covariance
    that is not positive, noise that is stated twice or not at all.
    """
    names, verification, positions = read_actuators(actuators, columns)
    check_calibration(actuators, verification)
    points, places = read_probe(probe)
    standing = read_stations(stations)
    table = _read_table(path, len(standing.names) > 1)
    pose, station, point = _locate(table, names, standing, points, actuators, stations, probe)
    coordinates, covariance = _read_coordinates(table, noise)
    turn = standing.rotation[station]
    shape = (len(names), len(standing.names), len(points))
    values, spread = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    seen = standing.position[station] + np.einsum("rij,rj->ri", turn, coordinates)
    values[pose, station, point] = seen
    spread[pose, station, point] = turn @ covariance @ np.swapaxes(turn, -1, -2)
    readings = TrackedPoints(tuple(names), positions, standing.names, points, places, values, spread)
    return readings, PoseRecords(tuple(names), verification, positions)


def read_probe(path: Path) -> tuple[tuple[str, ...], Array]:
    """Return the names of Q points and where they sit on the platform (Q, 3), mm."""
    table = read_table(path, ("point", *CARTESIAN))
    names = table.text("point")
    table.check_unique([(name,) for name in names], "point")
    return tuple(names), table.numbers(CARTESIAN)


def read_stations(path: Path | None) -> Stations:
    """Return the stations; without a table one that stands in the base frame."""
    if path is None:
        return Stations((ONLY_STATION,), np.zeros((1, 3)), np.eye(3)[None])
    table = read_table(path, ("station", *CARTESIAN), (*VECTOR, *OTHER_COLUMNS))
    names = table.text("station")
    table.check_unique([(name,) for name in names], "station")
    vector = read_rotation_vectors(table)
    missing = ~np.isfinite(vector).all(axis=1)
    table.refuse(
        missing, lambda _: f"found part of a rotation, expected {', '.join(VECTOR)} or {', '.join(QUATERNION)}"
    )
    return Stations(tuple(names), table.numbers(CARTESIAN), matrix_from_rotation_vector(vector))


def check_point_columns(path: Path, several: bool) -> None:
    """Raise InputError for a table of points without its columns, or with a coordinate that is no number."""
    table = _read_table(path, several)
    table.numbers(CARTESIAN if table.has(CARTESIAN) else POLAR)


def _read_table(path: Path, several: bool) -> CsvTable:
    upper, lower = name_covariances("xyz")
    keys = ("pose", "station", "point") if several else ("pose", "point")
    maybe = () if several else ("station",)
    noise = (*SAME, *DEVIATIONS, *upper, *lower, *POLAR_DEVIATIONS)
    table = read_table(path, keys, (*maybe, *CARTESIAN, *POLAR, *noise))
    cartesian, polar = table.has(CARTESIAN), table.has(POLAR)
    if cartesian == polar:
        found = "both" if polar else "neither"
        raise InputError(f"{path}: found {found} of {', '.join(CARTESIAN)} and {', '.join(POLAR)}, expected either")
    return table


def _locate(
    table: CsvTable,
    poses: list[str],
    stations: Stations,
    points: tuple[str, ...],
    actuators: Path,
    station_file: Path | None,
    probe: Path,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which pose, station and point each row is of."""
    found = table.text("pose")
    check_same_poses(table, found, poses, actuators)
    seen = table.text("station") if "station" in table.columns else [stations.names[0]] * len(found)
    what = table.text("point")
    table.check_unique(list(zip(found, seen, what, strict=True)), "pose/station/point")
    for row, (station, point) in enumerate(zip(seen, what, strict=True)):
        if station not in stations.names:
            where = ", without data.stations" if station_file is None else f"in {station_file}"
            known = ", ".join(stations.names)
            raise InputError(f"{table.where(row)}: station {station!r} is not {where}, expected one of {known}")
        if point not in points:
            raise InputError(f"{table.where(row)}: point {point!r}: not in {probe}")
    index = {name: k for k, name in enumerate(poses)}
    return (
        np.array([index[name] for name in found]),
        np.array([stations.names.index(name) for name in seen]),
        np.array([points.index(name) for name in what]),
    )


# --- coordinates and noise ---------------------------------------------------------------------------------------


def _read_coordinates(table: CsvTable, noise: PointNoise) -> tuple[Array, Array]:
    """Return coordinates (rows, 3) in the stations' frames, mm, and their covariances (rows, 3, 3), mm²."""
    if "x_mm" in table.columns:
        return table.numbers(CARTESIAN), _read_covariance(table, noise)
    raw = table.numbers(POLAR)
    table.positive(POLAR[:1])
    for k, limit in ((1, 360.0), (2, 90.0)):
        table.refuse_beyond(POLAR[k : k + 1], raw[:, k : k + 1], limit)
    reading = np.concatenate([raw[:, :1], np.radians(raw[:, 1:])], axis=1)
    coordinates, slopes = convert_polar(reading)
    change = slopes * _read_polar_noise(table, noise, raw[:, 0])[:, None, :]
    covariance = change @ np.swapaxes(change, -1, -2)
    return coordinates, covariance


def convert_polar(reading: Array) -> tuple[Array, Array]:
    """Return coordinates (..., 3) of range (mm), azimuth and elevation (rad), (..., 3), and the derivatives by them."""
    distance, azimuth, elevation = np.moveaxis(reading, -1, 0)
    along = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    across = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)
    up = np.stack(
        [-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)], axis=-1
    )
    by_azimuth, by_elevation = (distance * np.cos(elevation))[..., None] * across, distance[..., None] * up
    return distance[..., None] * along, np.stack([along, by_azimuth, by_elevation], axis=-1)


def _read_covariance(table: CsvTable, noise: PointNoise) -> Array:
    measured = np.ones((len(table.rows), 3), dtype=bool)
    covariance = read_covariances(table, "xyz", measured)
    same, each = table.has(SAME), table.has(DEVIATIONS)
    ways = (covariance is not None) + same + each
    if ways > 1 or table.has(POLAR_DEVIATIONS):
        raise InputError(f"{table.path}: found several kinds of noise columns, expected one")
    wanted = "sd_um, or sd_x_um, sd_y_um, sd_z_um, or cov_x_x ... cov_z_z"
    choose_noise(table.path, ways == 1, bool(noise.point_um) or noise.is_polar, wanted, "point_um")
    if noise.is_polar:
        raise InputError(f"{table.path}: found coordinates with noise of ranges and angles, expected point_um")
    if covariance is None:
        sd = table.positive(SAME if same else DEVIATIONS) if ways else np.array(noise.point_um)
        covariance = np.eye(3) * np.broadcast_to(sd, measured.shape)[:, None, :] ** 2
    check_positive(table, covariance, measured)
    return np.asarray(covariance * MICROMETRE**2)


def _read_polar_noise(table: CsvTable, noise: PointNoise, distance: Array) -> Array:
    """Return standard deviations of range (mm) and angles (rad), shape (rows, 3)."""
    upper, _ = name_covariances("xyz")
    if any(name in table.columns for name in (*SAME, *DEVIATIONS, *upper)):
        raise InputError(f"{table.path}: found ranges with coordinate noise, expected noise of ranges and angles")
    stated = table.has(POLAR_DEVIATIONS)
    keys = "range_um, azimuth_arcsec and elevation_arcsec"
    choose_noise(table.path, stated, noise.is_polar or bool(noise.point_um), ", ".join(POLAR_DEVIATIONS), keys)
    if stated:
        sd = table.positive(POLAR_DEVIATIONS)
    elif not noise.is_polar:
        raise InputError(f"{table.path}: found ranges and angles with point_um, expected {keys}")
    else:
        return spread_polar(noise, distance)
    return sd * np.array([MICROMETRE, ARCSECOND, ARCSECOND])


def spread_polar(noise: PointNoise, distance: Array) -> Array:
    """Return standard deviations of range (mm), azimuth and elevation (rad) at ranges (...) in mm, shape (..., 3)."""
    along = noise.range_um * MICROMETRE + 1e-6 * noise.range_ppm * distance
    angles = (np.full_like(along, ARCSECOND * x) for x in (noise.azimuth_arcsec, noise.elevation_arcsec))
    return np.stack([along, *angles], axis=-1)
