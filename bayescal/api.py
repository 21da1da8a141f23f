"""Experiments from Python by the names of their kinds; the frame does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayescal.calibrated.export import export_machine
from bayescal.calibrated.predict import command_poses, draw_poses, predict_poses
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.frame.results import Results
from bayescal.experiments.frame.run import Finished, compute_experiment, run_experiment
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.experiments.shared.study_schema import StudyConfig

__all__ = [
    "command_poses",
    "compute_audit",
    "draw_poses",
    "export_machine",
    "load_calibrated",
    "predict_poses",
    "run_study",
    "write_audit",
]


def run_study(config: StudyConfig, folder: Path, out: Path, workers: int = 1, resume: bool = False) -> Finished:
    """Run a study and put its results in ``out``; see `run_experiment`."""
    return run_experiment(config, folder, out, workers, resume)


def compute_audit(config: AuditConfig, folder: Path) -> Results:
    """Return everything an audit says, I-optimal poses among what would help, without writing anything."""
    return compute_experiment(config, folder)


def write_audit(config: AuditConfig, folder: Path, out: Path) -> dict[str, Any]:
    """Run an audit, put its results in ``out`` and return its summary; see `run_experiment`."""
    return run_experiment(config, folder, out).summary
