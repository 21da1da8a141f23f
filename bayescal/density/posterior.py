"""The posterior density of one variant in sampling coordinates, with its gradient and least-squares form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.optimize import least_squares
from scipy.special import erfcinv, erfinv, ndtr

from bayescal.density.likelihood import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import HalfNormalPrior, Prior, UniformPrior
from bayescal.errors import InputError
from bayescal.limits import FAR_AWAY
from bayescal.machines.closing_coordinates import close_at_mean
from bayescal.machines.coordinates import Coordinates, mirror_direction
from bayescal.machines.kinematics import compute_leg_lines
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

APPROACH = (1.0, 0.1)  # model errors in mm with which the search for the mode begins
HALF_LOG_TWO_PI = 0.5 * np.log(2 * np.pi)


@dataclass(frozen=True)
class ModelError:
    """The model error τ per leg: free with a half-normal prior of the given scale in mm, or none at all (scale None).

    Its sampling coordinate ζ is standard normal under the prior: Φ(ζ) is the prior probability of a smaller τ.
    """

    scale: float | None
    shared: bool = False

    def n_parameters(self, n_legs: int) -> int:
        """Return the number of free model errors."""
        if self.scale is None:
            return 0
        return 1 if self.shared else n_legs

    def names(self, n_legs: int) -> tuple[str, ...]:
        """Names of the free model errors."""
        if self.n_parameters(n_legs) == 1:
            return ("tau",)
        return tuple(f"tau[{leg}]" for leg in range(1, self.n_parameters(n_legs) + 1))

    def tau_from_zeta(self, zeta: Array) -> Array:
        """Return τ in mm."""
        assert self.scale is not None
        return self.scale * np.sqrt(2.0) * np.where(zeta > 0, erfcinv(ndtr(-zeta)), erfinv(ndtr(zeta)))

    def slope(self, zeta: Array, tau: Array) -> Array:
        """Return dτ/dζ in mm."""
        assert self.scale is not None
        return 0.5 * self.scale * np.exp(0.5 * ((tau / self.scale) ** 2 - zeta**2))


class Local(NamedTuple):
    """A posterior's likelihood around a point.

    Attributes
    ----------
    theta : ndarray, shape (D,)
    errors, slope : ndarray, shapes (P, K), (P, K, m)
        r and dr/dy.
    precision : ndarray, shape (P, K, K)
        Of r, as far as each pose counts.
    change : ndarray, shape (D, m)
        dθ/dy.
    counts, blunder : ndarray, shape (P,), optional
        How much each pose counts, and how probably it is a blunder; None where all count in full.
    """

    theta: Array
    errors: Array
    slope: Array
    precision: Array
    change: Array
    counts: Array | None = None
    blunder: Array | None = None


@dataclass(frozen=True, eq=False)
class Funnel:
    """How the geometry depends on the model errors around a point; see `bayescal.inference.target.Funnel`."""

    information: Array
    prior: Array
    rest: Array
    tau: Array
    parts: Array | None = None
    scores: Array | None = None


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the free parameters and model errors of one variant.

    Attributes
    ----------
    likelihood : Likelihood
        Density of the measurements at the calibration poses.
    priors : mapping of parameter name to Prior
        Priors of the free parameters.
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    model_error : ModelError
        Free model error, or none.
    """

    likelihood: Likelihood
    priors: Mapping[str, Prior]
    model_error: ModelError
    fixed: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that every name exists."""
        unknown = [name for name in (*self.priors, *self.fixed) if name not in self._layout.names]
        if unknown:
            known = ", ".join(self._layout.symbols)
            raise InputError(f"parameter {unknown[0]!r}: unknown here, expected one of {known}")

    def check_machine(self) -> None:
        """Raise InputError where the priors' centres, or the ends of a uniform prior, are no machine's parameters."""
        centre = self.coordinates.start
        self._layout.check(centre)
        bounded = self.coordinates.free[self.coordinates.bounded]
        lower, upper = self._layout.limits
        for k, low, high in zip(
            bounded,
            self.coordinates.lower[self.coordinates.bounded],
            self.coordinates.upper[self.coordinates.bounded],
            strict=True,
        ):
            if low < lower[k] or high > upper[k]:
                raise InputError(
                    f"parameter {self._layout.names[k]}: found a prior from {low:g} to {high:g}, "
                    f"expected it between {lower[k]:g} and {upper[k]:g}"
                )
        if not np.isfinite(self.likelihood.errors(centre[None])).all():
            raise InputError("found no machine at the priors' centres, expected unit directions and a home pose")

    @property
    def _layout(self) -> ParameterLayout:
        return self.likelihood.layout

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates of the geometry."""
        layout = self._layout
        start = layout.nominal.copy()
        position = {name: k for k, name in enumerate(layout.names)}
        for name, value in self.fixed.items():
            start[position[name]] = value
        free = np.array(sorted(position[name] for name in self.priors), dtype=int)
        ordered = [self.priors[layout.names[k]] for k in free]
        start[free] = [prior.mean for prior in ordered]
        lines = compute_leg_lines(self.likelihood.machine)
        bounds = [(p.lower, p.upper) if isinstance(p, UniformPrior) else (-np.inf, np.inf) for p in ordered]
        lower, upper = np.array(bounds).reshape(-1, 2).T
        scale = np.array([p.sd for p in ordered])
        return self._close_lengths(Coordinates(layout, start, free, scale, lines, lower, upper))

    def _close_lengths(self, known: Coordinates) -> Coordinates:
        """Return coordinates whose lengths follow the joints where a deformation leaves these hardly known."""
        likelihood = self.likelihood
        if not (isinstance(likelihood, PoseLikelihood) and likelihood.machine.deformation.hides_joints):
            return known
        poses = likelihood.poses
        return close_at_mean(known, likelihood.machine, poses.position, poses.rotation, poses.actuators)

    @cached_property
    def _ordered_priors(self) -> tuple[Prior, ...]:
        return tuple(self.priors[self._layout.names[k]] for k in self.coordinates.free)

    @cached_property
    def _normal(self) -> tuple[np.ndarray, Array, Array]:
        """Which free parameters have a normal prior, and its centres and scales."""
        which = ~self.coordinates.standard
        chosen = [prior for prior, normal in zip(self._ordered_priors, which, strict=True) if normal]
        return which, np.array([p.mean for p in chosen]), np.array([p.sd for p in chosen])

    @cached_property
    def _standard(self) -> np.ndarray:
        """Which coordinates are standard normal under the prior, whatever the others are."""
        model_errors = np.ones(self.n_parameters - self.n_geometry, dtype=bool)
        return np.concatenate([self.coordinates.standard, model_errors])

    @property
    def n_geometry(self) -> int:
        """Number of free geometric parameters."""
        return len(self.priors)

    @cached_property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters and model errors."""
        return self.n_geometry + self.model_error.n_parameters(self.likelihood.n_legs)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters and model errors."""
        names = tuple(self._layout.names[k] for k in self.coordinates.free)
        return names + self.model_error.names(self.likelihood.n_legs)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of the free parameters and of the model errors by name, in order."""
        return self._name_priors(self.names)

    def _name_priors(self, names: Sequence[str]) -> dict[str, Prior]:
        """Return the priors of the geometry, then of the model errors τ, of these names."""
        result = dict(zip(names, self._ordered_priors, strict=False))
        for name in names[self.n_geometry :]:
            assert self.model_error.scale is not None
            result[name] = HalfNormalPrior(self.model_error.scale)
        return result

    # --- transformations -----------------------------------------------------------------------------------------

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return self.coordinates.theta_from_y(y[..., : self.n_geometry])

    def tau(self, y: Array) -> Array:
        """Return the model error of each leg in mm, shape (B, N), or zeros (N,) if there is none."""
        n_legs = self.likelihood.n_legs
        if self.model_error.scale is None:
            return np.zeros(n_legs)
        tau = self.model_error.tau_from_zeta(y[..., self.n_geometry :])
        return np.broadcast_to(tau, (*tau.shape[:-1], n_legs))

    def funnel_errors(self, y: Array) -> Array:
        """Return the errors that the geometry's uncertainty depends on, shape (B, N); see `funnel`."""
        return self.tau(y)

    def model_errors(self, y: Array) -> Array:
        """Return what the likelihood takes as model errors, shape (B, N) or (N,), mm."""
        return self.tau(y)

    def mean_square_tau(self, natural: Array) -> float:
        """Return the mean of τ² over draws in natural units (..., n) and over legs, mm²; zero without model error."""
        tau = natural[..., self._taus]
        return float(np.mean(tau**2)) if tau.shape[-1] else 0.0

    def model_errors_at(self, y: Array) -> Array:
        """Return `model_errors` at one vector y, shape (n,)."""
        return np.broadcast_to(self.model_errors(y[None]), (1, self.likelihood.n_model_errors))[0]

    def natural(self, y: Array) -> Array:
        """Return the free parameters and model errors in their own units, shape (B, n)."""
        free = self.theta(y)[..., self.coordinates.free]
        if self.model_error.scale is None:
            return free
        return np.concatenate([free, self.model_error.tau_from_zeta(y[..., self.n_geometry :])], axis=-1)

    # --- density -------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, shape (B,), normalised over y."""
        return self._log_prior(y, self.theta(y))

    def _log_prior(self, y: Array, theta: Array) -> Array:
        """Add the normal priors to the coordinates that are standard normal themselves: bounded ones, model errors."""
        normal, centre, scale = self._normal
        z = (theta[..., self.coordinates.free[normal]] - centre) / scale
        standard = self._deviations(y)
        total = -0.5 * (np.einsum("...i,...i->...", z, z) + np.einsum("...i,...i->...", standard, standard))
        total = total + self.coordinates.log_volume(theta) + self.coordinates.log_ring_ratio(y[..., : self.n_geometry])
        return total + self.coordinates.log_scale - np.log(scale).sum() - self.n_parameters * HALF_LOG_TWO_PI

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); NaN where they are no coordinates."""
        y = rng.standard_normal((n_draws, self.n_parameters))
        theta = np.tile(self.coordinates.start, (n_draws, 1))
        for k, (place, prior) in enumerate(zip(self.coordinates.free, self._ordered_priors, strict=True)):
            theta[:, place] = prior.at_quantile(ndtr(y[:, k]))
        with np.errstate(invalid="ignore"):
            y[:, : self.n_geometry] = self.coordinates.y_from_theta(theta)
        return y

    def _deviations(self, y: Array) -> Array:
        """Return what is standard normal under the prior, whatever the other coordinates are, (..., n) to (..., k)."""
        return y[..., self._standard]

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, shape (B,), for coordinates (B, n); -inf where there is no machine."""
        with np.errstate(all="ignore"):  # far out numbers overflow; what is not finite has no density
            theta = self.theta(y)
            inside = self._layout.inside(theta)
            theta[~inside] = self.coordinates.start  # keeps what is no machine out of the models
            total = self._log_prior(y, theta) + self._log_likelihood(y, theta)
        return np.where(inside & np.isfinite(total), total, -np.inf)

    def _log_likelihood(self, y: Array, theta: Array) -> Array:
        """Return the log-likelihood, shape (B,), of coordinates (B, n) and their parameters (B, D)."""
        return self.likelihood(theta, self.model_errors(y))

    def finer(self) -> Self | None:
        """Return the same posterior without what the likelihood's hot path leaves out; None where that is nothing."""
        likelihood = self.likelihood.solved()
        return None if likelihood is None else replace(self, likelihood=likelihood)

    def as_fine(self, likelihood: Likelihood) -> Likelihood:
        """Return a likelihood of other poses that leaves out as much as this posterior's own does."""
        return (likelihood.solved() or likelihood) if self.likelihood.is_solved else likelihood

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose, shape (B, P)."""
        return self.evaluate_poses(self.likelihood, y)

    def evaluate_poses(self, likelihood: Likelihood, y: Array) -> Array:
        """Return the log-likelihood of each pose, of these or of others, shape (B, P), for coordinates (B, n)."""
        return likelihood.pointwise(self.theta(y), self.model_errors(y))

    # --- derivatives ---------------------------------------------------------------------------------------------

    def information(self, y: Array) -> tuple[Array, Array]:
        """Return the information of the data and the precision of the prior on the geometry at y, shapes (m, m)."""
        local = self._linearise(y)
        data = np.einsum("pik,pij,pjm->km", local.slope, local.precision, local.slope, optimize=True)
        rows = self._prior_slope(local.change)
        return data, rows.T @ rows

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return one pose's part of the information of the data on the geometry at y, shape (m, m)."""
        local = self._linearise(y)
        return np.asarray(local.slope[pose].T @ local.precision[pose] @ local.slope[pose])

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the geometry's prior as residuals of unit variance, shape (m,), at coordinates (m,) and θ (D,)."""
        normal, centre, scale = self._normal
        residual = y[: self.n_geometry].copy()
        residual[normal] = (theta[self.coordinates.free[normal]] - centre) / scale
        return residual

    def _prior_slope(self, change: Array) -> Array:
        """Return the derivative of `prior_residual` by the coordinates, shape (m, m), from dθ/dy."""
        normal, _, scale = self._normal
        rows = np.eye(self.n_geometry)
        rows[normal] = change[self.coordinates.free[normal]] / scale[:, None]
        return rows

    def residual_slope(self, theta: Array) -> tuple[Array, Array]:
        """Return dr/dy, shape (P, K, m), and the derivative of `prior_residual`, shape (m, m), at θ, shape (D,)."""
        change = self.coordinates.jacobian(theta)
        return self.likelihood.error_jacobian(theta)[1] @ change, self._prior_slope(change)

    def groups(self) -> list[np.ndarray]:
        """Return which geometric coordinates a model error makes uncertain together: each leg's.

        Frames that are free tie the legs together; with one model error for all legs everything is one group then.
        """
        return [np.arange(self.n_geometry)] if self._ties_legs and self.model_error.shared else self._legs()

    @property
    def _ties_legs(self) -> bool:
        """Whether parameters are free that no leg has, those of frames."""
        return bool((self.coordinates.free >= self.likelihood.machine.layout.size).any())

    def _legs(self) -> list[np.ndarray]:
        """Return which geometric coordinates belong to each leg."""
        layout, free = self._layout, self.coordinates.free
        per_leg = [block.symbol for block in layout.blocks if block.per_leg]
        legs = [[layout.index[s][leg] for s in per_leg] for leg in range(self.likelihood.n_legs)]
        return [np.flatnonzero(np.isin(free, leg)) for leg in legs]

    def _linearise(self, y: Array) -> Local:
        """Return the likelihood around y, shape (n,)."""
        theta = self.theta(y[None])[0]
        precision = np.linalg.inv(self.likelihood.error_covariance(self.model_errors_at(y)))
        errors, slope = self.likelihood.error_jacobian(theta)
        change = self.coordinates.jacobian(theta)
        return Local(theta, errors, slope @ change, precision, change)

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        return self._differentiate(y, self._linearise(y))

    def _differentiate(self, y: Array, local: Local) -> tuple[Array, Array]:
        """Return `gradient` at y, shape (n,), from the likelihood around it."""
        theta, errors, slope, precision, change, *_ = local
        weighted = np.einsum("pij,pj->pi", precision, errors)
        gradient = np.zeros(self.n_parameters)
        hessian = np.zeros((self.n_parameters, self.n_parameters))
        n = self.n_geometry
        rows = self._prior_slope(change)
        gradient[:n] = -np.einsum("pik,pi->k", slope, weighted) - rows.T @ self.prior_residual(y, theta)
        gradient[:n] += self.coordinates.log_volume_slope(theta) @ change + self.coordinates.log_ring_ratio_slope(y[:n])
        hessian[:n, :n] = -np.einsum("pik,pij,pjm->km", slope, precision, slope, optimize=True) - rows.T @ rows
        if self.model_error.scale is not None:
            self._add_model_error(y, local, weighted, gradient, hessian)
        return gradient, hessian

    @cached_property
    def _taus(self) -> slice:
        """Coordinates of the model errors τ."""
        return slice(self.n_geometry, self.n_geometry + self.model_error.n_parameters(self.likelihood.n_legs))

    def _add_model_error(self, y: Array, local: Local, weighted: Array, gradient: Array, hessian: Array) -> None:
        """Add the model errors' part."""
        inside, zeta = self._taus, y[self._taus]
        speed = self.model_error.slope(zeta, self.model_error.tau_from_zeta(zeta))
        per_leg, curvature = self._differentiate_by_errors(self.model_errors_at(y), local, weighted)
        if self.model_error.shared:
            per_leg, curvature = per_leg.sum(keepdims=True), curvature.sum(keepdims=True)
        gradient[inside] = per_leg * speed - zeta
        hessian[inside, inside] = -curvature * np.outer(speed, speed) - np.eye(len(zeta))

    def _differentiate_by_errors(self, model_errors: Array, local: Local, weighted: Array) -> tuple[Array, Array]:
        """Return the log-likelihood's gradient by the model errors (K,), and its expected curvature, shape (K, K).

        The log-determinant of a pose counts in full, however little the pose does.
        """
        square, precision = self.likelihood.on_legs(weighted) ** 2, self._see_by_legs(local.precision)
        if local.counts is not None:
            square, precision = square / local.counts[:, None], precision / local.counts[:, None, None]
        scaled = self.likelihood.actuator_weight * model_errors
        by_errors = np.sum(scaled * (square - np.diagonal(precision, axis1=1, axis2=2)), axis=0)
        return by_errors, 2.0 * np.einsum("pi,pij,pj->ij", scaled, precision**2, scaled)

    def _see_by_legs(self, precision: Array) -> Array:
        """Return Wᵀ C⁻¹ W, what the rows tell of each leg's error, shape (P, K, K) to (P, N, N)."""
        return np.swapaxes(self.likelihood.on_legs(np.swapaxes(self.likelihood.on_legs(precision), 1, 2)), 1, 2)

    # --- climbing ------------------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return a start near the mode, shape (n,): the nominal machine, led to the data by ever smaller model errors.

        Far off, everything seems to be the fault of every parameter; a coarse look moves only those that matter, and
        what is hardly determined stays near its prior.
        """
        y = np.zeros(self.n_parameters)
        for tau in APPROACH:
            y = self._fit_geometry(y, np.full(self.likelihood.n_model_errors, tau))
        return y

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry of least squares at its model errors."""
        return self._fit_geometry(y, self.model_errors_at(y))

    def _fit_geometry(self, start: Array, tau: Array, weight: Array | None = None) -> Array:
        """Return y with the geometry of least squares, whitened errors and priors together, at model errors (N,).

        A ``weight``, shape (P,), says how much each pose counts.
        """
        n = self.n_geometry
        whitening = np.linalg.inv(np.linalg.cholesky(self.likelihood.error_covariance(tau)))
        if weight is not None:
            whitening *= np.sqrt(weight)[:, None, None]

        def residual(y: Array) -> Array:
            theta = self.coordinates.theta_from_y(y[None])
            errors = self.likelihood.errors(theta)[0]
            white = np.einsum("pij,pj->pi", whitening, errors).ravel()
            value = np.concatenate([white, self.prior_residual(y, theta[0])])
            return np.where(np.isfinite(value) & self._layout.inside(theta)[0], value, FAR_AWAY)

        def jacobian(y: Array) -> Array:
            slope, prior_slope = self.residual_slope(self.coordinates.theta_from_y(y[None])[0])
            return np.concatenate([np.einsum("pij,pjk->pik", whitening, slope).reshape(-1, n), prior_slope])

        found = start.copy()
        found[:n] = least_squares(residual, start[:n], jacobian, method="lm", xtol=1e-10, ftol=1e-10).x
        return found

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return legs, and coordinates with the leg's direction mirrored to the other solution of the same gain.

        With one component of u free and κ fixed the actuator's gain along the leg, z · u, has two solutions in every
        leg. With both components free a circle of equal gain joins the two.
        """
        coordinates, layout = self.coordinates, self._layout
        images = []
        for leg, component in self._lone_components():
            theta = coordinates.theta_from_y(y[None, : self.n_geometry])[0]
            mirrored = mirror_direction(layout, theta, leg, component, coordinates.legs[leg], coordinates.free)
            if mirrored is None:
                continue
            image = y.copy()
            image[: self.n_geometry] = coordinates.y_from_theta(mirrored)
            images.append((leg, image))
        return images

    def _lone_components(self) -> list[tuple[int, int]]:
        """Return the legs of which one component of u is free and κ is not, with that component, 0 or 1."""
        layout, free = self._layout, self.coordinates.free
        if not layout.direction_symbols:
            return []
        components = np.stack([np.isin(layout.index[symbol], free) for symbol in layout.direction_symbols])
        alone = components.sum(axis=0) == 1
        if "kappa" in layout.index:
            alone &= ~np.isin(layout.index["kappa"], free)
        return [(int(leg), int(np.argmax(components[:, leg]))) for leg in np.flatnonzero(alone)]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return the coordinates of free directions' components, each with the other coordinates of its leg.

        Where κ is fixed the actuator gain is a quadratic of u_x that the other parameters of the leg have to follow.
        """
        components = tuple(f"{symbol}[" for symbol in self._layout.direction_symbols)
        tilted = np.array([name.startswith(components) for name in self.names], dtype=bool)
        return [(int(k), index[~tilted[index]]) for index in self._legs() for k in index[tilted[index]]]

    def funnel(self, y: Array) -> Funnel | None:
        """Return how the geometry depends on the model errors at y, shape (n,); None where there are none.

        None, too, where free frames tie legs together that each have an error: no leg is uncertain by itself then.
        """
        if self.model_error.scale is None or (self._ties_legs and not self.model_error.shared):
            return None
        likelihood = self.likelihood
        tau = np.broadcast_to(self.tau(y[None]), (1, likelihood.n_legs))[0]
        inverse = self._see_by_legs(np.linalg.inv(likelihood.error_covariance(tau)))
        precision = np.diagonal(inverse, axis1=-2, axis2=-1).mean(axis=0)
        variance = 1.0 / np.maximum(precision, np.finfo(float).tiny)
        rest = np.maximum(variance / likelihood.actuator_weight.mean(axis=0) - tau**2, 1e-12)
        information, prior = self.information(y)
        return Funnel(information, prior, rest, tau)
