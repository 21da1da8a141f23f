"""Draws that lack a posterior's tails are told by the weights of others that get there."""

from __future__ import annotations

import numpy as np
import pytest
from test_scouts import CLEAN, MISSED, N, Toy, gaussian, long_tail

from bayescal.inference.diagnostics import list_tail_problems
from bayescal.inference.exploration import Exploration
from bayescal.inference.overdispersed import compare_tails, draw_far_out, fit_tails
from bayescal.inference.sampling import sample_posterior
from bayescal.inference.straightening import Straightening


def explored(density, proposal):
    """Return what an exploration that found a proposal would be."""
    return Exploration(Straightening(Toy(density), np.zeros(N), (), np.empty(0), np.empty(0)), proposal, [], 1.0)


def compare(density, proposal, n_steps=40, seed=1):
    """Return what ensembles have of a density's tails beyond a proposal."""
    found = explored(density, proposal)
    first, second = np.random.SeedSequence(seed).spawn(2)
    sample = sample_posterior(found, first, 4, 64, n_steps // 2, n_steps)
    return compare_tails(found, sample, draw_far_out(found, second))


@pytest.mark.parametrize("name", ["minor mode", "bend", "long tail"])
def test_tails_that_a_short_run_lacks_are_named(name):
    (said,) = list_tail_problems(**vars(compare(*MISSED[name])))
    assert "more steps get there" in said


@pytest.mark.parametrize("name", CLEAN)
def test_nothing_is_said_of_draws_that_lack_nothing(name):
    assert not list_tail_problems(**vars(compare(*CLEAN[name])))


def test_more_steps_get_there():
    """Beyond where the proposal's density is 20 times too low lies the share of an exponential tail in closed form."""
    short, long = (compare(long_tail, gaussian(), n) for n in (20, 2000))
    assert short.found < 0.5 * long.found
    assert not list_tail_problems(**vars(long))
    mass = 5.0 + np.sqrt(np.pi / 2.0)  # of exp(-y / 5) and of half a normal
    log_excess = np.linspace(0.0, 40.0, 400_001)  # y > 0, the other coordinates at their proposal's own density, nearly
    ratio = 0.5 * np.log(2.0 * np.pi) - np.log(mass) - log_excess / 5.0 + 0.5 * log_excess**2
    begins = log_excess[np.argmax(ratio > np.log(20.0))]
    share = 5.0 * np.exp(-begins / 5.0) / mass
    assert long.expected == pytest.approx(share, abs=4.0 * long.error)
    assert long.found == pytest.approx(share, abs=0.05)


def test_a_small_lack_and_one_by_chance_are_not_said():
    assert not list_tail_problems(0.009, 0.0, 0.0)
    assert not list_tail_problems(0.05, 0.01, 0.02)
    assert not list_tail_problems(0.0, 0.0, 0.0)
    assert list_tail_problems(0.05, 0.01, 0.01)


def test_a_proposal_gets_the_tails_that_a_posterior_has():
    """Of a Student t of three degrees of freedom a Gaussian's own draws do not know."""

    def student(y):
        return -0.5 * (3.0 + N) * np.log1p((y * y).sum(axis=1) / 3.0)

    found = explored(student, gaussian())
    wider = fit_tails(found, draw_far_out(found, np.random.SeedSequence(2)))
    assert wider.proposal.dof == 4.0
    assert 0.5 < wider.efficiency <= 1.0


@pytest.mark.parametrize("name", CLEAN)
def test_a_proposal_that_leads_everywhere_stays_as_it_is(name):
    found = explored(*CLEAN[name])
    assert fit_tails(found, draw_far_out(found, np.random.SeedSequence(3))) is found
