"""Bayesian calibration of mechanisms.

The names below are the way in from Python, in the order in which they are needed; each is imported when first used.
"""

from __future__ import annotations

import os
import sys


def list_elsewhere() -> list[str]:
    """Return `sys.path` without the current folder, from which nothing is imported unless bayescal itself lies there.

    Python puts it first for ``python -m`` and at a prompt: a stranger's file with a library's name would be run.
    """
    try:  # of os.path, which has been imported already: a library's name may be that of such a file
        here, own = os.path.realpath(os.curdir), os.path.realpath(f"{__file__}/../..")
    except OSError:  # a folder that is gone
        return sys.path[:]
    return [one for one in sys.path if here == own or os.path.realpath(one or os.curdir) != here]


if sys.argv[:1] == ["-m"]:  # `python -m bayescal`, before anything else is imported
    sys.path[:] = list_elsewhere()

from importlib import import_module  # noqa: E402
from importlib.metadata import version  # noqa: E402

_HOMES = {
    "trust": "bayescal.config.trust",
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
