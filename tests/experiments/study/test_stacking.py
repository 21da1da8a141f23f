"""Weights of variants that predict alike, and differences of elpd with their standard errors."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.study.tables import compare_variants, tabulate_comparison
from bayescal.inference.leave_one_out import LeaveOneOut

N_POSES = 40


def leave_out(elpd):
    """Return what leaving each pose out tells."""
    return LeaveOneOut(elpd, np.full(N_POSES, 0.3), np.ones(N_POSES), np.full(N_POSES, np.nan))


@pytest.fixture
def fits():
    """Return two variants that each predict half of the poses better, and a hopeless one."""
    first = 30.0 + np.where(np.arange(N_POSES) % 2, 1.0, -1.0)
    return {"left": leave_out(first + 0.01), "right": leave_out(60.0 - first), "hopeless": leave_out(first - 500.0)}


def test_differences_have_the_standard_errors_of_paired_poses(fits):
    table = compare_variants(fits)
    assert list(table.index) == ["left", "right", "hopeless"]
    difference = fits["right"].weighted - fits["left"].weighted
    assert table["elpd_diff"]["right"] == pytest.approx(difference.sum())
    assert table["dse"]["right"] == pytest.approx(np.sqrt(N_POSES * difference.var()))
    assert table["elpd_diff"]["hopeless"] == pytest.approx(-N_POSES * 500.01)


def test_a_pose_that_was_refitted_counts_by_its_run(fits):
    fits["right"].refitted[3] = 100.0
    assert compare_variants(fits).index[0] == "right"


def test_a_table_says_how_each_predicts_beside_the_best(fits):
    variants = pd.DataFrame({"variant": [*fits, "alone"], "data_set": [*["same"] * 3, "other"], "n": range(4)})
    left_out = fits | {"alone": fits["left"]}
    table = tabulate_comparison(variants, left_out).set_index("variant")
    assert list(table.index) == [*fits, "alone"]
    same = table.loc[list(fits)]
    assert same["stacking_weight"].sum() == pytest.approx(1.0, abs=0.01)
    assert same["elpd_loo_difference"].max() == 0.0
    assert table["elpd_loo"]["left"] == pytest.approx(fits["left"].weighted.sum())
    assert table["stacking_weight"]["alone"] == 1.0
