"""Bad input to a calibration: one line that says what, where and what was expected; exit code 2, nothing written."""

import re

import calibrations
import pytest

TABLE_LINE = 'file = "data/readings.csv"'
STUDY, MACHINE, CLASS, TABLE = "study.toml", "machine.toml", "linear_delta.py", "data/readings.csv"
CASES = {
    STUDY: {
        "unknown channel": ("s = { noise_um = 5.0 }", "q = { noise_um = 5.0 }", "sensor 'q': expected"),
        "noise in another unit": ("s = { noise_um = 5.0 }", "s = { noise_deg = 5.0 }", "expected a noise in mm"),
        "noise without a unit": ("s = { noise_um = 5.0 }", "s = { noise = 5.0 }", "sensors.s: found no unit"),
        "two noises": (
            "s = { noise_um = 5.0 }",
            "s = { noise_um = 5.0, noise_mm = 1.0 }",
            "found noise_um and noise_mm",
        ),
        "unknown symbol": ("l = { prior", "length = { prior", "parameters: found 'length'"),
        "list of another length": (
            's0 = { prior = "normal", sd = 0.5 }',
            's0 = { prior = "normal", sd = [0.5, 0.5] }',
            "parameters.s0: found 2 values",
        ),
        "no such": ('file = "data/readings.csv"', 'file = "data/reading.csv"', "reading.csv"),
        "free without a prior": ('tied = ["l"]', 'free = ["q"]', "'one_rod' frees 'q', which has no prior"),
        "one in common": ('tied = ["l"]', 'tied = ["t_x"]', "one parameter, expected two"),
        "unknown group": (
            "[sampler]",
            "[noise_factor_log_sd]\ncam = 1.0\n[sampler]",
            "noise_factor_log_sd: found 'cam'",
        ),
        "error on a channel that is not there": (
            "[model_error]\nterms = []",
            "[model_error]\nprobe = { scale = 0.1 }",
            "model_error: found 'probe', expected one of s, camera, height",
        ),
        "noise of a channel that is not there": (
            "[sampler]",
            "[noise_factor_log_sd]\nprobe = 0.5\n[sampler]",
            "noise_factor_log_sd: found 'probe', expected one of s, camera, height",
        ),
        "group of several units": (
            "[sampler]",
            "[workspace]\nw = [0.0, 1.0]\n[sampler]",
            "workspace: found 'w', expected one of x, y, z",
        ),
        "bounds the wrong way": (
            "[sampler]",
            "[workspace]\nx = [1.0, 0.0]\n[sampler]",
            "workspace.x: found 1 to 0",
        ),
        "a channel without a column": (TABLE_LINE, f'{TABLE_LINE}\nchannels = ["s", "rx"]', "no column of 'rx'"),
        "read twice": ("[sensors]", f"[[data]]\n{TABLE_LINE}\n\n[sensors]", "second reading of s[1] at pose 'C001'"),
        "commanded and unknown": (TABLE_LINE, f'{TABLE_LINE}\ncommanded_channels = ["q"]', "no column of 'q'"),
        "commanded by an instrument": (
            TABLE_LINE,
            f'{TABLE_LINE}\ncommanded_channels = ["s", "height"]',
            "data.commanded_channels: found 'height', expected one of s[1], s[2], s[3]",
        ),
        "commanded by too few": (
            TABLE_LINE,
            f'{TABLE_LINE}\ncommanded_channels = ["s[1]", "s[3]"]',
            "data.commanded_channels: found 2 channels,",
        ),
        "commanded by what a variant leaves out": (
            'tied = ["l"]',
            'tied = ["l"]\nsensors = ["cam_x", "cam_y", "height"]',
            "data.commanded_channels: found 's[1]',",
        ),
        "measured without a source": ('status = "simulated"', 'status = "measured"', "expected source and licence"),
    },
    MACHINE: {
        "missing file": ("linear_delta.py:LinearDelta", "no_delta.py:LinearDelta", "no such"),
        "missing class": ("linear_delta.py:LinearDelta", "linear_delta.py:Delta", "Delta"),
        "unknown kind": ("linear_delta.py:LinearDelta", "line_machines", "line_machine"),
        "unknown key": ("rod_mm = 260.0", "rod_m = 0.26", "rod_m"),
        "rods that are too short": ("rod_mm = 260.0", "rod_mm = 140.0", "expected a finite reading"),
    },
    CLASS: {
        "no parameters": ("self.parameters = [", "self.other = [", "found no parameters"),
        "no channels": ("self.channels = [", "self.other = [", "found no channels"),
        "no such member": ("    def read(", "    def look(", "read"),
        "wrong shape": ("return np.concatenate([s,", "return np.concatenate([s[..., :2],", "found shape"),
        "not analytic": ("+ (y - parameters", "+ np.abs(y - parameters", "expected an analytic function"),
        "raises": ("s = z +", 's = z + parameters["none"] +', "KeyError"),
        "fails to import": ("import numpy as np", "import numpyy as np", "whose import fails"),
        "constructor that raises": ("angle = np.radians", "angle = np.radianss", "AttributeError"),
    },
    TABLE: {
        "unknown column": ("s_1_mm", "t_1_mm", "found column 't_1_mm'"),
        "unit of another kind": ("s_1_mm", "s_1_deg", "found column 's_1_deg'"),
        "no number": ("C001,calibration,", "C001,calibration,x", "expected a number"),
        "pose twice": ("C002", "C001", "already on line"),
        "unknown use": ("C001,calibration", "C001,calibrate", "use: found 'calibrate'"),
    },
}
"""By file: what is replaced in it, by what, and what is said of that."""


