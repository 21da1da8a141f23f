"""The shipped study of a hexapod: the twin's truth against posterior and prediction, in the study and in many twins.

The lengths alone are the negative control: with the joints taken for nominal the fit looks as good, and the posterior
is certain of wrong lengths.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest
import studies

from bayescal.data.photogrammetry.poses import PoseExtraction, extract_poses
from bayescal.data.photogrammetry.survey import Survey
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.simulation.compute import Twin, build_twin, survey_twin
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import TargetMeasurement
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import explore
from bayescal.inference.schema import count_walkers
from bayescal.machines.kinematics import solve_forward_kinematics

FOLDER = studies.EXPERIMENTS / "m2_hexapod"
RESULTS = studies.EXPERIMENTS.parent / "results"
VARIANT = "six_ups/none"
N_SURVEYS, N_DRAWS = 40, 150


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


# --- many twins ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """One calibration against its truth: shares and scores of parameters, errors of predicted poses in µm."""

    covered: float
    spread: float
    error: float
    predicted_sd: float


def draw_truth(twin: Twin, config: StudyConfig, rng: np.random.Generator) -> np.ndarray:
    """Return a machine drawn from the tolerances."""
    layout, theta = twin.machine.layout, twin.machine.layout.nominal.copy()
    for symbol in config.variants[0].free:
        theta[layout.index[symbol]] += rng.normal(0.0, config.parameters[symbol].sd, twin.mechanism.n_legs)
    return theta


def calibrate(
    twin: Twin, config: StudyConfig, survey: Survey, poses: PoseExtraction, theta: np.ndarray, seed: int
) -> Outcome:
    """Return how posterior and prediction at the verification poses fare against the truth, noise-free."""
    inputs = StudyInputs(config, FOLDER, twin.mechanism, TargetMeasurement(survey, poses, "robust"))
    posterior = inputs.posterior(inputs.variant(VARIANT), with_model_error=True)
    found = explore(posterior, np.random.SeedSequence(seed))
    walkers = count_walkers(posterior.n_parameters, 128)
    ensemble = run_ensemble(
        found.straight.log_density, found.proposal, np.random.SeedSequence([seed, 1]), walkers, 30, 40
    )
    y = found.straight.y_from_x(ensemble.draws.reshape(-1, posterior.n_parameters))
    draws = posterior.natural(y)[:, : posterior.n_geometry]
    truth = theta[[twin.machine.layout.names.index(name) for name in posterior.names[: posterior.n_geometry]]]
    rank = np.mean(draws < truth, axis=0)
    held = survey.actuators[survey.verification]
    machine, some = posterior.likelihood.machine, y[:: len(y) // N_DRAWS][:N_DRAWS]
    position = np.array([solve_forward_kinematics(machine, t, held).position for t in posterior.theta(some)])
    error = position.mean(axis=0) - solve_forward_kinematics(twin.machine, theta, held).position
    return Outcome(
        float(np.mean((rank > 0.05) & (rank < 0.95))),
        float(np.sqrt(np.mean(((draws.mean(axis=0) - truth) / draws.std(axis=0)) ** 2))),
        1e3 * float(np.sqrt(np.mean(error**2))),
        1e3 * float(np.sqrt(np.mean(position.var(axis=0)))),
    )


@pytest.mark.slow
def test_intervals_and_predictions_of_many_twins_come_true(twin, configs):
    outcomes: dict[str, list[Outcome]] = {name: [] for name in configs}
    for seed in range(N_SURVEYS):
        theta = draw_truth(twin, configs["study"], np.random.default_rng([seed, 2]))
        survey = survey_twin(twin, np.random.default_rng(seed), theta)[0]
        poses = extract_poses(survey, 1e-3 * configs["study"].data.target_noise_um)
        for name, config in configs.items():
            outcomes[name].append(calibrate(twin, config, survey, poses, theta, seed))
    ours, lengths = outcomes["study"], outcomes["lengths"]
    assert 0.86 <= np.mean([o.covered for o in ours]) <= 0.94
    assert 0.92 <= np.sqrt(np.mean([o.spread**2 for o in ours])) <= 1.08
    ratio = {
        n: np.sqrt(np.mean([o.error**2 for o in of]) / np.mean([o.predicted_sd**2 for o in of]))
        for n, of in outcomes.items()
    }
    assert 0.85 <= ratio["study"] <= 1.2
    # negative control: the lengths alone take the joints' errors upon themselves and know nothing of it
    assert np.mean([o.covered for o in lengths]) < 0.1
    assert ratio["lengths"] > 2
    assert np.mean([o.error for o in lengths]) > 1.5 * np.mean([o.error for o in ours])
