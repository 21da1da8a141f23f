"""The density of measurements of machines on legs, whatever instrument made them, and posteriors built of it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.errors import NO_MODEL_ERROR, LegErrors, LegTerm, ModelError
from bayescal.density.outliers import NORMAL, Outliers
from bayescal.density.posterior import Elimination, Funnel, Posterior
from bayescal.density.priors import Prior
from bayescal.density.sampling import LegSampling, build_sampling, check_bounds
from bayescal.errors import InputError
from bayescal.limits import FAR_AWAY
from bayescal.machines.kinematics import Machine
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.density.pose_likelihood import PoseLikelihood

BATCH = 256  # vectors at a time: what the hot loop touches stays in the cache
POSES = 128  # poses of six legs at a time, for the same reason; memory then hardly grows with the poses


def batches(size: int, n_poses: int = 1) -> list[slice]:
    """Return slices of at most `BATCH` out of ``size``, fewer where each takes memory for very many poses at once."""
    most = max(1, BATCH * POSES // max(n_poses, POSES))
    return [slice(k, min(k + most, size)) for k in range(0, size, most)]


class Local(NamedTuple):
    """A posterior's likelihood around a point."""

    theta: Array  # (D,)
    errors: Array  # (P, K): r and dr/dy
    slope: Array  # (P, K, m)
    precision: Array  # (P, K, K): of r, as far as each pose counts
    change: Array  # (D, m): dθ/dy
    counts: Array | None = None  # (P,): how much each pose counts; None where all count in full

    @property
    def weighted(self) -> Array:
        """C⁻¹ r, shape (P, K)."""
        return np.asarray((self.precision @ self.errors[..., None])[..., 0])

    @property
    def square(self) -> Array:
        """rᵀ C⁻¹ r of each pose as far as it counts, shape (P,)."""
        return np.einsum("pi,pi->p", self.errors, self.weighted)

    def inform(self) -> Array:
        """Return the information of the data on the geometry, shape (m, m)."""
        m = self.slope.shape[-1]
        return np.asarray(self.slope.reshape(-1, m).T @ (self.precision @ self.slope).reshape(-1, m))


def turn_to_coordinates(slope: Array, change: Array) -> Array:
    """Return derivatives by y, (P, K, m), from those by θ, (P, K, D), and dθ/dy (D, m): one product for all rows."""
    return np.asarray((slope.reshape(-1, len(change)) @ change).reshape(*slope.shape[:-1], change.shape[1]))


def whiten_by(whitening: Array) -> Callable[[Array], Array]:
    """Return what takes rows (P, K, n) of independent poses to white ones (P K, n), for matrices (P, K, K)."""
    return lambda rows: np.asarray((whitening @ rows).reshape(-1, rows.shape[-1]))


APPROACH = (1.0, 0.1)  # model errors in mm with which the search for the mode begins
REWEIGHTINGS = 6
TOLERANCE = 1e-6  # of least squares


