"""From simulated targets to intervals, many times: the whole chain covers the truth as often as it says.

Of the hexapod the lengths alone are the negative control: with the joints taken for nominal the fit looks as good, and
the posterior is certain of wrong lengths.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import studies

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.simulation.compute import Twin, build_twin, format_survey
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import explore
from bayescal.inference.schema import count_walkers
from bayescal.machines.kinematics import solve_forward_kinematics

N_SURVEYS, N_DRAWS = 50, 150
VARIANTS = {"telescope": "six_pus/matrix", "m2_hexapod": "six_ups/none"}


@dataclass(frozen=True)
class Shipped:
    """A copy of a shipped example, of whose twin other surveys are made."""

    folder: Path
    variant: str
    twin: Twin

    @property
    def free(self) -> list[str]:
        """Symbols that the variant frees."""
        return next(one.free for one in self.config().variants if one.name == self.variant)

    def config(self, name: str = "study") -> StudyConfig:
        """Return a study."""
        return load_experiment(self.folder / f"{name}.toml")

    def draw_truth(self, rng: np.random.Generator) -> np.ndarray:
        """Return a machine drawn from the study's own priors."""
        layout, theta, config = self.twin.machine.layout, self.twin.machine.layout.nominal.copy(), self.config()
        for symbol in self.free:
            theta[layout.index[symbol]] += rng.normal(0.0, config.parameters[symbol].sd, self.twin.mechanism.n_legs)
        return theta

    def survey(self, theta: np.ndarray, seed: int) -> None:
        """Put a survey of a machine instead of the shipped one."""
        survey = self.twin.seen.survey(self.twin, np.random.default_rng(seed), theta)[0]
        studies.write_texts(self.folder / "data", format_survey(survey, "Simulated for the tests"))

    def infer(self, theta: np.ndarray, seed: int, name: str = "study") -> Outcome:
        """Return how the posterior of the survey fares against the machine that it is of."""
        inputs = StudyInputs.load(self.config(name), self.folder, [self.variant])
        posterior = inputs.variants[self.variant].posterior().with_pose_guesses()
        y = draw(posterior, seed)
        draws = posterior.natural(y)[:, : posterior.n_geometry]
        places = [self.twin.machine.layout.names.index(name) for name in posterior.sampling.names]
        held = inputs.measured[0].poses.actuators[inputs.verification]
        machine, some = inputs.variants[self.variant].whole.machine, y[:: len(y) // N_DRAWS][:N_DRAWS]
        position = np.array([solve_forward_kinematics(machine, t, held).position for t in posterior.theta(some)])
        error = position.mean(axis=0) - solve_forward_kinematics(self.twin.machine, theta, held).position
        z, rank = (draws.mean(axis=0) - theta[places]) / draws.std(axis=0), np.mean(draws < theta[places], axis=0)
        nominal = self.twin.machine.layout.nominal[places]
        away = (draws.mean(axis=0) - nominal) / draws.std(axis=0)
        return Outcome(z, rank, away, float(np.mean(error**2)), float(np.mean(position.var(axis=0))))


@dataclass(frozen=True)
class Outcome:
    """Scores and ranks of the true parameters, and scores of nominal ones, (n,); squares (mm²) of errors of poses."""

    z: np.ndarray
    rank: np.ndarray
    away: np.ndarray
    square: float
    expected: float


def draw(posterior: CalibrationPosterior, seed: int) -> np.ndarray:
    """Return draws (S, n) of an ensemble."""
    found, n = explore(posterior, np.random.SeedSequence(seed)), posterior.n_parameters
    seeds, walkers = np.random.SeedSequence([seed, 1]), count_walkers(n, 128)
    ensemble = run_ensemble(found.straight.log_density, found.proposal, seeds, walkers, 30, 40)
    return found.straight.y_from_x(ensemble.draws.reshape(-1, n))


@pytest.fixture(scope="module", params=VARIANTS)
def shipped(request, tmp_path_factory) -> Shipped:
    folder = tmp_path_factory.mktemp("shipped") / request.param
    shutil.copytree(studies.EXPERIMENTS / request.param, folder)
    audit = studies.EXPERIMENTS / "audit"
    shutil.copytree(audit, folder.parent / "audit")
    twin = build_twin(load_experiment(folder / "simulate.toml"), folder)
    return Shipped(folder, VARIANTS[request.param], twin)


def stack(outcomes: list[Outcome]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return all scores and ranks, and how far predictions are off in units of what they say."""
    ratio = sum(one.square for one in outcomes) / sum(one.expected for one in outcomes)
    return np.array([one.z for one in outcomes]), np.array([one.rank for one in outcomes]), float(np.sqrt(ratio))


@pytest.mark.slow
@pytest.mark.parametrize("from_prior", [False, True], ids=["shipped truth", "truth from the prior"])
def test_ninety_percent_intervals_cover_from_targets_on(shipped, from_prior):
    outcomes, lengths = [], []
    for seed in range(N_SURVEYS):
        theta = shipped.draw_truth(np.random.default_rng([seed, 2])) if from_prior else shipped.twin.theta
        shipped.survey(theta, seed)
        outcomes.append(shipped.infer(theta, seed))
        if from_prior and shipped.folder.name == "m2_hexapod":
            lengths.append(shipped.infer(theta, seed, "lengths"))
    z, rank, ratio = stack(outcomes)
    assert 0.85 <= np.mean((rank > 0.05) & (rank < 0.95)) <= 0.95
    assert 0.85 <= z.std() <= 1.15
    # of 1800 normal scores one exceeds 4 with probability 0.11; five would be a fault
    assert np.sum(np.abs(z) > 4) <= 1
    assert np.abs(z).max() < 5
    assert 0.85 <= ratio <= 1.2
    if lengths:
        _, rank, ratio = stack(lengths)
        assert np.mean((rank > 0.05) & (rank < 0.95)) < 0.1
        assert ratio > 2.0


def test_shipped_twin_is_recovered(shipped):
    """Every parameter within four posterior sds of the truth."""
    for name in ("targets", "actuators"):
        shutil.copy(studies.EXPERIMENTS / shipped.folder.name / "data" / f"{name}.csv", shipped.folder / "data")
    found = shipped.infer(shipped.twin.theta, 1)
    assert np.abs(found.z).max() < 4.0
    if shipped.folder.name == "telescope":  # and it is not won by width: nominal values are refused
        assert (np.abs(found.away) > 4.0).any()
