"""Adaptive importance sampling: a mixture fitted to weighted draws again and again, where no peak is the posterior.

A posterior that is hardly narrower than its prior has bounds, shoulders and flat tops that no Gaussian about a mode
follows. Draws weighed by the mixture of all proposals that they came from (Cornuet, Marin, Mira and Robert 2012) show
its shape after a few blocks, each evaluated at once; chains of few walkers take many times as long to do so. The first
proposal and a Gaussian like the prior keep a share in each mixture, so that no region is lost.

Two legs between bounds, seen in three poses with a hundred times the noise, had 15 instead of 7 % effective draws with
it and an evidence that was not 0.15 nats low; no posterior of `benchmarks/ablation` needs it, the Hangprinter's
`robust` needs it or pilots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal, fit_mixture, proposal_from_draws
from bayescal.inference.reparameterisation import Reparameterisation
from bayescal.numerics.geometry import Array

DRAWS, BLOCKS = 500, 6
PATIENCE = 3  # blocks without a better one
MARGIN = 1.2  # an efficiency by few draws is often too large by chance
FIRST_SHARE, PRIOR_SHARE = 0.1, 0.1
DOF = 8.0  # of all components: lighter tails than those of a cloud of few effective draws would hide what is missing
EFFECTIVE = 10  # effective draws per coordinate that a fit needs; weights are tempered until there are so many
COOLER, COOLEST = 0.8, 0.05  # power of the weights: from one try to the next, and the least


@dataclass(frozen=True, eq=False)
class AdaptedProposal:
    """The mixture that a block of draws found best, with its efficiency by these."""

    proposal: MixtureProposal
    efficiency: float


def adapt_proposal(
    straight: Reparameterisation, first: MixtureProposal, rng: np.random.Generator, enough: float
) -> AdaptedProposal | None:
    """Return the best mixture of those fitted to blocks of draws; None where too few of the draws have a density.

    Parameters
    ----------
    straight : Reparameterisation
        Coordinates in which it lives.
    first : MixtureProposal
        The proposal so far.
    rng : Generator
    enough : float
        Efficiency that is aimed at.
    """
    n = straight.posterior.n_parameters
    wide, best, stale = _match_prior(straight, rng), None, 0
    proposal = first if wide is None else _mix(first, (wide, PRIOR_SHARE))
    x, density, used = np.empty((0, n)), np.empty(0), list[MixtureProposal]()
    for _ in range(BLOCKS):
        drawn = proposal.draw(DRAWS, rng)
        x, used = np.concatenate([x, drawn]), [*used, proposal]
        with np.errstate(all="ignore"):
            density = np.concatenate([density, evaluate_in_batches(straight.log_density, drawn)])
        efficiency = _count_effective(density[-DRAWS:] - proposal.log_density(drawn)) / DRAWS
        if best is None or efficiency > best.efficiency:
            best, stale = AdaptedProposal(proposal, efficiency), 0
        else:
            stale += 1
        if best.efficiency >= MARGIN * enough or stale >= PATIENCE:
            break
        log_weights = density - logsumexp([one.log_density(x) for one in used], axis=0)
        known = np.isfinite(log_weights)
        power = _find_power(log_weights[known], EFFECTIVE * n)
        if power is None:
            return None
        weights = power * log_weights[known]
        try:
            fitted = fit_mixture(x[known], np.exp(weights - logsumexp(weights)), rng.random(known.sum()) < 0.5, rng)
        except np.linalg.LinAlgError:  # a cloud without volume
            break
        beside = [(first, FIRST_SHARE), *([] if wide is None else [(wide, PRIOR_SHARE)])]
        proposal = _mix(fitted, *beside)
    return best


def _match_prior(straight: Reparameterisation, rng: np.random.Generator) -> MixtureProposal | None:
    """Return a Gaussian with the moments of the prior; None where the prior has none in these coordinates."""
    y = straight.posterior.draw_prior(DRAWS, rng)
    with np.errstate(all="ignore"):
        x = straight.x_from_y(y[np.isfinite(y).all(axis=1)])
    x = x[np.isfinite(x).all(axis=1)]
    if len(x) < DRAWS // 2:
        return None
    try:
        return proposal_from_draws(x, DOF)
    except np.linalg.LinAlgError:
        return None


def _mix(main: MixtureProposal, *others: tuple[MixtureProposal, float]) -> MixtureProposal:
    """Return a mixture in which others have shares."""
    left = 1.0 - sum(share for _, share in others)
    parts = [(main, left), *others]
    return MixtureProposal(
        np.concatenate([share * one.weights for one, share in parts]),
        np.concatenate([one.means for one, _ in parts]),
        np.concatenate([one.factors for one, _ in parts]),
        DOF,
    )


def _count_effective(log_weights: Array) -> float:
    """Return how many weights (B,) count."""
    known = log_weights[np.isfinite(log_weights)]
    return float(np.exp(2.0 * logsumexp(known) - logsumexp(2.0 * known))) if len(known) else 0.0


def _find_power(log_weights: Array, wanted: float) -> float | None:
    """Return the power of weights (B,) of which enough count; None where there is none."""
    power = 1.0
    while power > COOLEST:
        if _count_effective(power * log_weights) >= wanted:
            return power
        power *= COOLER
    return None
