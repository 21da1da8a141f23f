"""Families of machines by instruments: machines drawn from priors are simulated, calibrated, and found where they are.

A family's machines take the instruments that make sense of it in turn; frames, and where a plane lies, nobody states.
Parameters of one machine err together, so machines count: whatever the correlation, the share of a machine's
parameters inside their 90 % intervals has the mean 0.9, and the spread over machines tells the error of the mean.
Likewise z², z the truth's distance from the posterior's mean in its standard deviations, has the mean one.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import own_arm
import pandas as pd
import pytest
import studies
from machine_registry import SLED
from scipy.stats import norm, t
from serial_arms import SMALL

import bayescal as bc
from bayescal.calibrated.one_place import take_one_place
from bayescal.calibrated.predict import predict_poses
from bayescal.config.load import read_toml
from bayescal.density.calibration.measurements import Comparison
from bayescal.experiments.shared.readings.instruments import read_instruments
from bayescal.experiments.shared.readings.schema import InstrumentConfig
from bayescal.experiments.shared.readings.workspace import build_workspace, draw_standing
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.files.memory import MemoryPath
from bayescal.files.toml import write_toml
from bayescal.limits import COVERAGE
from bayescal.machine_files import MachineFiles
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import InstrumentedMachine, ReadingMachine, ReadingModel, place
from bayescal.numerics.geometry import matrix_from_rotation_vector

N_MACHINES, N_PLACES, N_SOCKETS = 40, 6, 5
EYES = {"eye to hand": "base", "eye in hand": "tool"}
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
    planar: bool = False

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

    def draw_places(
        self, model: ReadingModel, theta: np.ndarray, n: int, rng: np.random.Generator
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return n poses within reach of a machine (D,), and what has to be known there."""
        space = build_workspace(model, self.sections.get("workspace", {}), UnitsConfig()).widen(self.inner)
        given = {name: np.full(n, 20.0) for name in model.given}  # °C and degrees
        return draw_standing(model, space, theta, given, n, rng, in_range=True)[0], given


# --- instruments -----------------------------------------------------------------------------------------------------


def aim(
    name: str, family: Family, model: ReadingModel, rng: np.random.Generator
) -> tuple[Sections, Sections, Mapping[str, float]]:
    """Return instruments as they are, as a study knows them, and the noise of what is read beside the machine."""
    if name in ("own", "places"):
        return {}, {}, {"distance": 0.01} if name == "places" else family.own
    bare = InstrumentedMachine(model, ())
    target: dict[str, Any] = {"target_mm": TARGET} if bare.tells_rotation else {}
    pose, _ = family.draw_places(model, model.layout.nominal, N_SOCKETS, rng)
    tool = bare.place_tool(model.layout.nominal, pose)
    seen = tool[:, :3] + matrix_from_rotation_vector(tool[:, 3:]) @ target.get("target_mm", np.zeros(3))
    away = (seen.mean(axis=0) + 500.0 * rng.standard_normal(3)).tolist()
    frame = {"frame_mm": away, "frame_deg": (40.0 * rng.standard_normal(3)).tolist()}
    if name == "sockets":
        sockets = {f"s{k}": {"kind": "socket", "place_mm": one, **target} for k, one in enumerate(seen.tolist())}
        return sockets, sockets, dict.fromkeys(sockets, 0.02)
    if name == "point":
        there, known, noise = frame, {"kind": name, **target}, {"it": 0.02}
    elif name == "distance":
        there, known, noise = {"anchor_mm": away}, {"kind": name, **target}, {"it": 0.01}
        if family.planar:  # readings do not tell on which side of the plane
            known |= there
    elif name == "plane":  # through a place of the tool
        tilt = np.append(np.radians(5.0 * rng.standard_normal(2)), 0.0)
        offset = float(matrix_from_rotation_vector(tilt)[:, 2] @ seen[0])
        there, known, noise = (
            {"tilt_deg": np.degrees(tilt[:2]).tolist(), "offset_mm": offset},
            {"kind": name, **target},
            {"it": 0.01},
        )
    else:
        there = {**frame, "target_mm": TARGET, "target_deg": [5.0, 6.0, 70.0]}
        found = {"target_mm": "found", "target_deg": "found"}
        known = {"kind": "camera", "mounted": EYES[name]} if name in EYES else {"kind": name, **found}
        noise = {**{f"it[{axis}]": 0.02 for axis in "xyz"}, "it_r": 1e-4}
    return {"it": known | there}, {"it": known}, noise


# --- families --------------------------------------------------------------------------------------------------------


