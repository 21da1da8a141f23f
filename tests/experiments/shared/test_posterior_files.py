"""Saved readings as ArviZ takes them: LOO-PIT of every reading with its whole row left out, whatever was not read."""

from __future__ import annotations

import arviz as az
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from arviz_stats import loo_pit

from bayescal.experiments.shared.posterior_files import ReadingLayout, make_dataset

N_ROWS, SHAPE = 30, (4, 250)


def build_tree(rng, present):
    """Return the tree of two channels that both read a mean which is known to ± 0.1, with noise 1."""
    n = present.shape[1]
    mean, observed = 0.1 * rng.normal(size=SHAPE), rng.normal(size=(N_ROWS, n))
    density = -0.5 * ((observed - mean[..., None, None]) ** 2 * present).sum(axis=-1)
    replicated = mean[..., None, None] + rng.normal(size=(*SHAPE, N_ROWS, n))
    names = tuple(f"P{k}" for k in range(N_ROWS))
    layout = ReadingLayout(names, ("s", "d"), ("mm", "us"), present)
    groups = layout.arrange(np.where(present, observed, np.nan), replicated, replicated[:1, :50], density)
    posterior = make_dataset({"mean": ((), mean, "mm", "")}, drawn=True)
    return xr.DataTree.from_dict({"posterior": posterior, **groups}), density, observed, replicated


@pytest.mark.parametrize("gaps", [False, True])
def test_loo_pit_is_that_of_the_row_left_out(rng, tmp_path, gaps):
    present = np.ones((N_ROWS, 2), dtype=bool)
    present[::3, 1] = not gaps
    tree, density, observed, replicated = build_tree(rng, present)
    tree.to_netcdf(tmp_path / "tree.nc", engine="h5netcdf")
    with xr.open_datatree(tmp_path / "tree.nc", engine="h5netcdf") as saved:
        tree = saved.load()
    az.plot_loo_pit(tree)
    plt.close("all")
    weights = np.exp(-(density - density.max(axis=(0, 1)))).reshape(-1, N_ROWS, 1)
    below = (replicated < observed).reshape(-1, N_ROWS, 2)
    expected = ((weights * below).sum(axis=0) / weights.sum(axis=0))[present]
    np.testing.assert_allclose(loo_pit(tree)["readings"].to_numpy().ravel(), expected, atol=0.01)
    assert az.loo(tree).n_data_points == N_ROWS  # a row is what is left out and compared
    assert (expected > 0.001).all()


@pytest.mark.parametrize("gaps", [False, True])
def test_readings_keep_row_channel_and_unit(rng, gaps):
    present = np.ones((N_ROWS, 2), dtype=bool)
    present[4, 0] = not gaps
    found = build_tree(rng, present)[0]["observed_data"].to_dataset()["readings"]
    assert found.size == present.sum()
    units = found["unit"].where(found["channel"] == "d", drop=True)
    assert set(units.to_numpy().tolist()) == {"us"}
