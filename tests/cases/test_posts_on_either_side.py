"""Two posts, each on either side of a line: four machines explain the readings, with probabilities that priors tell."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytestmark = pytest.mark.runs

BESIDE, EXPECTED, TOLERANCE = np.array([9.3, -7.7]), np.array([3.0, -2.0]), 8.0


def test_four_machines_have_their_probabilities_beside_the_default_model_error(case, call):
    folder = case("posts_on_either_side")
    code, *said = call("run", folder / "study.toml", "--out", folder / "results", "--workers", 1)
    assert code == 0, said
    summary = json.loads(next(folder.rglob("summary.json")).read_text())
    modes = summary["variants"]["all"]["modes"]
    found = {tuple(np.sign(mode["parameters"][f"b[{k}]"][0]) for k in (1, 2)): mode for mode in modes}
    assert len(found) == len(modes) == 4
    mass = {signs: np.exp(-0.5 * np.sum(((np.abs(BESIDE) * signs - EXPECTED) / TOLERANCE) ** 2)) for signs in found}
    for signs, mode in found.items():
        assert mode["probability"] == pytest.approx(mass[signs] / sum(mass.values()), abs=0.06)
