"""Variants against each other, by what each says of rows that it has not seen."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bayescal.inference.leave_one_out import LeftOut
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from arviz_stats.utils import ELPDDataLOO

TIED = 2.0
"""Standard errors of the difference of elpd within which two variants predict alike."""


def compare_variants(left_out: Mapping[str, LeftOut]) -> pd.DataFrame:
    """Return elpd differences from the best variant with standard errors over the rows, and stacking weights.

    The densities of each row are taken relative to the best variant's there: neither differences nor weights change,
    and no exponential overflows.
    """
    from arviz_stats import compare

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


def tabulate_comparison(variants: pd.DataFrame, left_out: Mapping[str, LeftOut], same: str) -> pd.DataFrame:
    """Return a table of variants with how each predicts rows left out, beside the others of the same rows.

    Parameters
    ----------
    variants : DataFrame
        A row per ``variant``.
    left_out : mapping of str to LeftOut
    same : str
        Column that is the same for variants of the same rows.
    """
    rows = []
    for _, some in variants.groupby(same, sort=False):
        group = {str(name): left_out[str(name)] for name in some["variant"]}
        several = compare_variants(group) if len(group) > 1 else None
        for name, one in group.items():
            elpd, se = one.summarise()
            rows.append(
                {
                    "variant": name,
                    "elpd_loo": elpd,
                    "elpd_loo_se": se,
                    "elpd_loo_difference": 0.0 if several is None else several["elpd_diff"][name],
                    "elpd_loo_difference_se": 0.0 if several is None else several["dse"][name],
                    "stacking_weight": 1.0 if several is None else several["weight"][name],
                    "loo_pareto_k_max": float(one.pareto_k.max()),
                    "loo_refitted": int(one.was_refitted.sum()),
                    "loo_unreliable": int(one.is_doubtful.sum()),
                }
            )
    return variants.merge(pd.DataFrame(rows), on="variant")
