"""Small studies on disk for the tests: a simulated survey of the telescope with few poses, targets and parameters."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.config.registry import list_sources
from bayescal.experiments.runner.kept_inputs import CONFIG_FILE, keep_inputs
from bayescal.experiments.runner.load import load, load_experiment
from bayescal.experiments.runner.results import Results, read_results
from bayescal.experiments.runner.run import compute_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.tables import format_poses
from bayescal.machines.kinematics import STEP_TOLERANCE

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
TELESCOPE = EXPERIMENTS / "telescope"
CLAIMS = "claims.py:Rr8096"
"""Of the telescope; a tiny study has the files beside it."""
N_CALIBRATION = 13
N_VERIFICATION = 3
SEED = 20
SURVEY = ("targets.csv", "actuators.csv", "target_reference.csv")

NUMBER = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")
PROGRESS = re.compile(r"[A-Za-z -]+: \d+ of \d+ done, \d+ s(, about \d+ s left)?(; .*)?")

SIMULATION = """
kind = "simulation"
name = "tiny_twin"
title = "Tiny twin"
seed = 20
machine = "mechanism.toml"
model = "six_pus"

[provenance]
status = "reconstructed"
text = "Reconstructed: simulated for the tests, never measured"

[truth]
deformation_matrix = "deformation_matrix.csv"

[truth.offsets]
l = [0.37, -0.45, 1.02, 0.25, 0.43, 0.58]
kappa = [9.58e-3, 1.98e-3, 4.43e-3, 3.33e-3, 0.67e-3, 6.99e-3]

[poses]
calibration = "calibration_configurations.csv"
verification = "verification_configurations.csv"
unit_mm = 1.3

[noise]
target_um = 3.0
actuator_um = 1.0

[targets]
base = [{ count = 5, radius_mm = 190.0, height_mm = 0.0 }, { count = 2, radius_mm = 150.0, height_mm = 60.0 }]
platform = [{ count = 5, radius_mm = 100.0, height_mm = 20.0 }, { count = 2, radius_mm = 90.0, height_mm = 60.0 }]
targets_per_pad = 2
pad_radius_mm = 12.0

[measurement_frame]
distance_mm = 1500.0
angle_deg = 60.0
"""

DATA = """machine = "mechanism.toml"

[provenance]
status = "simulated"
text = "for the tests"

[[data]]
kind = "targets"
file = "data/targets.csv"
actuators = "data/actuators.csv"
reference = "data/target_reference.csv"
target_noise_um = 3.0

[sensors]
rho = { noise_um = 1.0 }

[deformation]"""
"""What studies of targets on disk have in common."""

STUDY = f"""
kind = "study"
name = "tiny"
title = "Tiny study"
seed = 11
{DATA}
kappa = 0.011
matrix = "targets"

[parameters]
l = {{ prior = "normal", sd = 2.0 }}
kappa = {{ prior = "normal", sd = 0.01 }}
b_z = {{ prior = "fixed", offset = 0.0 }}

[model_error]
terms = ["random"]
random_scale_um = 10.0
separate_by_leg = false

[[variants]]
model = "six_pus"
deformation = "none"
free = ["l"]

[[variants]]
model = "six_pus"
deformation = "matrix"
free = ["l", "kappa"]

[sampler]
ensembles = 4
walkers = 8
burn_in = 5
steps = 10

[evidence]
draws = 1000
max_draws = 1000

[validation]
draws = 100

[sensitivity]
prior_width_factors = [1.0]
"""

BY_TARGETS = """kind = "targets"
file = "data/targets.csv"
actuators = "data/actuators.csv"
reference = "data/target_reference.csv"
target_noise_um = 3.0
"""
BY_POSES = """kind = "poses"
file = "data/poses.csv"
actuators = "data/actuators.csv"
"""
"""What a tiny study's data are: targets, or in their place the poses found from them."""


@cache
def tiny_texts() -> dict[str, str]:
    """Return the texts of a tiny study's files by their names; made once."""
    texts = {
        "simulate.toml": SIMULATION,
        "study.toml": STUDY,
        "mechanism.toml": (TELESCOPE / "mechanism.toml").read_text(),
        "deformation_matrix.csv": (TELESCOPE / "deformation_matrix.csv").read_text(),
    }
    for name, n in (("calibration", N_CALIBRATION), ("verification", N_VERIFICATION)):
        rows = (TELESCOPE / f"{name}_configurations.csv").read_text().splitlines()
        texts[f"{name}_configurations.csv"] = "\n".join(rows[: 2 + n]) + "\n"
    return texts


@cache
def tiny_survey_texts() -> dict[str, str]:
    """Return the texts of the tiny survey's CSV files by their names in the study; simulated once."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_texts(folder, tiny_texts())
        files = simulate(folder / "simulate.toml").files
    return {f"data/{name}": str(files[name]) for name in SURVEY}


def write_texts(folder: Path, texts: dict[str, str]) -> None:
    """Write files by their names under a folder."""
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def write_tiny_study(folder: Path) -> Path:
    """Write a tiny study with its data to a folder and return its config."""
    paths = [*TELESCOPE.rglob("*.py"), *TELESCOPE.glob("published/*.csv")]
    claims = {path.relative_to(TELESCOPE).as_posix(): path.read_text() for path in paths}
    write_texts(folder, tiny_texts() | tiny_survey_texts() | claims)
    return folder / "study.toml"


LITTLE_EFFORT = """
[sampler]
walkers = 24
burn_in = 10
steps = 20

