"""Every machine that sensors see, and an instrument of each kind beside it: what contracts run over."""

from __future__ import annotations

from functools import cache

import numpy as np
import own_arm
import studies
from deltas import build_delta, build_five_bar, build_rotary_delta
from function_machines import point_on_lines
from serial_arms import build_arm
from sliding_platforms import build, make_content, sliding_star, star_of

from bayescal.machines.deformations import DEFORMATIONS, NominalDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models import MODELS
from bayescal.machines.read import load_mechanism, read_reading_model
from bayescal.machines.readings import Channel, FunctionModel, Legs, ReadingModel
from bayescal.machines.readings.camera import CameraConfig, CameraInstrument
from bayescal.machines.readings.line_machine import LineMachine, LineMachineConfig
from bayescal.machines.readings.mount import Mount, MountConfig
from bayescal.machines.readings.places import TwoPlaces
from bayescal.machines.readings.planes import PlaneConfig, PlaneInstrument
from bayescal.machines.readings.points import (
    DistanceConfig,
    DistanceInstrument,
    PointConfig,
    PointInstrument,
    PoseConfig,
    PoseInstrument,
)
from bayescal.machines.readings.sockets import SocketConfig, SocketInstrument
from bayescal.numerics.analytic import rotation_matrix, rotation_vector

LEGS = {
    "struts": ("audit/m2_hexapod_mechanism.toml", "six_ups", "none"),
    "base": ("telescope/mechanism.toml", "six_pus", "none"),
    "deformed": ("telescope/mechanism.toml", "six_pus", "linear"),
    "coupled": ("telescope/mechanism.toml", "six_pus", "matrix"),
}
MATRIX = np.array([[0.0, 3.0, -8.0, 12.0, -2.0, -20.0]] * 6) * 1e-3


def build_legs(name: str) -> Legs:
    """Return legs with encoders and inclinometers."""
    path, model, deformation = LEGS[name]
    mechanism = load_mechanism(studies.EXPERIMENTS / path)
    deformed = DEFORMATIONS[deformation].from_nominal(NominalDeformation(0.011, lambda: MATRIX))
    return Legs(build_machine(MODELS[model], mechanism, deformed), np.array([10.0, -20.0, 30.0]), inclined=True)


def read(path: str) -> ReadingModel:
    """Return the machine of a shipped file."""
    return read_reading_model(studies.EXPERIMENTS.parent / path)


class TurningArm(own_arm.Arm):
    """The arm with a tool that turns with its column and its forearm."""

    tool_channels = (*own_arm.Arm.tool_channels, *(Channel(f"r{a}", "rad", rotation="r") for a in "xyz"))

    def tool(self, parameters, v):
        def turn(angle, axis):
            return rotation_matrix(angle[..., None] * np.eye(3)[axis])

        here = rotation_vector(turn(v[..., 0], 2) @ turn(-v[..., 1] - v[..., 2], 1))
        return np.concatenate(np.broadcast_arrays(super().tool(parameters, v), here), axis=-1)

    def read(self, parameters, v, given):
        encoders = v - parameters["o"]
        return np.concatenate(np.broadcast_arrays(encoders, own_arm.Arm.tool(self, parameters, v)), axis=-1)


