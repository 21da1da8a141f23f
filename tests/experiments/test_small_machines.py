"""The examples of small machines of one class: each runs as it is shown and finds the truth."""

from __future__ import annotations

import runpy
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayescal as bc

EXAMPLES = Path(__file__).parents[2] / "examples" / "small_machines"
LINES = 25  # that a class takes at most


@pytest.mark.runs
@pytest.mark.parametrize("name", sorted(one.stem for one in EXAMPLES.glob("*.py")))
def test_it_finds_the_truth(name, tmp_path, monkeypatch):
    folder = Path(shutil.copytree(EXAMPLES, tmp_path / "small"))
    monkeypatch.chdir(folder)
    monkeypatch.setattr(bc, "calibrate", partial(bc.calibrate, quiet=True))
    shown = runpy.run_path(str(folder / f"{name}.py"), run_name="__main__")
    found = shown["study"].best.parameters.merge(shown["data"].truth[["parameter", "true"]])
    assert len(found) == len(shown["data"].truth)
    off = (found["mean"] - found["true"]) / found["sd"]
    assert np.sqrt(np.mean(off**2)) < 2.0
    assert off.abs().max() < 4.0
    widths = {one: np.radians(sd) if one.startswith("skew") else sd for one, sd in shown["TOLERANCES"].items()}
    prior = found["parameter"].str.partition("[")[0].map(widths)
    assert (found["sd"] < 0.1 * prior).all()  # readings told it, not the tolerance
    if name == "printed_part":
        assert len(pd.read_csv(folder / "corrections" / "grid.csv", comment="#")) == 9**3


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda one: one.stem)
def test_a_class_is_short(path):
    text = path.read_text()
    own = text[text.index("class ") : text.index("if __name__")]
    assert len(own.strip().splitlines()) <= LINES