[evidence]
draws = 1000
max_draws = 1000
"""


def run_little(call: Callable[..., tuple[int, str, str]], study: Path) -> tuple[int, str, Path]:
    """Run a study with little effort; return the exit code, what was complained of, and the results' folder."""
    with study.open("a", encoding="utf-8") as file:
        file.write(LITTLE_EFFORT)
    out = study.parent / "results"
    code, _, complaint = call("run", study, "--out", out, "--quiet", "--workers", 1)
    return code, complaint, out


def edit(path: Path, old: str, new: str) -> None:
    """Replace the first occurrence of a text in a file; it must be there."""
    text = path.read_text()
    assert old in text, f"{path} has no {old!r}"
    path.write_text(text.replace(old, new, 1))


@contextmanager
def changed_table(path: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> Iterator[None]:
    """Change a CSV table's rows below its comments, lists of cells with the header first, until the block ends."""
    original = path.read_text()
    comments = [line for line in original.splitlines() if line.startswith("#")]
    rows = change([line.split(",") for line in original.splitlines() if not line.startswith("#")])
    path.write_text("\n".join([*comments, *(",".join(row) for row in rows)]) + "\n")
    try:
        yield
    finally:
        path.write_text(original)


def change_actuators(mend: Callable[[np.ndarray], np.ndarray]) -> Callable[[list[list[str]]], list[list[str]]]:
    """Return what changes all actuator positions (P, N) of a table."""

    def apply(rows: list[list[str]]) -> list[list[str]]:
        rho = mend(np.array([row[2:] for row in rows[1:]], dtype=float))
        mended = zip(rows[1:], rho, strict=True)
        return [rows[0], *([*row[:2], *(f"{x:.6f}" for x in one)] for row, one in mended)]

    return apply


def find_line(path: Path, start: str) -> int:
    """Return the number of the first line that starts with a text, counted from one."""
    return next(n for n, line in enumerate(path.read_text().splitlines(), start=1) if line.startswith(start))


def load_study(path: Path) -> StudyInputs:
    """Return the inputs of a study from its config."""
    return StudyInputs.load(load_experiment(path), path.parent)


def feed_poses(path: Path) -> str:
    """Return the poses that a study of targets found as the text of a table of poses."""
    inputs = load_study(path)
    return format_poses(inputs.measured[0], inputs.config.provenance)


def copy_small(config: Path, folder: Path) -> Path:
    """Copy an experiment's folder and shrink the sampler of one of its configs; return the copy."""
    shutil.copytree(config.parent, folder, dirs_exist_ok=True)
    small = {"walkers": 8, "burn_in": 1, "steps": 4, "draws": 1000, "max_draws": 1000, "repeats": 2}
    lists = {"prior_width_factors": "[1.0]", "n_targets": "[6, 8]"}
    text = config.read_text().replace('"../', f'"{config.parents[1]}/')
    for key, value in (small | lists).items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    (folder / config.name).write_text(text)
    return folder / config.name


def keep_committed(results: Path, config: Path) -> None:
    """Put a config and the files that it names into results that were committed without them."""
    experiment, found = load(config)
    names = [*experiment.files(found, config.parent), *list_sources("KINDS", found.kind, config.parent)]
    place, kept = keep_inputs(found, config.parent, names)
    for name, one in kept.items():
        (results / name).parent.mkdir(parents=True, exist_ok=True)
        (results / name).write_text(one) if isinstance(one, str) else one(results / name)
    provenance = json.loads((results / "provenance.json").read_text())
    (results / "provenance.json").write_text(json.dumps({**provenance, CONFIG_FILE: place}))


def list_errors(err: str) -> list[str]:
    """Return the lines on standard error that are neither progress nor what `validate` says of the data, too."""
    said = ("warning: ", "first answer, ")
    return [one for one in err.splitlines() if not (PROGRESS.fullmatch(one) or one.startswith(said))]


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Return everything under a folder: files with their contents, directories with None."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def simulate(path: Path, **changed: object) -> Results:
    """Return what a config of a simulation, changed in some keys, gives: files by their names, and the truth."""
    config = load_experiment(path).model_copy(update=changed)
    return compute_experiment(config, path.parent)


def assert_same_text(found: str, expected: str, name: str = "") -> None:
    """Check that two texts are the same but for numbers, and these but for what another CPU makes of their last digits.

    A pose is solved for until a step is below `STEP_TOLERANCE`; of what is rounded to fewer digits the last may turn.
    """
    assert NUMBER.sub("#", found) == NUMBER.sub("#", expected), name
    for one, other in zip(NUMBER.findall(found), NUMBER.findall(expected), strict=True):
        digits, _, exponent = other.partition("e")
        last = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
        assert abs(float(one) - float(other)) <= max(STEP_TOLERANCE, 1.01 * last), f"{name}: {one}, expected {other}"


def read_posterior(folder: Path, variant: str) -> dict[str, dict[str, Any]]:
    """Return the rows of a variant's parameters in a results directory, by their names."""
    table = read_results(folder, ("parameters",)).table("parameters")
    return {str(row["parameter"]): row for row in table[table["variant"] == variant].to_dict("records")}
