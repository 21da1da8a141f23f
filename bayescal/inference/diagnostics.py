"""Convergence of ensembles: a chain is an ensemble, never a walker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.limits import ESS_BULK_LIMIT, ESS_TAIL_LIMIT, RHAT_LIMIT, TEMPERED_LIMIT
from bayescal.numerics.geometry import Array

LEAST_ERROR = 0.01  # nats; a few runs tell no smaller standard error


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
    by walker: then the autocorrelation along the chain is that of the walkers in time.
    """
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    n_ensembles, n_walkers, n_steps, _ = draws.shape
    walker_by_walker = np.moveaxis(draws.reshape(n_ensembles, n_walkers * n_steps, -1), -1, 0)
    step_by_step = np.moveaxis(np.swapaxes(draws, 1, 2).reshape(n_ensembles, n_walkers * n_steps, -1), -1, 0)
    return Diagnostics(
        rhat=np.asarray(array_stats.rhat(step_by_step), dtype=np.float64),
        ess_bulk=np.asarray(array_stats.ess(walker_by_walker), dtype=np.float64),
        ess_tail=np.asarray(array_stats.ess(walker_by_walker, method="tail", prob=(0.05, 0.95)), dtype=np.float64),
    )


def list_check_problems(evidence: tuple[float, float], check: tuple[float, float], settled: bool) -> list[str]:
    """Return what a check by tempering says against a log-evidence, in words; empty where they agree.

    Parameters
    ----------
    evidence, check : pair of float
        Both log-evidences with their standard errors.
    settled : bool
        Whether the chains of the check did.
    """
    problems = [] if settled else ["the chains of the check by tempering did not settle"]
    error = max(float(np.hypot(evidence[1], check[1])), LEAST_ERROR)
    apart = abs(evidence[0] - check[0]) / error
    if not apart <= TEMPERED_LIMIT:
        problems.append(
            f"log-evidence {evidence[0]:.3f} ± {evidence[1]:.3f}, by tempering {check[0]:.3f} ± {check[1]:.3f}: "
            f"{apart:.1f} standard errors apart, limit {TEMPERED_LIMIT:g}"
        )
    return problems
