"""Several results directories of one kind side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from bayescal.errors import InputError
from bayescal.experiments.frame.results import read_results
from bayescal.experiments.frame.run import find_results_kind
from bayescal.report.numbers import format_fixed

DECIMALS = 2


def compare_results(folders: Sequence[Path], kind: str | None = None) -> pd.DataFrame:
    """Return results of one kind side by side, as that kind compares them.

    Raises
    ------
    InputError
        Where a directory holds no results, kinds differ, or the kind finds them not comparable.
    """
    experiments = [find_results_kind(folder, kind) for folder in folders]
    for folder, experiment in zip(folders, experiments, strict=True):
        if type(experiment) is not type(experiments[0]):
            one, other = type(experiment).__name__, type(experiments[0]).__name__
            raise InputError(f"{folder}: found results of kind {one}, expected {other} as in {folders[0]}")
    return experiments[0].compare({str(folder): read_results(folder) for folder in folders})


def show_comparison(table: pd.DataFrame, console: Console) -> None:
    """Print a comparison; numbers are aligned to the right."""
    shown = Table()
    for name in table.columns:
        text = not pd.api.types.is_numeric_dtype(table[name])
        shown.add_column(str(name).replace("_", " "), justify="left" if text else "right", overflow="fold")
    for row in table.to_dict("records"):
        shown.add_row(*(_format(value) for value in row.values()))
    console.print(shown)


def _format(value: object) -> str:
    return format_fixed(value, DECIMALS) if isinstance(value, float) else str(value)
