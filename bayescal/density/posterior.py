"""The posterior density of one variant in sampling coordinates, with its gradient and least-squares form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from bayescal.density.curvature import differentiate_model_errors
from bayescal.density.geometry_fit import fit_geometry
from bayescal.density.geometry_prior import GeometryPrior, build_coordinates, check_bounds
from bayescal.density.independent_error import ModelError
from bayescal.density.leg_parameters import find_curved_ridges, find_legs, mirror_lone_components
from bayescal.density.likelihood import Likelihood
from bayescal.density.local import Funnel, Local, turn_to_coordinates
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import HalfNormalPrior, Prior
from bayescal.errors import InputError
from bayescal.machines.closing_coordinates import close_at_mean
from bayescal.machines.coordinates import Coordinates
from bayescal.machines.kinematics import compute_leg_lines
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

APPROACH = (1.0, 0.1)  # model errors in mm with which the search for the mode begins
HALF_LOG_TWO_PI = 0.5 * np.log(2 * np.pi)


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
        check_bounds(self.coordinates)
        if not np.isfinite(self.likelihood.errors(centre[None])).all():
            raise InputError("found no machine at the priors' centres, expected unit directions and a home pose")

    @property
    def _layout(self) -> ParameterLayout:
        return self.likelihood.layout

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates of the geometry."""
        lines = compute_leg_lines(self.likelihood.machine)
        return self._close_lengths(build_coordinates(self._layout, lines, self.priors, self.fixed))

    def _close_lengths(self, known: Coordinates) -> Coordinates:
        """Return coordinates whose lengths follow the joints where a deformation leaves these hardly known."""
        likelihood = self.likelihood
        if not (isinstance(likelihood, PoseLikelihood) and likelihood.machine.deformation.hides_joints):
            return known
        poses = likelihood.poses
        return close_at_mean(known, likelihood.machine, poses.position, poses.rotation, poses.actuators)

    @cached_property
    def _prior(self) -> GeometryPrior:
        return GeometryPrior(self.coordinates, self.priors)

    @cached_property
    def _standard(self) -> np.ndarray:
        """Which coordinates are standard normal under the prior, whatever the others are."""
        return np.append(np.flatnonzero(self.coordinates.standard), np.arange(self.n_geometry, self.n_parameters))

    @cached_property
    def _log_constant(self) -> float:
        """What the log-prior in the coordinates has that does not vary."""
        *_, scale = self._prior.normal
        return float(self.coordinates.log_scale - np.log(scale).sum() - self.n_parameters * HALF_LOG_TWO_PI)

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
        result = dict(zip(names, self._prior.ordered, strict=False))
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
        _, places, centre, scale = self._prior.normal
        z = (theta[..., places] - centre) / scale
        standard = self._deviations(y)
        total = -0.5 * (np.einsum("...i,...i->...", z, z) + np.einsum("...i,...i->...", standard, standard))
        total = total + self.coordinates.log_volume(theta) + self.coordinates.log_ring_ratio(y[..., : self.n_geometry])
        return np.asarray(total + self._log_constant)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); NaN where they are no coordinates."""
        y = rng.standard_normal((n_draws, self.n_parameters))
        y[:, : self.n_geometry] = self._prior.draw(y)
        return y

    def _deviations(self, y: Array) -> Array:
        """Return what is standard normal under the prior, whatever the other coordinates are, (..., n) to (..., k)."""
        return y[..., self._standard]

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, shape (B,), for coordinates (B, n); -inf where there is no machine."""
        with np.errstate(all="ignore"):  # far out numbers overflow; what is not finite has no density
            theta = self.theta(y)
            inside = self._layout.inside(theta)
            if not inside.all():
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
        data = local.inform()
        rows = self._prior_slope(local.change)
        return data, rows.T @ rows

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return one pose's part of the information of the data on the geometry at y, shape (m, m)."""
        local = self._linearise(y)
        return np.asarray(local.slope[pose].T @ local.precision[pose] @ local.slope[pose])

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the geometry's prior as residuals of unit variance, shape (m,), at coordinates (m,) and θ (D,)."""
        return self._prior.residual(y[: self.n_geometry], theta)

    def _prior_slope(self, change: Array) -> Array:
        """Return the derivative of `prior_residual` by the coordinates, shape (m, m), from dθ/dy."""
        return self._prior.slope(change)

    def residual_slope(self, theta: Array) -> tuple[Array, Array]:
        """Return dr/dy, shape (P, K, m), and the derivative of `prior_residual`, shape (m, m), at θ, shape (D,)."""
        change = self.coordinates.jacobian(theta)
        return turn_to_coordinates(self.likelihood.error_jacobian(theta)[1], change), self._prior_slope(change)

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
        return find_legs(self._layout, self.coordinates.free, self.likelihood.n_legs)

    def _linearise(self, y: Array) -> Local:
        """Return the likelihood around y, shape (n,)."""
        theta = self.theta(y[None])[0]
        precision = np.linalg.inv(self.likelihood.error_covariance(self.model_errors_at(y)))
        errors, slope = self.likelihood.error_jacobian(theta)
        change = self.coordinates.jacobian(theta)
        return Local(theta, errors, turn_to_coordinates(slope, change), precision, change)

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        return self._differentiate(y, self._linearise(y))

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) at y, shape (n,), and the Hessian (n, n) but for the errors' own curvature.

        It is that of Newton's steps: exact in the model errors, and so not always negative definite.
        """
        local = self._linearise(y)
        gradient, hessian = self._differentiate(y, local)
        if self.model_error.scale is not None:
            m, errors = self.n_geometry, self.model_errors_at(y)
            across, own = differentiate_model_errors(self.likelihood, local, errors, self._moves(y), self._bends(y))
            hessian[:m, m:], hessian[m:, :m] = across, across.T
            hessian[m:, m:] = own - np.eye(len(own))
        return gradient, hessian

    def _moves(self, y: Array) -> Array:
        """Return the derivative of `model_errors` by their coordinates at y, shape (k, N)."""
        zeta = y[self._taus]
        return self._spread(self.model_error.slope(zeta, self.model_error.tau_from_zeta(zeta)))

    def _bends(self, y: Array) -> Array:
        """Return the second derivative of `model_errors` by their coordinates at y, shape (k, N)."""
        zeta = y[self._taus]
        return self._spread(self.model_error.bend(zeta, self.model_error.tau_from_zeta(zeta)))

    def _spread(self, values: Array) -> Array:
        """Return something of each model error, shape (k,), at the legs that it is of, shape (k, N)."""
        n_legs = self.likelihood.n_legs
        return values[:, None] * (np.eye(n_legs) if len(values) == n_legs else np.ones((1, n_legs)))

    def _differentiate(self, y: Array, local: Local) -> tuple[Array, Array]:
        """Return `gradient` at y, shape (n,), from the likelihood around it."""
        theta, errors, slope, precision, change, *_ = local
        weighted = (precision @ errors[..., None])[..., 0]
        gradient = np.zeros(self.n_parameters)
        hessian = np.zeros((self.n_parameters, self.n_parameters))
        n = self.n_geometry
        rows = self._prior_slope(change)
        gradient[:n] = -weighted.ravel() @ slope.reshape(-1, n) - self.prior_residual(y, theta) @ rows
        gradient[:n] += self.coordinates.log_volume_slope(theta) @ change + self.coordinates.log_ring_ratio_slope(y[:n])
        hessian[:n, :n] = -local.inform() - rows.T @ rows
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
        whitening = np.linalg.inv(np.linalg.cholesky(self.likelihood.error_covariance(tau)))
        if weight is not None:
            whitening *= np.sqrt(weight)[:, None, None]
        found = start.copy()
        found[: self.n_geometry] = fit_geometry(self, start[: self.n_geometry], whitening)
        return found

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return legs, and coordinates with the leg's direction mirrored to the other solution of the same gain.

        With one component of u free and κ fixed the actuator's gain along the leg, z · u, has two solutions in every
        leg. With both components free a circle of equal gain joins the two.
        """
        images = mirror_lone_components(self.coordinates, y[: self.n_geometry])
        return [(leg, np.concatenate([image, y[self.n_geometry :]])) for leg, image in images]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return the coordinates of free directions' components, each with the other coordinates of its leg.

        Where κ is fixed the actuator gain is a quadratic of u_x that the other parameters of the leg have to follow.
        """
        return find_curved_ridges(self._layout, self.coordinates.free, self._legs())

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
