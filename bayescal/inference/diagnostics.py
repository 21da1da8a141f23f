"""Convergence of ensembles: a chain is an ensemble, never a walker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from arviz_stats.base import array_stats

from bayescal.limits import ESS_BULK_LIMIT, ESS_TAIL_LIMIT, RHAT_LIMIT
from bayescal.numerics.geometry import Array

APART = 100.0  # R-hat of ensembles that stand still at different places


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Rank-normalised R-hat and effective sample sizes of each parameter, shape (n,)."""

    rhat: Array
    ess_bulk: Array
    ess_tail: Array

    def list_problems(self) -> list[str]:
        """Return in words which limits are not kept; empty where all are."""
        rhat, bulk, tail = float(self.rhat.max()), float(self.ess_bulk.min()), float(self.ess_tail.min())
        problems = []
        if not rhat < RHAT_LIMIT:
            problems.append(f"R-hat {rhat:.3f}, limit {RHAT_LIMIT}")
        if not bulk > ESS_BULK_LIMIT:
            problems.append(f"bulk ESS {bulk:.0f}, limit {ESS_BULK_LIMIT:.0f}")
        if not tail > ESS_TAIL_LIMIT:
            problems.append(f"tail ESS {tail:.0f}, limit {ESS_TAIL_LIMIT:.0f}")
        return problems


def diagnose(draws: Array) -> Diagnostics:
    """Return the diagnostics of draws, shape (ensembles, walkers, steps, n).

    R-hat splits every ensemble in time, so that a drift of all walkers shows. The effective sizes take the draws walker
    by walker: then the autocorrelation along the chain is that of the walkers in time. A parameter that is the same in
    all draws, a scale that is zero, has nothing to mix, unless all others stand still as well.
    """
    n_ensembles, n_walkers, n_steps, _ = draws.shape
    walker_by_walker = np.moveaxis(draws.reshape(n_ensembles, n_walkers * n_steps, -1), -1, 0)
    step_by_step = np.moveaxis(np.swapaxes(draws, 1, 2).reshape(n_ensembles, n_walkers * n_steps, -1), -1, 0)
    rhat = np.asarray(array_stats.rhat(step_by_step), dtype=np.float64)
    bulk = np.asarray(array_stats.ess(walker_by_walker), dtype=np.float64)
    tail = np.asarray(array_stats.ess(walker_by_walker, method="tail", prob=(0.05, 0.95)), dtype=np.float64)
    still = np.ptp(walker_by_walker, axis=(1, 2)) == 0.0
    if still.any() and not still.all():
        rhat[still], bulk[still], tail[still] = 1.0, *[float(walker_by_walker[0].size)] * 2
    stuck = ~np.isfinite(rhat) & ~still & np.isfinite(walker_by_walker).all(axis=(1, 2))
    rhat[stuck], bulk[stuck], tail[stuck] = APART, 1.0, 1.0
    return Diagnostics(rhat, np.where(np.isfinite(bulk), bulk, 1.0), np.where(np.isfinite(tail), tail, 1.0))
