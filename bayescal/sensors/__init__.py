"""Sensors that may measure a machine."""

from bayescal.sensors.base import Sensor
from bayescal.sensors.points import PointSensor
from bayescal.sensors.pose import PoseSensor

__all__ = ["PointSensor", "PoseSensor", "Sensor"]
