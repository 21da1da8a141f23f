"""What the source of an experiment printed: values of criteria by label, criterion and number of poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.errors import InputError
from bayescal.experiments.selection.schema import SelectionConfig, label_of
from bayescal.files.csv_tables import read_table

KEY = ["label", "criterion", "n_poses"]


def read_published(config: SelectionConfig, folder: Path) -> pd.DataFrame | None:
    """Return the published values of criteria; None where no table is given.

    Raises
    ------
    InputError
        Where the table has other columns than label, criterion, n_poses and value, a value of zero or a row twice.
    """
    section = config.published
    if section is None or section.table is None:
        return None
    path = folder / section.table
    table = read_table(path, [*KEY, "value"])
    labels, criteria, numbers = table.text("label"), table.text("criterion"), table.numbers(["n_poses", "value"])
    for row in np.flatnonzero(numbers[:, 1] == 0.0):
        raise InputError(f"{table.where(int(row))}: value: found 0, expected another, for it is divided by")
    counts = numbers[:, 0].astype(int)
    keys = list(zip(labels, criteria, counts, strict=True))
    table.check_unique([(label, criterion, str(n)) for label, criterion, n in keys], "/".join(KEY))
    return pd.DataFrame({"label": labels, "criterion": criteria, "n_poses": counts, "published": numbers[:, 1]})


def check_published(config: SelectionConfig, published: pd.DataFrame | None) -> None:
    """Raise InputError where nothing that is selected was published."""
    if published is None:
        return
    keys = set(zip(published["label"], published["criterion"], published["n_poses"], strict=True))
    designs = {design.name for design in config.designs}
    if not _list_selected(config) & keys and not designs & set(published["label"]):
        raise InputError(
            "published.table: found nothing that [[selections]] has, expected its labels, criteria and n_poses"
        )


def _list_selected(config: SelectionConfig) -> set[tuple[str, str, int]]:
    """Return all that a config selects: labels, criteria, numbers of poses."""
    return {
        (label_of(choice), label_class(criterion), n)
        for choice in config.selections
        for criterion in choice.criteria
        for n in choice.n_poses
    }
