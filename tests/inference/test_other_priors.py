"""Evidences under other widths of the priors by moved draws, against searches of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import lines_posterior, unknown_noise

from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.inference.exploration import explore, weigh_proposal
from bayescal.inference.mode import find_modes
from bayescal.inference.other_priors import weigh_other_priors
from bayescal.inference.schema import EvidenceConfig

EFFORT = EvidenceConfig(draws=4000, max_draws=16_000)


def widen(posterior, factor):
    """Return a posterior whose normal priors are wider by a factor, its uniform ones about their middle."""

    def change(prior):
        if isinstance(prior, NormalPrior):
            return NormalPrior(prior.centre, factor * prior.scale)
        half = 0.5 * factor * (prior.upper - prior.lower)
        return UniformPrior(prior.mean - half, prior.mean + half)

    return replace(posterior, priors={name: change(one) for name, one in posterior.priors.items()})


def weigh(posterior, seed):
    """Return what exploring a posterior finds, and its log-evidence."""
    found = explore(posterior, np.random.SeedSequence(seed), 64, from_prior=True)
    return found, weigh_proposal(found, np.random.SeedSequence(seed + 1), EFFORT)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_moved_draws_find_the_evidence_that_a_search_finds(seed):
    posterior, _, _ = lines_posterior(np.random.default_rng(seed), terms=unknown_noise(4, errors=True))
    posterior = posterior.with_pose_guesses()
    factors = (0.3, 0.5, 2.0, 4.0)
    found, own = weigh(posterior, 10 * seed)
    others = {factor: widen(posterior, factor) for factor in factors}
    moved = weigh_other_priors(found, own, others, np.random.SeedSequence(seed))
    assert len(moved) >= 3
    change = [0.0]
    for factor, evidence in moved.items():
        _, expected = weigh(others[factor], 10 * seed + 5)
        error = np.hypot(evidence.standard_error, expected.standard_error)
        assert abs(evidence.log_evidence - expected.log_evidence) < 4.0 * error
        assert error < 0.1
        change.append(abs(expected.log_evidence - own.log_evidence) / error)
    assert max(change) > 20.0  # the width matters


def test_a_uniform_prior_made_wider_is_left_to_a_search(rng):
    posterior, _, _ = lines_posterior(rng, uniform=True)
    found, own = weigh(posterior, 1)
    others = {factor: widen(posterior, factor) for factor in (0.9, 1.5)}
    assert 1.5 not in weigh_other_priors(found, own, others, np.random.SeedSequence(1))


def test_moved_draws_follow_priors_that_move_the_posterior_far(rng):
    posterior, _, _ = lines_posterior(rng)
    found, own = weigh(posterior, 1)
    away = {name: NormalPrior(one.mean + 0.2, 1e-3) for name, one in posterior.priors.items()}
    narrow = replace(posterior, priors=away)
    evidence = weigh_other_priors(found, own, {0.001: narrow}, np.random.SeedSequence(1))[0.001]
    _, expected = weigh(narrow, 7)
    error = np.hypot(evidence.standard_error, expected.standard_error)
    assert abs(evidence.log_evidence - expected.log_evidence) < 4.0 * error
    assert abs(expected.log_evidence - own.log_evidence) > 1000.0 * error


def test_modes_that_wider_priors_add_count_by_laplace_with_half_of_it_for_an_error(rng, monkeypatch):
    posterior, _, _ = lines_posterior(rng)
    found, own = weigh(posterior, 1)
    others, modes = {2.0: widen(posterior, 2.0)}, find_modes(widen(posterior, 2.0))
    before = weigh_other_priors(found, own, others, np.random.SeedSequence(1))[2.0]
    assert len(found.modes) == len(modes) == 1
    fainter = replace(modes[0], log_density=modes[0].log_density - 1.0)
    monkeypatch.setattr("bayescal.inference.other_priors.find_more_modes", lambda *_: [modes[0], fainter])
    after = weigh_other_priors(found, own, others, np.random.SeedSequence(1))[2.0]
    more = np.log1p(np.exp(-1.0))
    assert after.log_evidence - before.log_evidence == pytest.approx(more)
    assert after.standard_error == pytest.approx(np.hypot(before.standard_error, 0.5 * more))
