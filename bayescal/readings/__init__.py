"""Internal and external sensors as functions of the pose and of the machine's parameters."""

from bayescal.readings.base import Channel, ReadingModel, Readings
from bayescal.readings.sliding_platform import SlidingPlatform
from bayescal.readings.spatial import SpatialMachine

__all__ = ["Channel", "ReadingModel", "Readings", "SlidingPlatform", "SpatialMachine"]
