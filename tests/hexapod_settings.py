"""Settings of simulated calibrations that the tests share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tiny_experiments
from papers import YU as HEXAPOD

from bayescal.experiments.runner.load import load_experiment
from yu2023.schema import HexapodCalibrationsConfig
from yu2023.setup import Setup, read_setup

SHIPPED = ("table4", "table8", "figure10")
SCALE = np.repeat([1e-3, np.radians(1e-4)], 3)


def load_setting(name: str = "table8") -> Setup:
    """Return the setting of a shipped experiment."""
    config = load_experiment(HEXAPOD / f"{name}.toml")
    assert isinstance(config, HexapodCalibrationsConfig)
    return read_setup(config, HEXAPOD)


def copy_tiny(name: str, folder: Path) -> Path:
    """Copy the shipped experiments to a folder, each with little to do; return the config of one."""
    return tiny_experiments.copy_tiny(folder, "yu2023", "audit") / "yu2023" / f"{name}.toml"
