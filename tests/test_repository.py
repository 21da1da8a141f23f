"""What stands around the package: benchmarks run, contracts cover what is added, CONTRIBUTING.md shows what works."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from tiny_experiments import SHIPPED, SMALL, key_line, read_kind

ROOT = Path(__file__).parents[1]
TINY = {
    "ablation.py --posteriors skewed": (),
    "audit.py --points 2": (),
    "fleet.py --machines 2 --ways workers:1 workers:2": (),
    "fleet.py --machines 2 --ways dask:1": ("distributed",),
    "growth.py --what audit --most 20": (),
    "growth.py --what channels variants --most 3 --write growth.json --picture growth.png": (),
    "hexapod_calibrations.py --alone 1": (),
    "jax_read.py --machines own_machine --tiny": ("jax",),
    "likelihood.py --repeats 2": (),
    "lookup_table.py --twins 1": (),
    "memory.py --kinds calibration --sizes 0": (),
    "next_pose.py --twins 1 --poses 10": (),
    "peers.py --posteriors lengths --seconds 1 --steps 5 --warm-up 50 --draws 50 --live 50"
    " --peers nuts nuts_exact nuts_whitened stretch nautilus dynesty least_squares": (
        *("jax", "numpyro", "dynesty", "nautilus"),
    ),
    "peers.py --posteriors ridge --peers nuts_straight nuts_straight_diagonal --steps 5 --warm-up 50 --draws 50": (
        *("jax", "numpyro"),
    ),
    "peers_machines.py --machines flsun_v400 --peers bayescal klipper scipy --effort quick": (),
    "peers_machines.py --machines ur10 mmt_mount --peers scipy": (),
    "pose_selection.py --candidates 300 --iterations 5 --sets 5": (),
    "sampling.py --warm-up 50 --draws 50": ("jax", "numpyro"),
    "sessions.py --twins 1": (),
    "stated.py --machines 'serial arm' --studies 1": (),
    "slips.py --studies 1 --machines hexaglide --slips clean unit": (),
}
"""By command: what it needs that the tests do not."""
PARTS = {"jax_density", "jax_straight", "peers_evidence", "peers_posteriors", "peers_sampling", "telescope_problem"}

OF_PEERS = {"astropy", "dynesty", "figaroh", "jax", "nautilus", "numpyro"}
OF_PEERS |= {"pytelpoint", "robotkinecal", "roboticstoolbox", "yaml"}

ADDED = {
    "compute": "from bayescal.experiments.added import page",
    "page": "from bayescal.density import priors",
    "kind": "from bayescal.experiments.study import kind",
}
BROKEN = ("No kind of experiment imports another", "Computation imports no page", "Pages know results")

BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
SECTIONS = {
    "machine",
    "instrument",
    "reader of files in a form of your own",
    "error term",
    "page block",
    "sampler",
    "kind",
}


@pytest.mark.slow
@pytest.mark.parametrize("command", TINY)
def test_a_benchmark_runs_tiny(command, tmp_path):
    for module in TINY[command]:
        pytest.importorskip(module)
    for folder in ("benchmarks", "experiments", "examples", "tests"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__", "results"))
    (tmp_path / "benchmarks" / "results").mkdir()
    script, *options = shlex.split(command)
    done = subprocess.run(
        [sys.executable, tmp_path / "benchmarks" / script, *options],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-1000:]


def test_what_makes_experiments_tiny_is_in_shipped_ones():
    """A key that was renamed would leave experiments as large as they are shipped."""
    texts = dict.fromkeys(SMALL, "")
    for path in SHIPPED.glob("*/*.toml"):
        kind = read_kind(path)
        if kind in SMALL:
            texts[kind] += path.read_text(encoding="utf-8")
    missing = {kind: [key for key in SMALL[kind] if not key_line(key).search(text)] for kind, text in texts.items()}
    assert not any(missing.values()), missing


def test_every_benchmark_is_run():
    run = {command.split()[0].removesuffix(".py") for command in TINY}
    assert run | PARTS == {path.stem for path in (ROOT / "benchmarks").glob("*.py")}


def test_benchmarks_import_what_exists():
    """Those too that are run nowhere, for want of a peer: modules, and names of the package."""
    ours = [path for folder in ("benchmarks", "experiments", "tests") for path in (ROOT / folder).rglob("*.py")]
    named = {one for path in ours for one in (path.stem, *path.relative_to(ROOT).parts[:-1])}
    known = {*sys.stdlib_module_names, *OF_PEERS, *named}
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules = [one.name for one in node.names]
            else:
                modules = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for module in modules:
                root = module.partition(".")[0]
                assert root in known or importlib.util.find_spec(root), f"{path.name} imports {module}"
                if root == "bayescal" and isinstance(node, ast.ImportFrom):
                    found = importlib.import_module(module)
                    for one in node.names:
                        has = hasattr(found, one.name) or importlib.util.find_spec(f"{module}.{one.name}")
                        assert has, f"{path.name} imports {one.name} of {module}"


@pytest.mark.runs
def test_an_added_kind_is_covered(tmp_path):
    shutil.copytree(ROOT / "bayescal", tmp_path / "bayescal", ignore=shutil.ignore_patterns("__pycache__"))
    added = tmp_path / "bayescal" / "experiments" / "added"
    added.mkdir()
    for name in ("__init__", *ADDED):
        (added / f"{name}.py").write_text(ADDED.get(name, "") + "\n")
    run = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache", "--config", ROOT / ".importlinter"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    said = " ".join(run.stdout.split())
    assert run.returncode == 1
    for name in BROKEN:
        assert f"{name}" in said
    for one in ("compute -> bayescal.experiments.added.page", "page -> bayescal.density.priors"):
        assert f"bayescal.experiments.added.{one}" in said
    assert "bayescal.experiments.added.kind -> bayescal.experiments.study.kind" in said


def read_sections() -> dict[str, list[tuple[str, str, str]]]:
    """Return language, file name and text of each section's blocks."""
    found = {}
    for section in re.split(r"^### ", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        name = re.match(r"(?:A|An) ([a-z ]+):", section)
        assert name is not None
        found[name[1]] = BLOCK.findall(section)
    return found


@pytest.mark.runs
def test_everything_that_contributing_shows_is_done(call, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    sections = read_sections()
    assert set(sections) == SECTIONS
    for name, blocks in sections.items():
        classes = [file for language, file, _ in blocks if language == "python"]
        assert len(classes) == 1, name
        for language, file, text in blocks:
            if language != "sh":
                (tmp_path / file).write_text(text, encoding="utf-8")
                continue
            for line in text.splitlines():
                command, *arguments = shlex.split(line)
                assert command == "bayescal"
                more = ["--workers", "2", "--quiet"] if arguments[0] == "run" else []
                code, _, complaint = call(*arguments, *more)
                assert code in (0, 3), (name, complaint)
    found = tmp_path / "results"
    parameters = pd.read_csv(next((found / "arm_by_laser").rglob("parameters.csv")))
    assert "laser_zero" not in set(parameters["parameter"])  # known where it has no tolerance
    rows = [json.loads((found / name / "summary.json").read_text())["n_poses"] for name in ("arm", "arm_by_logger")]
    assert rows[1]["calibration"] == -(-rows[0]["calibration"] // 2)
    assert "vibration" in (found / "arm_that_shakes" / "report.html").read_text()
    for name, shown in (("arm_with_lengths", True), ("arm", False)):
        assert ("Lengths of" in (found / name / "report.html").read_text()) == shown
    assert (found / "arm_with_lengths" / "inputs" / "lengths.py").is_file()
    assert "largest standard deviation" in (found / "repeatability" / "report.html").read_text()
