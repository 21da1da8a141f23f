"""A tiny study end to end: what it writes, that its numbers depend on config and seed alone, and that it can resume."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import studies
from efforts import searching_little

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.identity import hash_identity
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.losses import list_losses
from bayescal.experiments.runner.run import RunOutcome, run_experiment
from bayescal.experiments.study import compute
from bayescal.experiments.study.readings import fit_variant

pytestmark = pytest.mark.runs

VARIANTS = {"six_pus/none": 7, "six_pus/matrix": 13}
NUMBERS = (
    *("log_evidence", "log_evidence_se", "elpd_loo", "elpd_loo_se", "rhat_max", "ess_bulk_min"),
    *("ess_tail_min", "efficiency", "pareto_k"),
)


def run(path: Path, out: Path, workers: int = 1, resume: bool = False, **changes: Any) -> RunOutcome:
    config = load_experiment(path).model_copy(update=changes)
    with searching_little():
        return run_experiment(config, path.parent, out, workers, resume)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with a tiny study."""
    folder = tmp_path_factory.mktemp("tiny")
    studies.write_tiny_study(folder)
    return folder


@pytest.fixture(scope="module")
def result(folder) -> RunOutcome:
    """Return the finished tiny study."""
    return run(folder / "study.toml", folder / "results" / "first")


@pytest.fixture(scope="module")
def summary(result) -> dict[str, Any]:
    return json.loads((result.out / "summary.json").read_text())


@pytest.fixture(autouse=True)
def _skip_reports(monkeypatch):
    """Let only the first run, made before, write its report: the numbers do not depend on it."""
    monkeypatch.setattr(frame, "write_page", lambda page, folder, *more: folder)


# --- summary.json ----------------------------------------------------------------------------------------------------


def numbers_in(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for inner in value.values() for n in numbers_in(inner)]
    if isinstance(value, list):
        return [n for inner in value for n in numbers_in(inner)]
    return [value] if isinstance(value, int | float) else []


def test_summary_has_what_the_issue_asks_for(summary):
    assert summary["experiment"] == "tiny"
    assert summary["seed"] == 11
    assert len(summary["config_sha256"]) == 64
    assert set(summary["variants"]) == set(VARIANTS)
    for name, n_parameters in VARIANTS.items():
        fit = summary["variants"][name]
        assert fit["n_parameters"] == n_parameters
        assert type(fit["n_parameters"]) is int
        assert all(type(fit[key]) is float for key in NUMBERS)
        assert type(fit["converged"]) is bool
        methods = [fit[f"log_evidence_{by}"] for by in ("importance", "bridge")]
        assert all(type(value) is float for value in methods)
        assert fit["log_evidence"] in methods
        for use in ("calibration", "verification"):
            for error in ("position_error_mm", "orientation_error_deg"):
                assert 0 < fit[use][error]["mean"] <= fit[use][error]["max"]
        assert type(fit["elpd"]) is float


def test_every_number_of_the_summary_is_finite(result, summary):
    assert all(math.isfinite(n) for n in numbers_in(summary))
    text = (result.out / "summary.json").read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.mark.parametrize("name", VARIANTS)
def test_parameters_are_tabulated(result, name):
    parameters = studies.read_posterior(result.out, name)
    symbols = {"six_pus/none": ["l"], "six_pus/matrix": ["l", "kappa"]}[name]
    assert set(parameters) == {f"{s}[{leg}]" for s in symbols for leg in range(1, 7)} | {"tau"}
    for values in parameters.values():
        assert {"nominal", "mean", "sd", "q05", "q95", "prior_sd"} <= values.keys()
        assert values["q05"] < values["mean"] < values["q95"]
        assert values["sd"] > 0
    assert parameters["l[1]"]["nominal"] == 500.0
    assert parameters["l[1]"]["prior_sd"] == 2.0
    one = parameters["l[1]"]
    assert one["contraction"] == pytest.approx(1.0 - (one["sd"] / 2.0) ** 2, rel=1e-6)
    assert parameters["tau"]["verdict"] == "noise"


def test_matrix_variant_finds_the_lengths_of_the_twin(result):
    truth = [0.37, -0.45, 1.02, 0.25, 0.43, 0.58]
    found = studies.read_posterior(result.out, "six_pus/matrix")
    for leg, offset in enumerate(truth, start=1):
        values = found[f"l[{leg}]"]
        assert abs(values["mean"] - 500.0 - offset) < 5 * values["sd"]


def test_ranking_is_sorted(summary):
    (ranking,) = summary["rankings"]
    evidences = [summary["variants"][name]["log_evidence"] for name in ranking]
    assert sorted(ranking) == sorted(VARIANTS)
    assert evidences == sorted(evidences, reverse=True)
    assert ranking[0] == "six_pus/matrix"


def test_too_short_a_run_says_so(result, summary):
    assert not result.converged
    for fit in summary["variants"].values():
        assert not fit["converged"]
        assert "ESS" in fit["problems"]


# --- the other files -------------------------------------------------------------------------------------------------


def test_results_directory_holds_everything_and_nothing_is_left_beside_it(result, folder):
    names = {path.name for path in result.out.iterdir()}
    assert {"summary.json", "provenance.json", "tables", "posterior"} <= names
    tables = {path.name for path in (result.out / "tables").iterdir()}
    assert {f"{one}.csv" for one in ("variants", "parameters", "poses", "pose_errors", "errors")} <= tables
    assert "sensitivity.csv" not in tables  # no other width was asked for
    posteriors = {path.name for path in (result.out / "posterior").iterdir()}
    assert posteriors == {f"{name.replace('/', '-')}.nc" for name in VARIANTS}
    assert not list(folder.glob("**/*.partial"))


