"""Posteriors that a few spoiled poses do not spoil: each pose may be a blunder, with a probability that is inferred.

A measured pose errs by e_n, of covariance C_n as everywhere, or it is a blunder: it was named wrongly, a target was
covered, the machine had not settled. With the share ε of blunders

    p(e_n) = (1 - ε) N(e_n; 0, C_n) + ε t_ν(e_n; 0, κ² C_n),    ε ~ Beta(1, 1/m - 1),

m the share that is expected, ν = 1 and κ = 3: so heavy a tail holds blunders of ten and of a thousand deviations alike
(contaminated normal, Tukey 1960; the weights are those of Box and Tiao 1968). The probability that pose n is one,

    ε t_ν(e_n) / p(e_n),

is averaged over the posterior. Blunders of a pose have nothing to do with the model error τ, which all poses have.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaln, log_ndtr, ndtri_exp

from bayescal.density.batches import batches
from bayescal.density.likelihood import Likelihood
from bayescal.density.local import Local
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.posterior import APPROACH, HALF_LOG_TWO_PI, Posterior
from bayescal.density.priors import Prior
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

FREEDOM, WIDER = 1.0, 3.0
REWEIGHTINGS = 6
SHARE = "epsilon"


@dataclass(frozen=True)
class SharePrior(Prior):
    """The share of blunders, Beta(1, b) with b = 1 / m - 1: the fewer the likelier.

    Its sampling coordinate ζ is standard normal under the prior.
    """

    expected: float

    @property
    def exponent(self) -> float:
        """Return b."""
        return 1.0 / self.expected - 1.0

    def log_density(self, value: Array) -> Array:
        """Return the log-density, -inf outside of zero to one."""
        inside = (value >= 0.0) & (value < 1.0)
        left = np.log1p(-np.where(inside, value, 0.0))
        return np.where(inside, np.log(self.exponent) + (self.exponent - 1.0) * left, -np.inf)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Return n draws."""
        return self.share_from_zeta(rng.standard_normal(n))

    def standardise(self, value: Array) -> Array:
        """Return ζ."""
        return np.asarray(-ndtri_exp(self.exponent * np.log1p(-value)))

    def at_quantile(self, share: Array) -> Array:
        """Return shares by the prior's mass below them."""
        return np.asarray(-np.expm1(np.log1p(-share) / self.exponent))

    @property
    def mean(self) -> float:
        """The share that is expected."""
        return self.expected

    @property
    def sd(self) -> float:
        """Of Beta(1, b)."""
        b = self.exponent
        return float(np.sqrt(b / ((1.0 + b) ** 2 * (2.0 + b))))

    def share_from_zeta(self, zeta: Array) -> Array:
        """Return ε."""
        return np.asarray(-np.expm1(log_ndtr(-zeta) / self.exponent))

    def slope(self, zeta: Array) -> Array:
        """Return dε/dζ."""
        hazard = np.exp(-0.5 * zeta**2 - HALF_LOG_TWO_PI - log_ndtr(-zeta))
        return np.asarray((1.0 - self.share_from_zeta(zeta)) / self.exponent * hazard)


def compare_blunder(square: Array, n_rows: int) -> Array:
    """Return log t_ν(e; 0, κ² C) - log N(e; 0, C) from eᵀ C⁻¹ e of K rows, elementwise."""
    half, nu = 0.5 * n_rows, FREEDOM
    constant = gammaln(0.5 * nu + half) - gammaln(0.5 * nu) - half * np.log(0.5 * nu) - n_rows * np.log(WIDER)
    return np.asarray(constant + 0.5 * square - (0.5 * nu + half) * np.log1p(square / (nu * WIDER**2)))


