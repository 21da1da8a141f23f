"""Bayesian identification of parallel-kinematic machines.

The names below are the way in from Python; they are imported when first used, so that the command line starts quickly.
"""

from __future__ import annotations

from importlib import import_module

_HOMES = {
    "BayescalError": "bayescal.errors",
    "InputError": "bayescal.errors",
    "NumericalError": "bayescal.errors",
    "Machine": "bayescal.machines.kinematics",
    "MeasuredPoses": "bayescal.data.measured_poses",
    "Mechanism": "bayescal.machines.mechanism",
    "PoseLikelihood": "bayescal.density.likelihood",
    "Posterior": "bayescal.density.posterior",
    "build_twin": "bayescal.data.simulation",
    "compute_audit": "bayescal.experiments.audit.run",
    "explore": "bayescal.inference.exploration",
    "extract_poses": "bayescal.data.photogrammetry.poses",
    "identify": "bayescal.density.least_squares",
    "load_audit": "bayescal.config",
    "load_experiment": "bayescal.config",
    "load_inputs": "bayescal.experiments.study.inputs",
    "load_mechanism": "bayescal.config",
    "load_simulation": "bayescal.config",
    "read_survey": "bayescal.data.photogrammetry.survey",
    "run_ensemble": "bayescal.inference.ensemble",
    "run_study": "bayescal.experiments.study.run",
    "simulate_survey": "bayescal.data.simulation",
    "solve_forward_kinematics": "bayescal.machines.kinematics",
    "write_audit": "bayescal.experiments.audit.run",
    "write_report": "bayescal.experiments.study.page.write",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'bayescal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
