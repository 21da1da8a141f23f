"""Bayesian identification of parallel-kinematic machines.

The names below are the way in from Python; they are imported when first used, so that the command line starts quickly.
"""

from __future__ import annotations

from importlib import import_module

_HOMES = {
    "BayescalError": "bayescal.errors",
    "InputError": "bayescal.errors",
    "NumericalError": "bayescal.errors",
    "Machine": "bayescal.kinematics",
    "MeasuredPoses": "bayescal.measured_poses",
    "Mechanism": "bayescal.mechanism",
    "PoseLikelihood": "bayescal.likelihood",
    "Posterior": "bayescal.posterior",
    "build_twin": "bayescal.simulation",
    "compute_audit": "bayescal.audit.run",
    "explore": "bayescal.inference.exploration",
    "extract_poses": "bayescal.photogrammetry.poses",
    "identify": "bayescal.least_squares",
    "load_audit": "bayescal.config",
    "load_experiment": "bayescal.config",
    "load_inputs": "bayescal.study.inputs",
    "load_mechanism": "bayescal.config",
    "load_simulation": "bayescal.config",
    "read_survey": "bayescal.photogrammetry.survey",
    "run_ensemble": "bayescal.inference.ensemble",
    "run_study": "bayescal.study.run",
    "simulate_survey": "bayescal.simulation",
    "solve_forward_kinematics": "bayescal.kinematics",
    "write_audit": "bayescal.audit.run",
    "write_report": "bayescal.report.write",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'bayescal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
