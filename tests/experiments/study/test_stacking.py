"""Stacked predictions of variants that predict alike, and differences of elpd with their standard errors."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.shared.stacking import compare_variants, find_tied, tabulate_comparison
from bayescal.experiments.study import tables
from bayescal.experiments.study.tables import describe_stacking
from bayescal.inference.leave_one_out import LeftOut

N_POSES, N_HELD, N_DRAWS = 40, 6, 400


class Inputs:
    """What stacking needs of a study's inputs."""

    verification = np.arange(N_POSES + N_HELD) >= N_POSES


def make_fit(rng, elpd, bias=0.0):
    """Return what a task finds whose prediction is off by a bias in x, from elpd of each calibration pose."""
    n = N_POSES + N_HELD
    error = np.zeros((n, 6))
    error[:, 0] = bias
    misfit = (error[:, None] + 0.01 * rng.standard_normal((n, N_DRAWS, 6))).astype(np.float32)
    low, high = np.quantile(error[:, None] - misfit, [0.05, 0.95], axis=1)
    left_out = LeftOut(elpd, np.full(N_POSES, 0.3), np.ones(N_POSES), np.full(N_POSES, np.nan))
    evaluated = {
        **{"error": error, "low": low, "high": high, "position_bound": np.full(n, 0.03)},
        "orientation_bound": np.full(n, 0.03),
        "misfit": misfit,
        "log_likelihood": rng.normal(30.0 - 100.0 * abs(bias), 0.1, (2, N_DRAWS // 2, n)),
    }
    return SimpleNamespace(left_out=left_out, evaluated=evaluated)


@pytest.fixture
def fits():
    """Return two variants that each predict half of the poses better and err to opposite sides, and a hopeless one."""
    rng = np.random.default_rng(1)
    first = 30.0 + np.where(np.arange(N_POSES) % 2, 1.0, -1.0)
    return {
        "left": make_fit(rng, first + 0.01, -0.02),
        "right": make_fit(rng, 60.0 - first, 0.02),
        "hopeless": make_fit(rng, first - 500.0, 1.0),
    }


def left_out_of(fits):
    return {name: fit.left_out for name, fit in fits.items()}


def test_differences_have_the_standard_errors_of_paired_poses(fits):
    table = compare_variants(left_out_of(fits))
    assert list(table.index) == ["left", "right", "hopeless"]
    difference = fits["right"].left_out.weighted - fits["left"].left_out.weighted
    assert table["elpd_diff"]["right"] == pytest.approx(difference.sum())
    assert table["dse"]["right"] == pytest.approx(np.sqrt(N_POSES * difference.var()))
    assert table["elpd_diff"]["hopeless"] == pytest.approx(-N_POSES * 500.01)


def test_a_pose_that_was_refitted_counts_by_its_run(fits):
    fits["right"].left_out.refitted[3] = 100.0
    assert compare_variants(left_out_of(fits)).index[0] == "right"


def test_variants_within_two_standard_errors_tie(fits):
    assert find_tied(compare_variants(left_out_of(fits))) == ["left", "right"]


def test_the_stacked_prediction_is_better_than_either(fits):
    found = describe_stacking(Inputs, fits)
    assert set(found["weights"]) == {"left", "right"}
    assert found["weights"]["left"] == pytest.approx(0.5, abs=0.02)
    for use in ("calibration", "verification"):
        assert found[use]["position_error_mm"]["mean"] < 0.002  # each by itself: 0.02
        assert found[use]["interval_90_coverage"] == 1.0
    joint = [tables._joint_density(fits[name], Inputs.verification) for name in ("left", "right")]
    assert min(joint) < found["elpd"] < max(joint)


def test_one_that_leads_alone_is_not_stacked(fits):
    assert describe_stacking(Inputs, {name: fits[name] for name in ("left", "hopeless")}) is None


def test_a_table_says_how_each_predicts_beside_the_best(fits):
    variants = pd.DataFrame({"variant": [*fits, "alone"], "data": [*["same"] * 3, "other"], "n": range(4)})
    left_out = left_out_of(fits) | {"alone": fits["left"].left_out}
    table = tabulate_comparison(variants, left_out, "data").set_index("variant")
    assert list(table.index) == [*fits, "alone"]
    same = table.loc[list(fits)]
    assert same["stacking_weight"].sum() == pytest.approx(1.0, abs=0.01)
    assert same["elpd_loo_difference"].max() == 0.0
    assert table["elpd_loo"]["left"] == pytest.approx(fits["left"].left_out.weighted.sum())
    assert table["stacking_weight"]["alone"] == 1.0
