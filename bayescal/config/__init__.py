"""Configs: what the TOML files may say, read and checked before anything is computed."""

from bayescal.config.load import load_experiment, load_mechanism, load_simulation
from bayescal.config.schema import (
    MechanismConfig,
    PoseMethodsConfig,
    SimulationConfig,
    StudyConfig,
    VariantConfig,
)

__all__ = [
    "MechanismConfig",
    "PoseMethodsConfig",
    "SimulationConfig",
    "StudyConfig",
    "VariantConfig",
    "load_experiment",
    "load_mechanism",
    "load_simulation",
]
