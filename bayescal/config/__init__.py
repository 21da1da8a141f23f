"""Configs: what the TOML files may say, read and checked before anything is computed."""

from bayescal.config.load import load_experiment, load_mechanism, load_reading_simulation, load_simulation
from bayescal.config.schema import (
    MechanismConfig,
    PoseMethodsConfig,
    SimulationConfig,
    StudyConfig,
    VariantConfig,
)
from bayescal.experiments.audit.load import load_audit
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.pose_selection.schema import SelectionConfig
from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig, SelfCalibrationConfig
from bayescal.experiments.sensor_placement.schema import PlacementConfig
from bayescal.reproductions.sika2008.schema import SelfCalibrationsConfig
from bayescal.reproductions.yu2023.schema import HexapodCalibrationsConfig

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
