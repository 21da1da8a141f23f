"""Values from elsewhere, to look at beside a calibration: they stay out of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.errors import InputError, say_unknown
from bayescal.experiments.shared.readings.schema import ReferenceValuesConfig
from bayescal.files.csv_tables import read_table
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import units_like

COLUMNS = ("quantity", "unit", "value")
OF_TRUTH = "parameter"  # instead of the first, in true parameters as a simulation writes them


@dataclass(frozen=True, eq=False)
class ReferenceValues:
    """Values of parameters, or of channels read where all coordinates are zero."""

    title: str
    source: str
    quantities: tuple[str, ...]
    units: tuple[str, ...]  # inner ones
    values: Array  # with sd, (n,): NaN for a deviation that is not known
    sd: Array

    def evaluate(self, model: ReadingModel, theta: Array) -> Array:
        """Return the same quantities of machines (T, D), shape (T, n)."""
        names = model.layout.names
        unknown = {name: np.full(len(theta), np.nan) for name in model.given}  # for channels that do not depend on it
        read = model.read(theta, np.zeros((len(theta), len(model.coordinates))), unknown)
        columns = [
            theta[:, names.index(one)] if one in names else read[:, model.names.index(one)] for one in self.quantities
        ]
        return np.stack(columns, axis=1)


def read_beside(section: ReferenceValuesConfig, folder: Path, model: ReadingModel) -> ReferenceValues:
    """Return the values of a file; InputError for an unknown quantity or a unit of another kind."""
    path = folder / section.file
    table = read_table(path, None)
    columns = (OF_TRUTH, *COLUMNS[1:]) if OF_TRUTH in table.columns else COLUMNS
    for name in table.columns:
        if name not in (*columns, "sd"):
            raise InputError(f"{path}: found column {name!r}, expected {', '.join(COLUMNS)}, sd")
    for name in columns:
        if name not in table.columns:
            raise InputError(f"{path}: found no column {name!r}, expected {', '.join(COLUMNS)}")
    own = dict(zip(model.layout.names, model.layout.units, strict=True))
    own |= {one.name: one.unit for one in model.channels}
    factors, units = [], []
    for row, (name, unit) in enumerate(zip(table.text(columns[0]), table.text("unit"), strict=True)):
        if name not in own:
            raise InputError(say_unknown(f"{table.where(row)}: quantity", name, own))
        if unit not in units_like(own[name]):
            raise InputError(f"{table.where(row)}: unit: found {unit!r}, expected {' or '.join(units_like(own[name]))}")
        factors.append(units_like(own[name])[unit])
        units.append(own[name])
    values = table.numbers(("value",))[:, 0] * factors
    sd = table.numbers(("sd",), gaps=True)[:, 0] * factors if "sd" in table.columns else np.full(len(values), np.nan)
    return ReferenceValues(section.title, section.source, tuple(table.text(columns[0])), tuple(units), values, sd)
