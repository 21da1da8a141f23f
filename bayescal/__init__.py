"""Bayesian calibration of mechanisms.

The names below are the way in from Python, in the order in which they are needed; each is imported when first used.
"""

from __future__ import annotations

import sys

from bayescal.search_path import list_elsewhere

if sys.argv[:1] == ["-m"]:  # `python -m bayescal`, before anything else is imported
    sys.path[:] = list_elsewhere()

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # type checkers and editors do not call __getattr__
    from bayescal.api import (
        Data as Data,
    )
    from bayescal.api import (
        audit as audit,
    )
    from bayescal.api import (
        calibrate as calibrate,
    )
    from bayescal.api import (
        next_pose as next_pose,
    )
    from bayescal.api import (
        run_experiment as run_experiment,
    )
    from bayescal.api import (
        simulate as simulate,
    )
    from bayescal.calibrated.formats import export_machine as export_machine
    from bayescal.calibrated.machine import CalibratedMachine as CalibratedMachine
    from bayescal.calibrated.predict import compensate_poses as compensate_poses
    from bayescal.calibrated.predict import predict_poses as predict_poses
    from bayescal.config.sections import Section as Section
    from bayescal.config.trust import trust as trust
    from bayescal.data.reader import TableReader as TableReader
    from bayescal.density.calibration.terms import ErrorTerm as ErrorTerm
    from bayescal.errors import (
        BayescalError as BayescalError,
    )
    from bayescal.errors import (
        InputError as InputError,
    )
    from bayescal.errors import (
        NumericalError as NumericalError,
    )
    from bayescal.experiments.runner.load import load_experiment as load_experiment
    from bayescal.experiments.shared.calibrating import load_calibrated as load_calibrated
    from bayescal.machine_files import load_machine as load_machine
    from bayescal.machines.parameters import ParameterBlock as ParameterBlock
    from bayescal.machines.readings import (
        Channel as Channel,
    )
    from bayescal.machines.readings import (
        Coordinate as Coordinate,
    )
    from bayescal.machines.readings import (
        Instrument as Instrument,
    )
    from bayescal.machines.readings import (
        ReadingMachine as ReadingMachine,
    )
    from bayescal.results import (
        LoadedResults as LoadedResults,
    )
    from bayescal.results import (
        StudyResult as StudyResult,
    )
    from bayescal.results import (
        VariantResult as VariantResult,
    )
    from bayescal.results import (
        load_results as load_results,
    )

_HOMES = {
    "trust": "bayescal.config.trust",
    "load_machine": "bayescal.machine_files",
    "audit": "bayescal.api",
    "simulate": "bayescal.api",
    "Data": "bayescal.api",
    "calibrate": "bayescal.api",
    "StudyResult": "bayescal.results",
    "next_pose": "bayescal.api",
    "LoadedResults": "bayescal.results",
    "VariantResult": "bayescal.results",
    "load_results": "bayescal.results",
    "load_calibrated": "bayescal.experiments.shared.calibrating",
    "CalibratedMachine": "bayescal.calibrated.machine",
    "predict_poses": "bayescal.calibrated.predict",
    "compensate_poses": "bayescal.calibrated.predict",
    "export_machine": "bayescal.calibrated.formats",
    "load_experiment": "bayescal.experiments.runner.load",
    "run_experiment": "bayescal.api",
    "ReadingMachine": "bayescal.machines.readings",
    "ParameterBlock": "bayescal.machines.parameters",
    "Coordinate": "bayescal.machines.readings",
    "Channel": "bayescal.machines.readings",
    "Instrument": "bayescal.machines.readings",
    "TableReader": "bayescal.data.reader",
    "ErrorTerm": "bayescal.density.calibration.terms",
    "Section": "bayescal.config.sections",
    "BayescalError": "bayescal.errors",
    "InputError": "bayescal.errors",
    "NumericalError": "bayescal.errors",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":  # stands in pyproject.toml alone
        from importlib.metadata import version

        return version("bayescal")
    if name not in _HOMES:
        raise AttributeError(f"module 'bayescal' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
