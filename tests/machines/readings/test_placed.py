"""Instruments beside any machine, against an independent form; `test_machine_contract` has what every machine does."""

from __future__ import annotations

import machine_registry
import numpy as np
import own_arm
import pytest
from machine_registry import FRAME, build_instruments, draw
from scipy.spatial.transform import Rotation

from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, FunctionModel, Instrument, ReadingMachine, place
from bayescal.machines.readings.newton import share_contacts, touch
from bayescal.machines.readings.points import PointConfig, PointInstrument
from bayescal.machines.readings.sockets import SocketConfig, SocketInstrument

SEEN = {**machine_registry.LEVEL, **machine_registry.TURNING}


@pytest.fixture(params=SEEN)
def placed(request):
    name = request.param
    return place(machine_registry.MACHINES[name](), build_instruments(name in machine_registry.TURNING))


def test_readings_are_those_of_the_tool(placed, rng):
    """Every channel against scipy's rotations, from the tool that the machine itself states."""
    theta, pose, given = draw(placed, rng)
    found = dict(zip(placed.names, placed.read(theta, pose, given).T, strict=True))
    machine, n = placed.whole, placed.whole.layout.size
    numbers = machine.tool_values(theta[:, :n], pose)
    position = np.zeros((len(pose), 3))
    lengths = [k for k, one in enumerate(machine.tool_channels) if one.unit == "mm"]
    position[:, : len(lengths)] = numbers[:, lengths]
    turns = [k for k, one in enumerate(machine.tool_channels) if one.rotation]
    matrix = np.tile(np.eye(3), (len(pose), 1, 1))
    own = machine.rotation(pose)
    matrix[:, : own.shape[-1], : own.shape[-1]] = own
    tool = Rotation.from_rotvec(numbers[:, turns]) if turns else Rotation.from_matrix(matrix)
    at = {symbol: placed.layout.take(theta, symbol) for symbol in placed.layout.symbols}
    nothing = np.zeros((len(pose), 3))

    def target(name):
        return position + tool.apply(at.get(f"{name}_target", nothing))

    def look(name):
        return Rotation.from_rotvec(at[f"{name}_frame_r"]).inv().apply(target(name) - at[f"{name}_frame"])

    for name in {"station", "camera"} & {one.kind for one in placed.channels}:
        seen = np.stack([found[f"{name}[{axis}]"] for axis in "xyz"], axis=-1)
        np.testing.assert_allclose(seen, look(name), rtol=0, atol=1e-9)
    distance = np.linalg.norm(target("bar") - at["bar_anchor"], axis=1) - at["bar_zero"][:, 0]
    np.testing.assert_allclose(found["bar"], distance, rtol=0, atol=1e-9)
    tilted = Rotation.from_rotvec(at["bed_tilt"] @ placed.instruments[3].machine.across)
    height = (tilted.apply(placed.instruments[3].machine.normal) * target("bed")).sum(axis=1) - at["bed_offset"][:, 0]
    np.testing.assert_allclose(found["bed"], height, rtol=0, atol=1e-9)
    if "eye[x]" in found:  # the board's frame through the camera's, on the tool
        board, eye = (Rotation.from_rotvec(at[f"eye_{one}_r"]) for one in ("frame", "target"))
        seen = (tool * eye).inv().apply(at["eye_frame"] - target("eye")) / (1.0 + at["eye_scale"])
        np.testing.assert_allclose(
            np.stack([found[f"eye[{axis}]"] for axis in "xyz"], axis=-1), seen, rtol=0, atol=1e-9
        )
        turned = Rotation.from_rotvec(np.stack([found[f"eye_r[{axis}]"] for axis in "xyz"], axis=-1))
        assert (turned * ((tool * eye).inv() * board).inv()).magnitude().max() < 1e-12
    if "camera[x]" in found:
        seen = np.stack([found[f"camera_r[{axis}]"] for axis in "xyz"], axis=-1)
        frame, target_r = (Rotation.from_rotvec(at[f"camera_{one}_r"]) for one in ("frame", "target"))
        apart = Rotation.from_rotvec(seen) * (frame.inv() * tool * target_r).inv()
        assert apart.magnitude().max() < 1e-12


def test_the_machine_stays_what_it_is(placed, rng):
    """Its commands, its tool and what its channels read: instruments are for the calibration only."""
    theta, pose, given = draw(placed, rng)
    machine, n = placed.whole, placed.whole.layout.size
    assert placed.commanded == machine.commanded
    assert all(one.external for one in placed.channels[len(placed.whole.channels) :])
    own = machine.read(theta[:, :n], pose, given)
    np.testing.assert_array_equal(placed.read(theta, pose, given)[:, : own.shape[1]], own)
    position, by_pose, by_parameters = placed.tool(theta, pose)
    expected = machine.tool(theta[:, :n], pose)
    np.testing.assert_array_equal(position, expected[0])
    np.testing.assert_array_equal(by_pose, expected[1])
    np.testing.assert_array_equal(by_parameters[..., :n], expected[2])
    assert not by_parameters[..., n:].any()
    assert placed.seen_parameters(["bar"]) == placed.layout.names
    assert placed.seen_parameters(machine.names[:1]) == machine.seen_parameters(machine.names[:1])


