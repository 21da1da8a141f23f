"""Files of printers' firmware, read by readers that restate each firmware's kinematics."""

from __future__ import annotations

import configparser
import re
from dataclasses import replace

import numpy as np
import pytest
import studies
from calibrated_readings import build_planned, calibrate
from deltas import build_delta, build_five_bar, build_rotary_delta, trilaterate
from refusals import line_of
from scipy.optimize import least_squares

from bayescal.calibrated.carried import BareMachine, describe_carried
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import CommandErrors, Source, build_calibrated
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import FunctionModel
from bayescal.machines.readings.delta import DeltaMachine

NANOMETRE = 1e-6  # mm
DIRECTIONS = np.array([210.0, 330.0, 90.0])
FIRMWARES = ("klipper", "marlin", "reprapfirmware")
SOURCE = Source("made_up", "all", "Simulated, never measured")
NAMES = {"klipper": "printer.cfg", "marlin": "marlin.gcode", "reprapfirmware": "config.g"}


@pytest.fixture
def printer(rng):
    """Return the shipped printer, seen at two places, as a calibration might leave it."""
    return make_calibrated(read_reading_model(studies.EXPERIMENTS / "flsun_v400" / "machine.toml"), rng)


def make_calibrated(model, rng, size=1.0):
    off = {"rad": 0.003}
    theta = model.layout.nominal + size * rng.standard_normal(model.layout.size) * [
        off.get(unit, 0.5) for unit in model.layout.units
    ]
    n = len(model.commanded)
    return build_calibrated(model, theta, None, CommandErrors(np.zeros((n, n)), np.zeros(n)), SOURCE)


def list_words(text: str, command: str) -> dict[str, list[float]]:
    """Return the numbers behind each letter of a command."""
    line = next(one for one in text.splitlines() if one.startswith(command))
    return {one[0]: [float(x) for x in one[1:].split(":")] for one in line.split(";")[0].split()[1:]}


def read_klipper(text):
    """Return towers (3, 2), arms (3,) and heights of carriages at their endstops (3,)."""
    parser = configparser.ConfigParser(delimiters=(":",))
    parser.read_string(text)
    radius = parser.getfloat("printer", "delta_radius")
    each = [parser[f"stepper_{one}"] for one in "abc"]
    arms, angles, ends = (
        np.array([float(one[key]) for one in each]) for key in ("arm_length", "angle", "position_endstop")
    )
    return place_towers(radius, angles), arms, ends + np.sqrt(arms**2 - radius**2)


def read_marlin(text):
    shape, trims = list_words(text, "M665"), list_words(text, "M666")
    turns, radius = np.array([shape[one][0] for one in "XYZ"]), shape["R"][0]
    arms = shape["L"][0] + np.array([shape[one][0] for one in "ABC"])
    down = -np.array([trims[one][0] for one in "XYZ"])  # on from the endstop, after which the tool is at H
    assert (down >= 0.0).all()
    return place_towers(radius, turns + DIRECTIONS), arms, shape["H"][0] + np.sqrt(arms**2 - radius**2) + down


def read_reprap(text):
    shape, trims = list_words(text, "M665"), list_words(text, "M666")
    a, b, c = np.radians([shape[one][0] for one in "XYZ"])
    radius, arms = shape["R"][0], np.array(shape["L"])
    third = np.pi / 6.0
    towers = radius * np.array(
        [[-np.cos(third + a), -np.sin(third + a)], [np.cos(third - b), -np.sin(third - b)], [-np.sin(c), np.cos(c)]]
    )
    adjusted = np.array([trims[one][0] for one in "XYZ"])
    assert trims["A"] == trims["B"] == [0.0]
    return towers, arms, shape["H"][0] + np.sqrt(arms**2 - radius**2) + adjusted


def place_towers(radius, degrees):
    return radius * np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=-1)


READERS = {"klipper": read_klipper, "marlin": read_marlin, "reprapfirmware": read_reprap}


def come_to(text: str, name: str, travel: np.ndarray) -> np.ndarray:
    """Return where a firmware's printer stands with carriages (P, 3) below their endstops."""
    towers, arms, top = READERS[name](text)
    return np.array([trilaterate(np.column_stack([towers, top - one]), arms) for one in travel])


