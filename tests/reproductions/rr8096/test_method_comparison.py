"""The comparison of the pose methods: fair, calibrated, and its finding."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import studies
from papers import pose_methods

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment

compare_pose_methods, summarise_comparison = pose_methods.compare_pose_methods, pose_methods.summarise_comparison
ERRORS = ["position_error_mm", "orientation_error_deg", "axis_error_deg", "whitened_squared_error"]


@pytest.fixture(scope="module")
def comparison():
    return compare_pose_methods((6, 13, 20), 150, 50.0, 1.0, 0.005, np.random.default_rng(8096))


def test_rows_and_columns(comparison):
    assert list(comparison.columns) == ["method", "n_targets", "repeat", *ERRORS]
    assert comparison.groupby(["method", "n_targets"])["repeat"].nunique().tolist() == [150] * 6


def test_targets_are_on_the_cylinder():
    targets = pose_methods.draw_cylinder_targets(500, 50.0, 1.0, np.random.default_rng(1))
    np.testing.assert_allclose(np.hypot(targets[:, 0], targets[:, 1]), 1.0)
    assert 0 <= targets[:, 2].min() < 2
    assert 48 < targets[:, 2].max() <= 50


def test_whitened_errors_have_mean_six(comparison):
    for _, rows in comparison.groupby("method"):
        assert abs(rows["whitened_squared_error"].mean() - 6) < 3.5 * np.sqrt(12 / len(rows))


def test_barycentre_errors_are_those_of_a_mean(comparison):
    squares = comparison["position_error_mm"] ** 2 * comparison["n_targets"] / 0.005**2
    for (method, n_targets), rows in squares.groupby([comparison["method"], comparison["n_targets"]]):
        expected = 3.0 if method == "line" else 3.0 / 0.96
        assert abs(rows.mean() - expected) < 4 * np.sqrt(6 / len(rows)), (method, n_targets)


def test_robust_fit_finds_the_rotation_about_the_axis_better(comparison):
    """RR-8096 figure 5: same position, better orientation with the robust fit, the more so with more targets."""
    mean = comparison.groupby(["method", "n_targets"])[ERRORS].mean()
    ratio = mean.loc["line"] / mean.loc["robust"]
    assert ratio["orientation_error_deg"].loc[6] > 1.2
    assert ratio["orientation_error_deg"].loc[20] > 2.0
    assert np.all(np.abs(ratio["position_error_mm"] - 1) < 0.05)
    assert np.all(mean["axis_error_deg"] < 0.25 * mean["orientation_error_deg"])


def test_same_generator_state_gives_the_same_table():
    tables = [compare_pose_methods([6], 3, 50.0, 1.0, 0.005, np.random.default_rng(seed)) for seed in (5, 5, 6)]
    assert tables[0].equals(tables[1])
    assert not tables[0].equals(tables[2])


def test_summary_is_mean_and_standard_deviation(comparison):
    summary = summarise_comparison(comparison)
    chosen = comparison.query("method == 'line' and n_targets == 13")["axis_error_deg"].to_numpy()
    row = summary.query("method == 'line' and n_targets == 13").iloc[0]
    assert row["axis_error_deg_mean"] == pytest.approx(chosen.mean())
    assert row["axis_error_deg_sd"] == pytest.approx(chosen.std(ddof=1))
    assert len(summary) == 6


def test_figure_shows_the_means(comparison):
    summary = summarise_comparison(comparison)
    position, orientation = pose_methods.draw_pose_methods(summary).axes
    assert position.get_yscale() == "linear"
    assert orientation.get_yscale() == "log"
    assert "µm" in position.get_ylabel()
    assert "degrees" in orientation.get_ylabel()
    line = position.containers[0].lines[0]
    expected = 1000 * summary.query("method == 'line'")["position_error_mm_mean"]
    np.testing.assert_allclose(line.get_ydata(), expected)


def test_shipped_experiment_runs_tiny(tmp_path, pictures):
    """Tables as computed, the means in the summary, and a page with the figure."""
    path = studies.copy_small(studies.EXPERIMENTS / "rr8096" / "figure5.toml", tmp_path / "in")
    config, out = load_experiment(path), tmp_path / "out"
    finished = run_experiment(config, path.parent, out)
    expected = compare_pose_methods(
        config.n_targets,
        config.repeats,
        config.length_mm,
        config.radius_mm,
        1e-3 * config.target_noise_um,
        np.random.default_rng(config.seed),
    )
    repeats = pd.read_csv(out / "repeats.csv")
    pd.testing.assert_frame_equal(repeats, expected, rtol=1e-8)
    pd.testing.assert_frame_equal(pd.read_csv(out / "summary.csv"), summarise_comparison(expected), rtol=1e-8)
    means = expected.groupby("method")[ERRORS[:3]].mean()
    for method, errors in finished.summary["mean_errors"].items():
        assert errors == pytest.approx(means.loc[method].to_dict())
    ratio = means.loc["line", "orientation_error_deg"] / means.loc["robust", "orientation_error_deg"]
    assert f"{ratio:.3g}"[:3] in finished.page.headline
    assert (out / "figures" / "figure5.png").stat().st_size > 0
    assert "figure 5" in (out / "report.html").read_text(encoding="utf-8")


def test_no_repeats_is_an_input_error():
    with pytest.raises(InputError, match="found 0 repeats"):
        compare_pose_methods([6], 0, 50.0, 1.0, 0.005, np.random.default_rng(1))
