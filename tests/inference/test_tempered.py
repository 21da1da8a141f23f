"""Sequential Monte Carlo from the prior against closed forms, and where it has to say that it did not settle."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest
import telescope_machines as machines
from scipy import stats
from scipy.special import logsumexp

from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.errors import NumericalError
from bayescal.inference.diagnostics import list_check_problems
from bayescal.inference.proposal import fit_mixture
from bayescal.inference.tempered import estimate_by_tempering

LOG_TWO_PI = np.log(2 * np.pi)


@dataclass(frozen=True, eq=False)
class Toy:
    """A standard normal prior of n coordinates with a likelihood; below a floor of the first there is no density."""

    log_likelihood: object
    n_parameters: int
    floor: float = -np.inf

    def draw_prior(self, n_draws, rng):
        """Return draws of the prior; NaN below the floor."""
        y = rng.standard_normal((n_draws, self.n_parameters))
        return np.where(y[:, :1] > self.floor, y, np.nan)

    def log_prior(self, y):
        """Return the standard normal log-density."""
        return -0.5 * np.sum(y * y, axis=1) - 0.5 * self.n_parameters * LOG_TWO_PI

    def log_density(self, y):
        """Return prior times likelihood, none below the floor."""
        return np.where(y[:, 0] > self.floor, self.log_prior(y) + self.log_likelihood(y), -np.inf)


def normal(mean, sd):
    """Return the log-likelihood of independent normal data on each coordinate."""
    return lambda y: stats.norm.logpdf(y, mean, sd).sum(axis=1)


def estimate(toy, seed=1, n_runs=4):
    """Return what a short tempering finds."""
    return estimate_by_tempering(toy, np.random.SeedSequence(seed), 256, n_runs)


@pytest.mark.runs
def test_normal_likelihood():
    """A posterior a thousandth as wide as the prior: evidence and moments in closed form."""
    found = estimate(Toy(normal(0.4, 1e-3), 4))
    assert found.log_evidence == pytest.approx(4 * stats.norm.logpdf(0.4, 0, np.sqrt(1 + 1e-6)), abs=0.03)
    assert found.mixed
    mean = found.weights @ found.y
    np.testing.assert_allclose(mean, 0.4, atol=2e-4)
    np.testing.assert_allclose(np.sqrt(found.weights @ (found.y - mean) ** 2), 1e-3, rtol=0.1)
    assert found.weights.sum() == pytest.approx(1.0)


def ring(y, radius=1.2, sd=0.01):
    """Return the log-likelihood of a distance from the origin of the first two coordinates."""
    return stats.norm.logpdf(np.hypot(y[:, 0], y[:, 1]), radius, sd)


@pytest.mark.runs
def test_ring_of_even_mass():
    """Mass of a ring: ∫ r exp(-r²/2) N(r; 1.2, 0.01) dr, and all azimuths alike."""
    r = np.linspace(1.1, 1.3, 2001)
    expected = np.log(np.trapezoid(r * np.exp(-0.5 * r * r) * stats.norm.pdf(r, 1.2, 0.01), r))
    found = estimate(Toy(ring, 3))
    assert found.log_evidence == pytest.approx(expected, abs=0.05)
    azimuth = np.arctan2(found.y[:, 1], found.y[:, 0])
    np.testing.assert_allclose(np.histogram(azimuth, 4, (-np.pi, np.pi), weights=found.weights)[0], 0.25, atol=0.05)


@pytest.mark.runs
def test_modes_keep_their_masses():
    """Two narrow modes, one with 6 % of the mass, that no chain would leave by small steps."""
    means, shares = np.array([[0.8, 0.5], [-1.0, 0.3]]), np.array([0.94, 0.06])

    def both(y):
        masses = [normal(mean, 1.0)(np.zeros((1, 2))) for mean in means]
        terms = [normal(mean, 5e-3)(y) - mass for mean, mass in zip(means, masses, strict=True)]
        return logsumexp(terms, axis=0, b=shares[:, None])

    found = estimate(Toy(both, 2), n_runs=8)
    assert found.log_evidence == pytest.approx(0.0, abs=0.03)
    lesser = found.weights @ (found.y[:, 0] < 0)
    assert lesser == pytest.approx(0.06, abs=0.02)


@pytest.mark.slow
def test_funnel_into_a_narrow_end():
    """Data that are nothing but the scale of five coordinates pull it down, where these are narrow."""

    def funnel(y):
        sd = np.exp(2.0 * y[:, :1] - 2.0)
        return stats.norm.logpdf(y[:, 1:], 0.0, sd).sum(axis=1) + stats.norm.logpdf(y[:, 0], -0.8, 0.2)

    v = np.linspace(-3, 2, 4001)
    inner = 5 * stats.norm.logpdf(0.0, 0.0, np.sqrt(1 + np.exp(4.0 * v - 4.0)))
    expected = np.log(np.trapezoid(np.exp(inner + stats.norm.logpdf(v, -0.8, 0.2)) * stats.norm.pdf(v), v))
    found = estimate(Toy(funnel, 6))
    assert found.log_evidence == pytest.approx(expected, abs=0.1)


def test_what_has_no_coordinates_counts_as_nothing():
    """A quarter of the prior has no machine; the likelihood is that of all the rest alike."""
    floor = stats.norm.ppf(0.25)
    found = estimate(Toy(lambda y: np.zeros(len(y)), 2, floor))
    assert found.log_evidence == pytest.approx(np.log(0.75), abs=0.03)
    assert found.y[:, 0].min() > floor


def test_a_density_almost_nowhere_is_refused():
    with pytest.raises(NumericalError, match="prior draws"):
        estimate(Toy(normal(0.0, 1.0), 2, 6.0))


def test_where_it_started_does_not_matter():
    """Draws of a prior that is twice as wide as its density: the evidence is the density's."""

    class Wide(Toy):
        def draw_prior(self, n_draws, rng):
            return 2.0 * super().draw_prior(n_draws, rng)

    found = estimate(Wide(normal(1.0, 0.1), 2))
    right = 2 * stats.norm.logpdf(1.0, 0, np.sqrt(1.01))
    assert found.log_evidence == pytest.approx(right, abs=0.05)


