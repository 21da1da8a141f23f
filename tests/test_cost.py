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
from bayescal.experiments import KINDS, SCHEMAS, USES
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
    except SystemExit as ended:
        assert not ended.code
    print()
    print("imported:", *{one.partition(".")[0] for one in sys.modules})
"""
LIBRARIES = {"matplotlib", "arviz_stats", "emcee", "xarray", "h5py", "pandas"}
NUMERICAL = LIBRARIES | {"numpy", "scipy"}
COMMANDS = (
    (["--version"], NUMERICAL | {"pydantic", "rich", "cloudpickle"}),
    (["--help"], NUMERICAL | {"pydantic", "rich", "cloudpickle"}),
    (["list"], NUMERICAL),
    *((["schema", kind], NUMERICAL) for kind in SCHEMAS),
    (["validate", str(OWN_MACHINE / "study.toml")], LIBRARIES | {"jinja2"}),
)
"""Commands by what they do without, one after the other in a process: whoever does with less comes first."""
DENSITIES, FACTORISATIONS = 44_000, 79_000
"""Of `examples/own_machine`: two variants of 17 and 19 parameters with the default model error."""


def test_a_command_imports_what_it_uses(monkeypatch):
    monkeypatch.setenv("BAYESCAL_TRUST", "1")
    command = [sys.executable, "-c", IMPORTED, json.dumps([arguments for arguments, _ in COMMANDS])]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout  # of this file alone
    imported = [line.split() for line in said.splitlines() if line.startswith("imported: ")]
    for (arguments, without), modules in zip(COMMANDS, imported, strict=True):
        assert not without & set(modules), arguments


@pytest.mark.parametrize("kind", [*KINDS, *USES])
def test_a_kind_imports_what_it_reads_with(kind):
    module = {**KINDS, **USES}[kind].partition(":")[0]
    command = [sys.executable, "-c", f"import sys, {module}; print(*sys.modules)"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert module in said
    assert not {*LIBRARIES, "scipy.stats", "scipy.interpolate", "scipy.cluster", "jinja2"} & {*said}


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
