"""What runs cost that does not vary with the computer: modules imported, densities, factorisations.

Limits are a tenth above what was counted when they were written; whoever needs more says why.
"""

from __future__ import annotations

import json
import subprocess
import sys
from math import prod
from pathlib import Path

import pytest

from bayescal.density import linear_gaussian
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment
from bayescal.inference import importance

OWN_MACHINE = Path(__file__).parents[1] / "examples" / "own_machine"
IMPORTED = """
import json
import sys
from bayescal.cli import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["bayescal", *arguments]
    try:
        main()
    except SystemExit:
        pass
    print()
    print("imported:", *{one.partition(".")[0] for one in sys.modules})
"""
NUMERICAL = {"scipy", "pandas", "xarray", "matplotlib", "arviz_stats", "emcee"}
COMMANDS = (
    (["--version"], NUMERICAL),
    (["--help"], NUMERICAL),
    (["validate", str(OWN_MACHINE / "study.toml")], {"matplotlib", "arviz_stats", "emcee", "xarray"}),
    (["list", "kinds"], {"matplotlib", "arviz_stats", "emcee"}),
)
"""Commands by what they do without, one after the other in a process: whoever does with less comes first."""
DENSITIES, FACTORISATIONS = 42_000, 82_000
"""Of `examples/own_machine`: two variants of 17 and 19 parameters with the default model error."""


def test_a_command_imports_what_it_uses(monkeypatch):
    monkeypatch.setenv("BAYESCAL_TRUST", "1")
    command = [sys.executable, "-c", IMPORTED, json.dumps([arguments for arguments, _ in COMMANDS])]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout  # of this file alone
    imported = [line.split() for line in said.splitlines() if line.startswith("imported: ")]
    for (arguments, without), modules in zip(COMMANDS, imported, strict=True):
        assert not without & set(modules), arguments


@pytest.mark.runs
def test_a_small_study_computes_no_more_than_it_did(tmp_path, monkeypatch):
    counted = {"densities": 0, "factorisations": 0}
    factorise = linear_gaussian.factorise

    def count(n):
        counted["densities"] += n

    def factorise_counted(covariance):
        counted["factorisations"] += prod(covariance.shape[:-2])
        return factorise(covariance)

    monkeypatch.setattr(importance, "count", count)
    monkeypatch.setattr(linear_gaussian, "factorise", factorise_counted)
    run_experiment(load_experiment(OWN_MACHINE / "study.toml"), OWN_MACHINE, tmp_path / "out")
    assert counted["densities"] <= DENSITIES
    assert counted["factorisations"] <= FACTORISATIONS
