"""The files that a user would write of a twin, and what bayescal makes of them.

Projects of `bayescal init` are taken as they are, but for the tables and the sampler's effort; others are written
likewise. With ``tau`` the model error is stated to be random errors from pose to pose alone, of all machines; with
``floor`` systematic errors are stated to be 10 µm at least.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.calibrated.predict import predict_poses
from bayescal.experiments.runner.identity import describe_provenance, identify
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.results import write_results
from bayescal.experiments.runner.run import compute_experiment
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.experiments.shared.posterior_files import read_draws
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.projects.start import start_project
from benchmarks.truth.functions import Function
from benchmarks.truth.machines import Platform
from benchmarks.truth.simulated import Array, Simulated

INIT = {"hexapod": ("hexapod", "poses"), "carriages": ("carriages", "poses"), "delta": ("own", None)}
DEFAULTS = ("init", "tau", "floor", "random", "none")
EFFORT = """[sampler]
ensembles = 4
walkers = 48
burn_in = 5
steps = 16

[evidence]
draws = 1000
max_draws = 1000
tolerance_nat = 1.0

[sensitivity]
prior_width_factors = [1.0]
"""
EXACT = "exact"
"""Name of a variant without model error."""
STATED = {
    "tau": '[model_error]\nterms = ["random"]\nrandom_scale_um = 10.0\n',
    "floor": "[model_error]\nfloor_um = 10.0\n",
    "random": '[model_error]\nterms = ["random"]\n',
    "none": "[model_error]\nterms = []\n",
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
name = "{name}"
title = "A twin"
seed = 1
machine = "machine.toml"

[provenance]
status = "simulated"
text = "benchmarks/truth"

[[data]]
file = "data/readings.csv"{commanded}

[sensors]
{sensors}

[parameters]
{parameters}

[[variants]]
name = "all"
title = "Everything free"{fixed}
"""
DELTA = ["s_1_mm", "s_2_mm", "s_3_mm", "cam_x_mm", "cam_y_mm", "height_mm"]
NOISE = {"mm": ("noise_um", 1e3), "rad": ("noise_rad", 1.0)}
"""By unit of a channel, how a study states its noise, and times what; of others in their own."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What bayescal says of a twin.

    Attributes
    ----------
    draws : ndarray, shape (T, D)
        Of the posterior, in the simulator's order of parameters, mm and radians, or of what was named.
    held : ndarray of bool
        Which held-back readings lie within their 90 % predictive intervals, noise included.
    tool, sd : ndarray, shape (H, m)
        Where the tool is at the held-back poses by the actuators' readings, as `bayescal predict` says, and its
        standard deviations.
    gain : float
        Log-evidence of the study's model error over that of no model error, nat; NaN where it was not asked for.
    problems : str
        Why it calls itself not converged; empty where it did.
    seconds : float
        Processor time.
    """

    draws: Array
    held: np.ndarray
    tool: Array
    sd: Array
    gain: float
    problems: str
    seconds: float


