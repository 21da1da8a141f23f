"""Families of machines by instruments: machines drawn from priors are simulated, calibrated, and found where they are.

A family's machines take the instruments that make sense of it in turn; frames, and where a plane lies, nobody states.
Parameters of one machine err together, so machines count: whatever the correlation, the share of a machine's
parameters inside their 90 % intervals has the mean 0.9, and the spread over machines tells the error of the mean. So has
z², z the truth's distance from the posterior's mean in its standard deviations, the mean one: truths are of the prior.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import own_arm
import pytest
import studies
from machine_registry import SLED
from scipy.stats import norm, t
from serial_arms import SMALL

import bayescal as bc
from bayescal.calibrated.one_place import take_one_place
from bayescal.calibrated.predict import predict_poses
from bayescal.config.load import read_toml
from bayescal.experiments.shared.readings.workspace import Workspace, draw_standing
from bayescal.files.memory import MemoryPath
from bayescal.files.toml import write_toml
from bayescal.machine_files import MachineFiles
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import InstrumentedMachine, ReadingMachine
from bayescal.numerics.geometry import matrix_from_rotation_vector

N_MACHINES, N_PLACES = 40, 6
OFF = 3.0  # standard errors by which a mean over machines may be off, of many; of fewer as much of Student's t
INSIDE = norm.ppf(0.95)
TARGET = [30.0, -20.0, 45.0]  # mm, on tools that turn

type Sections = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Family:
    """A machine, the noise of its own channels, tolerances, and the instruments that make sense of it.

    ``own`` is the noise of its external channels, ``sections`` what simulation and study need to be said besides;
    ``inner`` is the part of the workspace in which sockets and planes are.
    """

    machine: str | dict[str, Any] | ReadingMachine
    noise: Mapping[str, float]
    tolerances: Mapping[str, float]
    instruments: tuple[str, ...]
    own: Mapping[str, float] = field(default_factory=dict)
    rows: int = 12
    sections: Mapping[str, Any] = field(default_factory=dict)
    study: Mapping[str, Any] = field(default_factory=dict)
    inner: float = 0.6

    def load(self, places: int) -> MachineFiles:
        """Return the machine, at one place or at two in a row of the data."""
        if isinstance(self.machine, ReadingMachine):
            return bc.load_machine(self.machine)
        path = studies.EXPERIMENTS.parent / self.machine if isinstance(self.machine, str) else None
        content = dict(self.machine) if path is None else read_toml(path)[0]
        content |= {"name": "machine", "title": "Machine", "places": places}
        beside = {one.name: one.read_bytes() for one in path.parent.glob("*.urdf")} if path else {}
        mechanism = studies.EXPERIMENTS / "audit" / "m2_hexapod_mechanism.toml"
        files = {"small.urdf": SMALL.encode(), "m2.toml": mechanism.read_bytes(), **beside}
        if places == 1:
            del content["places"]
        files["machine.toml"] = write_toml(content).encode()
        return MachineFiles(files, "machine.toml", read_reading_model(MemoryPath("machine.toml", files=files)))

    def draw_tool(self, machine: MachineFiles, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return where the nominal tool's target is at n poses, (n, 3), mm, and whether the tool is turned."""
        model = machine.model
        bare = InstrumentedMachine(model, ())
        half = self.inner * np.array([one.reach for one in model.coordinates])
        space = Workspace(model.home_pose - half, model.home_pose + half, model.pose_scale)
        given = {name: np.full(n, 20.0) for name in model.given}
        pose, _ = draw_standing(model, space, model.layout.nominal, given, n, rng)
        tool = bare.place_tool(model.layout.nominal, pose)
        turned = matrix_from_rotation_vector(tool[:, 3:])
        return tool[:, :3] + bare.tells_rotation * turned @ np.array(TARGET), bare.tells_rotation


# --- instruments -----------------------------------------------------------------------------------------------------


def aim(name: str, tool: np.ndarray, turned: bool, rng: np.random.Generator) -> tuple[Sections, Sections, Sections]:
    """Return instruments as they are, as a study knows them, and their noise; tools are at places (n, 3), mm."""
    target: dict[str, Any] = {"target_mm": TARGET} if turned else {}
    away = (tool.mean(axis=0) + 500.0 * rng.standard_normal(3)).tolist()
    frame = {"frame_mm": away, "frame_deg": (40.0 * rng.standard_normal(3)).tolist()}
    on_tool, unknown = {"target_mm": TARGET, "target_deg": [5.0, 6.0, 70.0]}, {"target_mm": "found", "target_deg": "found"}
    eyes = {"eye to hand": "base", "eye in hand": "tool"}
    if name == "point":
        there, known, noise = target | frame, target, {"it": 0.02}
    elif name == "distance":
        there, known, noise = target | {"anchor_mm": away}, target, {"it": 0.01}
    elif name == "plane":
        # through a place of the tool, its axis as the study has it
        tilt = np.radians(5.0 * rng.standard_normal(2))
        normal = matrix_from_rotation_vector(np.append(tilt, 0.0)) @ [0.0, 0.0, 1.0]
        there = target | {"tilt_deg": np.degrees(tilt).tolist(), "offset_mm": float(normal @ tool[0])}
        known, noise = target, {"it": 0.01}
    elif name == "pose" or name in eyes:
        known = {"kind": "camera", "mounted": eyes[name]} if name in eyes else {"kind": "pose", **unknown}
        there, noise = frame | on_tool, {"it[x]": 0.02, "it[y]": 0.02, "it[z]": 0.02, "it_r": 1e-4}
        return {"it": known | there}, {"it": known}, noise
    elif name == "sockets":
        known = {f"s{k}": {"kind": "socket", "place_mm": one, **target} for k, one in enumerate(tool.tolist())}
        return known, known, dict.fromkeys(known, 0.02)
    else:
        return {}, {}, {"distance": 0.01} if name == "places" else {}
    return {"it": {"kind": name, **there}}, {"it": {"kind": name, **known}}, noise