SLED = {
    "gear": 291.0,
    "spool_buildup_mm": 0.02,
    "workspace_half_width_mm": [1000.0, 500.0],
    "lines": [{"anchor_mm": [x, 1100.0, 12.0], "spool_radius_mm": 10.1} for x in (-1500.0, 1500.0)],
}
"""A router on two chains in front of a sheet."""
LEVEL = {
    "delta": lambda: read("examples/own_machine/machine.toml"),
    "delta printer at two places": lambda: read("experiments/flsun_v400/machine.toml"),
    "rotary delta": lambda: FunctionModel("rotary", build_rotary_delta()),
    "five-bar": lambda: FunctionModel("five_bar", build_five_bar()),
    "towers apart": lambda: FunctionModel("towers", build_delta()),
    "hangprinter": lambda: read("experiments/hangprinter/machine.toml"),
    "lines in a plane": lambda: FunctionModel("sled", LineMachine(LineMachineConfig(**SLED))),
    "three_rps": lambda: read("benchmarks/three_rps/solved.toml"),
    "arm": lambda: FunctionModel("arm", own_arm.Arm(None)),
}
"""Machines that say where their tool is, and not how it is turned."""
TURNING = {
    "legs": lambda: build_legs("struts"),
    "coupled legs": lambda: build_legs("coupled"),
    "coupled legs with gains": lambda: build_legs("coupled").with_optional(["gain"]),
    "m2 struts": lambda: read("experiments/m2_hexapod_table/machine.toml"),
    "sliding platform": sliding_star,
    "arm of rows": lambda: read("experiments/ur10/machine.toml"),
    "arm of a URDF file": lambda: read("experiments/panda_socket/machine.toml"),
    "arm that slides and sags": lambda: FunctionModel("small", build_arm()),
    "turning arm": lambda: FunctionModel("arm", TurningArm(None)),
    "turning arm at two places": lambda: FunctionModel("arm", TwoPlaces(TurningArm(None))),
}
ALONE = {
    "base legs": lambda: build_legs("base"),
    "deformed legs": lambda: build_legs("deformed"),
    "lines": lambda: point_on_lines(4, bearing=True),
    "mount": lambda: read("experiments/mmt_mount/machine.toml"),
    "equatorial mount": lambda: FunctionModel("mount", Mount(MountConfig(axes="equatorial", latitude_deg=31.7))),
    "three slides": lambda: star_of(3),
    "slides against their guides": lambda: build(make_content(5, "against", 10.0)),
}
MACHINES = {name: cache(build) for name, build in (LEVEL | TURNING | ALONE).items()}
CASES = [*MACHINES, *(f"{name}, seen" for name in (LEVEL | TURNING))]

FRAME = {"frame_mm": [900.0, -400.0, 250.0], "frame_deg": [10.0, -40.0, 115.0]}
TURNED = [30.0, -20.0, 45.0]


def build_instruments(turned: bool) -> dict:
    """Return an instrument of each kind; those of machines without a rotation see the tool's centre."""
    target = {"target_mm": TURNED} if turned else {}
    found = {
        "station": PointInstrument(PointConfig(**FRAME, **target)),
        "bar": DistanceInstrument(DistanceConfig(anchor_mm=[500.0, 600.0, -100.0], zero_mm=3.0, **target)),
        "socket": SocketInstrument(SocketConfig(place_mm=[300.0, -200.0, 100.0], **target)),
        "bed": PlaneInstrument(PlaneConfig(normal=[0.2, -0.1, 1.0], tilt_deg=[20.0, -70.0], offset_mm=40.0, **target)),
    }
    pose = PoseConfig(**FRAME, target_mm=TURNED, target_deg=[5.0, 6.0, 170.0])
    eye = CameraConfig(mounted="tool", **FRAME, target_mm=TURNED, target_deg=[5.0, 6.0, 170.0])
    return found | ({"camera": PoseInstrument(pose), "eye": CameraInstrument(eye)} if turned else {})


def sizes_of(model: ReadingModel) -> np.ndarray:
    """Return by what parameters are off their nominal values, (D,), in their units."""
    return np.array([{"mm": 0.1, "rad": 1e-2}.get(unit, 1e-3) for unit in model.layout.units])


def draw(model: ReadingModel, rng: np.random.Generator, n: int = 4, size: float = 1.0):
    """Return parameters (n, D) off nominal, poses (n, q) near home and what is given of them (n,)."""
    theta = model.layout.nominal + size * sizes_of(model) * rng.standard_normal((n, model.layout.size))
    moves = 0.2 * np.minimum(model.pose_scale, 100.0) * rng.uniform(-1.0, 1.0, (n, len(model.home_pose)))
    return theta, model.home_pose + moves, {name: rng.uniform(10.0, 12.0, n) for name in model.given}
