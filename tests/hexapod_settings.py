"""Settings of simulated calibrations that the tests share."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import studies
from papers import YU as HEXAPOD

from bayescal.experiments.frame.load import load_experiment
from yu2023.schema import HexapodCalibrationsConfig
from yu2023.setup import Setup, read_setup

SHIPPED = ("table4", "table8", "figure10")
SCALE = np.repeat([1e-3, np.radians(1e-4)], 3)
SMALL = {
    "candidates": "150",
    "list_length": "5",
    "iterations": "3",
    "verification_poses": "7",
    "repeats": "4",
    "selections": "2",
    "parameter_sets": "3",
    "noise_draws": "4",
}

USUAL = ("candidates", "list_length", "iterations")


def load_setting(name: str = "table8") -> Setup:
    """Return the setting of a shipped experiment."""
    config = load_experiment(HEXAPOD / f"{name}.toml")
    assert isinstance(config, HexapodCalibrationsConfig)
    return read_setup(config, HEXAPOD)


def copy_tiny(name: str, folder: Path) -> Path:
    """Copy the shipped experiments to a folder, one of them with little to do; return its config."""
    shutil.copytree(HEXAPOD, folder / "yu2023")
    shutil.copytree(studies.EXPERIMENTS / "audit", folder / "audit")
    path = folder / "yu2023" / f"{name}.toml"
    text = path.read_text()
    for key, value in SMALL.items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    text = text.replace("poses = [20, 25, 30, 35, 40, 45, 50, 60, 80]", "poses = [12, 24]")
    if "[selection]" not in text:  # then it would be the usual, long one
        text += "\n[selection]\n" + "".join(f"{key} = {SMALL[key]}\n" for key in USUAL)
    path.write_text(text)
    return path
