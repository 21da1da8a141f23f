"""What ArviZ has to do with every saved posterior, without a warning and without being told where anything is."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

import arviz as az
import matplotlib.pyplot as plt
import pandas as pd
import pytest
import xarray as xr

PLOTS = ("plot_ppc_dist", "plot_loo_pit", "plot_prior_posterior", "plot_rank")
GROUPS = {
    *("posterior", "prior", "log_prior", "log_likelihood", "sample_stats", "observed_data"),
    *("posterior_predictive", "prior_predictive"),
}


def read_tree(path: Path) -> xr.DataTree:
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        return tree.load()


def plot_everything(tree: xr.DataTree) -> None:
    for name in PLOTS:
        getattr(az, name)(tree)
        plt.close("all")


def scale_power(tree: xr.DataTree) -> pd.DataFrame:
    """Return ArviZ's table; that it logs advice where the prior decides is no warning."""
    logger = logging.getLogger("arviz_stats.psense")
    logger.disabled = True
    try:
        return az.psense_summary(tree, round_to=9)
    finally:
        logger.disabled = False


def check_tree(path: Path, k_is_good: bool = True) -> xr.DataTree:
    """Return a saved tree after ArviZ has plotted, scaled and compared it.

    With few poses and many parameters ArviZ rightly warns of Pareto k; of nothing else.
    """
    tree = read_tree(path)
    assert set(tree.children) >= GROUPS
    for node in tree.subtree:
        for name, variable in node.data_vars.items():
            assert variable.attrs["units"], f"{node.path}/{name}"
    plot_everything(tree)
    assert not scale_power(tree)["prior"].isna().any()
    with warnings.catch_warnings():
        if not k_is_good:
            warnings.filterwarnings("ignore", message="Estimated shape parameter of Pareto")
        table = az.compare({"one": tree, "other": tree})
    assert table["elpd_diff"].abs().max() == pytest.approx(0.0)
    return tree
