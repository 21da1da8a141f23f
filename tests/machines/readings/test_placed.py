"""Instruments beside any machine: one contract for all, against differences, an independent form, and each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import own_arm
import pytest
import sliding_platforms
from scipy.spatial.transform import Rotation

from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import Channel, FunctionModel, Instrument, ReadingMachine, place
from bayescal.machines.readings.placed import (
    DistanceConfig,
    DistanceInstrument,
    PointConfig,
    PointInstrument,
    PoseConfig,
    PoseInstrument,
)

ROOT = Path(__file__).parents[3]
FRAME = {"frame_mm": [900.0, -400.0, 250.0], "frame_deg": [10.0, -40.0, 115.0]}
TURNED = [30.0, -20.0, 45.0]


def read_legs(folder):
    (folder / "machine.toml").write_text(
        'kind = "legs"\nname = "m2"\nmechanism = "mechanism.toml"\nmodel = "six_ups"\ntool_mm = [10.0, -20.0, 60.0]\n'
    )
    text = (ROOT / "experiments" / "audit" / "m2_hexapod_mechanism.toml").read_text()
    (folder / "mechanism.toml").write_text(text)
    return read_reading_model(folder / "machine.toml")


class TurningArm(own_arm.Arm):
    """The arm with a tool that turns with its column and its forearm."""

    tool_channels = (*own_arm.Arm.tool_channels, *(Channel(f"r{a}", "rad", rotation="r") for a in "xyz"))

    def tool(self, parameters, v):
        from bayescal.numerics.analytic import rotation_matrix, rotation_vector

        def turn(angle, axis):
            return rotation_matrix(angle[..., None] * np.eye(3)[axis])

        here = rotation_vector(turn(v[..., 0], 2) @ turn(-v[..., 1] - v[..., 2], 1))
        return np.concatenate(np.broadcast_arrays(super().tool(parameters, v), here), axis=-1)

    def read(self, parameters, v, given):
        encoders = v - parameters["o"]
        return np.concatenate(np.broadcast_arrays(encoders, own_arm.Arm.tool(self, parameters, v)), axis=-1)


LEVEL = {
    "delta": lambda _: read_reading_model(ROOT / "examples" / "own_machine" / "machine.toml"),
    "hangprinter": lambda _: read_reading_model(ROOT / "experiments" / "hangprinter" / "machine.toml"),
    "three_rps": lambda _: read_reading_model(ROOT / "benchmarks" / "three_rps" / "solved.toml"),
    "arm": lambda _: FunctionModel("arm", own_arm.Arm(None)),
}
"""Machines that say where their tool is, and not how it is turned."""
TURNING = {
    "legs": read_legs,
    "struts": lambda _: read_reading_model(ROOT / "experiments" / "m2_hexapod_table" / "machine.toml"),
    "sliding platform": lambda _: sliding_platforms.sliding_star(),
    "turning arm": lambda _: FunctionModel("arm", TurningArm(None)),
}


def build_instruments(turned):
    """Return an instrument of each kind; those of machines without a rotation see the tool's centre."""
    target = {"target_mm": TURNED} if turned else {}
    found = {
        "station": PointInstrument(PointConfig(**FRAME, **target)),
        "bar": DistanceInstrument(DistanceConfig(anchor_mm=[500.0, 600.0, -100.0], zero_mm=3.0, **target)),
    }
    pose = PoseConfig(**FRAME, target_mm=TURNED, target_deg=[5.0, 6.0, 170.0])
    return found | ({"camera": PoseInstrument(pose)} if turned else {})


@pytest.fixture(params=[*LEVEL, *TURNING])
def placed(request, tmp_path):
    name = request.param
    machine = (LEVEL | TURNING)[name](tmp_path)
    return place(machine, build_instruments(name in TURNING))


