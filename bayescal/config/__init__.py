"""Configs: what the TOML files may say, read and checked before anything is computed."""

from bayescal.config.audit_schema import AuditConfig
from bayescal.config.calibration_schema import HexapodCalibrationsConfig
from bayescal.config.load import load_experiment, load_mechanism, load_simulation
from bayescal.config.load_audit import load_audit
from bayescal.config.schema import (
    MechanismConfig,
    PoseMethodsConfig,
    SimulationConfig,
    StudyConfig,
    VariantConfig,
)
from bayescal.config.selection_schema import SelectionConfig

__all__ = [
    "AuditConfig",
    "HexapodCalibrationsConfig",
    "MechanismConfig",
    "PoseMethodsConfig",
    "SelectionConfig",
    "SimulationConfig",
    "StudyConfig",
    "VariantConfig",
    "load_audit",
    "load_experiment",
    "load_mechanism",
    "load_simulation",
]
