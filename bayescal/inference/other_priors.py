"""The evidence under other priors, from draws of the posterior under one's own.

With p the posterior explored, of likelihood L and prior π, and π' another prior, draws x of p that an affine map T
moves have the weights L(T x) π'(T x) |T| / p(x), whose mean is the ratio of the evidences
(`bayescal.inference.correction`). T takes the normal nearest to p to the one that π' makes of it. Where the weights of
the moved draws have a heavy tail or a large scatter no such map is known, and the posterior under π' has to be explored
by itself. Wider priors may give mass to modes that no draw of p is near: these are looked for, and add what Laplace's
approximation has for them, half of which counts as an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from bayescal.density.priors import Prior
from bayescal.errors import NumericalError
from bayescal.inference.correction import (
    Correction,
    CostlyDensity,
    correct,
    draw_to_correct,
    weigh_both,
)
from bayescal.inference.exploration import Exploration
from bayescal.inference.importance import ImportanceEvidence, LogDensity, difference_twice
from bayescal.inference.mode import find_more_modes
from bayescal.inference.target import LogPosterior
from bayescal.numerics.geometry import Array

PROPOSED, DRAWN = 4000, 2048
"""Draws of the proposal, and those of the posterior among them."""
WEIGHED = 512  # a round
SCATTER, ROUGH_SCATTER = 0.04, 0.15
"""Standard error of the log-ratio, nats: one that is enough, and one beyond which moved draws say nothing."""
STEP = 0.1  # of the posterior's standard deviations, for the curvature of the priors' ratio


def weigh_other_priors(
    found: Exploration,
    own: ImportanceEvidence,
    others: Mapping[float, LogPosterior],
    seed: np.random.SeedSequence,
    costly: CostlyDensity | None = None,
    correction: Correction | None = None,
) -> dict[float, ImportanceEvidence]:
    """Return the log-evidences under priors that are wider or narrower by factors, as far as moved draws have them.

    Parameters
    ----------
    found : Exploration
        Of the posterior under its own priors.
    own : ImportanceEvidence
        Its log-evidence, of the density that was explored.
    others : mapping of float to LogPosterior
        By factor: the same posterior with priors of other widths about the same centres.
    seed : SeedSequence
    costly, correction
        The density that leaves nothing out, and what leads to it, where they are needed; evidences are of that then.
    """
    drawn = draw_to_correct(found, np.random.default_rng(seed), DRAWN, PROPOSED)
    result = {}
    for factor, other in others.items():
        try:
            moved = _weigh(found, drawn, other, costly, correction)
            if not moved.is_known_to(ROUGH_SCATTER):
                continue
            more = _weigh_further_modes(other, len(found.modes)) if factor > 1.0 else 0.0
        except (NumericalError, np.linalg.LinAlgError):
            continue
        error = math.hypot(own.standard_error, moved.standard_error, 0.5 * more)
        log_evidence = own.log_evidence + moved.log_ratio + more
        result[factor] = ImportanceEvidence(log_evidence, error, moved.efficiency, moved.pareto_k, moved.n_draws)
    return result


def _weigh_further_modes(posterior: LogPosterior, n_known: int) -> float:
    """Return what modes beyond so many add to the log-evidence, by Laplace's approximation."""
    masses = [mode.log_evidence for mode in find_more_modes(posterior, n_known)]
    return float(logsumexp(masses) - logsumexp(masses[:n_known])) if masses else 0.0


def _weigh(
    found: Exploration,
    drawn: tuple[Array, np.ndarray, Array],
    other: LogPosterior,
    costly: CostlyDensity | None,
    correction: Correction | None,
) -> Correction:
    """Return what leads to another posterior from draws as `draw_to_correct` has them."""
    density, ratio = found.straight.log_density, _compare_priors(found, other)
    information = _curve(found, ratio, drawn[2])
    moved = correct(CostlyDensity(density, ratio, information), *drawn, WEIGHED)
    if costly is None or correction is None or not moved.is_known_to(ROUGH_SCATTER):
        return moved
    fast = CostlyDensity(density, ratio, information)
    whole = replace(fast, excess=lambda x: ratio(x) + costly.excess(x))
    moves = moved.move, moved.move.then(correction.move)
    enough = math.sqrt(max(SCATTER**2 - moved.standard_error**2, (SCATTER / 4) ** 2))
    return weigh_both((fast, whole), moves, moved, drawn[0], enough)


def _compare_priors(found: Exploration, other: LogPosterior) -> LogDensity:
    """Return the logarithm of the ratio of two posteriors' priors, of straight coordinates (B, n)."""
    straight, m = found.straight, other.n_geometry
    own: LogPosterior = straight.posterior  # type: ignore[assignment]
    both: list[tuple[Prior, Prior]] = list(zip(own.all_priors().values(), other.all_priors().values(), strict=True))
    for before, after in both:
        if after.bounds[0] < before.bounds[0] or after.bounds[1] > before.bounds[1]:
            raise NumericalError("other priors: the coordinates end where the own prior does")

    def ratio(x: Array) -> Array:
        natural, total = own.natural(straight.y_from_x(x)), np.zeros(len(x))
        with np.errstate(invalid="ignore"):
            for k, (before, after) in enumerate(both[:m]):
                total += after.log_density(natural[:, k]) - before.log_density(natural[:, k])
        return np.where(np.isfinite(total), total, -np.inf)

    return ratio


def _curve(found: Exploration, ratio: LogDensity, covariance: Array) -> Array:
    """Return minus the Hessian (n, n) of a ratio at the main mode; zero where it has none."""
    factor = np.linalg.cholesky(covariance)
    centre = found.straight.x_from_y(found.modes[0].y[None])[0]
    _, hessian = difference_twice(ratio, centre, factor, STEP)
    if not np.isfinite(hessian).all():
        return np.zeros_like(covariance)
    back = np.linalg.inv(factor)
    return np.asarray(-back.T @ hessian @ back)
