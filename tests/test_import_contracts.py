"""Import contracts cover a kind of experiment that is added, without an edit of theirs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ADDED = {
    "compute": "from bayescal.experiments.added import page",
    "page": "from bayescal.density import priors",
    "kind": "from bayescal.experiments.study import kind",
}
BROKEN = ("No kind of experiment imports another", "Computation imports no page", "Pages know results")


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
