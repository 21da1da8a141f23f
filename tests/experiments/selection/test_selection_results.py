"""The committed results of the shipped experiments hold their selections, and what is claimed of them."""

from __future__ import annotations

import json

import pandas as pd
import pytest
import studies

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.selection.schema import label_of

RESULTS = studies.EXPERIMENTS.parent / "results"
NAMES = ("yu2023/table1", "pose_selection/rr8096_figure14", "pose_selection/hexapod_i_optimal")


def read(name: str, table: str) -> pd.DataFrame:
    return pd.read_csv(RESULTS / name / f"{table}.csv")


@pytest.mark.parametrize("experiment", NAMES)
def test_results_hold_all_selections(experiment):
    config = load_experiment(studies.EXPERIMENTS / f"{experiment}.toml")
    summary = json.loads((RESULTS / config.name / "summary.json").read_text(encoding="utf-8"))
    assert summary["name"] == config.name
    assert summary["headline"]
    chosen = {(label_of(c), name, n) for c in config.selections for name in c.criteria for n in c.n_poses}
    table = read(config.name, "selection_summary")
    assert {tuple(row) for row in table[["label", "criterion", "n_poses"]].itertuples(index=False)} >= chosen


def test_published_indices_are_reached():
    table = read("pose_selection_table1", "published")
    assert len(table) == 30
    assert (table["ratio"] > 0.9995).all()


def test_order_of_figure_14_from_15_poses_on():
    table = read("pose_selection_figure14", "error_summary").set_index(["name", "n_poses"])
    error = table["mean_position_um"]
    for n in (15, 20, 40):
        assert error["continuous", n] < 0.95 * error["exchange", n]
        assert error["exchange", n] < 0.95 * error["random", n]
    for n in (7, 8, 10):
        assert max(error["continuous", n], error["exchange", n]) < error["random", n]
    assert error["continuous", 40] < error["table_3", 40] < error["exchange", 40]


def test_i_optimal_poses_are_better_than_o1_optimal_ones():
    table = read("pose_selection_i_optimal", "error_summary").set_index(["name", "n_poses"])
    for column in ("predicted_over_limits", "simulated_over_limits"):
        ratio = table.loc["I", column] / table.loc["O1", column]
        assert ((ratio > 0.97) & (ratio < 0.995)).all(), column
