"""Sensors that say how much a reading tells of a pose, beside any machine: six channels of an instrument, or fewer.

Their noise is the inverse of that information, pose by pose. A coordinate that a sensor does not see is no channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.shared.design import build_sensor
from bayescal.machines.readings import PoseInstrument, ReadingModel
from bayescal.machines.sensors import Sensor
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, matrix_from_rotation_vector

NOWHERE = [0.0, 0.0, 0.0]
ON_TOOL = PoseInstrument.Config(frame_mm=NOWHERE, frame_deg=NOWHERE, target_mm=NOWHERE)
"""An instrument that sees poses of the tool in the base frame, its own frames at zero."""
BLIND = 1e-12  # of the largest eigenvalue of a pose's information, below which it does not determine its coordinates


@dataclass(frozen=True, eq=False)
class PlannedPoseSensor:
    """A sensor of poses and its channels."""

    name: str
    sensor: Sensor
    channels: tuple[str, ...]  # those of its six that it sees, by their names
    seen: np.ndarray  # (6,), bool: which of position and rotation vector these are

    def find_noise(self, pose: Array, names: Sequence[str]) -> Array:
        """Return covariances (P, k, k) of its channels at poses (P, 6) of the tool, mm and rad, by the poses' names."""
        information = self.sensor.information(pose[:, :3], matrix_from_rotation_vector(pose[:, 3:]))
        information = information[:, self.seen][:, :, self.seen]
        scale = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), np.finfo(float).tiny))
        values = np.linalg.eigvalsh(information / scale[:, :, None] / scale[:, None, :])  # mm and rad made comparable
        for k in np.flatnonzero(values[:, 0] < BLIND * values[:, -1])[:1]:
            raise InputError(
                f"sensors.{self.name}: found information that does not determine "
                f"{', '.join(self.channels)} at pose {names[k]!r}, expected whole coordinates, or "
                "[instruments]"
            )
        return np.asarray(np.linalg.inv(information))


def read_pose_sensors(config: AuditConfig, folder: Path) -> dict[str, Sensor]:
    """Return the sensors of a config that have a kind, by name."""
    _, sections = config.split_sensors()
    return {name: build_sensor(name, one, folder) for name, one in sections.items()}


def find_channels(sensors: Mapping[str, Sensor], model: ReadingModel) -> dict[str, PlannedPoseSensor]:
    """Return sensors with their channels of a machine before which their instruments are placed."""
    found = {}
    for name, sensor in sensors.items():
        places = model.select([name, f"{name}_r"])
        home = model.read(model.layout.nominal, model.home_pose[None], {one: np.ones(1) for one in model.given})
        tool = home[:, places]
        information = sensor.information(tool[:, :3], matrix_from_rotation_vector(tool[:, 3:]))
        seen = np.diagonal(information[0]) > 0.0
        if not seen.any():
            raise InputError(f"sensors.{name}: found no information on coordinates")
        assert len(places) == DEGREES_OF_FREEDOM
        found[name] = PlannedPoseSensor(name, sensor, tuple(model.names[k] for k in places[seen]), seen)
    return found
