"""Whether readings can be in the units they are said to be: how they change from pose to pose must be the machine's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.data.instruments.base import Instrument
from bayescal.data.instruments.points import PointReadings
from bayescal.data.instruments.poses import PoseReadings
from bayescal.errors import InputError
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix

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