class Likelihood(Elimination[LegSampling, LegErrors]):
    """The density of measurements of a machine on legs at P poses.

    At each pose the measurements err by K rows, normal with a covariance that does not depend on the parameters θ (D,):
    what is known of it, and the model errors τ_i of the N legs, C = C⁰ + W diag(w_i τ_i²) Wᵀ.

    Attributes
    ----------
    machine : Machine
    layout : ParameterLayout
        Of θ: the machine's parameters first, then those of the measurement.
    actuator_weight : ndarray, shape (P, N)
        w.
    """

    machine: Machine
    layout: ParameterLayout
    actuator_weight: Array

    @property
    def n_legs(self) -> int:
        """Number of legs N."""
        return self.actuator_weight.shape[1]

    @property
    def n_model_errors(self) -> int:
        """Number of entries of a model error: one per leg, or several kinds of N each."""
        return self.actuator_weight.shape[1]

    @property
    @abstractmethod
    def n_poses(self) -> int:
        """Number of poses P."""

    @abstractmethod
    def errors(self, theta: Array) -> Array:
        """Return the rows for parameter vectors (B, D), shape (B, P, K); NaN where there is no machine."""

    @abstractmethod
    def error_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Return the rows (P, K) and their exact derivative (P, K, D) for one parameter vector (D,)."""

    @abstractmethod
    def error_covariance(self, model_error: Array) -> Array:
        """Return C, shape (P, K, K), for model errors (N,) in mm."""

    @abstractmethod
    def on_legs(self, rows: Array) -> Array:
        """Return Wᵀ times something of the rows, shape (P, K, ...) to (P, N, ...)."""

    @abstractmethod
    def pose_errors(self, theta: Array) -> Array:
        """Return measured minus predicted pose (mm, rad), shape (B, P, 6); NaN where it is not measured."""

    @abstractmethod
    def pose_covariance(self, model_error: Array) -> Array:
        """Return the covariance of `pose_errors`, shape (..., P, 6, 6), for model errors (..., N) in mm."""

    def whiten(self, model_error: Array) -> Callable[[Array], Array]:
        """Return what makes rows (P, K, n) white under model errors (K,), of the same shape."""
        whitening = np.linalg.inv(np.linalg.cholesky(self.error_covariance(model_error)))
        return lambda rows: np.asarray(whitening @ rows)

    def parts(self) -> list[tuple[slice, Likelihood]]:
        """Return which poses are best worked on together, each with their density; by default all."""
        return [(slice(None), self)]

    # --- what it is, where it matters ----------------------------------------------------------------------------

    @property
    def of_poses(self) -> PoseLikelihood | None:
        """The density of the poses each by itself, where whole poses were measured in known frames; None elsewhere."""
        return None

    @property
    def closing_poses(self) -> MeasuredPoses | None:
        """Poses at whose mean the legs' lengths follow the joints, where these are hardly known; None elsewhere."""
        return None

    @property
    def n_rows(self) -> np.ndarray:
        """How many rows each pose has, shape (P,)."""
        return np.full(self.n_poses, self.n_legs)

    @property
    def is_solved(self) -> bool:
        """Whether nothing is left out of the rows for speed that could be had."""
        return False

    def finer(self) -> Likelihood | None:
        """Return the same density without what its hot path leaves out of the rows; None where that is nothing."""
        return None

    def like(self, other: Likelihood) -> Likelihood:
        """Return a density of other poses that leaves out as much as this one does."""
        return (other.finer() or other) if self.is_solved else other

    def of_errors_at(self, poses: PoseLikelihood, rows: np.ndarray | None = None) -> Likelihood:
        """Return the density of other poses whose errors depend on each other as here; by default they do not.

        ``rows`` says which of these poses they are, measured again, where they are that.
        """
        del rows
        return poses

    # --- densities -----------------------------------------------------------------------------------------------

    def evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return `pointwise` and eᵀ C⁻¹ e of each pose, shapes (B, P); infinite where there is no machine."""
        density, square = np.empty((2, len(theta), self.n_poses))
        for part in self._batches(len(theta)):
            some = model_error if model_error.ndim == 1 else model_error[part]
            density[part], square[part] = self._evaluate(theta[part], some)
        square[~np.isfinite(square)] = np.inf
        return density, square

    def pointwise(self, theta: Array, model_error: Array) -> Array:
        """Return the log-density of each pose.

        Parameters
        ----------
        theta : ndarray, shape (B, D)
            Parameter vectors.
        model_error : ndarray, shape (B, N) or (N,)
            τ of each leg, mm; one vector for all is much faster.

        Returns
        -------
        ndarray, shape (B, P)
            In units of mm and rad; -inf where a parameter vector is no machine (NaN closure).
        """
        result = np.empty((len(theta), self.n_poses))
        for part in self._batches(len(theta)):
            result[part] = self._evaluate(theta[part], model_error if model_error.ndim == 1 else model_error[part])[0]
        return result

    def _batches(self, size: int) -> list[slice]:
        """Return how many vectors to take at a time."""
        return batches(size, self.n_poses)

    @abstractmethod
    def _evaluate(self, theta: Array, model_error: Array) -> tuple[Array, Array]:
        """Return `evaluate` of a batch."""

    def __call__(self, theta: Array, model_error: Array) -> Array:
        """Return the log-likelihood, shape (B,); arguments as in `pointwise`."""
        return self.pointwise(theta, model_error).sum(axis=1)

    # --- under errors with coordinates ---------------------------------------------------------------------------

    def sampling(
        self, priors: Mapping[str, Prior], fixed: Mapping[str, float], common: Mapping[str, tuple[str, ...]]
    ) -> LegSampling:
        """Return the coordinates of the free parameters; no leg's parameters deviate alike with another's."""
        if common:
            raise InputError(f"common: found {next(iter(common))!r}, expected none: legs deviate each by themselves")
        return build_sampling(self.machine, self.layout, priors, fixed, self.closing_poses)

    def density(self, theta: Array, errors: LegErrors, zeta: Array) -> Array:
        """Return the log-likelihood, shape (B,); see `Elimination.density`."""
        if errors.outliers.expected:
            return self.density_by_row(theta, errors, zeta).sum(axis=1)
        return self(theta, errors.amplitudes(zeta))

    def density_by_row(self, theta: Array, errors: LegErrors, zeta: Array) -> Array:
        """Return the log-likelihood of each pose, shape (B, P); see `Elimination.density_by_row`."""
        if not errors.outliers.expected:
            return self.pointwise(theta, errors.amplitudes(zeta))
        density, square = self.evaluate(theta, errors.amplitudes(zeta))
        with np.errstate(all="ignore"):  # where there is no machine
            density += errors.tails(zeta).exceed(square, self.n_rows)
        return np.where(np.isfinite(density), density, -np.inf)

    def outlier_probabilities(self, theta: Array, errors: LegErrors, zeta: Array) -> Array:
        """Return how probable it is that each pose is an outlier, shape (B, P)."""
        square = self.evaluate(theta, errors.amplitudes(zeta))[1]
        with np.errstate(all="ignore"):
            return errors.tails(zeta).suspect(square, self.n_rows)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def linearise(self, theta: Array, change: Array, errors: LegErrors, zeta: Array) -> Local:
        """Return the density around θ (D,), ζ (k,), with dθ/dy (D, m), and precisions as far as each pose counts."""
        precision = np.linalg.inv(self.error_covariance(errors.amplitudes(zeta)))
        rows, slope = self.error_jacobian(theta)
        local = Local(theta, rows, turn_to_coordinates(slope, change), precision, change)
        if not errors.outliers.expected:
            return local
        counts = errors.tails(zeta[None]).trust(local.square[None], self.n_rows)[0]
        return local._replace(precision=counts[:, None, None] * precision, counts=counts)

    def inform(self, theta: Array, change: Array, errors: LegErrors, zeta: Array) -> Array:
        """Return the information of the data on the geometry, shape (m, m)."""
        return self.linearise(theta, change, errors, zeta).inform()

    def inform_row(self, theta: Array, change: Array, errors: LegErrors, zeta: Array, row: int) -> Array:
        """Return what one pose tells of the geometry beyond all others, shape (m, m)."""
        return self.inform_by_pose(self.linearise(theta, change, errors, zeta), row)

    def differentiate(
        self, theta: Array, change: Array, errors: LegErrors, zeta: Array, newton: bool
    ) -> tuple[Array, Array]:
        """Return gradient and Hessian of the log-likelihood; see `Elimination.differentiate`.

        Newton's Hessian is exact in the model errors, and so not always negative definite. It is that of Gauss and
        Newton where how much a pose counts depends on the model errors, too.
        """
        m, k = change.shape[1], errors.n_amplitudes
        gradient, hessian = np.zeros(m + len(zeta)), np.zeros((m + len(zeta), m + len(zeta)))
        amplitudes, slopes, inside = errors.amplitudes(zeta), errors.slopes_of_amplitudes(zeta), slice(m, m + k)
        local = self.linearise(theta, change, errors, zeta)
        gradient[:m] = -(local.weighted.ravel() @ local.slope.reshape(-1, m))
        hessian[:m, :m] = -local.inform()
        if k and newton and not errors.outliers.expected:
            across, own, by_errors = self.curve_by_errors(local, amplitudes)
            hessian[:m, inside] = across @ slopes.T
            hessian[inside, :m] = hessian[:m, inside].T
            gradient[inside] = slopes @ by_errors
            hessian[inside, inside] = slopes @ own @ slopes.T
            hessian[inside, inside] += np.diag(errors.curvatures_of_amplitudes(zeta) @ by_errors)
        elif k:
            by_errors, curvature = self.differentiate_by_errors(local, amplitudes)
            gradient[inside] = slopes @ by_errors
            hessian[inside, inside] = slopes @ curvature @ slopes.T
        if local.counts is not None:
            square = local.square / local.counts
            by_share = errors.tails(zeta[None]).slopes(square[None], self.n_rows)[0]
            gradient[m + k :] += by_share.sum(axis=0)
            hessian[m + k :, m + k :] -= by_share.T @ by_share
        return gradient, hessian

    def differentiate_by_errors(self, local: Local, model_error: Array) -> tuple[Array, Array]:
        """Return the log-likelihood's gradient by model errors (K,) around a point, and expected curvatures (K, K).

        The log-determinant of a pose counts in full, however little the pose does.
        """
        square, precision = self.on_legs(local.weighted) ** 2, self.see_by_legs(local.precision)
        if local.counts is not None:
            square, precision = square / local.counts[:, None], precision / local.counts[:, None, None]
        scaled = self.actuator_weight * model_error
        by_errors = np.sum(scaled * (square - np.diagonal(precision, axis1=1, axis2=2)), axis=0)
        return by_errors, -2.0 * np.einsum("pi,pij,pj->ij", scaled, precision**2, scaled)

    def curve_by_errors(self, local: Local, model_error: Array) -> tuple[Array, Array, Array]:
        """Return second derivatives of the log-likelihood, exact in the model errors, and its gradient by these.

        Fisher's information has geometry and model errors independent of each other and takes squared errors by their
        expectation: a search for the mode of a model that does not fit takes tens of steps with it. With
        C = C₀ + W diag(w τ²) Wᵀ, g = Wᵀ C⁻¹ e and Q = Wᵀ C⁻¹ W of a pose, ∂C/∂τ_i = 2 w_i τ_i W_i W_iᵀ gives

            ∂²/∂y ∂τ_i = 2 w_i τ_i g_i (W_iᵀ C⁻¹ ∂e/∂y),
            ∂²/∂τ_i ∂τ_j = 2 w_i τ_i w_j τ_j (Q_ij² - 2 g_i Q_ij g_j) + δ_ij w_i (g_i² - Q_ii).

        Returns
        -------
        by_geometry : ndarray, shape (m, K)
        by_errors : ndarray, shape (K, K)
        gradient : ndarray, shape (K,)
        """
        told = self.on_legs(local.weighted)
        steered = self.on_legs(local.precision @ local.slope)
        seen = self.see_by_legs(local.precision)
        weight = self.actuator_weight
        scaled, surplus = weight * model_error, told**2 - np.diagonal(seen, axis1=1, axis2=2)
        across = 2.0 * np.einsum("pi,pim->mi", scaled * told, steered)
        pulled = scaled * told
        own = 2.0 * np.einsum("pi,pij,pj->ij", scaled, seen**2, scaled)
        own -= 4.0 * np.einsum("pi,pij,pj->ij", pulled, seen, pulled)
        own += np.diag(np.sum(weight * surplus, axis=0))
        return across, own, np.sum(scaled * surplus, axis=0)

    def see_by_legs(self, precision: Array) -> Array:
        """Return Wᵀ C⁻¹ W, what the rows tell of each leg's error, shape (P, K, K) to (P, N, N)."""
        return np.swapaxes(self.on_legs(np.swapaxes(self.on_legs(precision), 1, 2)), 1, 2)

    def inform_by_pose(self, local: Local, pose: int) -> Array:
        """Return what one pose tells of the geometry around a point beyond all others, shape (m, m)."""
        return np.asarray(local.slope[pose].T @ local.precision[pose] @ local.slope[pose])

    # --- straightening -------------------------------------------------------------------------------------------

    def groups(self, sampling: LegSampling, errors: LegErrors) -> list[np.ndarray]:
        """Return which coordinates a model error makes uncertain together: each leg's.

        Where free frames tie the legs together and all have one model error, everything is one group.
        """
        if self._ties_legs(sampling) and errors.model_error.shared:
            return super().groups(sampling, errors)
        return sampling.legs

    def _ties_legs(self, sampling: LegSampling) -> bool:
        """Return whether parameters are free that no leg has, those of frames."""
        return bool((sampling.free >= self.machine.layout.size).any())

    def funnel_errors(self, errors: LegErrors, zeta: Array) -> Array:
        """Return the errors of each leg that the geometry's uncertainty depends on, shape (B, N)."""
        return errors.tau(zeta)

    def funnel(self, sampling: LegSampling, errors: LegErrors, y: Array) -> Funnel | None:
        """Return how the geometry depends on the errors at y, shape (n,); None where there are none.

        None, too, where free frames tie legs together that each have an error: no leg is uncertain by itself then.
        """
        if not errors.n_amplitudes or (self._ties_legs(sampling) and not errors.model_error.shared):
            return None
        zeta, m = y[sampling.size :], sampling.size
        theta = sampling.theta_from_y(y[None, :m])[0]
        change, amplitudes = sampling.jacobian(theta), errors.amplitudes(zeta)
        own, weight = errors.tau(zeta), self.actuator_weight
        local, rows = self.linearise(theta, change, errors, zeta), sampling.prior_slope(change)
        inverse = self.see_by_legs(np.linalg.inv(self.error_covariance(amplitudes)))
        precision = np.diagonal(inverse, axis1=-2, axis2=-1).mean(axis=0)
        variance = 1.0 / np.maximum(precision, np.finfo(float).tiny)
        rest = np.maximum(variance / weight.mean(axis=0) - own**2, 1e-12)
        return Funnel(local.inform(), rows.T @ rows, rest, own)

    # --- search for the mode -------------------------------------------------------------------------------------

    def approach(self, sampling: LegSampling, errors: LegErrors) -> Array:
        """Return initial values near the mode, shape (n,): the nominal machine, led to the data by ever smaller errors.

        Far off, everything seems to be the fault of every parameter; a coarse fit moves only those that matter, and
        what is hardly determined stays near its prior. Outliers are weighed down on the way.
        """
        y = np.zeros(sampling.size + errors.n_parameters)
        for size in (*APPROACH, APPROACH[-1] / 3.0) if errors.outliers.expected else APPROACH:
            y = self._fit(sampling, errors, y, errors.uniform(size))
        return self.polish(sampling, errors, y) if errors.outliers.expected else y

    def polish(self, sampling: LegSampling, errors: LegErrors, y: Array) -> Array:
        """Return y, shape (n,), with the geometry of least squares at its errors, reweighted where outliers may be."""
        return self._fit(sampling, errors, y, errors.amplitudes(y[sampling.size :]))

    def _fit(self, sampling: LegSampling, errors: LegErrors, start: Array, amplitudes: Array) -> Array:
        """Return y with the geometry of least squares, whitened rows and priors together, at amplitudes (K,)."""
        found, m = start.copy(), sampling.size
        whitening = np.linalg.inv(np.linalg.cholesky(self.error_covariance(amplitudes)))
        if not errors.outliers.expected:
            found[:m] = self.fit_geometry(sampling, start[:m], whiten_by(whitening))
            return found
        tails = errors.tails(found[None, m:])
        for _ in range(REWEIGHTINGS):
            white = whitening @ self.errors(sampling.theta_from_y(found[None, :m]))[0][..., None]
            weight = tails.trust(np.sum(white**2, axis=(1, 2))[None], self.n_rows)[0]
            found[:m] = self.fit_geometry(sampling, found[:m], whiten_by(whitening * np.sqrt(weight)[:, None, None]))
        return found

    def fit_geometry(self, sampling: LegSampling, start: Array, whiten: Callable[[Array], Array]) -> Array:
        """Return the geometry's coordinates of least squares, (m,); ``whiten`` takes rows (P, K, n) to white (R, n)."""
        from scipy.optimize import least_squares  # a tenth of a second to import

        def residual(y: Array) -> Array:
            theta = sampling.theta_from_y(y[None])
            white = whiten(self.errors(theta)[0][..., None]).ravel()
            value = np.concatenate([white, sampling.prior_residual(y, theta[0])])
            return np.where(np.isfinite(value) & self.layout.inside(theta)[0], value, FAR_AWAY)

        def jacobian(y: Array) -> Array:
            theta = sampling.theta_from_y(y[None])[0]
            change = sampling.jacobian(theta)
            slope = turn_to_coordinates(self.error_jacobian(theta)[1], change)
            return np.concatenate([whiten(slope), sampling.prior_slope(change)])

        return np.asarray(least_squares(residual, start, jacobian, method="lm", xtol=TOLERANCE, ftol=TOLERANCE).x)


