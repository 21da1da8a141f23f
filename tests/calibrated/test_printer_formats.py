"""Files of printers' firmware, read by readers that restate each firmware's kinematics."""

from __future__ import annotations

import configparser
import re

import numpy as np
import pytest
import studies
from calibrated_readings import build_planned, calibrate
from deltas import build_delta, trilaterate
from refusals import line_of
from scipy.optimize import least_squares

from bayescal.calibrated.carried import describe_carried
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import CommandErrors, Source, build_calibrated
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import FunctionModel

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


@pytest.mark.parametrize("name", FIRMWARES)
def test_other_machines_are_refused(rng, tmp_path, name):
    found = calibrate(build_planned("star"), 20, rng)
    assert 'expected kind = "delta"' in line_of(lambda: export_machine(found, tmp_path, name))
    assert not list(tmp_path.iterdir())
