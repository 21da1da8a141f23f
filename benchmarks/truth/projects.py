"""The files that a user would write of a twin, and what bayescal makes of them.

Projects of `bayescal init` are taken as they are, but for the tables and the sampler's effort; others are written
likewise. With ``tau`` the model error is stated to be random errors from pose to pose alone, of all machines; with
``floor`` systematic errors are stated to be 10 µm at least.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.experiments.frame.load import load, read_inputs
from bayescal.experiments.study.readings import fit_variant
from bayescal.projects.start import start_project
from benchmarks.truth.machines import Array, Platform, Simulated

INIT = {"hexapod": ("hexapod", "poses"), "carriages": ("carriages", "poses"), "delta": ("own", None)}
DEFAULTS = ("init", "tau", "floor")
EFFORT = """[sampler]
ensembles = 4
walkers = 48
burn_in = 5
steps = 16

[evidence]
draws = 1000
max_draws = 1000
target_error = 1.0
"""
STATED = {
    "tau": '[model_error]\nterms = ["independent"]\nscale_um = 10.0\n',
    "floor": "[model_error]\nat_least_um = 10.0\n",
}
TELESCOPE = """name = "telescope"

[base]
radius_mm = 155.0
azimuth_deg = [220.0, 320.0, 340.0, 80.0, 100.0, 200.0]

[platform]
radius_mm = 130.0
azimuth_deg = [265.0, 275.0, 25.0, 35.0, 145.0, 155.0]

[legs]
length_mm = 500.0
direction = [0.0, 0.0, 1.0]
initial_actuator_position_mm = 10.0
actuator_range_mm = 1.3
"""
OWN = """kind = "study"
name = "twin"
title = "A twin"
seed = 1
machine = "machine.toml"

[origin]
status = "simulated"
text = "benchmarks/truth"

[[data]]
file = "data/readings.csv"

[sensors]
{sensors}

[parameters]
{parameters}

[[variants]]
name = "all"
title = "Everything free"
"""
CLASSES = {
    "arm": (
        "arm.py:Arm",
        "encoder = { noise_rad = 5e-6 }\ntracker_x = { noise_um = 20.0 }\ntracker_y = { noise_um = 20.0 }\n"
        "tracker_z = { noise_um = 20.0 }",
        {"a": 0.3, "d": 0.3, "alpha": 0.03, "o": 0.03},
    ),
    "cables": (
        "cables.py:Cables",
        "cable = { noise_um = 20.0 }\n"
        + "\n".join(f"tracker_{axis} = {{ noise_um = 20.0 }}" for axis in "xyz")
        + "\n"
        + "\n".join(f"tracker_r{axis} = {{ noise_rad = 5e-5 }}" for axis in "xyz"),
        {**dict.fromkeys(("a_x", "a_y", "a_z"), 0.3), **dict.fromkeys(("b_x", "b_y", "b_z"), 0.2), "l0": 0.5},
    ),
}
COLUMNS = {
    "delta": ["s_1_mm", "s_2_mm", "s_3_mm", "cam_x_mm", "cam_y_mm", "height_mm"],
    "arm": [*(f"encoder_{k}_rad" for k in range(1, 7)), *(f"tracker_{axis}_mm" for axis in "xyz")],
    "cables": [
        *(f"cable_{k}_mm" for k in range(1, 9)),
        *(f"tracker_{axis}_mm" for axis in "xyz"),
        *(f"tracker_r{axis}_rad" for axis in "xyz"),
    ],
}


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What bayescal says of a twin.

    Attributes
    ----------
    draws : ndarray, shape (T, D)
        Of the posterior, in the simulator's order of parameters, mm and radians, or of what was named.
    held : ndarray of bool
        Which held-back readings lie within their 90 % predictive intervals, noise included.
    problems : list of str
        Why it calls itself not converged.
    seconds : float
        Processor time.
    """

    draws: Array
    held: np.ndarray
    problems: list[str]
    seconds: float