def test_same_seed_same_numbers():
    one, again, other = (estimate(Toy(normal(0.4, 0.1), 2), seed, 2) for seed in (3, 3, 4))
    assert one.log_evidence == again.log_evidence
    np.testing.assert_array_equal(one.y, again.y)
    assert one.log_evidence != other.log_evidence


@pytest.mark.runs
def test_mixture_follows_a_ring(rng):
    """Draws of a ring are told by many components, of a normal by one; and the density is normalised all the same."""
    angle = rng.uniform(-np.pi, np.pi, 3000)
    draws = 3.0 + (1 + 0.02 * rng.standard_normal(3000)) * np.array([np.cos(angle), np.sin(angle)])
    weights, seen = np.full(3000, 1 / 3000), np.arange(3000) % 2 == 0
    found = fit_mixture(draws.T, weights, seen, rng)
    assert len(found.weights) >= 8
    assert len(fit_mixture(rng.standard_normal((3000, 3)), weights, seen, rng).weights) == 1
    grid = np.stack(np.meshgrid(np.linspace(0, 6, 601), np.linspace(0, 6, 601)), axis=-1).reshape(-1, 2)
    assert np.exp(found.log_density(grid)).sum() * 1e-4 == pytest.approx(1.0, abs=0.01)


def test_agreement_is_refused_beyond_three_standard_errors():
    assert list_check_problems((10.0, 0.01), (10.05, 0.02), settled=True) == []
    (apart,) = list_check_problems((10.0, 0.01), (10.5, 0.02), settled=True)
    assert re.findall(r"[\d.]+\b", apart.partition("10.000")[2]) == ["0.010", "10.500", "0.020", "22.4", "3"]
    for other, settled in ((10.05, False), (np.nan, True)):
        assert len(list_check_problems((10.0, 0.01), (other, 0.02), settled=settled)) == 1


def test_draws_of_a_machines_prior(twin, rng):
    """In their own units they have the priors' distributions, whatever the coordinates."""
    machine = machines.build_machine("none")
    layout = machine.layout
    at = dict(zip(layout.names, layout.nominal, strict=True))
    priors = {
        "l[1]": UniformPrior(at["l[1]"] - 2.0, at["l[1]"] + 2.0),
        "a_x[1]": NormalPrior(at["a_x[1]"], 2.0),
        "u_x[1]": NormalPrior(0.0, 0.05),
        "u_y[1]": NormalPrior(0.01, 0.04),
    }
    posterior = machines.measure(machine, twin, priors, machines.let_err(0.01, shared=True))
    natural = posterior.natural(posterior.draw_prior(4000, rng))
    for k, (name, prior) in enumerate(posterior.all_priors().items()):
        if isinstance(prior, UniformPrior):
            expected = stats.uniform(prior.lower, prior.upper - prior.lower)
        else:
            expected = stats.halfnorm(scale=0.01) if name == "tau" else stats.norm(prior.centre, prior.scale)
        assert stats.kstest(natural[:, k], expected.cdf).pvalue > 1e-3, name