@pytest.mark.parametrize("name", FIRMWARES)
def test_a_firmware_comes_to_the_same_places(printer, rng, tmp_path, name):
    written = export_machine(printer, tmp_path, name)
    point = rng.uniform([-90.0, -90.0, 0.0], [90.0, 90.0, 40.0], (30, 3))
    travel = printer.model.read(printer.theta, np.hstack([point, point + 1.0]))[:, :3]
    text = (tmp_path / NAMES[name]).read_text()
    np.testing.assert_allclose(come_to(text, name, travel), point, rtol=0.0, atol=NANOMETRE)
    whole, *others = describe_carried(written)
    carried, of = re.match(r"The file carries (\S+) of (\S+) mm", whole).groups()
    assert carried == of
    assert "left" not in whole
    assert bool(others) == (name == "marlin")  # what a firmware without trims of the rods makes of it
    assert all("mm are left" in one for one in others)


@pytest.mark.parametrize("name", FIRMWARES)
def test_towers_at_several_radii_are_held_in_part(rng, tmp_path, name):
    found = make_calibrated(FunctionModel("towers", build_delta()), rng)
    written = export_machine(found, tmp_path, name)
    whole = describe_carried(written)[0]
    numbers = re.match(r"The file carries (\S+) of (\S+) mm .*; (\S+) mm are left", whole).groups()
    carried, of, left = map(float, numbers)
    assert carried == pytest.approx(of - left, rel=0.1, abs=0.02)
    half = found.model.pose_scale
    point = found.model.home_pose + half * rng.uniform(-1.0, 1.0, (400, 3))
    travel = found.model.read(found.theta, point)[:, :3]
    assert 0.0 < left < 0.2  # of radii that are 3 mm apart, most of which arms and directions make up for
    apart = come_to((tmp_path / NAMES[name]).read_text(), name, travel) - point
    assert np.sqrt((apart**2).sum(axis=1).mean()) == pytest.approx(left, rel=0.1)


