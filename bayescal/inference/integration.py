"""A posterior explored, and its evidence by importance sampling: by another proposal where the weights are doubtful."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.inference.exploration import Exploration, add_clusters, explore
from bayescal.inference.importance import ImportanceEvidence, estimate_by_importance
from bayescal.inference.overdispersed import FarDraws, fit_tails
from bayescal.inference.target import Target


@dataclass(frozen=True)
class Effort:
    """How many draws an evidence may take.

    Attributes
    ----------
    draws, max_draws : int
        Of a block, and of all blocks together.
    target_error : float
        Standard error of the log-evidence at which no other block is drawn.
    """

    draws: int
    target_error: float
    max_draws: int


def integrate_posterior(
    posterior: Target,
    explore_seed: np.random.SeedSequence,
    importance_seed: np.random.SeedSequence,
    n_walkers: int,
    effort: Effort,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return what a search from the beginning finds, and the log-evidence of it.

    Raises
    ------
    NumericalError
        As `explore`.
    """
    found = explore(posterior, explore_seed, n_walkers, anew=True)
    importance = _weigh(found, importance_seed, effort)
    if importance.is_doubtful:
        other = add_clusters(found, explore_seed, n_walkers)
        again = _weigh(other, importance_seed, effort)
        if again.is_better_than(importance):
            return other, again
    return found, importance


def widen_tails(
    found: Exploration,
    importance: ImportanceEvidence,
    far: FarDraws,
    importance_seed: np.random.SeedSequence,
    effort: Effort,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return exploration and evidence with a proposal of heavier tails where draws from farther out ask for them.

    Not so where its own weights would be doubtful, and those before were not.
    """
    wider = fit_tails(found, far)
    if wider is found:
        return found, importance
    again = _weigh(wider, importance_seed, effort)
    return (found, importance) if again.is_doubtful and not importance.is_doubtful else (wider, again)


def _weigh(found: Exploration, seed: np.random.SeedSequence, effort: Effort) -> ImportanceEvidence:
    return estimate_by_importance(
        found.straight.log_density,
        found.proposal,
        np.random.default_rng(seed),
        effort.draws,
        effort.target_error,
        effort.max_draws,
    )