DELTA = {
    "kind": "delta",
    "machine": {
        **{"radius_mm": 160.0, "arm_mm": 345.0, "endstop_mm": 415.0},
        **{"workspace_radius_mm": 140.0, "workspace_height_mm": 40.0},
    },
}
M2 = {"kind": "legs", "mechanism": "m2.toml", "model": "six_ups"}
LEVEL = ("own", "point", "distance", "plane", "sockets", "places")
TURNING = ("point", "pose", "eye to hand", "eye in hand", "distance", "plane", "sockets")
EVERY_WEATHER = {"conditions": {"elevation_deg": [0.0, 90.0], "temperature_c": [-5.0, 25.0]}}
STAR = {"workspace": {"x": [-50.0, 250.0], "y": [-150.0, 150.0], "phi": [120.0, 150.0]}}
FAMILIES = {
    "delta": Family(DELTA, {"s": 0.005}, {"r": 0.3, "l": 0.3, "e": 0.3}, LEVEL, {"height": 0.01}),
    "rotary_delta": Family(
        "examples/machines/rotary_delta.toml", {"q": 5e-5}, {"L": 0.3, "l": 0.3, "o": 0.1}, LEVEL, {"height": 0.01}
    ),
    "five_bar": Family(
        "examples/machines/five_bar.toml",
        {"q": 5e-5},
        {"L": 0.3, "l": 0.3, "o": 0.1},
        ("point", "distance", "places"),
        planar=True,
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
        planar=True,
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
        planar=True,
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


@dataclass(frozen=True, eq=False)
class Recovered:
    """How a calibration of a machine by an instrument fares against the truth.

    Scores z and which lie inside 90 % intervals, of parameters (n,) and of the tool's numbers at new places; how many
    solutions there are.
    """

    instrument: str
    z: np.ndarray
    inside: np.ndarray
    tool: np.ndarray
    pareto_k: float
    solutions: int


def recover(name: str, k: int, instrument: str = "", seed: int | None = None) -> Recovered:
    """Return how a family's k-th machine is recovered, by default by the instrument whose turn it is.

    Families have seeds of their own: of one and the same, their truths would lie alike in their priors.
    """
    family = FAMILIES[name]
    instrument = instrument or family.instruments[k % len(family.instruments)]
    rng = np.random.default_rng([k, zlib.crc32(name.encode())])
    seed = (zlib.crc32(name.encode()) + k) % 10**9 if seed is None else seed
    machine, places = family.load(1), 2 if instrument == "places" else 1
    there, known, noise = aim(instrument, family, machine.model, rng)
    tolerances = dict(family.tolerances)
    if instrument in EYES:
        tolerances["it_scale"] = 0.002
    if instrument == "distance" and family.planar:
        tolerances["it_anchor"] = 1.0
    data = bc.simulate(
        *(family.load(places), {**family.noise, **noise}, tolerances, family.rows),
        **{"seed": seed, "instruments": there, **family.sections},
    )
    study = bc.calibrate(
        *(family.load(places), data, tolerances),
        **{"seed": seed, "effort": "quick", "quiet": True, "instruments": known, "model_error": {"terms": []}},
        **{key: one for key, one in family.sections.items() if key != "conditions"},
    )
    sections = {key: InstrumentConfig.model_validate(one) for key, one in there.items()}
    layout = place(machine.model, read_instruments(sections, Path())).layout
    true = pd.Series(layout.nominal, layout.names)
    true.update(data.truth.set_index("parameter")["true"])
    found = study.best.posterior["posterior"].to_dataset()
    names = list(dict.fromkeys(study.best.parameters["parameter"]))
    draws = np.concatenate(
        [one.to_numpy().reshape(one.sizes["chain"] * one.sizes["draw"], -1) for one in found.values()], axis=1
    )
    low, high = np.quantile(draws, (0.05, 0.95), axis=0)
    at = true[names].to_numpy()
    return Recovered(
        instrument,
        (draws.mean(axis=0) - at) / draws.std(axis=0),
        (low <= at) & (at <= high),
        find_tool(family, machine.model, true, study, rng),
        float(study.ranking["pareto_k"].iloc[0]),
        int(study.best.parameters.get("mode", pd.Series([1])).max()),
    )


def find_tool(
    family: Family, model: ReadingModel, true: pd.Series, study: bc.StudyResult, rng: np.random.Generator
) -> np.ndarray:
    """Return scores of the tool's numbers at commands that lead the true machine to other places of its workspace."""
    theta = true[list(model.layout.names)].to_numpy()
    pose, given = family.draw_places(model, theta, N_PLACES, rng)
    commands = model.read(theta, pose, given)[:, model.select(model.commanded)]
    best = replace(study, allow_unconverged=True).best  # which a preliminary answer never is
    solution = best.take_mode(1) if "mode" in best.parameters else best
    found = predict_poses(take_one_place(solution.machine), commands, given)
    n = len(model.tool_channels)
    apart = Comparison(model.tool_channels).subtract(found.tool[:, :n], model.tool_values(theta, pose))
    return (apart / np.sqrt(np.diagonal(found.of_geometry, axis1=1, axis2=2)[:, :n])).ravel()


@cache
def recover_family(name: str) -> tuple[Recovered, ...]:
    """Return all machines of a family."""
    return tuple(recover(name, k) for k in range(N_MACHINES))


def find_off(shares: list[float], expected: float, least: float) -> float:
    """Return by how many standard errors the mean over machines is off, ``least`` the least error of the mean.

    More machines than these are held, or all numbers of each, by chance alone, and their spread says nothing then.
    """
    error = max(np.std(shares, ddof=1) / np.sqrt(len(shares)), least)
    return float(abs(np.mean(shares) - expected) / error)


def judge(found: Sequence[Recovered], off: float) -> dict[str, float]:
    """Return what of parameters and tool is farther off than so many standard errors over machines."""
    wrong = {}
    for what, scores, held in (
        ("parameters", [one.z for one in found], [one.inside for one in found]),
        ("tool", [one.tool for one in found], [np.abs(one.tool) <= INSIDE for one in found]),
    ):
        n = sum(len(one) for one in scores)
        figures = {
            "inside": ([one.mean() for one in held], COVERAGE, np.sqrt(COVERAGE * (1.0 - COVERAGE) / n)),
            "z²": ([np.mean(one**2) for one in scores], 1.0, np.sqrt(2.0 / n)),
        }
        for figure, (shares, expected, least) in figures.items():
            if find_off(shares, expected, least) > off:
                wrong[f"{what}: {figure}"] = float(np.mean(shares))
    return wrong


ONCE_LOST = {
    "what no reading tells stays where the search for a frame began": ("sliding_platform", 26),
    "a draw of the prior leads where no machine stands": ("sliding_platform", 3),
    "a plane is seen from one side": ("rotary_delta", 3),
    "an anchor begins where the tool is": ("line_machine in a plane", 2),
    "few of the workspace are within the ranges of actuators": ("legs", 0),
    "instruments are called as parameters of the machine": ("arm of rows", 6),
}


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("case", ONCE_LOST)
def test_machines_are_recovered_where(case):
    name, k = ONCE_LOST[case]
    found = recover(name, k, seed=k + 1)
    assert np.abs(np.concatenate([found.z, found.tool])).max() < 4.5
    assert found.solutions == 1


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
@pytest.mark.parametrize("name", FAMILIES)
def test_machines_of_a_family_are_recovered(name):
    assert not judge(recover_family(name), t.isf(norm.sf(OFF), N_MACHINES - 1))


@pytest.mark.slow
@pytest.mark.usefixtures("no_pictures")
def test_machines_of_all_families_are_recovered():
    """As many as show an interval that is some percent off."""
    assert not judge([one for name in FAMILIES for one in recover_family(name)], OFF)


# --- combinations that make no sense ---------------------------------------------------------------------------------


NO_PLACE, NO_TURN = (
    "expected tool_channels of its class, up to three in mm",
    "expected a rotation vector in tool_channels",
)
REFUSED = [
    *((name, one, NO_PLACE) for name in ("mount", "equatorial mount") for one in TURNING),
    *((name, "places", "places: found a tool without lengths") for name in ("mount", "equatorial mount")),
    *(
        (name, one, NO_TURN)
        for name in ("delta", "rotary_delta", "five_bar", "line_machine", "line_machine in a plane", "own class")
        for one in ("pose", *EYES)
    ),
    ("five_bar", "sockets", "found few poses of the workspace that touch it"),
    ("legs", "places", "places: found 2, expected 1"),
]
"""Families with instruments that they cannot have, and what is said."""


@pytest.mark.parametrize(("name", "instrument", "said"), REFUSED)
def test_what_makes_no_sense_is_refused_in_a_line(name, instrument, said):
    with pytest.raises(bc.InputError, match=re.escape(said)) as caught:
        recover(name, 0, instrument)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["five_bar", "line_machine in a plane", "sliding_platform"])
@pytest.mark.parametrize(
    ("instrument", "said"),
    [
        ("distance", "instruments.it: anchor_mm: missing, expected its value: the tool keeps to a plane"),
        ("plane", "instruments.it: tilt_deg: missing, expected its value: the tool keeps to a plane"),
    ],
)
def test_what_a_tool_in_a_plane_does_not_tell_has_to_be_stated(monkeypatch, name, instrument, said):
    monkeypatch.setitem(FAMILIES, name, replace(FAMILIES[name], planar=False))
    with pytest.raises(bc.InputError, match=re.escape(said)):
        recover(name, 0, instrument)
