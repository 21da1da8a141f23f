"""Benchmarks run as they stand, tiny: none of them rots unseen."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TINY = {
    "audit.py --points 2": (),
    "growth.py --what audit --most 20": (),
    "hexapod_calibrations.py --alone 1": (),
    "kernel_length.py --density": (),
    "likelihood.py --models --repeats 2": (),
    "likelihood.py --repeats 2": ("numba",),
    "lookup_table.py --twins 1": (),
    "memory.py --kinds calibration --sizes 0": (),
    "model_error.py --twins 1 --kernels linear --variants six_pus/none": (),
    "next_pose.py --twins 1 --poses 10": (),
    "peers.py --posteriors lengths --seconds 1 --steps 5 --warm-up 50 --draws 50 --live 50": (
        *("jax", "numpyro", "dynesty", "nautilus"),
    ),
    "pose_selection.py --candidates 300 --iterations 5 --sets 5": (),
    "recheck.py --twins 1": (),
    "sampling.py --warm-up 50 --draws 50": ("jax", "numpyro"),
    "sessions.py --twins 1": (),
    "slips.py --twins 1": (),
    "soak.py --minutes 0.1": (),
}
"""By command: what it needs that the tests do not."""
PARTS = {"jax_density", "numba_loops", "peers_evidence", "peers_posteriors", "peers_sampling", "telescope_problem"}


@pytest.mark.slow
@pytest.mark.parametrize("command", TINY)
def test_a_benchmark_runs_tiny(command, tmp_path):
    for module in TINY[command]:
        pytest.importorskip(module)
    for folder in ("benchmarks", "experiments", "examples", "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__", "results"))
    (tmp_path / "benchmarks" / "results").mkdir()
    script, *options = command.split()
    done = subprocess.run(
        [sys.executable, tmp_path / "benchmarks" / script, *options],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-1000:]


def test_every_benchmark_is_run():
    run = {command.split()[0].removesuffix(".py") for command in TINY}
    assert run | PARTS == {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
