"""A machine in which nothing moves: three distances of a printed square tell the skew of a printer's axes."""

from __future__ import annotations

import numpy as np
import pytest
from studies import run_little

from bayescal.experiments.frame.results import read_results


def test_it_is_fit_to_run(case, call):
    code, out, _ = call("validate", case("no_coordinates") / "study.toml")
    assert code == 0
    assert "3 combinations" in out
    assert "tool" not in out  # nothing moves that a class could call one


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_skew_is_found(case, call):
    code, complaint, out = run_little(call, case("no_coordinates") / "study.toml")
    assert code == 0 or "not everything converged" in complaint
    results = read_results(out)
    assert "lost" not in results.summary
    found = results.table("parameters").set_index("parameter").loc["skew"]
    # with the squares of the diagonals: AC² − BD² = 4 AD AB sin(skew)
    side = 0.5 * np.sqrt(140.7**2 + 142.2**2)
    assert abs(found["mean"] - np.arcsin((140.7**2 - 142.2**2) / (4.0 * side**2))) < 0.2 * found["sd"]
    assert 0.5 < found["sd"] / (0.05 / (140.0 / np.sqrt(2.0))) < 2.0
    assert "sensors do not determine" not in results.summary["headline"]
