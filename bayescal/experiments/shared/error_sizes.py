"""Units in which results state what is unknown: sizes of a model error are no lengths where the tool has none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from bayescal.density.calibration.model_error import OF_NOISE
from bayescal.density.priors import LENGTH, is_model_error
from bayescal.experiments.shared.function_errors import has_lengths
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

NOISE: Final = "noise"
"""Unit of sizes that are multiples of the noise of the machine's own channels."""


def find_units(model: ReadingModel, names: Sequence[str], units: Sequence[str]) -> tuple[Array, tuple[str, ...]]:
    """Return factors (n,) from inner units of parameters and errors to those in which results state them, and these.

    A size of a model error is inside in mm at the tool. Where the tool has no lengths it is a multiple of the noise.
    """
    own = np.zeros(len(names), dtype=bool)
    if not has_lengths(model):
        own |= [is_model_error(name) and not name.startswith(LENGTH) for name in names]
    shown = tuple(NOISE if mine else unit for mine, unit in zip(own, units, strict=True))
    return np.where(own, 1.0 / OF_NOISE, 1.0), shown