def test_a_hangprinter_turns_its_motors_to_the_same_places(rng, tmp_path):
    planned = build_planned("hangprinter")
    found = calibrate(planned, 30, rng)
    export_machine(found, tmp_path, "reprapfirmware")
    text = (tmp_path / "config.g").read_text()
    anchors = np.array([list_words(text, "M669")[one] for one in "ABCD"])
    spools = list_words(text, "M666")
    radius, lines, gear = np.array(spools["R"]), np.array(spools["U"]) * spools["O"], 12.75
    build = -lines * spools["Q"][0]

    def turn(point):
        """Return the motors' angles, of lengths of line that wind up in layers."""
        out = np.linalg.norm(anchors - point, axis=1) - np.linalg.norm(anchors, axis=1)
        return 2.0 * gear * np.array(spools["U"]) / build * (np.sqrt(radius**2 + build * out) - radius)

    for point in rng.uniform(planned.low, planned.high, (10, 3)):
        motors = found.model.read(found.theta, point)[:4]
        reached = least_squares(lambda p, to=motors: turn(p) - to, point + 5.0, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(reached.x, point, rtol=0.0, atol=NANOMETRE)


def test_a_rotary_delta_turns_its_arms_to_the_same_places(rng, tmp_path):
    found = make_calibrated(FunctionModel("rotary", build_rotary_delta()), rng)
    export_machine(found, tmp_path, "reprapfirmware")
    text = (tmp_path / "config.g").read_text()
    words, zeros = list_words(text, "M669"), list_words(text, "M666")
    assert words["K"] == [10.0]
    angle = np.radians([words[axis][0] for axis in "XYZ"] + DIRECTIONS)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for point in rng.uniform([-70.0, -70.0, 5.0], [70.0, 70.0, 70.0], (20, 3)):
        turned = found.model.read(found.theta, point)[:3] + np.radians([zeros[axis][0] for axis in "XYZ"])
        away = words["R"][0] + np.array(words["U"]) * np.cos(turned)
        elbows = np.column_stack([away[:, None] * out, words["H"] + np.array(words["U"]) * np.sin(turned)])
        np.testing.assert_allclose(trilaterate(elbows, np.array(words["L"])), point, rtol=0.0, atol=NANOMETRE)


@pytest.mark.parametrize("elbows", [("left", "right"), ("right", "right"), ("left", "left")])
def test_a_five_bar_turns_its_motors_to_the_same_places(rng, tmp_path, elbows):
    machine = build_five_bar(elbows=list(elbows))
    found = make_calibrated(FunctionModel("five_bar", machine), rng)
    written = export_machine(found, tmp_path, "reprapfirmware")
    words = list_words((tmp_path / "config.g").read_text(), "M669")
    sides = {1: (1.0, 1.0), 2: (-1.0, 1.0), 4: (-1.0, -1.0)}[int(words["L"][0])]  # of elbows along x
    assert words["K"] == [9.0]
    assert words["D"][2:] == [0.0, 0.0]
    for point in rng.uniform([-80.0, 190.0], [80.0, 310.0], (10, 2)):
        for arm, side in enumerate(sides):
            motor = np.array([words["X"][arm], words["Y"][arm]])
            crank, coupler = words["P"][arm], words["D"][arm]
            away = np.linalg.norm(point - motor)
            along = (away**2 + crank**2 - coupler**2) / (2.0 * away)
            aside = np.sqrt(crank**2 - along**2) * np.array([point[1] - motor[1], motor[0] - point[0]]) / away
            elbow = along * (point - motor) / away + side * aside * np.sign(aside[0])
            read = found.model.read(found.theta, point)[arm]
            turned = np.degrees(np.arctan2(elbow[1], elbow[0])) - words["B"][arm]
            assert (turned - np.degrees(read) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-7)
    carried, of = re.match(r"The file carries (\S+) of (\S+) mm", describe_carried(written)[0]).groups()
    assert carried == of


def test_a_five_bar_that_the_firmware_does_not_have_is_refused(rng, tmp_path):
    inwards = build_five_bar(elbows=["right", "left"])
    below = build_five_bar(workspace_mm=[[-90.0, 90.0], [-320.0, -180.0]])
    for machine, said in ((inwards, "found elbows to the right and"), (below, "found a workspace beside or below")):
        found = make_calibrated(FunctionModel("five_bar", machine), rng, 0.0)
        assert said in line_of(lambda one=found: export_machine(one, tmp_path, "reprapfirmware"))


# --- LinuxCNC --------------------------------------------------------------------------------------------------------


def read_hal(text):
    """Return towers (3, 2) of joints 0 to 2, arm, tower numbers and heights of carriages at their endstops."""
    pins = dict(line.split()[1:] for line in text.splitlines() if line.startswith("setp"))
    assert set(pins) == {"lineardeltakins.R", "lineardeltakins.L"}
    radius, arm = float(pins["lineardeltakins.R"]), float(pins["lineardeltakins.L"])
    half, side = 0.5 * radius, np.sqrt(0.75) * radius
    homes = re.findall(r"^# joint (\d): tower (\d), \[JOINT_\1\] HOME_OFFSET = (\S+)$", text, re.MULTILINE)
    assert [int(one[0]) for one in homes] == [0, 1, 2]
    towers = np.array([[0.0, radius], [-side, -half], [side, -half]])
    return towers, arm, [int(one[1]) - 1 for one in homes], np.array([float(one[2]) for one in homes])


@pytest.mark.parametrize("alike", [True, False])
def test_linuxcnc_comes_to_the_same_places(printer, rng, tmp_path, alike):
    machine = printer.model.machine.machine
    one = BareMachine(machine, FunctionModel("one", machine), printer.theta, {})
    theta = printer.theta.copy()
    if alike:
        theta = one.change(l=one.take("l").mean(), angle=np.radians(DIRECTIONS))
    printer = replace(printer, theta=theta)
    written = export_machine(printer, tmp_path, "linuxcnc")
    towers, arm, order, ends = read_hal((tmp_path / "lineardeltakins.hal").read_text())
    assert order == [2, 0, 1]  # of towers at 210, 330 and 90 degrees
    half = printer.model.pose_scale[:3]
    point = printer.model.home_pose[:3] + half * rng.uniform(-1.0, 1.0, (300, 3))
    travel = printer.model.read(theta, np.hstack([point, point + 1.0]))[:, order]
    there = [trilaterate(np.column_stack([towers, ends - s]), np.full(3, arm)) for s in travel]
    left = np.sqrt(((there - point) ** 2).sum(axis=1).mean())
    carried, of, rest = re.match(r"The file carries (\S+) of (\S+) mm [^;]*(.*)", describe_carried(written)[0]).groups()
    assert (rest == "") == alike
    if alike:
        assert left < NANOMETRE
        assert carried == of
    else:
        assert left == pytest.approx(float(re.search(r"(\S+) mm are left", rest)[1]), rel=0.1)


def test_linuxcnc_has_no_other_towers(rng, tmp_path):
    config = build_delta().config.model_copy(update={"angle_deg": [30.0, 150.0, 270.0]})
    found = make_calibrated(FunctionModel("towers", DeltaMachine(config)), rng)
    line = line_of(lambda: export_machine(found, tmp_path, "linuxcnc"))
    assert "found towers at 30, 150, 270 degrees, expected them near 90, 210, 330" in line


@pytest.mark.parametrize("name", [*FIRMWARES, "linuxcnc"])
def test_other_machines_are_refused(rng, tmp_path, name):
    found = calibrate(build_planned("star"), 20, rng)
    assert 'expected kind = "delta"' in line_of(lambda: export_machine(found, tmp_path, name))
    assert not list(tmp_path.iterdir())
