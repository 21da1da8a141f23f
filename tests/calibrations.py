"""Small calibrations of machines of one function: the example outside the package, with little to do."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

OWN_MACHINE = Path(__file__).parents[1] / "examples" / "own_machine"
LITTLE = {"walkers": "30", "burn_in": "8", "steps": "40", "draws": "1000", "max_draws": "1000"}


def copy_delta(folder: Path) -> Path:
    """Copy the example's files to a folder; return where they stand."""
    return Path(shutil.copytree(OWN_MACHINE, folder / "own_machine"))


def write_delta(folder: Path) -> Path:
    """Write a small calibration of the linear delta without a model error; return its config."""
    path = copy_delta(folder) / "study.toml"
    text = path.read_text()
    for key, value in LITTLE.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    path.write_text(text + "\n[next]\ncandidates = 20\n\n[model_error]\nterms = []\n")
    return path


SHORT_SWEEP = "\n[sweep]\nnoise = [0.5, 2.0]\nposes = [10, 60]\nworkspace = [0.5, 2.0]\n"
"""Of an audit: below and above what is planned; every point is a plan of its own, which takes time."""


def write_simulation(folder: Path) -> Path:
    """Write a small simulation of the linear delta; return its config."""
    path = copy_delta(folder) / "simulate.toml"
    path.write_text(path.read_text().replace("n_poses = 25", "n_poses = 6"))
    return path


def write_audit(folder: Path) -> Path:
    """Write a small audit of the linear delta, without sensors to choose from; return its config."""
    path = copy_delta(folder) / "audit.toml"
    text = path.read_text().partition("[sensor_selection]")[0].replace('method = "exchange"\n', "")
    path.write_text(text + "\n[next]\ncandidates = 20\n")
    change(path, "count = 12", "count = 4\ncandidates = 30")
    return path


def change(path: Path, old: str, new: str) -> Path:
    """Replace a text of a file, which must be there."""
    text = path.read_text()
    assert old in text, old
    path.write_text(text.replace(old, new))
    return path
