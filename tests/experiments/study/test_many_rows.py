"""What thousands of rows take: some rows and machines at a time, with the same numbers, and said beforehand."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.calibrated.functions import KnownFunctions
from bayescal.density.calibration import fixed_covariance, likelihood, measurements
from bayescal.errors import NumericalError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.memory import GIB, MemoryEstimate
from bayescal.experiments.shared import estimate
from bayescal.experiments.shared.estimate import PosteriorProblem, time_fit
from bayescal.experiments.shared.function_errors import tabulate_model_error
from bayescal.experiments.shared.posterior_files import choose_draws
from bayescal.experiments.shared.search_memory import KEPT_READINGS
from bayescal.experiments.shared.slip_search import SlipSearch
from bayescal.experiments.shared.slip_verdict import STATED
from bayescal.experiments.study.calibrated import tabulate_errors
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.projects.start import start_project

SOME = 7
LOADED = """
import sys
from pathlib import Path
from bayescal.experiments.runner.run import check_file
for folder in sys.argv[1:]:
    check_file(Path(folder, "study.toml"))
print(*{NEEDLESS} & {*sys.modules})
"""
NEEDLESS = {"pandas", "xarray", "matplotlib", "arviz_stats", "jinja2"}
NEEDLESS |= {f"scipy.{name}" for name in ("stats", "interpolate", "cluster")}
NEEDLESS |= {f"bayescal.calibrated.{name}" for name in ("exported", "functions", "machine", "predict", "tables")}


@pytest.fixture(scope="module")
def study() -> StudyInputs:
    path = calibrations.OWN_MACHINE / "study.toml"
    return StudyInputs.load(load_experiment(path), path.parent)


@pytest.fixture(scope="module")
def drawn(study) -> tuple[Any, np.ndarray, Any]:
    """Return a posterior whose functions are of few columns, machines near its mode, and errors drawn for them."""
    posterior = study.variants["all"].posterior().with_pose_guesses()
    y = posterior.least_squares_start() + 0.05 * np.random.default_rng(1).normal(size=(20, posterior.n_parameters))
    return posterior, y, posterior.likelihood.draw_common(*posterior.at(y), np.random.default_rng(2))


def test_tables_of_model_errors_are_those_of_some_rows_at_a_time(study, drawn, monkeypatch):
    posterior, y, common = drawn
    variant, config = study.variants["all"], study.config

    def tabulate() -> dict[str, pd.DataFrame]:
        rng = np.random.default_rng(3)
        own = variant.data, variant.verification, posterior, y, common, config.leg_error, rng
        return tabulate_model_error("all", *own) | {"errors": tabulate_errors(config, variant, posterior, y, common)}

    whole = tabulate()
    monkeypatch.setattr(measurements, "AT_ONCE", SOME)
    assert len(variant.data.split()) > 3
    parts = tabulate()
    assert {"model_error", "model_error_members", "model_error_poses", "errors"} <= set(whole)
    for name, table in whole.items():
        pd.testing.assert_frame_equal(parts[name], table, rtol=1e-9)


def test_densities_are_those_of_some_machines_at_a_time(drawn, monkeypatch):
    posterior, y, _ = drawn
    whole = posterior.log_density(y), posterior.pointwise(y)
    assert posterior.likelihood.frozen is not None
    for module in (likelihood, fixed_covariance):
        monkeypatch.setattr(module, "MANY_ROWS", 3 * posterior.likelihood.data.n_poses)
    assert posterior.log_density(y) == pytest.approx(whole[0], rel=1e-10)
    assert posterior.pointwise(y) == pytest.approx(whole[1], rel=1e-8)


def test_known_functions_are_those_of_some_rows_at_a_time(drawn, monkeypatch):
    posterior, y, _ = drawn
    whole = KnownFunctions.find(posterior, y)
    monkeypatch.setattr(measurements, "AT_ONCE", SOME)
    parts = KnownFunctions.find(posterior, y)
    size = np.sqrt(np.diag(whole.covariance))
    assert parts.mean == pytest.approx(whole.mean, rel=1e-6, abs=1e-6 * float(np.abs(whole.mean).max()))
    assert parts.covariance / np.outer(size, size) == pytest.approx(whole.covariance / np.outer(size, size), abs=1e-6)


# --- slips -----------------------------------------------------------------------------------------------------------


def test_a_first_look_says_as_the_search_what_data_that_fit_leave(study, monkeypatch):
    readings = study.variants["all"].list_readings()
    found = readings.measure_misfit()
    assert found == pytest.approx(SlipSearch(readings, ()).misfit, rel=0.02)
    assert found < STATED
    monkeypatch.setattr(measurements, "AT_ONCE", SOME)
    assert readings.measure_misfit() == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("far", ["one reading", "a row that no pose has"])
def test_a_first_look_does_not_pass_one_row_that_is_wrong(far, study):
    readings = study.variants["all"].list_readings()
    values = readings.values.copy()
    values[4, 0] += 2.0 if far == "one reading" else 1e4
    moved = readings.with_table(replace(readings.table, values=values))
    assert moved.measure_misfit() > STATED


# --- what is loaded and said -----------------------------------------------------------------------------------------


def test_validate_loads_nothing_that_only_runs_need(tmp_path):
    projects = {"hexapod": "poses", "own": None}
    for machine, instrument in projects.items():
        start_project(tmp_path / machine, machine, instrument)
    command = [sys.executable, "-c", LOADED.replace("{NEEDLESS}", repr(NEEDLESS)), *projects]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.split() == []


@dataclass(frozen=True, eq=False)
class Slow(PosteriorProblem):
    """A posterior whose densities take as long as is said, s."""

    each: float
    by_row: float
    n_parameters: int = 3

    @property
    def posterior(self) -> Any:
        return self

    def least_squares_start(self) -> np.ndarray:
        return np.zeros(self.n_parameters)

    def log_density(self, y: np.ndarray) -> np.ndarray:
        return self._burn(self.each, y)

    def pointwise(self, y: np.ndarray) -> np.ndarray:
        return self._burn(self.by_row, y)

    def _burn(self, seconds: float, y: np.ndarray) -> np.ndarray:
        until = time.process_time() + seconds * len(y)
        while time.process_time() < until:
            pass
        return np.zeros(len(y))

    evaluate = replicate_prior = measure_misfit = find_costly = None  # type: ignore[assignment]


def test_the_time_of_a_fit_is_that_of_its_densities():
    sampler, effort = SamplerConfig(walkers=20, burn_in=10, steps=40), EvidenceConfig(draws=1000)
    planned = 4 * 20 * 50 + 2 * 1000 + estimate.N_DRAWS
    kept = choose_draws(4, 20 * 40, KEPT_READINGS).size
    expected = estimate.SEARCHED * planned * 2e-3 + estimate.JUDGED * kept * 2e-2
    assert time_fit(Slow(2e-3, 2e-2), sampler, effort) == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize(
    ("seconds", "gibibytes", "expected"),
    [
        (None, 0.5, ""),
        (118.0, 0.5, ""),
        (300.0, 0.5, "this takes about 2 min with 2 workers"),
        (None, 2.0, "this takes at most 2.0 GiB of memory with 2 workers"),
        (7200.0, 2.0, "this takes about 60 min and at most 2.0 GiB of memory with 2 workers"),
    ],
)
def test_what_a_run_takes_is_said_where_it_is_much(seconds, gibibytes, expected):
    need = MemoryEstimate(gibibytes * GIB - MemoryEstimate().sum_up(2), sizes="rows")
    prepared = frame.PreparedRun(None, None, need, [], {})  # type: ignore[arg-type]
    assert frame._tell_effort(prepared, seconds, 2) == expected


@pytest.mark.parametrize(("seconds", "expected"), [(None, 2), (3.0, 1), (300.0, 2)])
def test_a_short_run_takes_this_process_alone(seconds, expected, monkeypatch, tmp_path):
    path: Path = calibrations.write_delta(tmp_path)
    said = []

    def open_engine(workers, *more):
        said.append(workers)
        raise NumericalError("enough")

    monkeypatch.setattr(frame, "cpu_count", lambda: 2)
    monkeypatch.setattr(frame, "open_engine", open_engine)
    monkeypatch.setattr(frame, "_estimate_seconds", lambda prepared: seconds)
    for workers in (None, 2):
        with pytest.raises(NumericalError, match="enough"):
            frame.run_experiment(load_experiment(path), path.parent, tmp_path / "out", workers)
    assert said == [expected, 2]


@pytest.mark.runs
@pytest.mark.parametrize("quiet", [True, False])
def test_a_run_says_it_once_and_keeps_nothing_of_it(quiet, monkeypatch, tmp_path, capsys):
    path: Path = calibrations.write_delta(tmp_path)
    monkeypatch.setattr(frame, "LONG", 0.0)
    out = frame.run_experiment(load_experiment(path), path.parent, tmp_path / "out", quiet=quiet).out
    assert capsys.readouterr().err.count("this takes about") == (0 if quiet else 1)
    assert not [one for one in out.rglob("*") if one.is_file() and b"this takes about" in one.read_bytes()]
