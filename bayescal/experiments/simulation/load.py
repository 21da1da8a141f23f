"""Reading the config of simulated photogrammetry."""

from __future__ import annotations

from pathlib import Path

from bayescal.data.schema import SimulationConfig
from bayescal.experiments.frame.load import load_kind


def load_simulation(path: Path) -> SimulationConfig:
    """Return the checked config of a simulation; InputError for anything at fault, with file, line and field."""
    config: SimulationConfig = load_kind(path, "simulation")
    return config
