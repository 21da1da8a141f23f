"""From simulated targets to intervals, fifty times: the whole chain covers the truth as often as it says."""

from pathlib import Path

import numpy as np
import pytest

from bayescal.data.photogrammetry.poses import extract_poses
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.simulation.compute import build_twin, survey_twin
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import TargetMeasurement
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import explore
from bayescal.inference.schema import count_walkers

TELESCOPE = Path(__file__).parents[3] / "experiments" / "telescope"
N_SURVEYS = 50


@pytest.fixture(scope="module")
def twin():
    return build_twin(load_experiment(TELESCOPE / "simulate.toml"), TELESCOPE)


@pytest.fixture(scope="module")
def config():
    return load_experiment(TELESCOPE / "study.toml")


def draw_truth(twin, config, variant, rng):
    """Return a machine drawn from the study's own priors."""
    layout, theta = twin.machine.layout, twin.machine.layout.nominal.copy()
    for symbol in variant.free:
        theta[layout.index[symbol]] += rng.normal(0.0, config.parameters[symbol].sd, twin.mechanism.n_legs)
    return theta


def infer(twin, config, theta, seed):
    """Return z-scores and posterior ranks of the true geometry, K estimated from the targets of the same survey."""
    survey = survey_twin(twin, np.random.default_rng(seed), theta)[0]
    noise = 1e-3 * config.measured.target_noise_um
    inputs = StudyInputs(
        config, TELESCOPE, twin.mechanism, TargetMeasurement(survey, extract_poses(survey, noise), "robust")
    )
    variant = inputs.variant("six_pus/matrix")
    posterior = inputs.posterior(variant, with_model_error=True)
    found = explore(posterior, np.random.SeedSequence(seed))
    walkers = count_walkers(posterior.n_parameters, 128)
    ensemble = run_ensemble(
        found.straight.log_density, found.proposal, np.random.SeedSequence([seed, 1]), walkers, 30, 40
    )
    y = found.straight.y_from_x(ensemble.draws.reshape(-1, posterior.n_parameters))
    draws = posterior.natural(y)[:, : posterior.n_geometry]
    truth = theta[[twin.machine.layout.names.index(name) for name in posterior.names[: posterior.n_geometry]]]
    return (draws.mean(axis=0) - truth) / draws.std(axis=0), np.mean(draws < truth, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("from_prior", [False, True], ids=["published truth", "truth from the prior"])
def test_ninety_percent_intervals_cover_from_targets_on(twin, config, from_prior):
    variant = next(v for v in config.variants if v.name == "six_pus/matrix")
    results = []
    for seed in range(N_SURVEYS):
        theta = draw_truth(twin, config, variant, np.random.default_rng([seed, 2])) if from_prior else twin.theta
        results.append(infer(twin, config, theta, seed))
    z, rank = np.array([r[0] for r in results]), np.array([r[1] for r in results])
    coverage = np.mean((rank > 0.05) & (rank < 0.95))
    assert 0.85 <= coverage <= 0.95
    assert 0.85 <= z.std() <= 1.15
    # 1800 normal scores exceed 4 with probability 0.11; five would be a fault
    assert np.sum(np.abs(z) > 4) <= 1
    assert np.abs(z).max() < 5


def test_shipped_twin_is_recovered(twin, config):
    """The study's own data: every parameter of the matrix variant within four posterior sds of the truth."""
    from bayescal.experiments.study.inputs import load_inputs

    inputs = load_inputs(config, TELESCOPE)
    posterior = inputs.posterior(inputs.variant("six_pus/matrix"), with_model_error=True)
    found = explore(posterior, np.random.SeedSequence(1))
    walkers = count_walkers(posterior.n_parameters, 128)
    ensemble = run_ensemble(found.straight.log_density, found.proposal, np.random.SeedSequence(2), walkers, 30, 40)
    y = found.straight.y_from_x(ensemble.draws.reshape(-1, posterior.n_parameters))
    draws = posterior.natural(y)[:, : posterior.n_geometry]
    truth = twin.theta[[twin.machine.layout.names.index(name) for name in posterior.names[: posterior.n_geometry]]]
    assert np.all(np.abs(draws.mean(axis=0) - truth) < 4 * draws.std(axis=0))
    # and it is not won by width: nominal values are refused
    nominal = posterior.likelihood.machine.layout.nominal[posterior.sampling.free]
    assert np.any(np.abs(draws.mean(axis=0) - nominal) > 4 * draws.std(axis=0))
