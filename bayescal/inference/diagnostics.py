"""Convergence of ensembles: a chain is an ensemble, never a walker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.inference.rank_diagnostics import judge_draws
from bayescal.limits import (
    EFFECTIVE_LIMIT,
    ESS_BULK_LIMIT,
    ESS_TAIL_LIMIT,
    PARETO_K_LIMIT,
    RHAT_LIMIT,
    STUCK_SHARE,
    STUCK_STEPS,
    TEMPERED_LIMIT,
)
from bayescal.numerics.geometry import Array

LEAST_ERROR = 0.01  # nats; a few runs tell no smaller standard error
LEAST_LACKING = 0.01  # of a posterior: a smaller share moves no interval that matters
TAIL_LIMIT = 2.5  # standard errors; of one posterior in two hundred with such tails that lacks nothing
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
    rhat, bulk, tail = judge_draws(draws)
    walker_by_walker = np.moveaxis(draws.reshape(len(draws), -1, draws.shape[-1]), -1, 0)
    still = np.ptp(walker_by_walker, axis=(1, 2)) == 0.0
    if still.any() and not still.all():
        rhat[still], bulk[still], tail[still] = 1.0, *[float(walker_by_walker[0].size)] * 2
    stuck = ~np.isfinite(rhat) & ~still & np.isfinite(walker_by_walker).all(axis=(1, 2))
    rhat[stuck], bulk[stuck], tail[stuck] = APART, 1.0, 1.0
    return Diagnostics(rhat, np.where(np.isfinite(bulk), bulk, 1.0), np.where(np.isfinite(tail), tail, 1.0))


def measure_longest_stand(log_density: Array) -> int:
    """Return for how many steps the most patient walker stood still; log-densities (ensembles, walkers, steps).

    Where a proposal misses mass, a walker that gets there finds no way back: effective sizes, which average over
    walkers that never went, do not see it.
    """
    longest = current = np.zeros(log_density.shape[:2], dtype=int)
    for moved in np.moveaxis(np.diff(log_density, axis=2) != 0.0, 2, 0):
        current = np.where(moved, 0, current + 1)
        longest = np.maximum(longest, current)
    return int(longest.max())


def list_stand_problems(longest_stand: int, n_steps: int) -> list[str]:
    """Return in words whether a walker is stuck; empty where none is."""
    limit = max(STUCK_STEPS, int(np.ceil(STUCK_SHARE * n_steps)))
    if longest_stand < limit:
        return []
    return [f"a walker stood still for {longest_stand} of {n_steps} steps, limit {limit}"]


def list_scout_problems(n_apart: int, n_walkers: int, limit: int) -> list[str]:
    """Return in words whether walkers that started far out stayed there; empty where hardly any did."""
    if n_apart < limit:
        return []
    return [f"{n_apart} of {n_walkers} walkers that started far out stayed where hardly any draw is, limit {limit}"]


def list_tail_problems(expected: float, found: float, error: float) -> list[str]:
    """Return in words whether draws lack what of the posterior lies where the proposal seldom leads.

    Parameters
    ----------
    expected, found : float
        Share of the posterior there, and of the draws.
    error : float
        Standard error of their difference.
    """
    lacking = expected - found
    if lacking <= max(LEAST_LACKING, TAIL_LIMIT * error):  # not so where weights are no numbers
        return []
    return [
        f"{100 * expected:.1f} % of the posterior, but {100 * found:.1f} % of the draws lie in tails where the "
        f"proposal seldom leads ({lacking / error:.1f} standard errors apart, limit {TAIL_LIMIT:g}); more steps get "
        "there"
    ]


def list_importance_problems(pareto_k: float, n_effective: float) -> list[str]:
    """Return in words what speaks against the weights of importance sampling; empty where nothing does.

    What the proposal misses the chains that start from it miss, too, so that a bridge from them is no way out.
    """
    problems = []
    if not pareto_k <= PARETO_K_LIMIT:
        problems.append(f"Pareto k of the importance weights {pareto_k:.2f}, limit {PARETO_K_LIMIT}")
    if not n_effective >= EFFECTIVE_LIMIT:
        problems.append(f"{n_effective:.0f} effective draws of importance sampling, limit {EFFECTIVE_LIMIT:.0f}")
    return problems


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
