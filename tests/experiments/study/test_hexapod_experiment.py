"""The shipped study of a hexapod: the twin's truth against the committed posterior and its predictions.

The lengths alone are the negative control: with the joints taken for nominal the fit looks as good, and the posterior
is certain of wrong lengths.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import studies

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.simulation.compute import Twin, build_twin

FOLDER = studies.EXPERIMENTS / "m2_hexapod"
RESULTS = studies.EXPERIMENTS.parent / "results"
VARIANT = "six_ups/none"


@pytest.fixture(scope="module")
def twin() -> Twin:
    return build_twin(load_experiment(FOLDER / "simulate.toml"), FOLDER)


@pytest.fixture(scope="module")
def configs() -> dict[str, StudyConfig]:
    return {name: load_experiment(FOLDER / f"{name}.toml") for name in ("study", "lengths")}


def read_fit(experiment: str, variant: str = VARIANT):
    return json.loads((RESULTS / experiment / "summary.json").read_text())["variants"][variant]


def read_scores(twin: Twin, experiment: str) -> tuple[np.ndarray, np.ndarray]:
    """Return z-scores of the true geometry in committed results, and whether 90 % intervals hold it."""
    parameters = {
        n: p for n, p in studies.read_posterior(RESULTS / experiment, VARIANT).items() if not n.startswith("tau")
    }
    truth = np.array([twin.theta[twin.machine.layout.names.index(name)] for name in parameters])
    mean, sd, low, high = (np.array([p[key] for p in parameters.values()]) for key in ("mean", "sd", "q05", "q95"))
    return (mean - truth) / sd, (low <= truth) & (truth <= high)


def test_shipped_truth_lies_within_the_tolerances(twin, configs):
    """As drawn from them: 42 squares in units of the tolerances sum to between 20 and 71 (99.7 % of χ²)."""
    layout = twin.machine.layout
    moved = {s: twin.theta[k] - layout.nominal[k] for s, k in layout.index.items() if s != "kappa"}
    square = sum(np.sum((x / configs["study"].parameters[s].sd) ** 2) for s, x in moved.items())
    assert 20 < square < 71


def test_committed_posterior_holds_the_truth_and_that_of_the_lengths_alone_does_not(twin):
    z, inside = read_scores(twin, "m2_hexapod")
    assert 34 <= inside.sum() <= 42
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5
    z, inside = read_scores(twin, "m2_hexapod_lengths")
    assert not inside.any()
    assert np.abs(z).min() > 10


def test_committed_evidence_prefers_the_truth():
    evidence = {v: read_fit("m2_hexapod", f"six_ups/{v}")["log_evidence"] for v in ("none", "linear", "matrix")}
    assert 0.5 < evidence["none"] - evidence["linear"] < 10  # it holds the truth and pays for what it does not need
    assert evidence["none"] - evidence["matrix"] > 10
    assert evidence["none"] - read_fit("m2_hexapod_lengths")["log_evidence"] > 20


def test_committed_predictions_hold_the_verification_poses():
    held = read_fit("m2_hexapod")["verification"]
    assert 0.8 <= held["interval_90_coverage"] <= 0.98  # 24 poses of six components
    assert held["bound_95_coverage"] >= 0.87