def test_results_hold_a_report(result):
    page = (result.out / "report.html").read_text()
    assert "six_pus/matrix" in page
    assert list((result.out / "figures").glob("*.png"))


def test_provenance_says_where_the_results_come_from(result, summary, folder):
    provenance = json.loads((result.out / "provenance.json").read_text())
    assert provenance["config_sha256"] == summary["config_sha256"]
    assert provenance["seed"] == 11
    assert provenance["config"]["parameters"]["l"] == {"prior": "normal", "sd": 2.0}
    assert hash_identity({"config": provenance["config"], "files": provenance["files"]}) == summary["config_sha256"]
    assert provenance["versions"]["numpy"] == np.__version__
    assert {"bayescal", "emcee", "scipy", "arviz"} <= provenance["versions"].keys()
    expected = {"mechanism.toml", *studies.tiny_survey_texts()}
    assert set(provenance["files"]) == expected
    for name, value in provenance["files"].items():
        assert value == hashlib.sha256((folder / name).read_bytes()).hexdigest()


def test_tables_agree_with_the_summary(result, summary):
    tables = {name: pd.read_csv(result.out / "tables" / f"{name}.csv") for name in ("variants", "poses", "pose_errors")}
    for row in tables["variants"].to_dict("records"):
        assert row["log_evidence"] == pytest.approx(summary["variants"][row["variant"]]["log_evidence"], rel=1e-8)
    assert len(tables["poses"]) == len(VARIANTS) * studies.N_CALIBRATION
    assert len(tables["pose_errors"]) == len(VARIANTS) * (studies.N_CALIBRATION + studies.N_VERIFICATION)


# --- the numbers depend on config and seed alone ---------------------------------------------------------------------


def test_other_seed_gives_others(result, folder):
    other = run(folder / "study.toml", folder / "results" / "other seed", seed=12)
    assert other.summary["config_sha256"] != result.summary["config_sha256"]
    for name in VARIANTS:
        one, two = (r.summary["variants"][name] for r in (result, other))
        assert one["log_evidence"] != two["log_evidence"]
        assert one["log_evidence"] == pytest.approx(two["log_evidence"], abs=0.5)


def test_title_changes_no_number(result, folder):
    other = run(folder / "study.toml", folder / "results" / "other title", title="Another")
    one, two = ((found.out / "summary.json").read_text() for found in (result, other))
    assert one == two.replace("Another", "Tiny study")


def test_resume_after_changed_data_is_refused(folder, tmp_path, monkeypatch):
    path = studies.write_tiny_study(tmp_path)

    def interrupt(inputs, name):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(compute, "fit_variant", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run(path, tmp_path / "out")
    data = tmp_path / "data" / "actuators.csv"
    data.write_text(data.read_text() + "# measured again\n")
    with pytest.raises(InputError, match=r"config differs: files.data/actuators.csv"):
        run(path, tmp_path / "out", resume=True)


def test_numerical_failure_of_one_variant_costs_that_one(tmp_path, monkeypatch):
    path = studies.write_tiny_study(tmp_path)
    calls = []

    def fail_later(inputs, name):
        calls.append(name)
        if len(calls) == 2:
            raise NumericalError("as if")
        return fit_variant(inputs, name)

    monkeypatch.setattr(compute, "fit_variant", fail_later)
    found = run(path, tmp_path / "out").summary
    (loss,) = list_losses(found)
    assert calls[1] in loss.what
    assert loss.why == "as if"
    assert set(found["variants"]) == set(calls) - {calls[1]}


# --- smaller studies -------------------------------------------------------------------------------------------------


def keep_poses(folder: Path, *names: str) -> None:
    for file in ("targets", "actuators"):
        path = folder / "data" / f"{file}.csv"
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines[:3], *(line for line in lines[3:] if line.split(",")[0] in names)]) + "\n")


def test_study_without_verification_poses(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    keep_poses(tmp_path, *(f"C{k:02d}" for k in range(1, 14)))
    result = run(path, tmp_path / "out")
    assert all(fit["verification"] is None for fit in result.summary["variants"].values())
    assert result.summary["n_poses"] == {"calibration": 13, "verification": 0}


def test_claims_are_tested_where_the_config_names_them(result, tmp_path):
    assert not (result.out / "tables" / "claims.csv").exists()
    assert "publication" not in result.summary
    path = studies.write_tiny_study(tmp_path)
    studies.edit(path, "seed = 11", f'seed = 11\npublished_claims = "{studies.CLAIMS}"')
    claimed = run(path, tmp_path / "out")
    assert not pd.read_csv(claimed.out / "tables" / "claims.csv").empty
    assert claimed.summary["publication"]
    assert claimed.summary["rankings"] == result.summary["rankings"]


def test_study_with_missing_targets_runs(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    targets = tmp_path / "data" / "targets.csv"
    lines = targets.read_text().splitlines()
    missing = ("C01,base,B02", "C02,platform,P03", "C03,platform,L41", "V01,base,B05")
    targets.write_text("\n".join(line for line in lines if not line.startswith(missing)) + "\n")
    fits = run(path, tmp_path / "out").summary["variants"]
    assert fits["six_pus/matrix"]["log_evidence"] > fits["six_pus/none"]["log_evidence"] + 100.0
