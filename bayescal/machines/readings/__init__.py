"""Internal and external sensors as functions of the pose and of the machine's parameters."""

from bayescal.machines.readings.base import POSE, BoundReadings, Channel, Coordinate, Given, ReadingModel, Readings
from bayescal.machines.readings.function import FunctionModel, Parameters, ReadingMachine
from bayescal.machines.readings.instrument import Instrument
from bayescal.machines.readings.legs import Legs
from bayescal.machines.readings.placed import InstrumentedMachine, locate_tool, place
from bayescal.machines.readings.points import PoseInstrument
from bayescal.machines.readings.tracker import Tracker

MACHINES = {
    "arm": "bayescal.machines.readings.arm:Arm",
    "delta": "bayescal.machines.readings.delta:DeltaMachine",
    "five_bar": "bayescal.machines.readings.five_bar:FiveBar",
    "mount": "bayescal.machines.readings.mount:Mount",
    "rotary_delta": "bayescal.machines.readings.rotary_delta:RotaryDelta",
    "line_machine": "bayescal.machines.readings.line_machine:LineMachine",
    "sliding_platform": "bayescal.machines.readings.sliding_platform:SlidingPlatform",
    "strut_machine": "bayescal.machines.readings.strut_machine:StrutMachine",
}
"""Built-in machines of one function, by the ``kind`` of their files."""
INSTRUMENTS = {
    name: f"bayescal.machines.readings.points:{name.capitalize()}Instrument" for name in ("distance", "point", "pose")
} | {
    "camera": "bayescal.machines.readings.camera:CameraInstrument",
    "plane": "bayescal.machines.readings.planes:PlaneInstrument",
    "socket": "bayescal.machines.readings.sockets:SocketInstrument",
}
"""Built-in instruments beside a machine, by the ``kind`` of their sections."""

__all__ = [
    "INSTRUMENTS",
    "MACHINES",
    "POSE",
    "BoundReadings",
    "Channel",
    "Coordinate",
    "FunctionModel",
    "Given",
    "Instrument",
    "InstrumentedMachine",
    "Legs",
    "Parameters",
    "PoseInstrument",
    "ReadingMachine",
    "ReadingModel",
    "Readings",
    "Tracker",
    "locate_tool",
    "place",
]
