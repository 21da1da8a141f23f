"""Values over repeats as rows of a table and as plain numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayescal.numerics.geometry import Array

PERCENTILES = (2.5, 50.0, 97.5)


def list_records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows of a table without what is not known, which JSON has no number for."""
    return [{str(k): v for k, v in row.items() if not pd.isna(v)} for row in table.to_dict("records")]


def describe(values: Array, published: float | None = None) -> dict[str, float]:
    """Return mean, standard error and percentiles of values; of a published one, what share lies below it."""
    low, middle, high = np.percentile(values, PERCENTILES)
    found = {
        "mean": float(np.mean(values)),
        "standard_error": float(np.std(values, ddof=1) / np.sqrt(len(values))),
        "low": float(low),
        "median": float(middle),
        "high": float(high),
    }
    if published is None or np.isnan(published):
        return found
    return found | {"published": published, "share_below": float(np.mean(values < published))}
