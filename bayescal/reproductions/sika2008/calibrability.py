"""Calibrability C = cond(JᵀJ) (Šika et al. 2008, eq. 6; Valášek, Šika and Hamrle 2007), and what it is worth.

J is the Jacobian of the constraints by the calibrated parameters, the poses eliminated. Its condition depends on the
units in which lengths and angles are written, and so does C: in metres and radians it is not what it is in millimetres
and degrees. In units of the noise and of the tolerances it has a meaning: C_scaled is the ratio of the best to the
least known direction, in information gained for what was known beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.sensor_sets import FreeParameters, SensorSet, eliminate_poses

DEGREE, MM_PER_METRE = float(np.pi / 180), 1000.0


@dataclass(frozen=True)
class Calibrability:
    """cond(JᵀJ) of one plan in different units.

    Attributes
    ----------
    metres_radians, millimetres_radians, millimetres_degrees : float
        Of the constraints as they stand, residuals and parameters in these units.
    scaled : float
        Residuals in units of the noise, parameters in units of their tolerances.
    """

    metres_radians: float
    millimetres_radians: float
    millimetres_degrees: float
    scaled: float


def in_units(sensors: SensorSet, length: float, angle: float) -> SensorSet:
    """Return the sensors with a length in mm and an angle in rad for noise, whatever their own."""
    units = [length if sensors.model.channels[k].unit == "mm" else angle for k in sensors.chosen]
    return SensorSet(sensors.model, sensors.chosen, np.array(units))


def compute_calibrability(sensors: SensorSet, free: FreeParameters, pose: Array) -> Calibrability:
    """Return the calibrability of the machine as expected at poses (P, q); infinite where a direction is not seen."""
    units = np.array(sensors.model.layout.units)[free.places]
    in_metres, in_degrees = np.where(units == "mm", MM_PER_METRE, 1.0), np.where(units == "mm", 1.0, DEGREE)
    return Calibrability(
        _condition(in_units(sensors, MM_PER_METRE, 1.0), free, pose, in_metres),
        _condition(in_units(sensors, 1.0, 1.0), free, pose, np.ones(len(units))),
        _condition(in_units(sensors, 1.0, DEGREE), free, pose, in_degrees),
        _condition(sensors, free, pose, free.scale),
    )


def _condition(sensors: SensorSet, free: FreeParameters, pose: Array, moves: Array) -> float:
    rows = eliminate_poses(sensors.linearise(free.centre, pose))[..., free.places] * moves
    count = len(moves)
    values = np.linalg.svd(rows.reshape(-1, count), compute_uv=False)
    return float((values[0] / values[-1]) ** 2) if len(values) == count and values[-1] > 0.0 else float("inf")
