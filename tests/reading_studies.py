"""Small self-calibrations on disk for the tests: a machine of any number of legs, its simulated readings, a config."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
from reading_machines import EXPERIMENT

from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.self_calibration.inputs import ReadingInputs, read_inputs
from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig
from bayescal.experiments.self_calibration.simulate import simulate_readings
from bayescal.machines.read import read_sliding_platform

SMALL = {"walkers": 46, "burn_in": 2, "steps": 6, "draws": 1000, "max_draws": 1000}
SHORT_WORKSPACE = {"n_poses": 20}

SIMULATION = """
kind = "reading_simulation"
name = "small"
title = "Small"
origin = "Simulated for the tests, never measured"
seed = 4
machine = "machine.toml"
verification_poses = 3

[poses]
n_poses = 20
position_mm = 150.0
angle_deg = 15.0
"""

STUDY = """
kind = "self_calibration"
name = "small"
title = "Small"
origin = "Simulated for the tests, never measured"
seed = 5
machine = "machine.toml"

[data]
readings = "data/readings.csv"
true_parameters = "data/true_parameters.csv"
true_poses = "data/true_poses.csv"

[workspace]
n_poses = 20
position_mm = 150.0
angle_deg = 15.0

[sampler]
ensembles = 4
walkers = 56
burn_in = 5
steps = 12

[evidence]
draws = 1000
max_draws = 1000
"""

SENSORS = """
[sensors]
s = { noise_um = 1.0 }
phi = { noise_arcsec = 1.0 }
psi = { noise_arcsec = 1.0 }
x_V = { noise_um = 10.0 }
y_V = { noise_um = 10.0 }
phi_V = { noise_arcsec = 2.0 }

[tolerances]
length_mm = 0.3
angle_deg = 0.05
zero_deg = 2.0
"""


def describe_machine(n_legs: int) -> str:
    """Return the TOML of a machine whose legs stand evenly about its tool."""
    parts = ['kind = "sliding_platform"', f'name = "star_{n_legs}"']
    for k in range(n_legs):
        angle = 2 * np.pi * k / n_legs
        x, y = np.cos(angle), np.sin(angle)
        parts.append(
            f"[[legs]]\nguide_point_mm = [{600 * x:.6f}, {600 * y:.6f}]\n"
            f"guide_angle_deg = {np.degrees(angle) - 270 * (k > 0) + 90 * (k == 0):.6f}\nlength_mm = 800.0\n"
            f"platform_point_mm = [{100 * x:.6f}, {100 * y:.6f}]"
        )
    return "\n".join([*parts, "[tool]\npoint_mm = [0.0, 0.0]", "[home]\ntool_mm = [0.0, 0.0]\nangle_deg = 0.0\n"])


def describe_variant(name: str, sensors: list[str], extra: str = "") -> str:
    """Return the TOML of a variant."""
    return f'\n[[variants]]\nname = "{name}"\ntitle = "Variant {name}"\nsensors = {sensors}\n{extra}\n'


def write_small(folder: Path, *variants: str, n_legs: int = 3) -> Path:
    """Write machine, readings and config of a small self-calibration; return the config."""
    (folder / "machine.toml").write_text(describe_machine(n_legs))
    (folder / "simulate.toml").write_text(SIMULATION + SENSORS)
    simulation = load_experiment(folder / "simulate.toml")
    assert isinstance(simulation, ReadingSimulationConfig)
    model = read_sliding_platform(folder / simulation.machine)
    (folder / "data").mkdir()
    for name, text in simulate_readings(simulation, model, np.random.default_rng(simulation.seed)).files.items():
        (folder / "data" / name).write_text(text)
    path = folder / "study.toml"
    path.write_text(STUDY + SENSORS + "".join(variants or [describe_variant("s6", ["s", "phi"])]))
    return path


def load_small(path: Path) -> ReadingInputs:
    """Return the inputs of a config."""
    return read_inputs(load_experiment(path), path.parent)


def copy_shipped(folder: Path, variants: Collection[str], n_poses: int = 24, effort: Mapping[str, int] = SMALL) -> Path:
    """Copy the shipped experiment with some of its variants and poses, and little to do; return its config."""
    shutil.copytree(EXPERIMENT, folder)
    path = folder / "study.toml"
    text = path.read_text()
    for key, value in (effort | SHORT_WORKSPACE).items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    head, *parts = text.partition("[sampler]")[0].split("[[variants]]")
    kept = [part for part in parts if re.search(r'name = "(\w+)"', part)[1] in variants]
    path.write_text("[[variants]]".join([head, *kept]) + "[sampler]" + text.partition("[sampler]")[2])
    _keep_poses(folder / "data", n_poses)
    return path


def _keep_poses(data: Path, n_poses: int) -> None:
    """Leave so many calibration poses in the shipped data, and six for verification."""
    for name in ("readings", "true_poses"):
        lines = (data / f"{name}.csv").read_text().splitlines()
        calibration, verification = ([line for line in lines[3:] if line[0] == use] for use in "CV")
        rows = [*lines[:3], *calibration[:n_poses], *verification[:6]]
        (data / f"{name}.csv").write_text("\n".join(rows) + "\n")
