"""Internal and external sensors as functions of the pose and of the machine's parameters."""

from bayescal.machines.readings.base import Channel, Coordinate, Given, ReadingModel, Readings
from bayescal.machines.readings.function import FunctionModel, Parameters, ReadingMachine
from bayescal.machines.readings.legs import LegsModel
from bayescal.machines.readings.sliding_platform import SlidingPlatform
from bayescal.machines.readings.spatial import SpatialMachine

MACHINES = {
    "line_machine": "bayescal.machines.readings.line_machine:LineMachine",
    "strut_machine": "bayescal.machines.readings.strut_machine:StrutMachine",
}
"""Built-in machines of one function, by the ``kind`` of their files."""

__all__ = [
    "MACHINES",
    "Channel",
    "Coordinate",
    "FunctionModel",
    "Given",
    "LegsModel",
    "Parameters",
    "ReadingMachine",
    "ReadingModel",
    "Readings",
    "SlidingPlatform",
    "SpatialMachine",
]
