"""Draws from farther out than a proposal leads, with the weights that a posterior gives them.

They are of the proposal stretched fourfold along one principal axis each, the looser an axis the more of them: what
ensembles that start from the proposal and jump by it may have missed, some of these see.

Two equal modes nine standard deviations apart, one of them found, are reported by nobody else than the mass in tails;
a lesser mode of a tenth of the mass needs the heavier tails (`benchmarks/ablation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from bayescal.inference.exploration import Exploration, weigh_proposal
from bayescal.inference.importance import ImportanceEvidence, evaluate_in_batches
from bayescal.inference.proposal import MixtureProposal
from bayescal.inference.sampling import Sample
from bayescal.inference.schema import EvidenceConfig
from bayescal.inference.stages import stage
from bayescal.limits import HARMLESS
from bayescal.numerics.geometry import Array

N_DRAWS = 5000
AT_ONCE = 50  # draws whose axes are held, a matrix each
STRETCH = 4.0
EVEN_AXIS_FRACTION = 0.5  # share of draws that are spread over the axes evenly
MIN_PROPOSAL_DENSITY_RATIO = 20.0
"""By what factor a proposal leads somewhere less often than the posterior's mass would have it."""
CERTAIN = 2.0  # standard errors by which there have to be tails
HEAVIER = (20.0, 10.0, 6.0, 4.0)  # degrees of freedom

LEAST_LACKING = 0.01  # of a posterior: a smaller share moves no interval that matters
TAIL_LIMIT = 2.5  # standard errors; of one posterior in two hundred with such tails that lacks nothing


@dataclass(frozen=True, eq=False)
class TailDraws:
    """Independent draws from farther out."""

    x: Array  # (B, n): in the proposal's coordinates
    log_density: Array  # (B,): of the posterior there
    log_weights: Array  # (B,): by which they are draws of the posterior; minus infinity where that has no density

    @cached_property
    def weights(self) -> Array:
        """The same, their sum one."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return np.asarray(weights / weights.sum())

    @cached_property
    def log_evidence(self) -> float:
        """What the weights say of it."""
        highest = self.log_weights.max()
        return float(highest + np.log(np.exp(self.log_weights - highest).mean()))


def draw_tails(exploration: Exploration, seed: np.random.SeedSequence) -> TailDraws:
    """Return draws of an explored posterior's proposal as it is stretched."""
    wide = StretchedMixture(exploration.proposal)
    x = wide.draw(N_DRAWS, np.random.default_rng(seed))
    with np.errstate(all="ignore"), stage("tails", N_DRAWS):
        log_density = evaluate_in_batches(exploration.straight.log_density, x)
        log_weights = log_density - wide.log_density(x)
    log_weights[~np.isfinite(log_weights)] = -np.inf
    return TailDraws(x, log_density, log_weights)


def fit_tails(found: Exploration, far: TailDraws) -> Exploration:
    """Return an exploration whose proposal has tails as heavy as the posterior's, by draws from farther out.

    A proposal's own draws do not know of tails that it leads to too seldom. The mean of p / q over the posterior, one
    over the efficiency of q, does, and says how many degrees of freedom are best. Where hardly any of the mass is in
    such tails, or one draw alone says so, the exploration stays as it is.
    """
    seen = far.weights > 0.0
    x, log_posterior, weights = far.x[seen], far.log_density[seen] - far.log_evidence, far.weights[seen]
    there = log_posterior - found.proposal.log_density(x) > np.log(MIN_PROPOSAL_DENSITY_RATIO)
    share = float(weights[there].sum())
    if not share > max(LEAST_LACKING, CERTAIN * float(np.linalg.norm(weights * (there - share)))):
        return found

    def rate(proposal: MixtureProposal) -> float:
        return float(np.exp(-logsumexp(log_posterior - proposal.log_density(x), b=weights)))

    best = max((replace(found.proposal, dof=dof) for dof in (found.proposal.dof, *HEAVIER)), key=rate)
    return replace(found, proposal=best, efficiency=rate(best))


