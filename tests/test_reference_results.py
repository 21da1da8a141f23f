"""The committed reference results belong to the committed config, and the documentation quotes them and runs."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayescal.config.registry import list_sources
from bayescal.experiments.audit.audit import analyse
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.runner.identity import hash_identity, identify
from bayescal.experiments.runner.load import load

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
RESULTS = ROOT / "results" / "telescope"
STUDIES = ("telescope", "telescope_model_error", "m2_hexapod", "m2_hexapod_lengths")
COMMITTED = {
    "telescope": "telescope/study",
    "telescope_model_error": "telescope/model_error",
    "m2_hexapod": "m2_hexapod/study",
    "m2_hexapod_lengths": "m2_hexapod/lengths",
    "m2_hexapod_next_pose": "m2_hexapod/next_pose",
    "m2_hexapod_sensors": "sliding_star/m2_hexapod_sensors",
    "m2_hexapod_sessions": "m2_hexapod_sessions/sessions",
    "m2_hexapod_table": "m2_hexapod_table/table",
    "hangprinter": "hangprinter/study",
    "sliding_star": "sliding_star/study",
    "sliding_star_sensors": "sliding_star/sensors",
    "sliding_star_calibrations": "sika2008/calibrations",
    **{f"audit_{name}": f"audit/{name}" for name in ("m2_hexapod", "telescope_posterior", "telescope_six_pus_none")},
    **{f"hexapod_{name}": f"yu2023/{name}" for name in ("figure10", "table4", "table8")},
    "pose_extraction": "rr8096/figure5",
    "pose_selection_figure14": "pose_selection/rr8096_figure14",
    "pose_selection_i_optimal": "pose_selection/hexapod_i_optimal",
    "pose_selection_table1": "yu2023/table1",
}
"""Of committed results, the config that they were computed from."""


@pytest.fixture(scope="module")
def summary():
    return json.loads((RESULTS / "summary.json").read_text())


@pytest.mark.parametrize("name", COMMITTED)
def test_results_are_those_of_the_committed_config(name):
    path, results = ROOT / "experiments" / f"{COMMITTED[name]}.toml", ROOT / "results" / name
    kind, config = load(path)
    assert config.name == name  # where the command writes by default
    files = [*kind.files(config, path.parent), *list_sources("KINDS", config.kind, path.parent)]
    current = hash_identity(identify(config, path.parent, files))
    for file in ("provenance.json", "summary.json"):
        assert json.loads((results / file).read_text())["config_sha256"] == current


QUOTED = re.compile(r"\| ([\d.]+) ± ([\d.]+) \| ([\d.]+) \| ([\d.]+) / ([\d.]+) µm \| ([\d.]+) mm rms")
ROUNDED = np.array([0.01, 0.01, 0.1, 0.1, 0.1, 0.1])
"""Last digits of what is quoted."""
SAMPLED = np.array([0.0, 0.0, 0.0, 0.02, 0.02, 0.0])
"""Shares by which another computer's draws move it: of `make study`, which replaces the committed results."""


def test_documentation_quotes_the_results(summary):
    quoted = np.array(QUOTED.findall((DOCS / "reproductions" / "rr8096.md").read_text()), dtype=float)
    assert len(quoted) == len(summary["variants"])
    for name, fit in summary["variants"].items():
        error = fit["verification"]["position_error_mm"]
        found = [fit["log_evidence"], fit["log_evidence_se"], fit["elpd"], 1e3 * error["mean"], 1e3 * error["max"]]
        off = np.abs(quoted - [*found, fit["distance_from_nominal_mm"]])
        assert (off <= ROUNDED + SAMPLED * quoted).all(axis=1).any(), name


@pytest.mark.parametrize("name", STUDIES)
def test_evidences_agree_and_all_converged(name):
    summary = json.loads((ROOT / "results" / name / "summary.json").read_text())
    for one in summary["variants"].values():
        assert abs(one["log_evidence_importance"] - one["log_evidence_bridge"]) < 0.1
        assert one["converged"]
        assert one["rhat_max"] < 1.01
        assert one["ess_bulk_min"] > 1000


def test_sessions_found_what_is_said():
    results = ROOT / "results" / "m2_hexapod_sessions"
    summary = json.loads((results / "summary.json").read_text())
    assert all(summary["reliable"].values())
    legs, expansion = (pd.read_csv(results / "tables" / f"{name}.csv") for name in ("legs", "expansion"))
    whole = legs[(legs["since"] == "January") & (legs["session"] == "June")].set_index("leg").loc[3]
    page = " ".join((DOCS / "howto" / "sessions.md").read_text().split())
    assert f" {whole['mean']:.1f} ± {whole['sd']:.1f} µm" in page
    assert f" {expansion['mean'][0]:.2f} ± {expansion['sd'][0]:.2f} ppm/K" in page
    assert abs(whole["mean"] - 41.0) < 2.0 * whole["sd"]  # the twin's


@pytest.mark.parametrize("name", ["telescope_six_pus_none", "m2_hexapod"])
def test_audits_are_those_of_the_committed_designs(name):
    """What the plan tells, computed again: no committed audit is left behind."""
    design = ROOT / "experiments" / "audit" / f"{name}.toml"
    config = load_audit(design)
    committed = json.loads((ROOT / "results" / config.name / "summary.json").read_text())
    if config.data is not None:  # linearised at draws, which take long: that the design is the same must do
        return
    (plan,) = read_plans(config, design.parent).values()
    analysis = analyse(plan)
    found = dict(zip(plan.names, analysis.information.contraction, strict=True))
    assert committed["structural_rank"] == analysis.structure.rank
    assert committed["reduced_set"]["free"] == [plan.names[k] for k in analysis.selection.free]
    assert {n: v["contraction"] for n, v in committed["parameters"].items()} == pytest.approx(found, abs=1e-6)


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("[!_]*.md")), *sorted(DOCS.glob("[!_]*/*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        made = re.search(r"(^|/)reference/", target)  # by the documentation's build
        assert made or target.startswith("https://") or (page.parent / target).exists(), target


def test_figures_to_hold_name_files_that_are_there():
    named = re.findall(r"`((?:tests|results|benchmarks)/[^` ]+)", (DOCS / "figures.md").read_text())
    assert len(named) > 10
    for path in named:
        assert (ROOT / path).exists(), path


def test_python_snippet_runs(tmp_path, monkeypatch):
    """The example from Python, without its long middle part: running the whole study."""
    text = (DOCS / "howto" / "python.md").read_text()
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[1]
    lines = [line for line in code.splitlines() if "run_experiment(" not in line]
    monkeypatch.chdir(ROOT)
    namespace: dict = {}
    exec("\n".join(lines), namespace)
    assert namespace["found"].efficiency > 0.05
    assert namespace["posterior"].names[0] == "a_x[1]"


@pytest.mark.parametrize("name", sorted(path.parent.name for path in (ROOT / "results").glob("*/provenance.json")))
def test_committed_results_are_whole(name):
    """As `make update-manifests` leaves them: without posteriors and pages, which are not committed."""
    tracked = json.loads((ROOT / "results" / name / "manifest.json").read_text())["sha256"]
    assert {"provenance.json", "summary.json"} <= set(tracked)
    for file, expected in tracked.items():
        assert hashlib.sha256((ROOT / "results" / name / file).read_bytes()).hexdigest() == expected, file
