"""What `import bayescal` offers: few names, each with an example that runs, and nothing heavy."""

import doctest
import inspect
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bayescal

LIGHT = """
import sys
import bayescal
for name in bayescal.__all__:
    getattr(bayescal, name)
print(*{one.partition(".")[0] for one in sys.modules} & {HEAVY})
"""
HEAVY = {
    "pandas",
    "xarray",
    "matplotlib",
    "PIL",
    "arviz",
    "emcee",
    "h5netcdf",
    "jinja2",
    "joblib",
    "rich",
    "typer",
    "dask",
}


def test_names_are_few_and_documented():
    assert len(bayescal.__all__) <= 30
    assert sorted(bayescal.__all__) == dir(bayescal)
    for name in bayescal.__all__:
        assert inspect.getdoc(getattr(bayescal, name)), name


def test_naming_things_imports_nothing_heavy():
    done = subprocess.run(
        [sys.executable, "-c", LIGHT.replace("{HEAVY}", repr(HEAVY))], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


@pytest.mark.runs
def test_every_name_has_an_example_that_runs(tmp_path, monkeypatch):
    """The examples go on from one to the next, in the order of the reference."""
    shutil.copytree(Path(__file__).parents[1] / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    runner, namespace, said = doctest.DocTestRunner(optionflags=options), {}, []
    for name in bayescal.__all__:
        text = inspect.getdoc(getattr(bayescal, name))
        found = doctest.DocTestParser().get_doctest(text, namespace, name, None, 0)
        assert any(f"bc.{name}" in one.source for one in found.examples), name
        runner.run(found, out=said.append, clear_globs=False)
        namespace = found.globs
        assert not runner.failures, "".join(said)
