"""Bayesian calibration of mechanisms.

The names below are the way in from Python, in the order in which they are needed; each is imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version

_HOMES = {
    "load_machine": "bayescal.front",
    "audit": "bayescal.front",
    "simulate": "bayescal.front",
    "Data": "bayescal.front",
    "calibrate": "bayescal.front",
    "StudyResult": "bayescal.loaded",
    "next_pose": "bayescal.front",
    "load_results": "bayescal.loaded",
    "load_calibrated": "bayescal.experiments.shared.calibrating",
    "CalibratedMachine": "bayescal.calibrated.machine",
    "predict_poses": "bayescal.calibrated.predict",
    "command_poses": "bayescal.calibrated.predict",
    "export_machine": "bayescal.calibrated.formats",
    "load_experiment": "bayescal.experiments.frame.load",
    "run_experiment": "bayescal.front",
    "ReadingMachine": "bayescal.machines.readings",
    "ParameterBlock": "bayescal.machines.parameters",
    "Coordinate": "bayescal.machines.readings",
    "Channel": "bayescal.machines.readings",
    "Instrument": "bayescal.machines.readings",
    "ErrorTerm": "bayescal.density.calibration.terms",
    "Section": "bayescal.config.sections",
    "BayescalError": "bayescal.errors",
    "InputError": "bayescal.errors",
    "NumericalError": "bayescal.errors",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":  # stands in pyproject.toml alone
        return version("bayescal")
    if name not in _HOMES:
        raise AttributeError(f"module 'bayescal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
