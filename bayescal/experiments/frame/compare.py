"""Several results directories of one kind side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.frame.load import AnyExperiment
from bayescal.experiments.frame.results import read_results
from bayescal.experiments.frame.run import find_results_kind


def compare_results(folders: Sequence[Path], trust: bool = False) -> tuple[AnyExperiment, pd.DataFrame]:
    """Return the kind of results, and what it says of them side by side.

    Raises
    ------
    InputError
        Where a directory holds no results, kinds differ, or the kind finds them not comparable.
    """
    results = {str(folder): read_results(folder) for folder in folders}
    kinds = [one.provenance.get("kind") for one in results.values()]
    for folder, kind in zip(results, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(
                f"{folder}: found results of kind {kind!r}, expected {kinds[0]!r} as in {folders[0]}: evidences "
                "compare only of the same data, which tables of two kinds do not show"
            )
    experiment = find_results_kind(folders[0], trust)
    return experiment, experiment.compare(results)
