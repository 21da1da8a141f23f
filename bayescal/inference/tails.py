"""Whether draws have as much of a posterior's mass as lies where the proposal seldom leads.

Ensembles start from a proposal and jump by it. Where that leads too seldom, in a long tail or a lesser mode, a short
run has too little of the mass, and neither R-hat nor effective sizes see what no draw is of. How much there is can be
known without them: draws from farther out get there, and their weights count it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.inference.exploration import Exploration
from bayescal.inference.overdispersed import SELDOM, FarDraws
from bayescal.inference.sampling import Sample
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Tails:
    """The share of a posterior where its proposal seldom leads.

    Attributes
    ----------
    expected : float
        By the weights of draws that get there.
    found : float
        Of the ensembles' draws.
    error : float
        Standard error of their difference.
    """

    expected: float
    found: float
    error: float


def compare_tails(exploration: Exploration, sample: Sample, far: FarDraws) -> Tails:
    """Return how much of the posterior lies where the proposal seldom leads, and how many of the draws."""
    weights = far.weights

    def is_seldom(log_density: Array, x: Array) -> np.ndarray:
        return log_density - far.log_evidence - exploration.proposal.log_density(x) > np.log(SELDOM)

    there = is_seldom(far.log_density, far.x)
    expected = float(weights[there].sum())
    n_ensembles, n_walkers, _, n = sample.straight.shape
    seen = is_seldom(sample.log_density.ravel(), sample.straight.reshape(-1, n)).reshape(n_ensembles, -1)
    shares = seen.mean(axis=1)
    found = float(shares.mean())
    between = shares.std(ddof=1) / np.sqrt(n_ensembles) if n_ensembles > 1 else 0.0
    more = max(found, expected)
    within = np.sqrt(more * (1.0 - more) / (n_ensembles * n_walkers))  # a walker that gets there stays
    of_weights = np.sqrt(np.sum((weights * (there - expected)) ** 2))
    return Tails(expected, found, float(np.hypot(max(between, within), of_weights)))
