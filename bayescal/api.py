"""Experiments from Python by the names of their kinds; the frame does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.frame.results import Results
from bayescal.experiments.frame.run import Finished, compute_experiment, run_experiment
from bayescal.experiments.study.schema import StudyConfig


def run_study(config: StudyConfig, folder: Path, out: Path, workers: int = 1, resume: bool = False) -> Finished:
    """Run a study and put its results in ``out``; see `run_experiment`."""
    return run_experiment(config, folder, out, workers, resume)


def compute_audit(config: AuditConfig, folder: Path) -> Results:
    """Return everything an audit says, I-optimal poses among what would help, without writing anything."""
    return compute_experiment(config, folder)


def write_audit(config: AuditConfig, folder: Path, out: Path) -> dict[str, Any]:
    """Run an audit, put its results in ``out`` and return its summary; see `run_experiment`."""
    return run_experiment(config, folder, out).summary
