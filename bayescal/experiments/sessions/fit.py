"""The joint posterior of sessions: scales by importance, states in closed form, both set against the exact density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayescal.density.sessions import LinearSessions, SessionModel, find_state
from bayescal.inference.scales import Scales, find_scales_mode, keep_by_weight, sample_scales
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

ROUNDS = 2  # of linearising at the state that the scales want
HALF_LOG_TWO_PI = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True, eq=False)
class SessionFit:
    """What sessions say.

    Attributes
    ----------
    log_evidence, standard_error : float
        Of the exact density.
    quality : ndarray, shape (4,)
        Efficiency and Pareto k of the scales' weights, then of the weights from the linearised to the exact density.
    zeta, z : ndarray, shapes (T, n_scales) and (T, n)
        Draws of the posterior: scales and states.
    """

    log_evidence: float
    standard_error: float
    quality: Array
    zeta: Array
    z: Array

    @property
    def is_sound(self) -> bool:
        """Whether no weights have too heavy a tail."""
        return bool(np.max(self.quality[[1, 3]]) <= PARETO_K_LIMIT)


def fit_sessions(model: SessionModel, n_draws: int, rng: np.random.Generator) -> SessionFit:
    """Return evidence and draws of the joint posterior; n_draws of the scales, a third of them kept with a state each.

    Raises
    ------
    NumericalError
        Where no state or no scales are found.
    """
    linear, mode = _find_mode(model)
    kept = count_kept(n_draws)
    scales = sample_scales(lambda zeta: compute_log_density(linear, zeta), mode, n_draws, kept, rng)
    z, linearised = _draw_states(linear, scales, rng)
    log_weights = model.log_likelihood(z, scales.draws) - linearised
    both = np.concatenate([scales.draws, z], axis=1)
    exact = keep_by_weight(both, log_weights, kept, rng)
    correction = float(logsumexp(log_weights) - np.log(kept))
    spread = float(np.std(np.exp(log_weights - correction)) / np.sqrt(kept))
    n = model.n_scales
    return SessionFit(
        scales.log_evidence + correction,
        float(np.hypot(scales.standard_error, spread)),
        np.array([scales.efficiency, scales.pareto_k, exact.efficiency, exact.pareto_k]),
        exact.draws[:, :n],
        exact.draws[:, n:],
    )


def count_kept(n_draws: int) -> int:
    """Return how many draws of the scales are kept with a state."""
    return max(n_draws // 3, 100)


def compute_log_density(linear: LinearSessions, zeta: Array) -> float:
    """Return the log-density of scales ζ (n,), prior included, the states integrated."""
    marginal = linear.condition(*linear.model.read_scales(zeta)).log_marginal
    return marginal - 0.5 * float(zeta @ zeta) - len(zeta) * HALF_LOG_TWO_PI


def _find_mode(model: SessionModel) -> tuple[LinearSessions, Array]:
    """Return sessions linearised at the most probable state at the most probable scales, and those scales."""
    zeta, z = np.zeros(model.n_scales), np.zeros(model.size)
    for _ in range(ROUNDS):
        linear, z = find_state(model, *model.read_scales(zeta), z)
        zeta = find_scales_mode(lambda scales, at=linear: compute_log_density(at, scales), zeta)  # type: ignore[misc]
    return linear, zeta


def _draw_states(linear: LinearSessions, scales: Scales, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a state for each draw of the scales, shape (T, n), and its linearised log-likelihood, shape (T,)."""
    model, draws = linear.model, []
    values = np.empty(len(scales.draws))
    for k, zeta in enumerate(scales.draws):
        errors, sigma = model.read_scales(zeta)
        draws.append(linear.condition(errors, sigma).draw(rng.standard_normal(model.size)))
        values[k] = linear.log_likelihood(draws[-1], errors, sigma)
    return np.array(draws), values