def write_project(
    name: str, machine: Simulated, default: str, folder: Path, effort: str = EFFORT, beside: bool = False
) -> None:
    """Write machine and study into a folder, as `bayescal init` would, without tables that matter.

    ``effort`` are the sections of the sampler; none for the package's own. With ``beside`` a variant without model
    error stands beside the first one.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if isinstance(machine, Function):
        _write_function(name, machine, folder)
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
    text = "\n".join(
        part for part in re.split(r"\n(?=\[)", text) if not _says(part, "sampler", "evidence", "sensitivity")
    )
    if default in STATED:
        parts = [part for part in re.split(r"\n(?=\[)", text) if not _says(part, "model_error")]
        text = "\n".join([*parts, STATED[default]])
    if beside:
        first = next(part for part in re.split(r"\n(?=\[)", text) if part.startswith("[[variants]]"))
        text += "\n" + re.sub(r'name = ".*"', f'name = "{EXACT}"\nmodel_error = []', first, count=1)
    path.write_text(f"{text}\n{effort}")


def _says(part: str, *sections: str) -> bool:
    return part.startswith(tuple(f"[{name}" for name in sections))


def _free(text: str, machine: Platform) -> str:
    """Return a study of legs with other tolerances."""
    said = "".join(f'{symbol} = {{ prior = "normal", sd = {sd} }}\n' for symbol, sd in machine.tolerances.items())
    text = re.sub(r"\[parameters\]\n.*?(?=\n\[)", f"[parameters]\n{said}", text, flags=re.DOTALL)
    text = re.sub(r"actuator_noise_um = \S+", "actuator_noise_um = 1.0", text)
    return re.sub(r"free = \[.*?\]", f"free = {quote(list(machine.tolerances))}", text)


def _write_function(name: str, machine: Function, folder: Path) -> None:
    """Write the class that a user has, and a study of what its simulator declares."""
    folder.mkdir(parents=True)
    shutil.copyfile(Path(__file__).parent / "classes" / f"{name}.py", folder / f"{name}.py")
    kind = f"{name}.py:{type(machine).__name__}"
    (folder / "machine.toml").write_text(f'kind = "{kind}"\nname = "{name}"\ntitle = "{name}"\n')
    sensors = [(sensor, *NOISE.get(one.unit, ("noise", 1.0)), one) for sensor, one in machine.sensors.items()]
    symbols = [(symbol, np.degrees(one.sd) if one.unit == "rad" else one.sd) for symbol, one in machine.symbols.items()]
    text = OWN.format(
        name=name,
        commanded=f"\ncommanded_channels = {quote(machine.commanded)}" if machine.commanded else "",
        sensors="\n".join(f"{sensor} = {{ {key} = {times * one.noise:.9g} }}" for sensor, key, times, one in sensors),
        parameters="\n".join(f'{symbol} = {{ prior = "normal", sd = {sd:.9g} }}' for symbol, sd in symbols),
        fixed=f"\nfixed = {quote(machine.fixed)}" if machine.fixed else "",
    )
    (folder / "study.toml").write_text(text)


def quote(names: Sequence[str]) -> str:
    """Return names as a list of a config."""
    return f"[{', '.join(f'"{name}"' for name in names)}]"


def write_tables(machine: Simulated, values: Array, held: np.ndarray, folder: Path) -> None:
    """Write what was measured: channels (P, m), some rows (P,) held back."""
    use = np.where(held, "verification", "calibration")
    rows = [f"R{k + 1:03d},{one}" for k, one in enumerate(use)]
    (folder / "data").mkdir(exist_ok=True)
    if not isinstance(machine, Platform):
        columns = machine.columns if isinstance(machine, Function) else DELTA
        _write(folder / "data" / "readings.csv", ["pose", "use", *columns], rows, values)
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


def compute(folder: Path, seed: int, out: Path) -> None:
    """Write what the study of a folder finds of its tables into a new folder, all but its page."""
    experiment, config = load(folder / "study.toml")
    config = config.model_copy(update={"seed": seed})
    identity = identify(config, folder, experiment.files(config, folder))
    found = compute_experiment(config, folder)
    out.mkdir()
    provenance = describe_provenance(config, identity)
    write_results(replace(found, provenance=provenance), out, experiment.tables_in, experiment.digits)


def calibrate(machine: Simulated, folder: Path, seed: int, commands: Array, names: Sequence[str] = ()) -> Calibrated:
    """Return what a study finds of its tables, computed in this process; draws of other unknowns if they are named.

    ``commands`` (H, N) are what actuators read at the held-back poses.
    """
    began = time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "results"
        compute(folder, seed, out)
        seconds = time.process_time() - began
        variants = json.loads((out / "summary.json").read_text())["variants"]
        first = next(iter(variants))
        gain = variants[first]["log_evidence"] - variants[EXACT]["log_evidence"] if EXACT in variants else np.nan
        drawn = read_draws(out / "posterior" / f"{stem_of(first)}.nc")
        held = read_held(out / "tables", first, isinstance(machine, Platform))
        place = predict_poses(load_calibrated(out, first, allow_unconverged=True, trust=True), commands)
    draws = np.stack([drawn[name] for name in names or machine.names], axis=1)
    return Calibrated(draws, held, place.tool, place.sd, gain, variants[first]["problems"], seconds)


def read_held(tables: Path, variant: str, by_pose: bool) -> np.ndarray:
    """Return which held-back readings lie within their intervals: components of poses, or each by the others."""
    found = pd.read_csv(tables / ("pose_errors.csv" if by_pose else "predictions.csv"))
    found = found[found["variant"] == variant]
    if not by_pose:
        return found["in_interval_90"].to_numpy()
    found = found[found["use"] == "verification"]
    low, error, high = (found.filter(regex=f"^r?[xyz]_{what}_").to_numpy() for what in ("low", "error", "high"))
    return ((low <= error) & (error <= high)).ravel()
