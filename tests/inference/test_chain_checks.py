"""Draws and walkers from far out: planted misses of a proposal are seen, and nothing is said where there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bayescal.inference.chain_checks import (
    StretchedMixture,
    TailShare,
    compare_tail_mass,
    draw_tails,
    fit_tails,
)
from bayescal.inference.diagnostics import list_importance_problems
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.reparameterisation import Reparameterisation
from bayescal.inference.sampling import sample_posterior

N = 6
APART = 9.0


@dataclass(frozen=True)
class Toy:
    """A density with a name for tests of ensembles, which need no more of a target."""

    log_density: object
    n_parameters: int = N
    n_geometry: int = N

    def natural(self, y):
        return y


def normal(y):
    """Standard normal."""
    return -0.5 * (y * y).sum(axis=1)


def two_modes(y):
    """Two of equal mass, apart along the first coordinate."""
    return np.logaddexp(normal(y), normal(y - APART * np.eye(N)[0]))


def minor_mode(y):
    """One of a tenth of the mass, where the first coordinate is looser than the others."""
    y = y / np.array([3.0, *np.ones(N - 1)])
    return np.logaddexp(np.log(0.9) + normal(y), np.log(0.1) + normal(y - 5.0 * np.eye(N)[0]))


def banana(y):
    """A ridge that bends away from its tangent."""
    bent = y.copy()
    bent[:, 0] /= 3.0
    bent[:, 1] -= 0.5 * (y[:, 0] ** 2 - 9.0)
    return normal(bent)


def long_tail(y):
    """One tail of the first coordinate is exponential, five times as long as the proposal is wide."""
    first = np.where(y[:, 0] > 0, -y[:, 0] / 5.0, -0.5 * y[:, 0] ** 2)
    return first + normal(y[:, 1:])


def skewed(y):
    """Log-gamma: tails that differ, none heavy."""
    return (5.0 * y / np.sqrt(5.0) - 5.0 * np.exp(y / np.sqrt(5.0))).sum(axis=1)


def gaussian(*sd, means=((0.0,) * N,)):
    """Return a proposal of one shape about each mean."""
    scale = np.diag([*sd, *np.ones(N - len(sd))])
    return MixtureProposal(np.full(len(means), 1.0 / len(means)), np.array(means), np.array([scale] * len(means)), 50.0)


def explored(density, proposal):
    """Return what an exploration that found a proposal would be."""
    return Exploration(Reparameterisation(Toy(density), np.zeros(N), (), np.empty(0), np.empty(0)), proposal, [], 1.0)


def look(density, proposal, seed=1):
    """Return the problems that other diagnostics name of a proposal and its sample, and those of the mass in tails."""
    found = explored(density, proposal)
    first, second, third = np.random.SeedSequence(seed).spawn(3)
    sample = sample_posterior(found, first, 4, 64, 20, 40)
    weighed = estimate_by_importance(density, proposal, np.random.default_rng(second), 5000)
    others = sample.diagnostics.list_problems()
    others += list_importance_problems(weighed.pareto_k, weighed.efficiency * weighed.n_draws)
    return others, compare_tail_mass(found, sample, draw_tails(found, third)).list_problems()


def test_a_mode_that_all_others_are_blind_to_is_seen():
    """Two modes nine deviations apart, and a proposal of one of them: evidence wrong by log 2."""
    others, tails = look(two_modes, gaussian())
    assert not others
    assert "in tails" in tails[0]


MISSED = {
    "minor mode": (minor_mode, gaussian(3.0)),
    "bend": (banana, gaussian(0.5)),
    "long tail": (long_tail, gaussian()),
    "width": (normal, gaussian(*[0.4] * N)),
}
CLEAN = {
    "normal": (normal, gaussian()),
    "too wide": (normal, gaussian(*[1.3] * N)),
    "skewed": (skewed, gaussian()),
    "both modes": (two_modes, gaussian(means=((0.0,) * N, (APART, *(0.0,) * (N - 1))))),
}


@pytest.mark.parametrize("name", MISSED)
def test_what_a_proposal_misses_never_counts_as_converged(name):
    others, tails = look(*MISSED[name])
    assert others + tails


@pytest.mark.parametrize("name", CLEAN)
def test_nothing_is_said_where_nothing_is_missed(name):
    assert not look(*CLEAN[name])[1]


@pytest.mark.parametrize("shift", [0.0, 4.0])
def test_stretched_density_is_that_of_its_draws(shift):
    """Weighted by it, draws integrate any density of mass one: along the stretched axes as well as about the centre."""
    factor = np.array([[2.0, 0.0], [0.6, 0.5]])
    wide = StretchedMixture(MixtureProposal(np.ones(1), np.zeros((1, 2)), factor[None], 50.0))
    draws = wide.draw(50_000, np.random.default_rng(1))
    loosest = np.linalg.svd(factor)[0][:, 0] * np.linalg.svd(factor)[1][0]
    white = np.linalg.solve(factor, (draws - shift * loosest).T)
    weights = np.exp(-0.5 * (white * white).sum(axis=0) - wide.log_density(draws)) / np.linalg.det(factor) / (2 * np.pi)
    assert weights.mean() == pytest.approx(1.0, abs=4 * weights.std() / np.sqrt(len(weights)))
    assert weights.std() < 4 * weights.mean()


# --- tails ------------------------------------------------------------------------------------------------------------


def compare(density, proposal, n_steps=40, seed=1):
    """Return what ensembles have of a density's tails beyond a proposal."""
    found = explored(density, proposal)
    first, second = np.random.SeedSequence(seed).spawn(2)
    sample = sample_posterior(found, first, 4, 64, n_steps // 2, n_steps)
    return compare_tail_mass(found, sample, draw_tails(found, second))


@pytest.mark.parametrize("name", ["minor mode", "bend", "long tail"])
def test_tails_that_a_short_run_lacks_are_named(name):
    (said,) = compare(*MISSED[name]).list_problems()
    assert "more steps" in said


@pytest.mark.parametrize("name", CLEAN)
def test_nothing_is_said_of_draws_that_lack_nothing(name):
    assert not compare(*CLEAN[name]).list_problems()


@pytest.mark.runs
def test_more_steps_get_there():
    """Beyond where the proposal's density is 20 times too low lies the share of an exponential tail in closed form."""
    short, long = (compare(long_tail, gaussian(), n) for n in (20, 2000))
    assert short.found < 0.5 * long.found
    assert not long.list_problems()
    mass = 5.0 + np.sqrt(np.pi / 2.0)  # of exp(-y / 5) and of half a normal
    log_excess = np.linspace(0.0, 40.0, 400_001)  # y > 0, the other coordinates at their proposal's own density, nearly
    ratio = 0.5 * np.log(2.0 * np.pi) - np.log(mass) - log_excess / 5.0 + 0.5 * log_excess**2
    begins = log_excess[np.argmax(ratio > np.log(20.0))]
    share = 5.0 * np.exp(-begins / 5.0) / mass
    assert long.expected == pytest.approx(share, abs=4.0 * long.error)
    assert long.found == pytest.approx(share, abs=0.05)


def test_a_small_lack_and_one_by_chance_are_not_said():
    assert not TailShare(0.009, 0.0, 0.0).list_problems()
    assert not TailShare(0.05, 0.01, 0.02).list_problems()
    assert not TailShare(0.0, 0.0, 0.0).list_problems()
    assert TailShare(0.05, 0.01, 0.01).list_problems()
    assert "(inf " in TailShare(0.05, 0.0, 0.0).list_problems()[0]  # standard errors of draws that none lies far out


def test_a_proposal_gets_the_tails_that_a_posterior_has():
    """Of a Student t of three degrees of freedom a Gaussian's own draws do not know."""

    def student(y):
        return -0.5 * (3.0 + N) * np.log1p((y * y).sum(axis=1) / 3.0)

    found = explored(student, gaussian())
    wider = fit_tails(found, draw_tails(found, np.random.SeedSequence(2)))
    assert wider.proposal.dof == 4.0
    assert 0.5 < wider.efficiency <= 1.0


@pytest.mark.parametrize("name", CLEAN)
def test_a_proposal_that_leads_everywhere_stays_as_it_is(name):
    found = explored(*CLEAN[name])
    assert fit_tails(found, draw_tails(found, np.random.SeedSequence(3))) is found