# --- families --------------------------------------------------------------------------------------------------------


DELTA = {
    "kind": "delta",
    "machine": dict(radius_mm=160.0, arm_mm=345.0, endstop_mm=415.0, workspace_radius_mm=140.0, workspace_height_mm=40.0),
}
M2 = {"kind": "legs", "mechanism": "m2.toml", "model": "six_ups"}
LEVEL = ("own", "point", "distance", "plane", "sockets", "places")
TURNING = ("point", "pose", "eye to hand", "eye in hand", "distance", "plane", "sockets")
EVERY_WEATHER = {"conditions": {"elevation_deg": [0.0, 90.0], "temperature_c": [-5.0, 25.0]}}
STAR = {"workspace": {"x": [-200.0, 200.0], "y": [-200.0, 200.0], "phi": [-30.0, 30.0]}}
FAMILIES = {
    "delta": Family(DELTA, {"s": 0.005}, {"r": 0.3, "l": 0.3, "e": 0.3}, LEVEL, {"height": 0.01}),
    "rotary_delta": Family(
        "examples/machines/rotary_delta.toml", {"q": 5e-5}, {"L": 0.3, "l": 0.3, "o": 0.1}, LEVEL, {"height": 0.01}
    ),
    "five_bar": Family(
        "examples/machines/five_bar.toml", {"q": 5e-5}, {"L": 0.3, "l": 0.3, "o": 0.1}, ("point", "distance", "places")
    ),
    "line_machine": Family(
        "experiments/hangprinter/machine.toml",
        {"motor": 2e-3},
        {"A_x": 2.0, "A_y": 2.0, "R": 0.1},
        LEVEL,
        dict.fromkeys("xyz", 0.1),
    ),
    "line_machine in a plane": Family(
        {"kind": "line_machine", "machine": SLED},
        {"motor": 2e-3},
        {"A_x": 1.0, "A_y": 1.0},
        ("own", "point", "distance", "places"),
        dict.fromkeys("xy", 0.1),
    ),
    "arm of a URDF file": Family(
        {"kind": "arm", "machine": {"urdf": "small.urdf"}},
        {"joint[1]": 5e-5, "joint[2]": 0.02, "joint[3]": 5e-5},
        {"offset": 0.2},
        TURNING[:-1],
    ),
    "arm of rows": Family(
        "experiments/ur10/machine.toml", {"joint": 5e-5}, {"offset": 0.2}, TURNING, rows=20, inner=0.3
    ),
    "sliding_platform": Family(
        "experiments/sliding_star/machine.toml",
        {"s": 0.005},
        {"l": 0.3},
        ("own", "point", "pose", "eye to hand", "eye in hand", "distance"),
        {"phi": 1e-4},
        sections=STAR,
    ),
    "mount": Family(
        {"kind": "mount", "machine": {"axes": "altazimuth"}},
        {"encoder": 5e-6},
        dict.fromkeys(("IA", "IE", "AN", "AW", "CA"), 0.02),
        ("own",),
        {"azimuth": 5e-6, "elevation": 5e-6},
    ),
    "equatorial mount": Family(
        {"kind": "mount", "machine": {"axes": "equatorial", "latitude_deg": 31.7}},
        {"encoder": 5e-6},
        dict.fromkeys(("IH", "ID", "ME", "MA", "CH"), 0.02),
        ("own",),
        {"hour_angle": 5e-6, "declination": 5e-6},
    ),
    "strut_machine": Family(
        "experiments/m2_hexapod_table/machine.toml", {"q": 0.001}, {"l": 0.5, "c": 3.0}, TURNING, sections=EVERY_WEATHER
    ),
    "legs": Family(M2, {"rho": 0.002}, {"l": 0.1}, TURNING, inner=0.2),
    "own class": Family(
        own_arm.Arm(None),
        {"encoder": 5e-5},
        {"h": 0.3, "o": 0.1, "a": 0.3},
        LEVEL[:-1],
        {f"tracker_{axis}": 0.02 for axis in "xyz"},
    ),
}


# --- recovery --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recovered:
    """Scores z of the parameters of a machine, which lie within 90 % intervals, and z of its tool's numbers."""

    instrument: str
    z: np.ndarray
    inside: np.ndarray
    tool: np.ndarray
    efficiency: float


def recover(name: str, k: int, instrument: str = "") -> Recovered:
    """Return how a family's k-th machine is recovered."""
    family = FAMILIES[name]
    instrument = instrument or family.instruments[k % len(family.instruments)]
    rng = np.random.default_rng([k, zlib.crc32(name.encode())])
    machine = family.load(2 if instrument == "places" else 1)
    aimed = family.load(1)
    there, known, noise = {}, {}, {}
    if instrument not in ("own", "places"):
        there, known, noise = aim(instrument, *family.draw_tool(aimed, 5, rng), rng)
    else:
        noise = {"distance": 0.01} if instrument == "places" else family.own
    noise = {**family.noise, **noise}
    data = bc.simulate(
        machine, noise, family.tolerances, family.rows, seed=k + 1, instruments=there, **family.sections
    )
    sections = {key: one for key, one in family.sections.items() if key != "conditions"}
    study = bc.calibrate(
        *(machine, data, family.tolerances),
        **{"effort": "quick", "quiet": True, "seed": k + 1, "instruments": known, "model_error": {"terms": []}},
        **sections,
    )
    true = data.truth.set_index("parameter")["true"]
    draws = study.best.posterior["posterior"].to_dataset()
    return study, true, draws, data
