"""Variants against each other, by what each says of rows that it has not seen."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayescal.experiments.shared.estimate import Fit
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from arviz_stats.utils import ELPDDataLOO

TIED = 2.0
"""Standard errors of the difference of elpd within which two variants predict alike."""


def compare_variants(fits: Mapping[str, Fit]) -> pd.DataFrame:
    """Return elpd differences from the best variant with standard errors over the rows, and stacking weights.

    The densities of each row are taken relative to the best variant's there: neither differences nor weights change,
    and no exponential overflows.
    """
    from arviz_stats import compare

    left_out = {name: fit.left_out for name, fit in fits.items()}
    best = np.max([one.elpd for one in left_out.values()], axis=0)
    data = {name: _as_elpd_data(one.elpd - best, one.pareto_k) for name, one in left_out.items()}
    with warnings.catch_warnings():
        # bad poses are refitted or counted, and which variant to choose the evidence says
        warnings.simplefilter("ignore", UserWarning)
        return compare(data, method="stacking", round_to="none")


def _as_elpd_data(elpd: Array, pareto_k: Array) -> ELPDDataLOO:
    import xarray as xr
    from arviz_stats.utils import ELPDDataLOO

    n = len(elpd)
    pointwise, k = (xr.DataArray(values, dims=["row"]) for values in (elpd, pareto_k))
    se = float(np.sqrt(n * np.var(elpd)))
    return ELPDDataLOO(
        elpd=float(elpd.sum()),
        se=se,
        p=0.0,
        n_samples=0,
        n_data_points=n,
        scale="log",
        warning=False,
        good_k=PARETO_K_LIMIT,
        elpd_i=pointwise,
        pareto_k=k,
    )


def find_tied(comparison: pd.DataFrame) -> list[str]:
    """Return the variants whose elpd is within two standard errors of the best one's, that one first."""
    tied = comparison["elpd_diff"].abs() <= TIED * comparison["dse"]
    tied.iloc[0] = True
    return [str(name) for name in comparison.index[tied]]
