"""Bayesian identification of parallel-kinematic machines.

The names below are the way in from Python; they are imported when first used, so that the command line starts quickly.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version

_HOMES = {
    "BayescalError": "bayescal.errors",
    "InputError": "bayescal.errors",
    "NumericalError": "bayescal.errors",
    "Audit": "bayescal.loaded",
    "Data": "bayescal.front",
    "audit": "bayescal.front",
    "calibrate": "bayescal.front",
    "load_machine": "bayescal.front",
    "next_pose": "bayescal.front",
    "simulate": "bayescal.front",
    "CalibratedMachine": "bayescal.calibrated.machine",
    "Channel": "bayescal.machines.readings",
    "Coordinate": "bayescal.machines.readings",
    "Instrument": "bayescal.machines.readings",
    "Machine": "bayescal.machines.kinematics",
    "MeasuredPoses": "bayescal.data.measured_poses",
    "Mechanism": "bayescal.machines.mechanism",
    "ParameterBlock": "bayescal.machines.parameters",
    "PoseLikelihood": "bayescal.density.pose_likelihood",
    "Posterior": "bayescal.density.posterior",
    "ReadingMachine": "bayescal.machines.readings",
    "Section": "bayescal.config.sections",
    "StudyInputs": "bayescal.experiments.study.inputs",
    "StudyResult": "bayescal.loaded",
    "build_twin": "bayescal.experiments.simulation.twin",
    "command_poses": "bayescal.calibrated.predict",
    "compute_audit": "bayescal.api",
    "draw_poses": "bayescal.calibrated.predict",
    "explore": "bayescal.inference.exploration",
    "export_machine": "bayescal.calibrated.export",
    "extract_poses": "bayescal.data.photogrammetry.poses",
    "identify": "bayescal.density.least_squares",
    "load_audit": "bayescal.experiments.audit.load",
    "load_calibrated": "bayescal.experiments.shared.calibrating",
    "load_experiment": "bayescal.experiments.frame.load",
    "load_inputs": "bayescal.experiments.study.load",
    "load_results": "bayescal.loaded",
    "load_mechanism": "bayescal.machines.read",
    "predict_poses": "bayescal.calibrated.predict",
    "read_survey": "bayescal.data.photogrammetry.survey",
    "run_ensemble": "bayescal.inference.ensemble",
    "run_experiment": "bayescal.experiments.frame.run",
    "run_study": "bayescal.api",
    "sample_posterior": "bayescal.inference.sampling",
    "simulate_survey": "bayescal.experiments.simulation.twin",
    "solve_forward_kinematics": "bayescal.machines.kinematics",
    "solve_inverse_kinematics": "bayescal.machines.kinematics",
    "tabulate_jacobian": "bayescal.identifiability.jacobian",
    "write_audit": "bayescal.api",
    "write_report": "bayescal.experiments.frame.run",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":  # stands in pyproject.toml alone
        return version("bayescal")
    if name not in _HOMES:
        raise AttributeError(f"module 'bayescal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