@pytest.fixture
def refuse(refuse, tmp_path):
    """Return a function that checks that a run is refused in one line that says something."""
    return lambda path, message: refuse(re.escape(message), tmp_path / "out", "run", path, "--quiet")


@pytest.mark.parametrize(("file", "case"), [(file, case) for file, cases in CASES.items() for case in cases])
def test_what_is_at_fault_is_named(file, case, tmp_path, refuse):
    old, new, message = CASES[file][case]
    path = calibrations.write_delta(tmp_path)
    calibrations.change(path.parent / file, old, new)
    if "leaves out" in case:
        calibrations.change(path, TABLE_LINE, f'{TABLE_LINE}\ncommanded_channels = ["s"]')
    if case == "not analytic":
        calibrations.change(path.parent / file, 'np.abs(y - parameters["y"]) ** 2', 'np.abs(y - parameters["y"])')
    refuse(path, message)


def test_a_pose_that_its_readings_do_not_tell(tmp_path, refuse):
    path = calibrations.write_delta(tmp_path)
    table = path.parent / "data" / "readings.csv"
    lines = table.read_text().splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([*cells[:4], "", "", "", ""])
    table.write_text("\n".join(lines) + "\n")
    refuse(path, "pose 'C001': found 2 readings, expected at least 3")


STUDY_OF_POSES = """kind = "study"
name = "legs"
title = "Legs"
seed = 1
machine = "machine.toml"

[provenance]
status = "simulated"
text = "Simulated"

[[data]]
kind = "poses"
file = "data/readings.csv"
actuators = "data/readings.csv"
position_um = 10.0
orientation_arcsec = 10.0

[sensors]
rho = { noise_um = 1.0 }

[deformation]
kappa = 0.0
matrix = "targets"

[model_error]
random_scale_um = 5.0

[parameters]
l = { prior = "normal", sd = 0.1 }

[[variants]]
model = "six_pus"
deformation = "none"
free = ["l"]
"""


def test_a_model_of_legs_for_another_machine(tmp_path, refuse):
    path = calibrations.write_delta(tmp_path).parent / "legs.toml"
    path.write_text(STUDY_OF_POSES)
    refuse(path, "model: found 'six_pus', expected none for")


def test_a_commanded_channel_without_a_column_or_a_cell(tmp_path, refuse):
    path = calibrations.write_delta(tmp_path)
    calibrations.change(path, TABLE_LINE, f'{TABLE_LINE}\ncommanded_channels = ["s"]')
    table = path.parent / "data" / "readings.csv"
    written = table.read_text()
    table.write_text(written.replace("s_2_mm", "other").replace("s_2_mm", "other"))
    calibrations.change(path, TABLE_LINE, f'{TABLE_LINE}\nignore = ["other"]')
    refuse(path, "found no column of 's[2]', which data.commanded_channels")
    lines = written.splitlines()
    cells = lines[4].split(",")
    lines[4] = ",".join([*cells[:3], "", *cells[4:]])
    table.write_text("\n".join(lines) + "\n")
    refuse(path, "line 5: found no s[2], expected it by data.commanded_channels")
