"""The posterior density of one variant in sampling coordinates, with its gradient and least-squares form.

One class, whatever the legs err by: the coordinates of the geometry, a density of the measured rows, and the errors
(`bayescal.density.errors`), whose coordinates come behind those of the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from bayescal.density.batches import batches
from bayescal.density.errors import NO_MODEL_ERROR, SHARE, TAU, Errors, ErrorTerm, ModelError, Outliers
from bayescal.density.geometry_fit import fit_geometry
from bayescal.density.geometry_prior import (
    GeometryPrior,
    build_coordinates,
    check_bounds,
    find_curved_ridges,
    find_legs,
    mirror_lone_components,
)
from bayescal.density.likelihood import Likelihood
from bayescal.density.local import Funnel, Local, turn_to_coordinates
from bayescal.density.model_error import BORDER, LENGTH, SCALE, Kernel
from bayescal.density.priors import Prior
from bayescal.density.structured import root_of
from bayescal.errors import InputError
from bayescal.machines.closing_coordinates import close_at_mean
from bayescal.machines.coordinates import Coordinates
from bayescal.machines.kinematics import compute_leg_lines
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

APPROACH = (1.0, 0.1)  # model errors in mm with which the search for the mode begins
REWEIGHTINGS = 6
HALF_LOG_TWO_PI = 0.5 * np.log(2 * np.pi)
EDGE = 1e-3  # how near to a bound, by the width of a uniform prior, a machine known otherwise is taken to be


@final
@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the free parameters and errors of one variant; a `bayescal.inference.target.Target`.

    Attributes
    ----------
    likelihood : Likelihood
        Density of the measurements at the calibration poses.
    priors : mapping of parameter name to Prior
        Priors of the free parameters.
    model_error : ModelError
        The model error τ, or none.
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    terms : sequence of ErrorTerm
        What else the likelihood takes: scale and length of an error that is a function of the pose.
    outliers : Outliers or None
        Where poses may be outliers.
    """

    likelihood: Likelihood
    priors: Mapping[str, Prior]
    model_error: ModelError = NO_MODEL_ERROR
    fixed: Mapping[str, float] = field(default_factory=dict)
    terms: Sequence[ErrorTerm] = ()
    outliers: Outliers | None = None

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
    def errors(self) -> Errors:
        """All errors."""
        return Errors(self.likelihood.n_legs, (self.model_error, *self.terms), self.outliers)

    @cached_property
    def coordinates(self) -> Coordinates:
        """Coordinates of the geometry; lengths follow the joints where the likelihood hardly determines these."""
        lines, poses = compute_leg_lines(self.likelihood.machine), self.likelihood.closing_poses
        known = build_coordinates(self._layout, lines, self.priors, self.fixed)
        if poses is None:
            return known
        return close_at_mean(known, self.likelihood.machine, poses.position, poses.rotation, poses.actuators)

    @cached_property
    def _prior(self) -> GeometryPrior:
        return GeometryPrior(self.coordinates, self.priors)

    @cached_property
    def _standard(self) -> np.ndarray:
        """Which coordinates of the geometry are standard normal under the prior, whatever the others are."""
        return np.flatnonzero(self.coordinates.standard)

    @cached_property
    def _log_constant(self) -> float:
        """What the log-prior in the coordinates has that does not vary."""
        *_, scale = self._prior.normal
        volume = float(self.coordinates.log_scale - np.log(scale).sum() - self.n_parameters * HALF_LOG_TWO_PI)
        return volume + self.errors.log_mass

    @property
    def n_geometry(self) -> int:
        """Number of free geometric parameters."""
        return len(self.priors)

    @property
    def n_parameters(self) -> int:
        """Number n of sampling coordinates: free parameters and errors."""
        return self.n_geometry + self.errors.n_parameters

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters and errors."""
        return (*(self._layout.names[k] for k in self.coordinates.free), *self.errors.names)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        units = dict(zip(self._layout.names, self._layout.units, strict=True))
        return tuple(units.get(name, "1" if name in (LENGTH, SHARE) else "mm") for name in self.names)

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of everything that is free by name, in order."""
        return dict(zip(self.names, (*self._prior.ordered, *self.errors.priors), strict=True))

    # --- transformations -----------------------------------------------------------------------------------------

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return self.coordinates.theta_from_y(y[..., : self.n_geometry])

    def _zeta(self, y: Array) -> Array:
        """Return the coordinates of the errors."""
        return y[..., self.n_geometry :]

    def tau(self, y: Array) -> Array:
        """Return the model error of each leg in mm, shape (B, N), or zeros (N,) if no error is free."""
        return self.errors.tau(self._zeta(y))

    def model_errors(self, y: Array) -> Array:
        """Return what the likelihood takes as model errors, shape (B, K), or (K,) if none is free."""
        return self.errors.amplitudes(self._zeta(y))

    def model_errors_at(self, y: Array) -> Array:
        """Return `model_errors` at one vector y, shape (n,)."""
        return self.errors.amplitudes(self._zeta(y))

    def mean_square_tau(self, natural: Array) -> float:
        """Return the mean of τ² over draws in natural units (..., n) and over legs, mm²; zero without model error."""
        tau = self._zeta(natural)[..., self.errors.place(TAU)]
        return float(np.mean(tau**2)) if tau.shape[-1] else 0.0

    def natural(self, y: Array) -> Array:
        """Return everything that is free in its own unit, shape (B, n)."""
        return np.concatenate([self.theta(y)[..., self.coordinates.free], self.errors.natural(self._zeta(y))], axis=-1)

    def adopt(self, theta: Array, errors: Array) -> Array:
        """Return the coordinates of machines θ (M, D), brought within the priors' bounds, with those of errors."""
        coordinates, theta = self.coordinates, theta.copy()
        bounded = coordinates.bounded
        lower, upper = coordinates.lower[bounded], coordinates.upper[bounded]
        margin, places = EDGE * (upper - lower), coordinates.free[bounded]
        theta[:, places] = np.clip(theta[:, places], lower + margin, upper - margin)
        return np.concatenate([coordinates.y_from_theta(theta), errors], axis=1)

    # --- density -------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, shape (B,), normalised over y."""
        return self._log_prior(y, self.theta(y))

    def _log_prior(self, y: Array, theta: Array) -> Array:
        """Add the normal priors to the coordinates that are standard normal themselves: bounded ones, errors."""
        _, places, centre, scale = self._prior.normal
        z = (theta[..., places] - centre) / scale
        standard = np.concatenate([y[..., self._standard], self.errors.deviations(self._zeta(y))], axis=-1)
        total = -0.5 * (np.einsum("...i,...i->...", z, z) + np.einsum("...i,...i->...", standard, standard))
        total = total + self.coordinates.log_volume(theta) + self.coordinates.log_ring_ratio(y[..., : self.n_geometry])
        return np.asarray(total + self._log_constant)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n); NaN where they are no coordinates."""
        y = rng.standard_normal((n_draws, self.n_parameters))
        y[:, : self.n_geometry] = self._prior.draw(y)
        y[:, self.n_geometry :] = self.errors.draw(y[:, self.n_geometry :], rng)
        return y

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
        if self.outliers is None:
            return self.likelihood(theta, self.model_errors(y))
        return self._mix(self.likelihood, y, theta)[0].sum(axis=1)

    def _mix(self, likelihood: Likelihood, y: Array, theta: Array) -> tuple[Array, Array]:
        """Return the log-density of poses that may be outliers, and the probability that they are, shapes (B, P)."""
        assert self.outliers is not None
        density, square = likelihood.evaluate(theta, self.model_errors(y))
        share = self.errors.shares(self._zeta(y))[:, None]
        with np.errstate(all="ignore"):  # where there is no machine
            both = density + self.outliers.add(square, likelihood.n_rows, share)
            outlier = self.outliers.probability(square, likelihood.n_rows, share)
        return np.where(np.isfinite(both), both, -np.inf), outlier

    def finer(self) -> Posterior | None:
        """Return the same posterior without what the likelihood's hot path leaves out; None where that is nothing."""
        likelihood = self.likelihood.solved()
        return None if likelihood is None else replace(self, likelihood=likelihood)

    def as_fine(self, likelihood: Likelihood) -> Likelihood:
        """Return a likelihood of other poses that leaves out as much as this posterior's own does."""
        return (likelihood.solved() or likelihood) if self.likelihood.is_solved else likelihood

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose, shape (B, P)."""
        return self.evaluate_poses(self.likelihood, y)

    def pointwise_of(self, y: Array, row: int) -> Array:
        """Return the log-likelihood of one pose, shape (B,), for coordinates (B, n)."""
        return np.asarray(self.pointwise(y)[:, row])

    def evaluate_poses(self, likelihood: Likelihood, y: Array) -> Array:
        """Return the log-likelihood of each pose, of these or of others, shape (B, P), for coordinates (B, n)."""
        if self.outliers is None:
            return likelihood.pointwise(self.theta(y), self.model_errors(y))
        parts = [self._mix(likelihood, y[part], self.theta(y[part]))[0] for part in batches(len(y))]
        return np.concatenate(parts)

    def outlier_probabilities(self, likelihood: Likelihood, y: Array) -> Array:
        """Return how probable it is that each pose is an outlier, for every draw (B, n), shape (B, P)."""
        parts = [self._mix(likelihood, y[part], self.theta(y[part]))[1] for part in batches(len(y))]
        return np.concatenate(parts)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def information(self, y: Array) -> tuple[Array, Array]:
        """Return the information of the data and the precision of the prior on the geometry at y, shapes (m, m)."""
        local = self._linearise(y, self._nearest(y))
        rows = self._prior_slope(local.change)
        return local.inform(), rows.T @ rows

    def pose_information(self, y: Array, pose: int) -> Array:
        """Return what one pose tells of the geometry at y beyond all others, shape (m, m); see `pointwise`."""
        likelihood = self._nearest(y)
        return likelihood.inform_by_pose(self._linearise(y, likelihood), pose)

    def prior_residual(self, y: Array, theta: Array) -> Array:
        """Return the geometry's prior as residuals of unit variance, shape (m,), at coordinates (m,) and θ (D,)."""
        return self._prior.residual(y[: self.n_geometry], theta)

    def _prior_slope(self, change: Array) -> Array:
        """Return the derivative of `prior_residual` by the coordinates, shape (m, m), from dθ/dy."""
        return self._prior.slope(change)

    def residual_slope(self, theta: Array, likelihood: Likelihood | None = None) -> tuple[Array, Array]:
        """Return dr/dy, shape (P, K, m), and the derivative of `prior_residual`, shape (m, m), at θ, shape (D,)."""
        change, likelihood = self.coordinates.jacobian(theta), likelihood or self.likelihood
        return turn_to_coordinates(likelihood.error_jacobian(theta)[1], change), self._prior_slope(change)

    def groups(self) -> list[np.ndarray]:
        """Return which geometric coordinates a model error makes uncertain together: each leg's.

        With an error that is a function of the pose, or where free frames tie the legs together and all have one model
        error, everything is one group.
        """
        one = self.likelihood.levels is not None or (self._ties_legs and self.model_error.shared)
        return [np.arange(self.n_geometry)] if one else self._legs()

    @property
    def _ties_legs(self) -> bool:
        """Whether parameters are free that no leg has, those of frames."""
        return bool((self.coordinates.free >= self.likelihood.machine.layout.size).any())

    def _legs(self) -> list[np.ndarray]:
        """Return which geometric coordinates belong to each leg."""
        return find_legs(self._layout, self.coordinates.free, self.likelihood.n_legs)

    def _nearest(self, y: Array) -> Likelihood:
        return self.likelihood.nearest(self.model_errors_at(y))

    def _linearise(self, y: Array, likelihood: Likelihood) -> Local:
        """Return a likelihood around y, shape (n,), with the precision of r as far as each pose counts."""
        theta = self.theta(y[None])[0]
        precision = np.linalg.inv(likelihood.error_covariance(self.model_errors_at(y)))
        errors, slope = likelihood.error_jacobian(theta)
        change = self.coordinates.jacobian(theta)
        local = Local(theta, errors, turn_to_coordinates(slope, change), precision, change)
        if self.outliers is None:
            return local
        counts, outlier = self._weigh_poses(y, errors, precision)
        return local._replace(precision=counts[:, None, None] * precision, counts=counts, outlier=outlier)

    def _weigh_poses(self, y: Array, errors: Array, precision: Array) -> tuple[Array, Array]:
        """Return how much each pose counts, shape (P,), and its probability of being an outlier."""
        assert self.outliers is not None
        square = np.einsum("pi,pij,pj->p", errors, precision, errors)
        return self.outliers.weigh(square, self.likelihood.n_rows, self.errors.shares(self._zeta(y)))

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n)."""
        return self._differentiate(y, newton=False)

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return the exact gradient (n,) at y, shape (n,), and the Hessian (n, n) but for the errors' own curvature.

        It is that of Newton's steps: exact in the model errors, and so not always negative definite. That of `gradient`
        where how much a pose counts depends on the model errors, too, or the density is interpolated.
        """
        return self._differentiate(y, newton=True)

    def _differentiate(self, y: Array, newton: bool) -> tuple[Array, Array]:
        m, zeta = self.n_geometry, self._zeta(y)
        gradient, hessian = np.zeros(self.n_parameters), np.zeros((self.n_parameters, self.n_parameters))
        amplitudes, slopes = self.model_errors_at(y), self.errors.slopes(zeta)
        views = self.likelihood.views(amplitudes)
        exact = newton and len(views) == 1 and self.outliers is None and bool(len(slopes))
        inside = slice(m, m + len(slopes))
        for share, likelihood in views:
            local = self._linearise(y, likelihood)
            gradient[:m] -= share * (local.weighted.ravel() @ local.slope.reshape(-1, m))
            hessian[:m, :m] -= share * local.inform()
            if exact:
                across, own, by_errors = likelihood.curve_by_errors(local, amplitudes)
                hessian[:m, inside] = across @ slopes.T
                hessian[inside, :m] = hessian[:m, inside].T
                own = slopes @ own @ slopes.T + np.diag(self.errors.curvatures(zeta) @ by_errors)
            elif len(slopes):
                by_errors, curvature = likelihood.differentiate_by_errors(local, amplitudes)
                own = slopes @ curvature @ slopes.T
            if len(slopes):
                gradient[inside] += share * (slopes @ by_errors)
                hessian[inside, inside] += share * own
            if self.outliers is not None:
                self._add_share(zeta, local, gradient, hessian)
        rows = self._prior_slope(local.change)
        gradient[:m] -= self.prior_residual(y, local.theta) @ rows
        gradient[:m] += self.coordinates.log_volume_slope(local.theta) @ local.change
        gradient[:m] += self.coordinates.log_ring_ratio_slope(y[:m])
        hessian[:m, :m] -= rows.T @ rows
        gradient[m:] -= self.errors.deviations(zeta)
        hessian[m:, m:] -= np.eye(len(zeta))
        return gradient, hessian

    def _add_share(self, zeta: Array, local: Local, gradient: Array, hessian: Array) -> None:
        """Add the part of ε, the last of the coordinates."""
        assert local.outlier is not None
        assert self.outliers is not None
        share, slope = self.errors.shares(zeta), self.outliers.share.slope(zeta[-1])
        by_share = local.outlier / share - (1.0 - local.outlier) / (1.0 - share)
        gradient[-1] += by_share.sum() * slope
        hessian[-1, -1] -= np.sum(by_share**2) * slope**2

    # --- search for the mode -------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return initial values near the mode, shape (n,): the nominal machine, led to the data by ever smaller errors.

        Far off, everything seems to be the fault of every parameter; a coarse fit moves only those that matter, and
        what is hardly determined stays near its prior. Outliers are weighed down on the way.
        """
        y = np.zeros(self.n_parameters)
        sizes = APPROACH if self.outliers is None else (*APPROACH, APPROACH[-1] / 3.0)
        for size in sizes:
            y = self._fit_geometry(y, self.errors.uniform(size))
        return y if self.outliers is None else self.polish(y)

    def polish(self, y: Array) -> Array:
        """Return y, shape (n,), with the geometry of least squares at its errors, reweighted where outliers may be."""
        return self._fit_geometry(y, self.model_errors_at(y))

    def _fit_geometry(self, start: Array, model_errors: Array) -> Array:
        """Return y with the geometry of least squares, whitened errors and priors together, at model errors (K,)."""
        likelihood, found = self.likelihood.nearest(model_errors), start.copy()
        covariance = likelihood.error_covariance(model_errors)
        whitening, m = np.linalg.inv(np.linalg.cholesky(covariance)), self.n_geometry
        if self.outliers is None:
            found[:m] = fit_geometry(self, likelihood, start[:m], whitening)
            return found
        precision = np.linalg.inv(covariance)
        for _ in range(REWEIGHTINGS):
            errors = likelihood.errors(self.theta(found[None]))[0]
            weight, _ = self._weigh_poses(found, errors, precision)
            found[:m] = fit_geometry(self, likelihood, found[:m], whitening * np.sqrt(weight)[:, None, None])
        return found

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return legs, and coordinates with the leg's direction mirrored to the other solution of the same gain.

        With one component of u free and κ fixed the actuator's gain along the leg, z · u, has two solutions in every
        leg. With both components free a circle of equal gain joins the two. Each switch of an error jumps, too.
        """
        m = self.n_geometry
        found = [(leg, np.append(image, y[m:])) for leg, image in mirror_lone_components(self.coordinates, y[:m])]
        first, images = self.likelihood.n_legs + m, self.errors.jumps(self._zeta(y))
        return found + [(first + k, np.append(y[:m], image)) for k, image in images]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return the coordinates of free directions' components, each with the other coordinates of its leg.

        Where κ is fixed the actuator gain is a quadratic of u_x that the other parameters of the leg have to follow.
        """
        return find_curved_ridges(self._layout, self.coordinates.free, self._legs())

    # --- straightening -------------------------------------------------------------------------------------------

    def funnel_errors(self, y: Array) -> Array:
        """Return the errors that the geometry's uncertainty depends on, shape (B, N) or (B, L N); see `funnel`."""
        return self.likelihood.errors_by_level(self.model_errors(y))

    def funnel(self, y: Array) -> Funnel | None:
        """Return how the geometry depends on the errors at y, shape (n,); None where there are none.

        None, too, where free frames tie legs together that each have an error: no leg is uncertain by itself then.

        Where the error is a function of the pose, what the geometry is worth hangs on its scale s: the larger it is,
        the less do combinations of poses tell in which the kernel's error is. The joint mode of scale and geometry is
        therefore none of the scale's density; that is seen in straight coordinates only (as restricted likelihood has
        it: Patterson and Thompson 1971).
        """
        if not self.errors.n_amplitudes or (self._ties_legs and not self.model_error.shared):
            return None
        level, likelihood = self.likelihood.levels, self._nearest(y)
        own, tau = self.funnel_errors(y[None])[0], self.tau(y[None])[0]
        if level is None:
            inverse = likelihood.see_by_legs(np.linalg.inv(likelihood.error_covariance(self.model_errors_at(y))))
            precision = np.diagonal(inverse, axis1=-2, axis2=-1).mean(axis=0)
            variance = 1.0 / np.maximum(precision, np.finfo(float).tiny)
            rest = np.maximum(variance / likelihood.actuator_weight.mean(axis=0) - tau**2, 1e-12)
            information, prior = self.information(y)
            return Funnel(information, prior, rest, own)
        local, n_legs, m = self._linearise(y, likelihood), self.likelihood.n_legs, self.n_geometry
        whitening, _ = root_of(local.precision)
        rows, white = whitening @ local.slope, (whitening @ local.errors[..., None])[..., 0]
        chosen = np.eye(level.max() + 1)[level]
        parts = np.einsum("kl,kia,kib->liab", chosen, rows, rows, optimize=True)
        scores = -np.einsum("kl,kia,ki->lia", chosen, rows, white, optimize=True)
        weight = likelihood.actuator_weight[:, :n_legs]
        variance = 1.0 / np.diagonal(local.precision, axis1=-2, axis2=-1) / weight
        rest = (chosen.T @ variance / chosen.sum(axis=0)[:, None]).ravel() - own**2
        prior_rows = self._prior_slope(local.change)
        return Funnel(
            parts.sum(axis=(0, 1)),
            prior_rows.T @ prior_rows,
            np.maximum(rest, 1e-12),
            own,
            parts.reshape(-1, m, m),
            scores.reshape(-1, m),
        )

    # --- errors that are a function of the pose --------------------------------------------------------------------

    def function_of_pose(self, natural: Array) -> tuple[Kernel, Array] | None:
        """Return the kernel, of the draws' median length, and the rms of each leg's scale (N,), mm, over draws (S, n).

        None where there is no such error; the draws are in natural units.
        """
        structured, zeta = self.likelihood.structured, self._zeta(natural)
        if structured is None:
            return None
        scale = np.sqrt(np.mean(zeta[:, self.errors.place(SCALE)] ** 2, axis=0))
        kernel = structured.kernel_of(np.median(zeta[:, self.errors.place(LENGTH)], axis=0))
        return kernel, np.broadcast_to(scale, self.likelihood.n_legs)

    def probability_of_error(self, y: Array) -> Array:
        """Return the share of draws (B, n) with an error that is a function of the pose, of each scale."""
        return np.asarray((self._zeta(y)[..., self.errors.place(SCALE)] > BORDER).mean(axis=0))
