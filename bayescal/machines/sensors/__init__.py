"""Sensors that may measure a machine."""

from bayescal.machines.sensors.base import Sensor
from bayescal.machines.sensors.points import PointSensor
from bayescal.machines.sensors.pose import PoseSensor

SENSORS = {"pose": PoseSensor, "targets": PointSensor}
"""Built-in sensors, by the ``kind`` of their sections."""

__all__ = ["SENSORS", "PointSensor", "PoseSensor", "Sensor"]
