"""Frames of any instrument beside any machine are found from readings made with others, by its own channels."""

from __future__ import annotations

import numpy as np
import own_arm
import pytest
import studies

from bayescal import Channel, ParameterBlock
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.found_frames import find_frames
from bayescal.experiments.shared.readings.reading_tables import PoseReadings
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import FunctionModel, Instrument, Legs, PoseInstrument, place
from bayescal.machines.readings.camera import CameraInstrument
from bayescal.machines.readings.newton import touch
from bayescal.machines.readings.planes import PlaneInstrument
from bayescal.machines.readings.points import DistanceInstrument, PointInstrument

MECHANISM = studies.EXPERIMENTS / "audit" / "m2_hexapod_mechanism.toml"
NOWHERE = (float("nan"),) * 3


class Beam(Instrument):
    """Where the tool is seen by a camera that turns all it sees: a user-defined class whose frame nobody states."""

    def __init__(self, config=None):
        super().__init__(config)
        self.parameters = [ParameterBlock("r", NOWHERE, "rad")]
        self.channels = [Channel(f"[{axis}]", "mm") for axis in "uvw"]

    def see(self, parameters, position, rotation):
        from bayescal.numerics.analytic import rotation_matrix

        return (rotation_matrix(parameters["r"]) @ position[..., None])[..., 0]


def make_config(machine):
    """Return a study of which the machine's first symbol is free, within a hundredth of a millimetre or of a degree."""
    symbol = machine.layout.symbols[0]
    return StudyConfig.model_validate(
        {
            **{"kind": "study", "name": "found", "title": "found", "seed": 1, "machine": "machine.toml"},
            **{"provenance": {"status": "simulated", "text": "drawn"}, "data": [{"file": "readings.csv"}]},
            **{"sensors": {"seen": {"noise_mm": 0.02}}, "parameters": {symbol: {"prior": "normal", "sd": 0.01}}},
            "variants": [{"name": "all", "title": "all", "free": [symbol]}],
        }
    )


def build_arm():
    return FunctionModel("arm", own_arm.Arm(None)).pick(np.arange(3))


def build_legs():
    model = Legs(build_machine(SixUps, load_mechanism(MECHANISM), NoDeformation()))
    return model.pick(model.select(model.commanded))


def read(machine, instruments, true, rng, n=25):
    """Return readings of a machine and instruments, and their noise, 20 µm and 20 µrad."""
    placed = place(machine, {name: one.settle(true[name]) for name, one in instruments.items()})
    half = np.where(machine.pose_scale > 1.0, 20.0, 0.15)
    pose = machine.home_pose + half * rng.uniform(-1.0, 1.0, (n, len(machine.home_pose)))
    if placed.contacts:
        reads = np.ones((n, len(placed.channels)), dtype=bool)
        pose, touching = touch(placed, placed.layout.nominal, pose, reads, np.zeros(reads.shape), {})
        assert touching.all()
    exact = placed.read(placed.layout.nominal, pose)
    sd = np.where([one.unit == "mm" for one in placed.channels], 0.02, 2e-5) * np.ones_like(exact)
    values = exact + sd * rng.standard_normal(exact.shape)
    nothing = np.full_like(sd, np.nan), None, np.zeros(sd.shape, dtype=bool)
    names = tuple(f"P{k}" for k in range(n))
    return PoseReadings(names, np.zeros(n, dtype=bool), values, *nothing), sd