@dataclass(frozen=True, eq=False, kw_only=True)
class RobustPosterior(Posterior):
    """Posterior of free parameters, model errors τ and the share ε of blunders; its coordinates in this order.

    Attributes
    ----------
    likelihood : PoseLikelihood
    share : SharePrior
    """

    likelihood: PoseLikelihood
    share: SharePrior

    # --- coordinates ---------------------------------------------------------------------------------------------

    @cached_property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters, model errors and ε."""
        return self.n_geometry + self.model_error.n_parameters(self.likelihood.n_legs) + 1

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, the model errors and ε."""
        geometry = tuple(self._layout.names[k] for k in self.coordinates.free)
        return (*geometry, *self.model_error.names(self.likelihood.n_legs), SHARE)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of everything that is free by name, in order."""
        return self._name_priors(self.names[:-1]) | {SHARE: self.share}

    def tau(self, y: Array) -> Array:
        """Return the model error of each leg in mm, shape (B, N), or zeros (N,) if there is none."""
        return super().tau(y[..., :-1])

    def shares(self, y: Array) -> Array:
        """Return ε, (..., n) to (...)."""
        return self.share.share_from_zeta(y[..., -1])

    def natural(self, y: Array) -> Array:
        """Return everything free in its own unit, shape (B, n)."""
        return np.concatenate([super().natural(y[..., :-1]), self.shares(y)[..., None]], axis=-1)

    # --- density -------------------------------------------------------------------------------------------------

    def _log_likelihood(self, y: Array, theta: Array) -> Array:
        return self._mix(self.likelihood, y, theta).sum(axis=1)

    def evaluate_poses(self, likelihood: Likelihood, y: Array) -> Array:
        """Return the log-likelihood of each pose, of these or of others, shape (B, P)."""
        assert isinstance(likelihood, PoseLikelihood)
        return self._mix(likelihood, y, self.theta(y))

    def _mix(self, likelihood: PoseLikelihood, y: Array, theta: Array) -> Array:
        density, square = likelihood.evaluate(theta, self.tau(y))
        share = self.shares(y)[:, None]
        with np.errstate(all="ignore"):  # where there is no machine
            both = density + np.logaddexp(np.log1p(-share), np.log(share) + self._compare(square))
        return np.where(np.isfinite(both), both, -np.inf)

    def _compare(self, square: Array) -> Array:
        return compare_blunder(square, self.likelihood.n_legs)

    def blunder_probabilities(self, likelihood: PoseLikelihood, y: Array) -> Array:
        """Return how probable it is that each pose is a blunder, for every draw, shape (B, P)."""
        result = np.empty((len(y), likelihood.n_poses))
        for part in batches(len(y)):
            _, square = likelihood.evaluate(self.theta(y[part]), self.tau(y[part]))
            result[part] = self._suspect(square, self.shares(y[part])[:, None])
        return result

    def _suspect(self, square: Array, share: Array) -> Array:
        """Return ε t / p from eᵀ C⁻¹ e and ε."""
        odds = np.log(share) - np.log1p(-share) + self._compare(square)
        return np.asarray(1.0 / (1.0 + np.exp(-odds)))

    # --- derivatives ---------------------------------------------------------------------------------------------

    def _weigh_errors(self, errors: Array, precision: Array, share: Array) -> tuple[Array, Array]:
        """Return how much each pose counts, shape (P,), and its probability of being a blunder."""
        square = np.einsum("pi,pij,pj->p", errors, precision, errors)
        blunder = self._suspect(square, share)
        tail = (FREEDOM + self.likelihood.n_legs) / (FREEDOM * WIDER**2 + square)
        return (1.0 - blunder) + blunder * tail, blunder

    def _linearise(self, y: Array) -> Local:
        """Return the likelihood around y, shape (n,), with the precision of r as far as each pose counts."""
        local = super()._linearise(y)
        counts, blunder = self._weigh_errors(local.errors, local.precision, self.shares(y))
        return local._replace(precision=counts[:, None, None] * local.precision, counts=counts, blunder=blunder)

    def _differentiate(self, y: Array, local: Local) -> tuple[Array, Array]:
        """Add the part of ε."""
        gradient, hessian = super()._differentiate(y, local)
        assert local.blunder is not None
        share = self.shares(y)
        by_share = local.blunder / share - (1.0 - local.blunder) / (1.0 - share)
        slope = self.share.slope(y[-1])
        gradient[-1] = by_share.sum() * slope - y[-1]
        hessian[-1, :] = hessian[:, -1] = 0.0
        hessian[-1, -1] = -np.sum(by_share**2) * slope**2 - 1.0
        return gradient, hessian

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return `gradient`: how much a pose counts depends on the model errors, too."""
        return self.gradient(y)

    # --- climbing ------------------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return a start near the mode, shape (n,): by ever smaller model errors, blunders left out on the way."""
        y = np.zeros(self.n_parameters)
        for tau in (*APPROACH, APPROACH[-1] / 3.0):
            y = self._reweight(y, np.full(self.likelihood.n_legs, tau))
        return self.polish(y)

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry of reweighted least squares at its model errors."""
        return self._reweight(y, self._tau_at(y))

    def _tau_at(self, y: Array) -> Array:
        return np.broadcast_to(self.tau(y[None]), (1, self.likelihood.n_legs))[0]

    def _reweight(self, y: Array, tau: Array) -> Array:
        precision = np.linalg.inv(self.likelihood.error_covariance(tau))
        for _ in range(REWEIGHTINGS):
            errors = self.likelihood.leg_errors(self.theta(y[None]))[0]
            weight, _ = self._weigh_errors(errors, precision, self.shares(y))
            y = self._fit_geometry(y, tau, weight)
        return y


def build_robust(plain: Posterior, expected_share: float) -> RobustPosterior:
    """Return a posterior whose poses may be blunders.

    Raises
    ------
    InputError
        Where poses are not measured whole in the frame of the base.
    """
    if not isinstance(plain.likelihood, PoseLikelihood):
        raise InputError("blunders: found poses measured in part or in unknown frames, expected whole ones")
    return RobustPosterior(
        likelihood=plain.likelihood,
        priors=plain.priors,
        model_error=plain.model_error,
        fixed=plain.fixed,
        share=SharePrior(expected_share),
    )
