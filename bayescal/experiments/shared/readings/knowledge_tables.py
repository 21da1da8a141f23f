"""What readings tell as rows of tables, of a calibration or of its audit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import Knowledge
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units


def name_data(variant: Variant) -> str:
    """Return which readings a variant takes in, in words that are the same for the same ones."""
    kinds = dict.fromkeys(one.kind for one in variant.model.channels)
    return f"{' '.join(kinds)}, {variant.data.n_poses} poses, {int(variant.data.present.sum())} readings"


def tabulate_accuracy(variant: Variant, known: Knowledge, units: UnitsConfig) -> pd.DataFrame:
    """Return the standard uncertainty of a variant's tool, a coordinate a row; places in the config's units."""
    return pd.DataFrame(
        {
            "variant": variant.name,
            "coordinate": known.coordinates,
            "unit": known.units,
            "before": known.before,
            "after": known.after,
            "noise": known.noise,
            "worst": known.worst,
            "worst_at": [name_place(variant, pose, units) for pose in known.worst_pose],
        }
    )


def name_place(variant: Variant, pose: Array, asked: UnitsConfig) -> str:
    """Return where a pose is, coordinate by coordinate, in the units of a config."""
    units = Units(asked.length, asked.angle)
    return ", ".join(
        f"{one.name} = {value / units.factor(one.unit):.4g} {units.name(one.unit)}"
        for one, value in zip(variant.model.coordinates, pose, strict=True)
    )


def list_ridges(variant: Variant, known: Knowledge) -> Iterator[dict[str, Any]]:
    """Return the combinations that a variant does not tell."""
    for name, share, text in known.ridges:
        yield {"variant": variant.name, "parameter": name, "contraction": share, "sentence": text}


def list_next(variant: Variant, known: Knowledge) -> Iterator[dict[str, Any]]:
    """Return where to measure next, by what part the mean squared error would fall."""
    for pose, sensors, gain in zip(known.next_pose, known.next_sensors, known.next_gain, strict=True):
        coordinates = {f"{c.name}_{c.unit}": pose[k] for k, c in enumerate(variant.model.coordinates)}
        yield {"variant": variant.name, "sensors": sensors, **coordinates, "gain": gain}


def plain(row: dict[Any, Any]) -> dict[str, Any]:
    """Return a row with None for what is no number."""
    return {str(k): None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
