"""The telescope's variants: proposals good enough to be used, and two unrelated evidences that agree."""

from __future__ import annotations

import machines
import numpy as np
import pytest
from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import count_walkers, explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.posterior import ModelError


@pytest.fixture(params=["none", "linear", "matrix"], scope="module")
def explored(request, twin):
    """Return a variant with free model errors per leg, and its exploration."""
    posterior = machines.build_posterior(request.param, twin, ModelError(0.01))
    return request.param, posterior, explore(posterior, np.random.SeedSequence(1))


def test_proposal_is_efficient(explored):
    _, posterior, found = explored
    assert found.efficiency > 0.05
    evidence = estimate_by_importance(
        found.straight.log_density, found.proposal, np.random.default_rng(3), 10_000
    )
    assert evidence.efficiency > 0.05
    assert evidence.pareto_k < 0.7
    assert found.modes[0].log_density == max(mode.log_density for mode in found.modes)
    assert found.proposal.means.shape[1] == posterior.n_parameters


def test_evidences_agree(explored):
    name, posterior, found = explored
    density = found.straight.log_density
    importance = estimate_by_importance(density, found.proposal, np.random.default_rng(3), 20_000, 0.02, 100_000)
    walkers = count_walkers(posterior.n_parameters, 128)
    seeds = np.random.SeedSequence(5).spawn(4)
    runs = [run_ensemble(density, found.proposal, seed, walkers, 30, 80) for seed in seeds]
    draws, densities = np.stack([run.draws for run in runs]), np.stack([run.log_density for run in runs])
    bridge = estimate_by_bridge(density, draws, densities, np.random.default_rng(7), 20_000)
    difference = importance.log_evidence - bridge.log_evidence
    assert abs(difference) < 0.1
    assert abs(difference) < 4 * np.hypot(importance.standard_error, bridge.standard_error)
    assert bridge.converged
    assert min(run.acceptance for run in runs) > 0.15


def test_the_true_deformation_has_the_highest_evidence(twin):
    """The data are of the matrix deformation, and neither estimate is in doubt about it."""
    found = {}
    for name in ("none", "linear", "matrix"):
        posterior = machines.build_posterior(name, twin, ModelError(0.01))
        exploration = explore(posterior, np.random.SeedSequence(2))
        found[name] = exploration.modes[0].log_evidence
    assert found["matrix"] > max(found["none"], found["linear"]) + 100


def test_same_seed_explores_alike(twin):
    posterior = machines.build_posterior("linear", twin, ModelError(0.01))
    first, second = (explore(posterior, np.random.SeedSequence(4)) for _ in range(2))
    assert first.efficiency == second.efficiency
    np.testing.assert_array_equal(first.proposal.factors, second.proposal.factors)


@pytest.mark.parametrize(("n_parameters", "asked", "expected"), [(42, 128, 128), (66, 128, 134), (42, 127, 126), (3, 1, 8)])
def test_number_of_walkers_is_even_and_large_enough(n_parameters, asked, expected):
    assert count_walkers(n_parameters, asked) == expected
    assert count_walkers(n_parameters, asked) >= 2 * n_parameters + 2
