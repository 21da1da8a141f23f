"""Leaving a pose out by a run of its own, against the evidence of the posterior that has never seen it."""

from __future__ import annotations

import numpy as np
import pytest
import studies

from bayescal.inference.correction import draw_to_correct
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.leave_one_out import (
    MAX_REFITS,
    LeaveOneOut,
    leave_out,
    move_without,
    refit_doubtful,
    refit_without,
)
from bayescal.inference.sampling import sample_posterior

POSE = 12  # the worst one of a variant that misfits


@pytest.fixture(scope="module")
def variant(tmp_path_factory):
    return studies.load_study(studies.write_tiny_study(tmp_path_factory.mktemp("tiny"))).variants["six_pus/none"]


@pytest.fixture(scope="module")
def posterior(variant):
    return variant.posterior().with_pose_guesses()


@pytest.fixture(scope="module")
def found(posterior):
    return explore(posterior, np.random.SeedSequence(3))


def log_evidence(posterior, exploration) -> float:
    rng = np.random.default_rng(4)
    return estimate_by_importance(exploration.straight.log_density, exploration.proposal, rng, 8000).log_evidence


def test_a_run_without_a_pose_gives_the_difference_of_evidences(variant, posterior, found):
    """p(y_i | the others) = p(all) / p(the others), the latter from a likelihood that has never seen the pose."""
    others = ~variant.verification
    others[np.flatnonzero(others)[POSE]] = False
    rest = variant.posterior(others).with_pose_guesses()
    expected = log_evidence(posterior, found) - log_evidence(rest, explore(rest, np.random.SeedSequence(5)))
    moved = move_without(POSE, posterior, found, *draw_to_correct(found, np.random.default_rng(7), 1024))
    assert -moved.log_ratio == pytest.approx(expected, abs=0.1)
    proposal = moved.move.move_proposal(found.proposal)
    refitted = refit_without(POSE, posterior, found, proposal, 64, np.random.SeedSequence(6))
    assert refitted == pytest.approx(expected, abs=0.15)


def test_where_moved_draws_are_not_enough_a_run_is(posterior, found, monkeypatch):
    enough = refit_doubtful(make_left_out(1), posterior, found, 64, np.random.SeedSequence(9)).refitted[0]
    monkeypatch.setattr("bayescal.inference.leave_one_out.MAX_LOO_ERROR_NAT", 0.0)
    run = refit_doubtful(make_left_out(1), posterior, found, 64, np.random.SeedSequence(9)).refitted[0]
    assert run != enough
    assert run == pytest.approx(enough, abs=0.15)


def test_weights_and_runs_agree_where_weights_are_good(posterior, found):
    sample = sample_posterior(found, np.random.SeedSequence(7), 4, 32, 20, 40)
    flat = sample.y.reshape(4, -1, posterior.n_parameters)
    density = posterior.pointwise(flat.reshape(-1, posterior.n_parameters)).reshape(*flat.shape[:2], -1)
    weighted = leave_out(posterior.natural(flat), density)
    best = int(np.argmin(weighted.pareto_k))
    assert weighted.pareto_k[best] < 0.5
    refitted = refit_without(best, posterior, found, found.proposal, 64, np.random.SeedSequence(8))
    assert refitted == pytest.approx(weighted.elpd[best], abs=0.15)


def make_left_out(n_bad: int) -> LeaveOneOut:
    pareto_k = np.where(np.arange(13) < n_bad, 0.9, 0.1)
    return LeaveOneOut(np.zeros(13), pareto_k, np.zeros(13), np.full(13, np.nan))


def test_bad_poses_alone_are_refitted(posterior, found):
    left_out = refit_doubtful(make_left_out(2), posterior, found, 16, np.random.SeedSequence(9))
    assert left_out.was_refitted.tolist() == [True] * 2 + [False] * 11
    assert not left_out.is_doubtful.any()
    assert (left_out.elpd[2:] == 0).all()
    assert (left_out.elpd[:2] != 0).all()


def test_where_too_many_are_bad_none_is_refitted_and_all_are_counted(posterior, found):
    left_out = refit_doubtful(make_left_out(MAX_REFITS + 1), posterior, found, 16, np.random.SeedSequence(9))
    assert not left_out.was_refitted.any()
    assert left_out.is_doubtful.sum() == MAX_REFITS + 1
