"""Several results directories of one kind side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.load import AnyExperiment
from bayescal.experiments.frame.results import read_results
from bayescal.experiments.frame.run import find_results_kind


def compare_results(folders: Sequence[Path], kind: str | None = None) -> tuple[AnyExperiment, pd.DataFrame]:
    """Return the kind of results, and what it says of them side by side.

    Raises
    ------
    InputError
        Where a directory holds no results, kinds differ, or the kind finds them not comparable.
    """
    experiments = [find_results_kind(folder, kind) for folder in folders]
    for folder, experiment in zip(folders, experiments, strict=True):
        if type(experiment) is not type(experiments[0]):
            one, other = type(experiment).__name__, type(experiments[0]).__name__
            raise InputError(
                f"{folder}: found results of kind {one}, expected {other} as in {folders[0]}: evidences compare only "
                "of the same data, which tables of two kinds do not show"
            )
    return experiments[0], experiments[0].compare({str(folder): read_results(folder) for folder in folders})
