"""Configs: what the TOML files may say, read and checked before anything is computed."""

from bayescal.config.audit_schema import AuditConfig
from bayescal.config.calibration_schema import HexapodCalibrationsConfig
from bayescal.config.load import load_experiment, load_mechanism, load_reading_simulation, load_simulation
from bayescal.config.load_audit import load_audit
from bayescal.config.placement_schema import PlacementConfig
from bayescal.config.reading_study_schema import ReadingSimulationConfig, SelfCalibrationConfig
from bayescal.config.schema import (
    MechanismConfig,
    PoseMethodsConfig,
    SimulationConfig,
    StudyConfig,
    VariantConfig,
)
from bayescal.config.selection_schema import SelectionConfig
from bayescal.config.self_calibrations_schema import SelfCalibrationsConfig

__all__ = [
    "AuditConfig",
    "HexapodCalibrationsConfig",
    "MechanismConfig",
    "PlacementConfig",
    "PoseMethodsConfig",
    "ReadingSimulationConfig",
    "SelectionConfig",
    "SelfCalibrationConfig",
    "SelfCalibrationsConfig",
    "SimulationConfig",
    "StudyConfig",
    "VariantConfig",
    "load_audit",
    "load_experiment",
    "load_mechanism",
    "load_reading_simulation",
    "load_simulation",
]