def widen_tails(
    found: Exploration,
    importance: ImportanceEvidence,
    far: TailDraws,
    importance_seed: np.random.SeedSequence,
    effort: EvidenceConfig,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return exploration and evidence with a proposal of heavier tails where draws from farther out ask for them.

    Not so where its own weights would be unreliable, and those before were not.
    """
    wider = fit_tails(found, far)
    if wider is found:
        return found, importance
    again = weigh_proposal(wider, importance_seed, effort)
    return (found, importance) if again.is_doubtful and not importance.is_doubtful else (wider, again)


class StretchedMixture:
    """A mixture of normal densities, each stretched along one of its principal axes: as many as there are axes."""

    def __init__(self, proposal: MixtureProposal) -> None:
        self._weights, self._means = proposal.weights, proposal.means
        parts = [np.linalg.svd(factor) for factor in proposal.factors]
        self._axes, self._sizes = np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts])
        even, loose = 1.0 / self._sizes.shape[1], self._sizes**2
        self._shares = EVEN_AXIS_FRACTION * even + (1.0 - EVEN_AXIS_FRACTION) * loose / loose.sum(axis=1, keepdims=True)

    def draw(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return independent draws, shape (n_draws, n)."""
        component = rng.choice(len(self._weights), n_draws, p=self._weights)
        normal = rng.standard_normal((n_draws, self._means.shape[1]))
        for m in np.unique(component):
            own = np.flatnonzero(component == m)
            normal[own, rng.choice(normal.shape[1], len(own), p=self._shares[m])] *= STRETCH
        normal *= self._sizes[component]
        moved = [
            np.einsum("bij,bj->bi", self._axes[component[k : k + AT_ONCE]], normal[k : k + AT_ONCE])
            for k in range(0, n_draws, AT_ONCE)
        ]
        return np.asarray(self._means[component] + np.concatenate(moved))

    def log_density(self, x: Array) -> Array:
        """Return the log-density, (B, n) to (B,)."""
        constant = 0.5 * x.shape[1] * np.log(2.0 * np.pi) + np.log(STRETCH)
        terms = np.empty((len(self._weights), len(x)))
        for m, (mean, axes, sizes) in enumerate(zip(self._means, self._axes, self._sizes, strict=True)):
            square = ((x - mean) @ axes / sizes) ** 2
            stretched = logsumexp(0.5 * square * (1.0 - STRETCH**-2), axis=1, b=self._shares[m])
            terms[m] = np.log(self._weights[m]) - np.log(sizes).sum() - 0.5 * square.sum(axis=1) + stretched
        return np.asarray(logsumexp(terms, axis=0) - constant)


@dataclass(frozen=True)
class TailShare:
    """The share of a posterior where its proposal seldom leads."""

    expected: float  # by the weights of draws that get there
    found: float  # of the ensembles' draws
    error: float  # standard error of their difference

    def list_problems(self) -> list[str]:
        """Return in words whether draws lack what of the posterior lies there."""
        lacking = self.expected - self.found
        if lacking <= max(LEAST_LACKING, TAIL_LIMIT * self.error):  # not so where weights are no numbers
            return []
        ratio = lacking / self.error if self.error > 0.0 else np.inf
        apart = f"{ratio:.1f} standard errors apart, limit {TAIL_LIMIT:g}"
        shares = f"{100 * self.expected:.1f} % of the posterior, {100 * self.found:.1f} % of draws"
        return [f"{shares} in tails ({apart}); use more steps"]


def compare_tail_mass(exploration: Exploration, sample: Sample, far: TailDraws) -> TailShare:
    """Return how much of the posterior lies where the proposal seldom leads, and how many of the draws.

    Where the proposal leads too seldom, in a long tail or a lesser mode, a short run has too little of the mass, and
    neither R-hat nor effective sizes see what no draw is of. Weights of draws from farther out count it without them.
    """
    weights = far.weights

    def is_seldom(log_density: Array, x: Array) -> np.ndarray:
        return log_density - far.log_evidence - exploration.proposal.log_density(x) > np.log(MIN_PROPOSAL_DENSITY_RATIO)

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
    return TailShare(expected, found, float(np.hypot(max(between, within), of_weights)))


def find_rare_ratio(far: TailDraws, exploration: Exploration) -> float:
    """Return log p / q, both normalised, beyond which hardly any of the posterior lies; infinite where nobody knows.

    By the weights of draws from farther out the places beyond it hold less than `HARMLESS` of the mass, two standard
    errors included: a walker that stands still at one of them is right to.
    """
    ratio = far.log_density - far.log_evidence - exploration.proposal.log_density(far.x)
    ratio[~np.isfinite(far.log_weights)] = -np.inf
    order = np.argsort(-ratio)
    weights = far.weights[order]
    beyond = np.cumsum(weights) + 2.0 * np.sqrt(np.cumsum(weights**2))
    rare = int(np.searchsorted(beyond, HARMLESS))
    return float(ratio[order[rare]]) if rare else np.inf
