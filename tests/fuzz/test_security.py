"""What files name is text: a page with hostile names executes nothing, and no code is imported that is not wanted."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import calibrations
import pandas as pd
import pytest
import studies
from fuzz.judged import judge_call, judge_refusal

from bayescal.experiments.runner import run as frame

pytestmark = pytest.mark.usefixtures("no_pictures")

RESULTS = Path(__file__).parents[2] / "results"
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = (
    "\"'><script>document.title='EXECUTED'</script><img src=x onerror=\"document.title='EXECUTED'\">${{7*7}}{{7*7}}"
)
PAGES = ("hangprinter", "hexapod_figure10", "pose_extraction", "telescope")
OWN_KINDS = {"hexapod_figure10": "yu2023/figure10.toml", "pose_extraction": "rr8096/figure5.toml"}
"""Of results of kinds of their own, whose code they need for a page, the configs."""
NAMED = ("title", "text", "platform", "python", "versions", "experiment", "machine", "source")
KEPT = {
    "kind",
    "prior",
    "of",
    "model",
    "deformation",
    "status",
    "actuated_joint",
    "setting",
    "level",
    "sampling",
    "class",
    "noise",
}
"""Texts that choose something and are no names."""


def poison(value: Any, key: str = "") -> Any:
    """Return JSON with something hostile after every text that somebody may have written."""
    if isinstance(value, dict):
        return {name: poison(one, name) for name, one in value.items()}
    if isinstance(value, list):
        return [poison(one, key) for one in value]
    return value + HOSTILE if isinstance(value, str) and key not in KEPT else value


def write_hostile(name: str, folder: Path) -> Path:
    """Write results whose titles, origins, sources, and names of machines and poses are hostile."""
    found = Path(shutil.copytree(RESULTS / name, folder / name))
    if name in OWN_KINDS:
        studies.keep_committed(found, studies.EXPERIMENTS / OWN_KINDS[name])
    for file in ("provenance.json", "summary.json"):
        content = json.loads((found / file).read_text())
        for key in NAMED:
            if key in content:
                content[key] = poison(content[key], key)
        for section in ("provenance", "reference_values", "published_claims", "data"):
            if isinstance(content.get("config"), dict) and section in content["config"]:
                content["config"][section] = poison_texts(content["config"][section])
        (found / file).write_text(json.dumps(content))
    for table in found.rglob("*.csv"):
        cells = pd.read_csv(table, dtype=str, keep_default_na=False)
        if "pose" in cells:
            cells.assign(pose=cells["pose"] + HOSTILE).to_csv(table, index=False)
    return found


def poison_texts(value: Any) -> Any:
    """Return a section of a config with its free texts made hostile, not those that choose something."""
    free = {"title", "text", "source", "licence", "provenance", "costs"}
    if isinstance(value, dict):
        return {name: poison(one, name) if name in free else poison_texts(one) for name, one in value.items()}
    return [poison_texts(one) for one in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", ["hexapod_figure10", *(pytest.param(one, marks=pytest.mark.slow) for one in PAGES)])
def test_hostile_names_are_text_on_the_page(name, tmp_path):
    html = frame.write_report(write_hostile(name, tmp_path), trust=True).read_text()
    assert "EXECUTED" in html
    assert "<script>document" not in html
    assert "<img src=x" not in html
    assert "{{7*7}}" in html


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="there is no Chromium here to open pages in")
@pytest.mark.parametrize("name", PAGES)
def test_hostile_names_execute_nothing_in_a_browser(name, tmp_path):
    path = frame.write_report(write_hostile(name, tmp_path), trust=True)
    assert run_browser(path).count("<title>EXECUTED</title>") == 0
    trap = tmp_path / "trap.html"
    trap.write_text(f"<!DOCTYPE html><html><head><title>x</title></head><body>{HOSTILE}</body></html>")
    assert "<title>EXECUTED</title>" in run_browser(trap)  # the browser would have shown it


def run_browser(path: Path) -> str:
    """Return the tree of a page after everything on it has run."""
    assert BROWSER is not None
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000", "--dump-dom"]
    done = subprocess.run([*command, path.as_uri()], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


# --- own classes -----------------------------------------------------------------------------------------------------

TRAP = "from pathlib import Path\nPath({!r}).write_text('executed')\n"


@pytest.fixture
def own(tmp_path) -> tuple[Path, Path]:
    """Return a config with a machine of its own that leaves a mark when it is imported, and that mark."""
    config, mark = calibrations.write_delta(tmp_path), tmp_path / "mark"
    module = config.parent / "linear_delta.py"
    module.write_text(
        module.read_text().replace("import numpy as np\n", "import numpy as np\n" + TRAP.format(str(mark)))
    )
    return config, mark


@pytest.mark.parametrize("where", ["before", "after", "environment"])
def test_own_class_is_refused_on_demand(own, where, monkeypatch):
    config, mark = own
    if where == "environment":
        monkeypatch.setenv("BAYESCAL_NO_CUSTOM_CODE", "1")
    arguments = {"before": ["--no-custom-code", "validate", config], "after": ["validate", config, "--no-custom-code"]}
    said = judge_refusal(list(arguments.get(where, ["validate", config])), config.parent)
    assert "found 'linear_delta.py:LinearDelta'," in said
    assert not mark.exists()
    monkeypatch.delenv("BAYESCAL_NO_CUSTOM_CODE", raising=False)
    assert judge_call(["validate", config]).code == 0  # it was for one call
    assert mark.exists()


@pytest.mark.parametrize("kind", ["linear_delta.py:LinearDelta", "os:system", "antigravity:x"])
def test_own_kind_is_refused_on_demand(own, kind):
    config = own[0].with_name("kind.toml")
    config.write_text(f'kind = "{kind}"\nname = "x"\ntitle = "x"\nseed = 1\n')
    assert "audit, " in judge_refusal(["run", config, "--no-custom-code"], config.parent).partition("expected")[2]
    assert not own[1].exists()
