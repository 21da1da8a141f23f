"""Settings of simulated self-calibrations that the tests share."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
from papers import SIKA
from sliding_platforms import SETS, STAR, sliding_star
from tiny_experiments import SMALL

from sika2008.schema import PosesConfig, SensorConfig, TolerancesConfig
from sika2008.setup import build_sensors, draw_poses, free_parameters

NOISE = {
    "s": SensorConfig(noise_um=1.0),
    "phi": SensorConfig(noise_arcsec=0.5),
    "psi": SensorConfig(noise_arcsec=0.5),
}
TOLERANCES = TolerancesConfig(length_mm=0.3, angle_deg=0.05, zero_deg=2.0)


def make_problem(n_sensors: int = 12, n_poses: int = 40, seed: int = 1, noise=NOISE):
    """Return sensors, free parameters and poses of the shipped machine."""
    model = sliding_star()
    sensors = build_sensors(model, noise, SETS[n_sensors])
    free = free_parameters(model, sensors.names, TOLERANCES)
    config = PosesConfig(n_poses=n_poses, position_mm=200.0, angle_deg=30.0)
    return sensors, free, draw_poses(model, config, np.random.default_rng(seed))


def copy_tiny(folder: Path) -> Path:
    """Copy the shipped experiment to a folder and give it little to do; return its config."""
    shutil.copytree(SIKA, folder / "sika2008")
    shutil.copytree(STAR, folder / "sliding_star")
    path = folder / "sika2008" / "calibrations.toml"
    text = path.read_text()
    for key, value in SMALL["self_calibrations.py:SelfCalibrations"].items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    path.write_text(text)
    return path
