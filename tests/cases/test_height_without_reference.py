"""Requirements that no number of poses will meet, since the candidates do not tell the geometry that matters."""

from __future__ import annotations

import numpy as np
import pytest

from bayescal.experiments.runner.results import read_results
from bayescal.pose_selection.next_pose import learn, learn_all


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_endless_measuring_is_not_called_what_helps(case, call):
    folder = case("height_without_reference")
    out = folder / "next"
    code, _, _ = call(
        "next-pose", folder / "study.toml", "--require", "z=0.05", "--out", out, "--quiet", "--workers", 1
    )
    assert code == 0
    results = read_results(out)
    summary = results.summary
    assert summary["requirements"]["probability_parameters_known"] > 0.95
    assert summary["requirements"]["probability_all_candidates"] < 0.05
    assert summary["decision"] == "infeasible"
    assert "Add a channel" in " ".join(results.table("findings")["action"])


def test_measuring_all_is_measuring_one_after_the_other(rng):
    rows, root = rng.normal(size=(6, 2, 3)), rng.normal(size=(3, 3))
    covariance = root @ root.T
    one_by_one = covariance
    for one in [*rows, *rows]:
        one_by_one = learn(one_by_one, one)
    np.testing.assert_allclose(learn_all(covariance, rows, 2.0), one_by_one, atol=1e-12)


def test_what_no_row_sees_stays_as_it_was(rng):
    rows = rng.normal(size=(6, 2, 3)) * [1.0, 1.0, 0.0]
    found = learn_all(np.diag([1.0, 2.0, 3.0]), rows, 1e6)
    np.testing.assert_allclose(found, np.diag([0.0, 0.0, 3.0]), atol=1e-5)