FRAME = np.array([1500.0, -800.0, 300.0]), np.array([0.4, -1.9, 1.1])
CASES = {
    "a tracked point": (
        build_arm,
        PointInstrument(PointInstrument.Config()),
        {"frame": FRAME[0], "frame_r": FRAME[1]},
    ),
    "its rotation alone": (
        build_arm,
        PointInstrument(PointInstrument.Config(frame_mm=FRAME[0].tolist())),
        {"frame_r": FRAME[1]},
    ),
    "a ball bar's anchor and zero": (
        build_arm,
        DistanceInstrument(DistanceInstrument.Config(zero_mm="found")),
        {"anchor": np.array([300.0, 350.0, -100.0]), "zero": np.array([41.0])},
    ),
    "a user-defined instrument": (build_arm, Beam(), {"r": FRAME[1]}),
    "a target far from the tool": (
        build_legs,
        PointInstrument(PointInstrument.Config(target_mm="found")),
        {"frame": FRAME[0], "frame_r": FRAME[1], "target": np.array([60.0, -45.0, 120.0])},
    ),
    "hand and eye": (
        build_legs,
        PoseInstrument(PoseInstrument.Config(target_mm="found", target_deg="found")),
        {"frame": FRAME[0], "frame_r": FRAME[1], "target": np.array([30.0, 9.0, 80.0]), "target_r": -FRAME[1]},
    ),
    **{
        f"a camera on the {mounted}": (
            build_legs,
            CameraInstrument(CameraInstrument.Config(mounted=mounted)),
            {"frame": FRAME[0], "frame_r": FRAME[1], "target": np.array([30.0, 9.0, 80.0]), "target_r": -FRAME[1]},
        )
        for mounted in ("base", "tool")
    },
    "a plane that a probe touches": (
        build_arm,
        PlaneInstrument(PlaneInstrument.Config(normal=[1.0, 0.0, 0.2])),
        {"tilt": np.array([0.6, -1.1]), "offset": np.array([250.0])},
    ),
    "a plane that a tip off the tool touches": (
        build_legs,
        PlaneInstrument(PlaneInstrument.Config(target_mm="found")),
        {"tilt": np.array([-1.1, 0.5]), "offset": np.array([-220.0]), "target": np.array([60.0, -45.0, 120.0])},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_nobody_states_is_found(case, rng):
    build, one, true = CASES[case]
    machine = build()
    readings, sd = read(machine, {"seen": one}, {"seen": true}, rng)
    n = len(machine.channels)
    readings.values[3::5, n:] = np.nan  # rows of another instrument, and one that was seen in part
    readings.values[1, -1] = np.nan
    config = make_config(machine)
    found = find_frames(config, machine, {"seen": one}, readings, sd, ())
    assert set(found.wide) == {f"seen_{symbol}" for symbol in true}
    (settled,) = found.instruments.values()
    placed = place(machine, found.instruments)
    truth = place(machine, {"seen": one.settle(true)})
    for block in settled.parameters:
        if block.symbol in true:  # as well as poses of a few centimetres and degrees tell it
            away = 30.0 if block.unit == "mm" else 0.02
            np.testing.assert_allclose(block.nominal, true[block.symbol], atol=away, err_msg=block.symbol)
    other, _ = read(machine, {"seen": one}, {"seen": true}, rng)
    pose, _ = machine.locate(machine.layout.nominal, other.values[:, : len(machine.channels)])
    own, seen = (one.read(one.layout.nominal, pose) for one in (placed, truth))
    np.testing.assert_allclose(own, seen, atol=1.0)  # initial values, from which all is fitted together
    freed = found.free(config)
    assert set(found.wide) <= set(freed.variants[0].free)
    assert all(freed.parameters[symbol].sd > 1.0 for symbol in found.wide)


class LongWay(Beam):
    """The same, whose proposal turns the other way round, further than half a turn."""

    def propose(self, stated, seen, position, rotation):
        size = np.linalg.norm(FRAME[1])
        return [{"r": FRAME[1] * (1.0 - 2.0 * np.pi / size)}]


class Yaw(Instrument):
    """A camera that is turned about z by an angle that nobody states, and looked for a turn further."""

    def __init__(self, config=None):
        super().__init__(config)
        self.parameters = [ParameterBlock("yaw", NOWHERE[:1], "rad", per_leg=False)]
        self.channels = [Channel(f"[{axis}]", "mm") for axis in "uvw"]

    def see(self, parameters, position, rotation):
        c, s = np.cos(parameters["yaw"]), np.sin(parameters["yaw"])
        x, y, z = position[..., 0], position[..., 1], position[..., 2]
        return np.stack(np.broadcast_arrays(c * x - s * y, s * x + c * y, z), axis=-1)

    def propose(self, stated, seen, position, rotation):
        return [{"yaw": np.array([0.7 + 2.0 * np.pi])}]


class Offsets(Yaw):
    """Three angles, each by itself, which are no rotation vector."""

    def __init__(self, config=None):
        super().__init__(config)
        self.parameters = [ParameterBlock("o", NOWHERE, "rad")]

    def see(self, parameters, position, rotation):
        return position + 100.0 * parameters["o"]

    def propose(self, stated, seen, position, rotation):
        return [{"o": np.array([2.5, 2.4, -2.3])}]


@pytest.mark.parametrize(
    ("one", "true"),
    [(LongWay(), {"r": FRAME[1]}), (Yaw(), {"yaw": np.array([0.7])}), (Offsets(), {"o": np.array([2.5, 2.4, -2.3])})],
    ids=["rotation vector", "angle", "three angles"],
)
def test_what_is_found_turns_by_half_a_turn_at_most(one, true, rng):
    machine = build_arm()
    readings, sd = read(machine, {"seen": one}, {"seen": true}, rng)
    (settled,) = find_frames(make_config(machine), machine, {"seen": one}, readings, sd, ()).instruments.values()
    (symbol,) = true
    (block,) = (own for own in settled.parameters if own.symbol == symbol)
    np.testing.assert_allclose(block.nominal, true[symbol], atol=0.02)


def test_what_own_channels_do_not_tell_has_to_be_stated(rng):
    machine = build_arm()
    one = PointInstrument(PointInstrument.Config())
    readings, sd = read(machine, {"seen": one}, {"seen": {"frame": FRAME[0], "frame_r": FRAME[1]}}, rng)
    readings.values[:, 0] = np.nan
    with pytest.raises(InputError, match="instruments: seen_frame: expected its value"):
        find_frames(make_config(machine), machine, {"seen": one}, readings, sd, ())
