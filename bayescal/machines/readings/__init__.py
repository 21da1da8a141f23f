"""Internal and external sensors as functions of the pose and of the machine's parameters."""

from bayescal.machines.readings.base import Channel, ReadingModel, Readings
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from bayescal.machines.readings.spatial import SpatialMachine

__all__ = ["Channel", "ReadingModel", "Readings", "SlidingPlatform", "SpatialMachine"]
