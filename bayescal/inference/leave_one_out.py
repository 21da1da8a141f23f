"""Leave-one-out cross-validation over poses: importance weights where they suffice, moved draws where they do not.

Leaving a pose out of a density takes its pointwise part away, whatever that part is: p(θ | all but i) ∝ p(θ | all) /
p(y_i | θ). A pose whose weights 1 / p(y_i | θ) have too heavy a tail (Pareto k) is left out by moving the draws to
where the posterior of the others is (`bayescal.inference.correction`): the ratio of both evidences is the pose's
density given the others. Where moved draws are not enough either, a short run on the others' posterior is.

Rows that a machine cannot do without need the refits; sums over rows are moved by 1.6 nats at most, for 7 % of the time
of a fit (`benchmarks/ablation`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.errors import NumericalError
from bayescal.inference.correction import Correction, CostlyDensity, correct, draw_to_correct, pull_back
from bayescal.inference.ensemble import run_ensemble
from bayescal.inference.exploration import Exploration
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.schema import count_walkers
from bayescal.inference.target import LogPosterior
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

MAX_REFITS = 10
"""Poses of one posterior that are refitted without; where more are bad, the posterior is, and none is."""
HOPELESS_K = 10.0  # stands for a tail too heavy for its shape to be found
CONSTANT = 1e-9  # nats between the largest and the smallest density of a pose that tells nothing
MOVED, WEIGHED = 1024, 256  # draws that are moved at most, and those that are weighed in a round
MAX_LOO_ERROR_NAT = 0.1  # nats, standard error of a pose's density from moved draws; beyond it a run is worth its time
REFIT_BURN_IN, REFIT_STEPS = 30, 30


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """What leaving each of P poses out found."""

    weighted: Array  # (P,): elpd of each pose by Pareto-smoothed importance sampling
    pareto_k: Array  # (P,)
    effective: Array  # (P,): each pose's part of the effective number of parameters
    refitted: Array  # (P,): elpd by moved draws or by a run without the pose; NaN where there was none

    @property
    def elpd(self) -> Array:
        """Return each pose's elpd, that of its refit where there is one."""
        return np.where(self.was_refitted, self.refitted, self.weighted)

    @property
    def was_refitted(self) -> np.ndarray:
        """Which poses were refitted without."""
        return np.isfinite(self.refitted)

    @property
    def is_doubtful(self) -> np.ndarray:
        """Which poses have weights with too heavy a tail and were not refitted without."""
        return (self.pareto_k > PARETO_K_LIMIT) & ~self.was_refitted

    def summarise(self) -> tuple[float, float]:
        """Return the elpd of all poses, each left out, and its standard error over the poses."""
        from arviz_stats.base import array_stats

        summary = array_stats.loo_summary(self.elpd, self.effective)
        return float(summary[0]), float(summary[1])


def leave_out(draws: Array, log_likelihood: Array) -> LeaveOneOut:
    """Return leave-one-out by weights, from draws (E, S, n) and each pose's log-likelihood (E, S, P)."""
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    n_draws = log_likelihood.shape[0] * log_likelihood.shape[1]
    by_parameter = np.moveaxis(draws, -1, 0)
    size = float(np.mean(array_stats.ess(by_parameter, method="mean"))) / n_draws if len(draws) > 1 else 1.0
    told = np.ptp(log_likelihood, axis=(0, 1)) > CONSTANT  # not of a row without redundancy: all weights are the same
    elpd, pareto_k, effective = log_likelihood.mean(axis=(0, 1)), *np.zeros((2, log_likelihood.shape[-1]))
    if told.any():
        elpd[told], pareto_k[told], effective[told] = array_stats.loo(
            np.moveaxis(log_likelihood[..., told], -1, 0), r_eff=size
        )
    pareto_k = np.where(np.isfinite(pareto_k), pareto_k, HOPELESS_K)
    return LeaveOneOut(elpd, pareto_k, effective, np.full(len(elpd), np.nan))


def refit_doubtful(
    found: LeaveOneOut, posterior: LogPosterior, exploration: Exploration, n_walkers: int, seed: np.random.SeedSequence
) -> LeaveOneOut:
    """Return the same with unreliable poses refitted, at most `MAX_REFITS` of them."""
    unreliable = np.flatnonzero(found.is_doubtful)
    if not 0 < len(unreliable) <= MAX_REFITS:
        return found
    draw_seed, *seeds = seed.spawn(1 + len(unreliable))
    drawn = draw_to_correct(exploration, np.random.default_rng(draw_seed), MOVED)
    refitted = found.refitted.copy()
    for pose, own in zip(unreliable.tolist(), seeds, strict=True):
        proposal = exploration.proposal
        try:
            moved = move_without(pose, posterior, exploration, *drawn)
            if moved.pareto_k <= PARETO_K_LIMIT and moved.standard_error <= MAX_LOO_ERROR_NAT:
                refitted[pose] = -moved.log_ratio
                continue
            proposal = moved.move.move_proposal(proposal)
        except NumericalError:
            pass  # no moved draw is a machine: the run starts where the posterior of all is
        refitted[pose] = refit_without(pose, posterior, exploration, proposal, n_walkers, own)
    return LeaveOneOut(found.weighted, found.pareto_k, found.effective, refitted)


def move_without(
    pose: int, posterior: LogPosterior, exploration: Exploration, draws: Array, modes: np.ndarray, covariance: Array
) -> Correction:
    """Return what leads from the posterior to that without a pose: minus its log-ratio is the pose's elpd.

    Parameters
    ----------
    pose : int
    posterior : Fittable
    exploration : Exploration
    draws, modes, covariance : ndarray
        As of `draw_to_correct`.
    """
    straight = exploration.straight

    def gain(x: Array) -> Array:
        with np.errstate(all="ignore"):
            return -np.asarray(posterior.pointwise_of(straight.y_from_x(x), pose))

    y = exploration.modes[0].y
    information = -pull_back(straight, y, posterior.row_information(y, pose))
    return correct(CostlyDensity(straight.log_density, gain, information), draws, modes, covariance, WEIGHED)


def refit_without(
    pose: int,
    posterior: LogPosterior,
    exploration: Exploration,
    proposal: MixtureProposal,
    n_walkers: int,
    seed: np.random.SeedSequence,
) -> float:
    """Return a pose's log predictive density from draws of the posterior of all the others, near a proposal of it."""
    straight, n = exploration.straight, posterior.n_parameters

    def own(x: Array) -> Array:
        return np.asarray(posterior.pointwise_of(straight.y_from_x(x), pose))

    def without(x: Array) -> Array:
        with np.errstate(all="ignore"):
            left = straight.log_density(x) - own(x)
        return np.where(np.isfinite(left), left, -np.inf)

    walkers = count_walkers(n, n_walkers)
    run = run_ensemble(without, proposal, seed, walkers, REFIT_BURN_IN, REFIT_STEPS)
    density = own(run.draws.reshape(-1, n))
    return float(logsumexp(density) - np.log(len(density)))