type LegPosterior = Posterior[Likelihood, LegSampling, LegErrors]
"""The posterior of a machine on legs."""


def build_leg_posterior(
    likelihood: Likelihood,
    priors: Mapping[str, Prior],
    model_error: ModelError = NO_MODEL_ERROR,
    fixed: Mapping[str, float] | None = None,
    terms: Sequence[LegTerm] = (),
    outliers: Outliers = NORMAL,
) -> LegPosterior:
    """Return the posterior of a machine on legs.

    Parameters
    ----------
    likelihood : Likelihood
        Density of the measurements at the calibration poses.
    priors : mapping of parameter name to Prior
        Of the free parameters.
    model_error : ModelError
        The model error τ, or none.
    fixed : mapping of parameter name to float, optional
        Values of fixed parameters that are not nominal.
    terms : sequence of LegTerm
        What else the likelihood takes: scales of errors that are functions of the pose.
    outliers : Outliers
        What poses are like that are wrong as a whole; by default none is expected.
    """
    errors = LegErrors.of_legs(likelihood.n_legs, (model_error, *terms), outliers)
    return Posterior(likelihood, priors, errors, fixed or {})


def check_machine(posterior: LegPosterior) -> None:
    """Raise InputError where the priors' centres, or the ends of a uniform prior, are no machine's parameters."""
    sampling = posterior.sampling
    sampling.layout.check(sampling.start)
    check_bounds(sampling.coordinates)
    if not np.isfinite(posterior.likelihood.errors(sampling.start[None])).all():
        raise InputError("found no machine at the priors' centres, expected unit directions and a home pose")
