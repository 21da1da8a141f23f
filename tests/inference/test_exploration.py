"""The telescope's variants: proposals good enough to be used, and two unrelated evidences that agree."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import FINE_ENOUGH, Exploration, _compare, _refit, add_clusters, explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.schema import count_walkers

SEED, NAMES = 1, ("none", "linear", "matrix")


@pytest.fixture(scope="module")
def explorations(twin):
    """Return the variants with free model errors per leg, and what exploring them found."""
    posteriors = {name: machines.build_posterior(name, twin, machines.let_err()).with_pose_guesses() for name in NAMES}
    return {name: (p, explore(p, np.random.SeedSequence(SEED))) for name, p in posteriors.items()}


@pytest.fixture(params=NAMES)
def explored(request, explorations):
    """Return a variant and its exploration."""
    return explorations[request.param]


def test_proposal_is_efficient(explored):
    posterior, found = explored
    assert found.efficiency > 0.05
    evidence = estimate_by_importance(found.straight.log_density, found.proposal, np.random.default_rng(3), 10_000)
    assert evidence.efficiency > 0.05
    assert evidence.pareto_k < 0.7
    assert found.modes[0].log_density == max(mode.log_density for mode in found.modes)
    assert found.proposal.means.shape[1] == posterior.n_parameters


@pytest.mark.runs
def test_evidences_agree(explored):
    posterior, found = explored
    density = found.straight.log_density
    importance = estimate_by_importance(density, found.proposal, np.random.default_rng(3), 10_000, 0.03, 100_000)
    walkers = count_walkers(posterior.n_parameters, 128)
    seeds = np.random.SeedSequence(5).spawn(4)
    runs = [run_ensemble(density, found.proposal, seed, walkers, 30, 50) for seed in seeds]
    draws, densities = np.stack([run.draws for run in runs]), np.stack([run.log_density for run in runs])
    bridge = estimate_by_bridge(density, draws, densities, np.random.default_rng(7), 10_000)
    difference = importance.log_evidence - bridge.log_evidence
    assert abs(difference) < 0.1
    assert abs(difference) < 4 * np.hypot(importance.standard_error, bridge.standard_error)
    assert bridge.converged
    assert min(run.acceptance for run in runs) > 0.15


def test_the_true_deformation_has_the_highest_evidence(explorations):
    """The data are of the matrix deformation, and Laplace's approximation leaves no doubt about it."""
    found = {name: exploration.modes[0].log_evidence for name, (_, exploration) in explorations.items()}
    assert found["matrix"] > max(found["none"], found["linear"]) + 100


def test_same_seed_explores_alike(explorations):
    posterior, first = explorations["linear"]
    second = explore(posterior, np.random.SeedSequence(SEED))
    assert first.efficiency == second.efficiency
    np.testing.assert_array_equal(first.proposal.factors, second.proposal.factors)
    other = explore(posterior, np.random.SeedSequence(SEED + 1))
    assert first.efficiency != other.efficiency


@pytest.mark.parametrize(
    ("n_parameters", "asked", "expected"), [(42, 128, 128), (66, 128, 134), (42, 127, 126), (3, 1, 8)]
)
def test_number_of_walkers_is_even_and_large_enough(n_parameters, asked, expected):
    assert count_walkers(n_parameters, asked) == expected
    assert count_walkers(n_parameters, asked) >= 2 * n_parameters + 2


def test_clusters_mend_weights_with_a_heavy_tail(twin):
    """A proposal half as wide as the posterior has such weights; with clusters of its chains' draws it has not."""
    posterior = machines.build_posterior(
        "matrix", twin.select(np.arange(12)), machines.let_err(None), ("l", "kappa")
    ).with_pose_guesses()
    found = explore(posterior, np.random.SeedSequence(SEED))
    narrow = replace(found, proposal=replace(found.proposal, factors=0.5 * found.proposal.factors))
    density, rng = found.straight.log_density, np.random.default_rng(3)
    bad, mended = (
        estimate_by_importance(density, one.proposal, rng, 4000)
        for one in (narrow, add_clusters(narrow, np.random.SeedSequence(2)))
    )
    good = estimate_by_importance(density, found.proposal, rng, 4000)
    assert bad.is_doubtful
    assert not mended.is_doubtful
    assert mended.is_better_than(bad)
    assert mended.log_evidence == pytest.approx(good.log_evidence, abs=0.1)


@pytest.mark.parametrize(("finer", "fine"), [("in the tails", True), ("at draws of the posterior", False)])
def test_a_density_is_fine_where_its_posterior_has_draws(finer, fine):
    """A wide proposal has draws far off, where a coarse density may be wrong by hundreds of nats."""

    def coarse(x):
        return -0.5 * np.sum(x**2, axis=1)

    def other(x):
        far = np.abs(x).max(axis=1) > 4.0
        return coarse(x) + (np.where(far, -200.0, 0.0) if fine else 2.0 * x[:, 0])

    proposal = MixtureProposal(np.ones(1), np.zeros((1, 2)), 3.0 * np.eye(2)[None], 8.0)
    posterior = SimpleNamespace(log_density=coarse)
    straight = SimpleNamespace(y_from_x=lambda x: x, log_density=coarse, posterior=posterior)
    found = Exploration(straight, proposal, [], 0.2)
    share, left_out = _compare(found, SimpleNamespace(log_density=other), np.random.default_rng(1))
    assert (share >= FINE_ENOUGH) is (left_out < 0.1) is fine


def test_a_pilot_whose_walkers_stand_still_keeps_what_was_known(explorations):
    posterior, found = explorations["none"]
    still = np.tile(found.straight.x_from_y(found.modes[0].y[None]), (50 * posterior.n_parameters, 1))
    proposal = _refit(found.straight, still, found.modes)
    assert np.isfinite(proposal.log_density(still[:1])).all()