def draw(model, rng, n=4):
    """Return parameters (n, D), poses (n, q) near home and what is given of them."""
    size = np.array([1e-2 if unit in ("mm", "rad") else 1e-3 for unit in model.layout.units])
    theta = model.layout.nominal + size * rng.standard_normal((n, model.layout.size))
    pose = model.home_pose + 0.02 * np.minimum(model.pose_scale, 100.0) * rng.uniform(
        -1.0, 1.0, (n, len(model.home_pose))
    )
    return theta, pose, {name: rng.uniform(10.0, 12.0, n) for name in model.given}


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
    if "camera[x]" in found:
        seen = np.stack([found[f"camera_r[{axis}]"] for axis in "xyz"], axis=-1)
        frame, target_r = (Rotation.from_rotvec(at[f"camera_{one}_r"]) for one in ("frame", "target"))
        apart = Rotation.from_rotvec(seen) * (frame.inv() * tool * target_r).inv()
        assert apart.magnitude().max() < 1e-12


def test_derivatives_are_those_of_differences(placed, rng):
    theta, pose, given = draw(placed, rng)
    found = placed.linearise(theta, pose, True, given)
    np.testing.assert_allclose(found.values, placed.read(theta, pose, given), rtol=0, atol=1e-10)
    alone = placed.linearise(theta, pose, False, given)
    np.testing.assert_allclose(alone.by_pose, found.by_pose, rtol=1e-9, atol=1e-12)
    seen = slice(len(placed.whole.channels), None)  # the machine's own have their tests
    for exact, at, where in ((found.by_pose, pose, 1), (found.by_parameters, theta, 0)):
        for k in range(at.shape[1]):
            step = 1e-5 * max(1.0, float(np.abs(at[:, k]).max())) * np.eye(at.shape[1])[k]
            above, below = (
                placed.read(*((theta, pose + one) if where else (theta + one, pose)), given)[:, seen]
                for one in (step, -step)
            )
            slope = (above - below) / (2.0 * step[k])
            np.testing.assert_allclose(exact[:, seen, k], slope, rtol=1e-6, atol=2e-6)


def test_picked_channels_read_the_same(placed, rng):
    """Once and again, with channels of all parts, of one, and without any of the machine's own."""
    theta, pose, given = draw(placed, rng)
    whole = placed.linearise(theta, pose, True, given)
    last = len(placed.channels) - 1
    own = len(placed.whole.channels)
    for some in ([0, 1, own, own + 2, last], [own + 1, last], list(range(own)), [1, own - 1, last]):
        once = placed.pick(np.array(some))
        for model, places in ((once, some), (once.pick(np.array([1])), some[1:2])):
            assert model.names == tuple(placed.names[k] for k in places)
            assert model.layout.names == placed.layout.names
            found = model.linearise(theta, pose, True, given)
            np.testing.assert_allclose(found.values, whole.values[:, places], rtol=0, atol=1e-12)
            np.testing.assert_allclose(found.by_pose, whole.by_pose[:, places], rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(found.by_parameters, whole.by_parameters[:, places], rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(model.read(theta, pose, given), found.values, rtol=0, atol=1e-10)


def test_batches_of_machines_and_poses(placed, rng):
    theta, pose, given = draw(placed, rng)
    found = placed.linearise(theta[:, None], pose[None, :3], True, {name: one[None, :3] for name, one in given.items()})
    n, q, size = len(placed.channels), pose.shape[1], theta.shape[1]
    assert found.values.shape == (4, 3, n)
    assert found.by_pose.shape == (4, 3, n, q)
    assert found.by_parameters.shape == (4, 3, n, size)
    again = placed.linearise(theta[2], pose[1], True, {name: one[1] for name, one in given.items()})
    np.testing.assert_allclose(found.by_parameters[2, 1], again.by_parameters, rtol=1e-9, atol=1e-12)


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


def test_an_actuator_that_deflects_others_still_does(tmp_path, rng):
    """The gain of a machine's model errors, with an instrument's beside it."""
    import telescope_machines

    from bayescal.machines.readings import Legs

    machine = Legs(telescope_machines.build_machine("matrix"), np.zeros(3))
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
        (own_arm.Arm, Tilted, "sees how the tool is turned, machine 'arm' gives no rotation; expected"),
        (own_arm.Arm, Rough, "expected an analytic function"),
        (Toolless, Clock, "sees where the tool is, machine 'arm' does not say it; expected tool_channels"),
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
    with pytest.raises(InputError, match="instruments: found 'tracker_x' twice, expected instruments of other names"):
        place(model, {"tracker": seen})