def write_project(name: str, machine: Simulated, default: str, folder: Path) -> None:
    """Write machine and study into a folder, as `bayescal init` would, without tables that matter."""
    shutil.rmtree(folder, ignore_errors=True)
    if name in CLASSES:
        _write_class(name, folder)
    elif name in INIT:
        start_project(folder, *INIT[name])
    else:
        start_project(folder, *INIT["carriages"])
        (folder / "machine.toml").write_text(TELESCOPE)
    path = folder / "study.toml"
    text = path.read_text()
    if name == "delta":  # one variant is judged
        text = re.sub(r'\[\[variants\]\]\nname = "one_rod".*?(?=\n\[)', "", text, flags=re.DOTALL)
    if name.startswith("telescope"):
        text = _free(text, machine)
    text = "\n".join(part for part in re.split(r"\n(?=\[)", text) if not _says(part, "sampler", "evidence"))
    if default in STATED:
        parts = [part for part in re.split(r"\n(?=\[)", text) if not _says(part, "model_error")]
        text = "\n".join([*parts, STATED[default]])
    path.write_text(f"{text}\n{EFFORT}")


def _says(part: str, *sections: str) -> bool:
    return part.startswith(tuple(f"[{name}" for name in sections))


def _free(text: str, machine: Platform) -> str:
    """Return a study of legs with other tolerances."""
    said = "".join(f'{symbol} = {{ prior = "normal", sd = {sd} }}\n' for symbol, sd in machine.tolerances.items())
    text = re.sub(r"\[parameters\]\n.*?(?=\n\[)", f"[parameters]\n{said}", text, flags=re.DOTALL)
    text = re.sub(r"actuator_noise_um = \S+", "actuator_noise_um = 1.0", text)
    return re.sub(r"free = \[.*?\]", f"free = {list(machine.tolerances)}".replace("'", '"'), text)


def _write_class(name: str, folder: Path) -> None:
    reference, sensors, tolerances = CLASSES[name]
    folder.mkdir(parents=True)
    shutil.copyfile(Path(__file__).with_name(f"{name}.py"), folder / f"{name}.py")
    (folder / "machine.toml").write_text(f'kind = "{reference}"\nname = "{name}"\ntitle = "{name}"\n')
    said = "\n".join(f'{symbol} = {{ prior = "normal", sd = {sd} }}' for symbol, sd in tolerances.items())
    (folder / "study.toml").write_text(OWN.format(sensors=sensors, parameters=said))


def write_tables(name: str, machine: Simulated, values: Array, held: np.ndarray, folder: Path) -> None:
    """Write what was measured: channels (P, m), some rows (P,) held back."""
    use = np.where(held, "verification", "calibration")
    rows = [f"R{k + 1:03d},{one}" for k, one in enumerate(use)]
    (folder / "data").mkdir(exist_ok=True)
    if not isinstance(machine, Platform):
        _write(folder / "data" / "readings.csv", ["pose", "use", *COLUMNS[name]], rows, values)
        return
    actuators = [f"rho_{leg}_mm" for leg in range(1, 7)]
    _write(folder / "data" / "actuators.csv", ["pose", "use", *actuators], rows, values[:, :6])
    pose = values[:, 6:].copy()
    pose[:, 3:] = np.degrees(pose[:, 3:])
    noise = np.tile(machine.noise[6:] * np.repeat([1e3, 1e6], 3), (len(values), 1))
    seen = ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    stated = [f"sd_{axis}_um" for axis in "xyz"] + [f"sd_r{axis}_urad" for axis in "xyz"]
    names = [row.split(",")[0] for row in rows]
    _write(folder / "data" / "poses.csv", ["pose", *seen, *stated], names, np.hstack([pose, noise]))


def _write(path: Path, header: list[str], rows: list[str], values: Array) -> None:
    lines = [",".join([first, *(f"{value:.12g}" for value in row)]) for first, row in zip(rows, values, strict=True)]
    path.write_text("\n".join([",".join(header), *lines]) + "\n")


def calibrate(machine: Simulated, folder: Path, seed: int, names: Sequence[str] = ()) -> Calibrated:
    """Return what a study finds of its tables, computed in this process; draws of other unknowns if they are named."""
    began = time.process_time()
    kind, config = load(folder / "study.toml")
    inputs = read_inputs(kind, config.model_copy(update={"seed": seed}), folder)
    fit = fit_variant(inputs, config.variants[0].name)
    seconds = time.process_time() - began
    order = [fit.names.index(name) for name in names or machine.names]
    if isinstance(machine, Platform):
        found = fit.poses.select(inputs.verification)
        held = ((found.low <= found.error) & (found.error <= found.high)).ravel()
    else:
        held = np.concatenate([one.predictions.inside for one in fit.held])
    return Calibrated(fit.draws.reshape(-1, fit.draws.shape[-1])[:, order], held, fit.list_problems(), seconds)
