"""From a check's config to what is checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.density.legs import find_function_of_pose
from bayescal.errors import InputError
from bayescal.experiments.check.schema import CheckConfig
from bayescal.experiments.check.subject import Subject
from bayescal.experiments.frame.load import load
from bayescal.experiments.shared.measured import MeasuredVariant, measure_variants


@dataclass(frozen=True, eq=False)
class CheckInputs:
    """A check, read.

    Attributes
    ----------
    config : CheckConfig
    origin : str
        Of the data, in words.
    subjects : dict of str to Subject
        The study's variants that may be checked, by their names.
    """

    config: CheckConfig
    origin: str
    subjects: dict[str, Subject]


def read_check(config: CheckConfig, folder: Path) -> CheckInputs:
    """Return a check, read.

    Raises
    ------
    InputError
        Where the file calibrates no machine, its data cannot be simulated, or a variant is not there.
    """
    path = folder / config.study
    experiment, study = load(path)
    found = measure_variants(experiment, study, path, config.variants)
    for name, measured in found.items():
        if measured.posterior.errors.has_columns:
            raise InputError(
                f"{path}: variant {name!r}: found errors common to all rows, expected noise of single rows: checks "
                "have no errors that are functions"
            )
        if measured.legs is not None:
            _refuse_function(measured.legs, f"{path}: variant {name!r}")
    origin = next(iter(found.values())).origin.partition(": study ")[0]
    return CheckInputs(config, origin, {name: Subject(measured) for name, measured in found.items()})


def _refuse_function(measured: MeasuredVariant, where: str) -> None:
    """Raise InputError where legs err by a function of the pose."""
    posterior = measured.posterior
    function = find_function_of_pose(posterior, posterior.natural(np.zeros((1, posterior.n_parameters))))
    if function is not None:
        raise InputError(
            f"{where}: found kernel {function[0].name!r} of its model error, expected 'independent', or deformation "
            "'free_matrix' for linear errors: checks have no errors that are functions of the pose"
        )