def test_an_actuator_that_deflects_others_still_does():
    """The gain of a machine's model errors, with an instrument's beside it."""
    machine = machine_registry.MACHINES["coupled legs"]()
    placed = place(machine, build_instruments(turned=True))
    theta, pose = placed.layout.nominal[None], placed.home_pose[None]
    n, own = len(machine.channels), machine.error_gain(machine.layout.nominal[None], pose)
    gain = placed.error_gain(theta, pose)
    np.testing.assert_array_equal(gain[:, :n, :n], own)
    np.testing.assert_array_equal(gain[0, n:], np.eye(len(placed.channels))[n:])
    assert not gain[0, :n, n:].any()


class Clock(Instrument):
    """A dial gauge along z."""

    def __init__(self, config):
        super().__init__(config)
        self.parameters, self.channels = [ParameterBlock("zero", (0.0,), per_leg=False)], [Channel("dial", "mm")]

    def see(self, parameters, position, rotation):
        return (position[..., 2] - parameters["zero"])[..., None]


class Tilted(Clock):
    def see(self, parameters, position, rotation):
        return (rotation[..., 2, 0] - parameters["zero"])[..., None]


class Rough(Clock):
    def see(self, parameters, position, rotation):
        return (np.abs(position[..., 2] - 1.0) - parameters["zero"])[..., None]


class Toolless(own_arm.Arm):
    tool = ReadingMachine.tool
    tool_channels = ()

    def read(self, parameters, v, given):
        return np.concatenate(np.broadcast_arrays(v - parameters["o"], own_arm.Arm.tool(self, parameters, v)), axis=-1)


@pytest.mark.parametrize(
    ("machine", "instrument", "message"),
    [
        (own_arm.Arm, Tilted, "instruments.clock: machine 'arm': expected a rotation vector"),
        (own_arm.Arm, Rough, "expected an analytic function"),
        (Toolless, Clock, "instruments.clock: machine 'arm': expected tool_channels"),
    ],
)
def test_what_does_not_fit_is_refused(machine, instrument, message):
    model = FunctionModel("arm", machine(None))
    with pytest.raises(InputError, match=message) as caught:
        place(model, {"clock": instrument(None)})
    assert str(caught.value).startswith("instruments.clock: ")


def test_names_that_the_machine_has_are_refused():
    """The arm's own channel ``tracker_x`` would have the column of an instrument's ``tracker[x]``."""
    model, seen = FunctionModel("arm", own_arm.Arm(None)), PointInstrument(PointConfig(**FRAME))
    assert "station[x]" in place(model, {"station": seen}).names
    with pytest.raises(InputError, match="instruments: found 'tracker_x'"):
        place(model, {"tracker": seen})


def test_an_instrument_s_name_stands_for_its_channels():
    class Level(Instrument):
        parameters = (ParameterBlock("zero", (0.0,), per_leg=False),)
        channels = (Channel("pitch", "mm"), Channel("roll", "mm"))

        def see(self, parameters, position, rotation):
            return position[..., :2] - parameters["zero"][..., None]

    found = place(machine_registry.MACHINES["arm"](), {"level": Level(None)})
    assert [found.names[k] for k in found.select(["level"])] == ["level_pitch", "level_roll"]
    assert list(found.pick(found.select(["level_roll"])).select(["level"])) == [0]
    with pytest.raises(InputError, match="tilt"):
        found.select(["tilt"])


@pytest.mark.parametrize(("where", "touches"), [([500.0, 100.0, 300.0], True), ([1500.0, 0.0, 900.0], False)])
def test_a_tool_touches_what_is_within_its_reach(where, touches, rng):
    model = place(FunctionModel("arm", own_arm.Arm(None)), {"ball": SocketInstrument(SocketConfig(place_mm=where))})
    theta, start = model.layout.nominal, model.home_pose + 0.3 * rng.uniform(-1.0, 1.0, (30, 3))
    read = share_contacts(model, 30)
    error = 0.5 * rng.standard_normal(read.shape)
    pose, found = touch(model, theta, start, read, error, {})
    assert found.any() == touches
    places = model.instrument_places["ball"]
    np.testing.assert_allclose((model.read(theta, pose[found]) + error[found])[:, places], 0.0, atol=1e-6)


def test_a_tool_of_a_plane_touches_nothing_beside_it(rng):
    """Where it comes nearest is no contact."""
    machine = machine_registry.MACHINES["lines in a plane"]()
    x, y = (*machine.tool_values(machine.layout.nominal, machine.home_pose), 0.0)[:2]
    for z, touches in ((0.0, True), (5.0, False)):
        model = place(machine, {"ball": SocketInstrument(SocketConfig(place_mm=[x + 30.0, y - 20.0, z]))})
        start = model.home_pose + rng.uniform(-50.0, 50.0, (5, 2))
        read = share_contacts(model, 5)
        found = touch(model, model.layout.nominal, start, read, np.zeros(read.shape), {})[1]
        assert (found == touches).all()
