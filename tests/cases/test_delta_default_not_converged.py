"""A probed delta of nine parameters, seen in one number a row, converges with default effort and model error."""

from __future__ import annotations

import json

import pandas as pd
import pytest

pytestmark = pytest.mark.runs


def test_both_variants_converge(case, call, tmp_path):
    folder = case("delta_default_not_converged")
    code, *said = call("run", folder / "study.toml", "--out", tmp_path / "out", "--workers", 1)
    assert code == 0, said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())["variants"]
    assert [one["converged"] for one in summary.values()] == [True, True]
    table = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv", comment="#").set_index(["variant", "parameter"])
    assert table.loc[("arms_differ", "r"), "sd"] < 0.5
