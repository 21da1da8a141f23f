"""A faultless force cell: gains that are free keep their values beside the default model error."""

from __future__ import annotations

import json

import pandas as pd
import pytest

pytestmark = pytest.mark.runs

GAINS = {"k_x[1]": 1.01, "k_y[2]": 0.99, "k_z[3]": 1.02, "k_x[2]": -0.01, "k_z[1]": -0.03}


def test_gains_are_found_with_the_default_model_error_as_without(case, call, tmp_path):
    folder = case("own_term_shrinks_gains")
    study = folder / "study.toml"
    text = study.read_text()
    study.write_text(text + '\n[[variants]]\nname = "right"\nmodel_error = []\n')
    code, *said = call("run", study, "--out", tmp_path / "out", "--workers", 1)
    assert code == 0, said
    table = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv", comment="#").set_index(["variant", "parameter"])
    for name, truth in GAINS.items():
        row, right = table.loc[("full", name)], table.loc[("right", name)]
        assert abs(row["mean"] - truth) < 4.0 * row["sd"] < 0.04  # a smooth error may have a linear part
        assert right["sd"] < row["sd"]
    tool = pd.read_csv(tmp_path / "out" / "tables" / "accuracy.csv", comment="#").set_index("variant")
    whole = (tool["posterior_sd"] ** 2 + tool["noise"] ** 2) ** 0.5
    assert (whole["full"].to_numpy() < 1.5 * whole["right"].to_numpy()).all()
    fits = json.loads((tmp_path / "out" / "summary.json").read_text())["variants"]
    assert fits["full"]["log_evidence"] < fits["right"]["log_evidence"]
    assert fits["full"]["converged"]
