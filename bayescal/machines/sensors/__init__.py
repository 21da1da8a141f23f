"""Sensors that may measure a machine."""

from bayescal.machines.sensors.base import Sensor
from bayescal.machines.sensors.points import PointSensor
from bayescal.machines.sensors.pose import PoseSensor

__all__ = ["PointSensor", "PoseSensor", "Sensor"]
