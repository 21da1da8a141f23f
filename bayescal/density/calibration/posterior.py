"""Posterior of a calibration: priors by parameter, errors as a composition of terms, poses eliminated.

Coordinates are standard normal under the prior: a normal prior's parameter in its standard deviations, a uniform one's
by Φ, those of the errors as their terms say (`terms.Errors`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from bayescal.density.calibration.likelihood import CalibrationLikelihood, Stand
from bayescal.density.calibration.terms import HALF_LOG_TWO_PI, NO_ERRORS, CommonDraws, Errors
from bayescal.density.calibration.whitening import Whitening
from bayescal.density.elimination import invert, left_of, orthonormalise, project_out
from bayescal.density.local import Funnel
from bayescal.density.low_rank_columns import Coefficients, find_coefficients, split
from bayescal.density.priors import Prior, UniformPrior
from bayescal.errors import InputError, NumericalError
from bayescal.numerics.geometry import Array

STEP = 1e-4  # of a coordinate, for the slope of the logarithms of volumes
DAMPING, LARGEST_DAMPING = 1e-3, 1e12
NEARBY, FAR = 8, 3.0  # machines by which the density is tried about its anchor, and how many deviations they are off
EDGE = 1e-3  # how near to a bound, by the width of a uniform prior, a machine known otherwise is taken to be
GAIN = 1e-12  # of the squares, below which the search has arrived
STILL = 1e-8  # of a coordinate, below which a step that leads nowhere is the last: shorter ones lead nowhere, too
LEAST_SHARE = 1e-3  # of a variance, that an unknown noise is taken to have
MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class CalibrationPosterior:
    """Posterior of free parameters and of what is unknown of the errors; a `bayescal.inference.target.Target`.

    Attributes
    ----------
    likelihood : CalibrationLikelihood
    priors : mapping of name to Prior
        Of the free parameters.
    errors : Errors
    fixed : mapping of parameter name to float
        Values of fixed parameters that are not nominal.
    common : mapping of name to tuple of parameter names
        Parameters that deviate alike from their nominal values, under the name that their prior has.
    """

    likelihood: CalibrationLikelihood
    priors: Mapping[str, Prior]
    errors: Errors = NO_ERRORS
    fixed: Mapping[str, float] = field(default_factory=dict)
    common: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the names."""
        layout = self.likelihood.model.layout
        shared = [name for members in self.common.values() for name in members]
        for name in (*(name for name in self.priors if name not in self.common), *shared, *self.fixed):
            if name not in layout.names:
                raise InputError(f"parameter {name!r}: unknown here, expected one of {', '.join(layout.symbols)}")

    # --- parameters ------------------------------------------------------------------------------------------------

    @cached_property
    def geometry_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the layout's order."""
        return tuple(sorted(self.priors, key=lambda name: self.places(name)[0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, then of the errors'."""
        return (*self.geometry_names, *self.errors.names)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of all."""
        units = self.likelihood.model.layout.units
        return (*(units[self.places(name)[0]] for name in self.geometry_names), *self.errors.units)

    def places(self, name: str) -> list[int]:
        """Return where the parameters of a coordinate stand in the layout."""
        names = self.likelihood.model.layout.names
        return [names.index(member) for member in self.common.get(name, (name,))]

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""
        return len(self.priors) + self.errors.n_parameters

    @property
    def n_geometry(self) -> int:
        """How many of them are parameters of the machine."""
        return len(self.priors)

    @cached_property
    def centre(self) -> Array:
        """The machine as expected, shape (D,)."""
        layout = self.likelihood.model.layout
        theta = layout.nominal.copy()
        for name, value in self.fixed.items():
            theta[layout.names.index(name)] = value
        for name, prior in self.priors.items():
            places = self.places(name)
            theta[places] += prior.mean - theta[places[0]]
        return theta

    @cached_property
    def _moves(self) -> Array:
        """Which parameters go with which coordinate, ones and zeros, shape (m, D)."""
        moves = np.zeros((self.n_geometry, self.likelihood.model.layout.size))
        for k, name in enumerate(self.geometry_names):
            moves[k, self.places(name)] = 1.0
        return moves

    @cached_property
    def _first(self) -> np.ndarray:
        return np.array([self.places(name)[0] for name in self.geometry_names], dtype=int)

    @cached_property
    def prior_sd(self) -> Array:
        """Standard deviations of all priors, shape (n,)."""
        return np.array([prior.sd for prior in self.all_priors().values()])

    def all_priors(self) -> dict[str, Prior]:
        """Return the priors of all parameters in their own units, by name and in order."""
        own = (*(self.priors[name] for name in self.geometry_names), *self.errors.priors)
        return dict(zip(self.names, own, strict=True))

    @cached_property
    def _uniform(self) -> tuple[np.ndarray, Array]:
        chosen = [self.priors[name] for name in self.geometry_names]
        return np.array([isinstance(one, UniformPrior) for one in chosen], dtype=bool), np.array(
            [one.upper - one.lower if isinstance(one, UniformPrior) else one.sd for one in chosen]
        )

    def _deviate(self, y: Array) -> Array:
        """Return deviations from the priors' means (..., m) from coordinates (..., m)."""
        uniform, width = self._uniform
        return np.where(uniform, (ndtr(y) - 0.5) * width, y * width)

    def _speed(self, y: Array) -> Array:
        """Return the derivative of the same."""
        uniform, width = self._uniform
        return np.where(uniform, np.exp(-0.5 * y * y - HALF_LOG_TWO_PI) * width, width)

    def zeta(self, y: Array) -> Array:
        """Return the coordinates of the errors, (..., n) to (..., n - m)."""
        return y[..., self.n_geometry :]

    def theta(self, y: Array) -> Array:
        """Return full parameter vectors (B, D) of coordinates (B, n)."""
        return np.asarray(self.centre + self._deviate(y[..., : self.n_geometry]) @ self._moves)

    def natural(self, y: Array) -> Array:
        """Return parameters and what is unknown of the errors in their own units, (..., n)."""
        geometry = self.centre[self._first] + self._deviate(y[..., : self.n_geometry])
        return np.concatenate([geometry, self.errors.natural(self.zeta(y))], axis=-1)

    # --- density -------------------------------------------------------------------------------------------------

    def log_prior(self, y: Array) -> Array:
        """Return the log-prior in the coordinates, (B, n) to (B,)."""
        place = np.concatenate([y[..., : self.n_geometry], self.errors.deviation(self.zeta(y))], axis=-1)
        constant = self.n_parameters * HALF_LOG_TWO_PI + len(self.errors.switches) * np.log(2.0)
        return np.asarray(-0.5 * np.einsum("...i,...i->...", place, place) - constant)

    def draw_prior(self, n_draws: int, rng: np.random.Generator) -> Array:
        """Return draws of the prior in the coordinates, shape (n_draws, n)."""
        return self.errors.draw_prior(rng.standard_normal((n_draws, self.n_parameters)), self.n_geometry, rng)

    def deviations(self, y: Array, other: CalibrationLikelihood | None = None) -> tuple[Array, Array]:
        """Return f σ (B, P, K) and the root of the variances beside (B, 1 or P, K) at coordinates (B, n)."""
        likelihood = other or self.likelihood
        return self.errors.deviations(self.zeta(y), likelihood.data, likelihood.sd)

    def finer(self) -> None:
        """Return None: the density leaves nothing out."""

    def log_density(self, y: Array) -> Array:
        """Return log-likelihood plus log-prior, (B, n) to (B,), -inf where there is no machine."""
        with np.errstate(all="ignore"):
            theta = self.theta(y)
            inside = self.likelihood.model.layout.inside(theta)
            theta[~inside] = self.centre
            total = self.log_prior(y) + self._log_likelihood(y, theta)
        return np.where(inside & np.isfinite(total), total, -np.inf)

    def _log_likelihood(self, y: Array, theta: Array) -> Array:
        likelihood, outliers = self.likelihood, self.errors.outliers
        if not self.errors.has_columns:
            return np.asarray(likelihood.pointwise(theta, *self.deviations(y), outliers).sum(axis=1))
        total = np.empty(len(y))
        for part, white, at in self._explain(y, theta, likelihood):
            rest = likelihood.offset(white, at)
            for some, found in self._absorb(y[part], white, at):
                weighed = outliers.weigh(found.square, likelihood.n_spare) + rest[some]
                total[part][some] = weighed.sum(axis=1) + found.penalty
        return total

    def pointwise(self, y: Array) -> Array:
        """Return the log-likelihood of each pose's readings given all other poses, (B, n) to (B, P)."""
        likelihood, outliers = self.likelihood, self.errors.outliers
        if not self.errors.has_columns:
            return likelihood.pointwise(self.theta(y), *self.deviations(y), outliers)
        result = np.empty((len(y), likelihood.data.n_poses))
        for part, white, at in self._explain(y, self.theta(y), likelihood):
            rest = likelihood.offset(white, at)
            for some, found in self._absorb(y[part], white, at):
                result[part][some] = rest[some] + found.condition_each(outliers, likelihood.n_spare)
        return np.where(np.isfinite(result), result, -np.inf)

    def predict_density(self, other: CalibrationLikelihood, y: Array) -> Array:
        """Return the log-density of each of Q other poses' readings given those of the posterior, (B, n) to (B, Q)."""
        outliers = self.errors.outliers
        if not self.errors.has_columns:
            return other.pointwise(self.theta(y), *self.deviations(y, other), outliers)
        result = np.empty((len(y), other.data.n_poses))
        for part, white, at in self._explain(y, self.theta(y), self.likelihood):
            for some, found in self._absorb(y[part], white, at):
                own = y[part][some]
                beyond = other.whiten(*self.deviations(own, other))
                there = other.stand(self.theta(own), beyond)
                columns = self.columns(own, beyond, there.slope, other)
                told = found.condition_others(there.error, columns, outliers, other.n_spare)
                result[part][some] = other.offset(beyond, there) + told
        return np.where(np.isfinite(result), result, -np.inf)

    def residuals(self, y: Array) -> Array:
        """Return white residuals of the best poses and of the mean errors common to all rows, (B, n) to (B, P, K)."""
        white, at = self.stand(y)
        if not self.errors.has_columns:
            return at.error
        return np.concatenate([found.residual for _, found in self._absorb(y, white, at)])

    def stand(self, y: Array) -> tuple[Whitening, Stand]:
        """Return the whitening and where machines of coordinates (B, n) explain the readings best."""
        white = self.likelihood.whiten(*self.deviations(y))
        return white, self.likelihood.stand(self.theta(y), white)

    def _explain(
        self, y: Array, theta: Array, likelihood: CalibrationLikelihood
    ) -> Iterator[tuple[slice, Whitening, Stand]]:
        """Yield machines that are looked at together, with whitening and where they explain readings best."""
        for part in likelihood.batches(len(y)):
            white = likelihood.whiten(*self.deviations(y[part], likelihood))
            yield part, white, likelihood.stand(theta[part], white)

    # --- errors common to all rows -------------------------------------------------------------------------------

    def columns(self, y: Array, white: Whitening, slope: Array, other: CalibrationLikelihood | None = None) -> Array:
        """Return what coefficients do to white readings that are free of the poses, (B, P, K, N), for slopes H."""
        likelihood = other or self.likelihood
        acted = self._white_columns(y, white, likelihood)
        with np.errstate(all="ignore"):
            axes = orthonormalise(slope)
            return np.asarray(acted - axes @ (np.swapaxes(axes, -1, -2) @ acted))

    def _white_columns(self, y: Array, white: Whitening, likelihood: CalibrationLikelihood) -> Array:
        acted = self.errors.columns(self.zeta(y), likelihood.data)
        return white.rows(np.where(likelihood.data.present[..., None], acted, 0.0))

    def draw_common(self, y: Array, rng: np.random.Generator) -> CommonDraws:
        """Return draws of the errors common to all rows, one for each of the coordinates (B, n)."""
        if not self.errors.has_columns:
            return CommonDraws(self.errors, ())
        white, at = self.stand(y)
        parts = [(self.zeta(y[some]), found.draw(rng)) for some, found in self._absorb(y, white, at)]
        return CommonDraws(self.errors, tuple(parts))

    def _absorb(self, y: Array, white: Whitening, at: Stand) -> Iterator[tuple[slice, Coefficients]]:
        """Yield the coefficients of errors common to all rows given the readings, of machines worked on together."""
        n_columns = self.errors.columns(self.zeta(y[:1]), self.likelihood.data).shape[-1]
        n_machines, n_poses, n_channels = at.error.shape
        for some in split(n_machines, n_poses, n_channels, n_columns):
            columns = self.columns(y[some], white.pick(some), at.slope[some])
            yield some, self._find(columns, at.error[some])

    def _find(self, columns: Array, error: Array) -> Coefficients:
        return find_coefficients(error, columns, self.errors.outliers, self.likelihood.n_spare)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def rows(self, y: Array, white: Whitening, pose: Array) -> tuple[Array, Array, Array]:
        """Return white errors (P, K), H (P, K, q) and the derivative of the readings by the coordinates (P, K, m)."""
        theta = self.theta(y[None])
        error, slope, by_parameters = self.likelihood.linearise(theta, pose, white, with_parameters=True)
        return error[0], slope[0], by_parameters[0] @ self.moves(y).T

    def moves(self, y: Array) -> Array:
        """Return the derivatives of θ by the geometry's coordinates at y, shape (n,), as rows (m, D)."""
        return np.asarray(self._moves * self._speed(y[: self.n_geometry])[:, None])

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return the gradient (n,) of the log-density at y, shape (n,), and its Gauss-Newton Hessian (n, n).

        Exact but for differences of logarithms of volumes, and of how H turns.
        """
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            error, slope, by_parameters = self.rows(y, white, at.pose)
            trust = self.errors.outliers.trust(at.square, self.likelihood.n_spare)[0]
            left = project_out(slope)
            rows, error = left @ by_parameters, left_of(left, error)
            weighed, found, turn = trust[:, None, None] * rows, None, None
            if self.errors.has_columns:
                acted = self._white_columns(y[None], white, self.likelihood)[0]
                found = self._find((left @ acted)[None], error[None])
                error, trust, weighed = found.residual[0], found.trust[0], found.reduce(rows[None])[0]
                follow = left_of(invert(slope, 0.0), acted @ found.mean[0])  # what coefficients make of the poses
                turn = (trust[:, None] * error)[..., None] * follow[:, None]
            m, n = self.n_geometry, self.n_parameters
            gradient = -np.concatenate([y[:m], self.errors.deviation(y[m:])])
            hessian = -np.eye(n)
            gradient[:m] += np.einsum("p,pki,pk->i", trust, rows, error)
            gradient[: n if found is not None else m] += self._volume_slope(y, white, slope, turn)
            hessian[:m, :m] -= np.einsum("pki,pkj->ij", rows, weighed, optimize=True)
            if n > m:
                self._add_errors(y, white, left, error, trust, found, gradient, hessian)
        return gradient, hessian

    def newton(self, y: Array) -> tuple[Array, Array]:
        """Return `gradient`, whose Hessian is nearly the exact one."""
        return self.gradient(y)

    def _add_errors(
        self,
        y: Array,
        white: Whitening,
        left: Array,
        error: Array,
        trust: Array,
        found: Coefficients | None,
        gradient: Array,
        hessian: Array,
    ) -> None:
        """Add the part of the errors' unknowns, their expected curvature in place of the exact one.

        Logarithms of volumes are in the gradient already where there are coefficients, ``found``.
        """
        m, likelihood = self.n_geometry, self.likelihood
        there = likelihood.data.present
        slopes = self.errors.covariance_slopes(
            y[m:], likelihood.data, likelihood.sd, likelihood.correlation, likelihood.error_gain
        )
        slopes = np.where(there[:, :, None] & there[:, None, :], slopes, 0.0)
        both = white.rows(np.swapaxes(white.rows(slopes), -1, -2))
        seen = left @ both
        gradient[m:] += 0.5 * np.einsum("p,pk,npkl,pl->n", trust, error, both, error, optimize=True)
        hessian[m:, m:] -= 0.5 * np.einsum("npkl,oplk->no", seen, seen, optimize=True)
        if found is None:
            gradient[m:] -= 0.5 * np.trace(seen, axis1=-2, axis2=-1).sum(axis=-1)
            return
        acted = self.errors.column_slopes(y[m:], likelihood.data)
        moved = left @ white.rows(np.where(there[..., None], acted, 0.0))
        gradient[m:] += np.einsum("p,pk,npku,u->n", trust, error, moved, found.mean[0], optimize=True)
        hessian[m:, m:] -= found.inform(both, trust[:, None, None] * left @ both, moved)

    def _volume_slope(self, y: Array, white: Whitening, slope: Array, turn: Array | None = None) -> Array:
        """Return the derivative of log-volumes by the coordinates at y and its white H, (m,); (n,) with coefficients.

        By the expansion where the density takes H from there, else by central differences. Coefficients move the poses
        by δ, to first order; residuals r change with H by -r dH δ, ``turn`` being r δ, (P, K, q).
        """
        m = self.n_geometry
        n = m if turn is None else self.n_parameters
        if turn is None:
            by_parameters = self.likelihood.differentiate_volume(self.theta(y[None])[0], white, slope)
            if by_parameters is not None:
                return self.moves(y) @ by_parameters
        moves = STEP * np.eye(self.n_parameters)[:n]
        points = y + np.concatenate([moves, -moves])
        parts = [self._log_volume(points[part], turn) for part in self.likelihood.batches(2 * n)]
        volume, turned = (np.concatenate(one) for one in zip(*parts, strict=True))
        turned[np.arange(2 * n) % n >= m] = 0.0  # by noise H is scaled alone, which is no turn
        values = volume + turned
        return np.asarray((values[:n] - values[n:]) / (2.0 * STEP))

    def _log_volume(self, y: Array, turn: Array | None) -> tuple[Array, Array]:
        """Return log-volumes of machines (B, n) right where they stand, with that of coefficients; and -r H δ."""
        white, at = self.stand(y)  # whose H is that of a pose close by, the same for machines that are much alike
        theta, slope = self.theta(y), at.slope
        if not self.likelihood.is_near(theta).all():
            slope = self.likelihood.linearise(theta, at.pose, white)[1]
        there = Stand(at.pose, at.error, slope)
        volume = self.likelihood.log_volume(there, white).sum(axis=1)
        if turn is None:
            return volume, np.zeros(len(y))
        volume += white.log_det.sum(axis=1)
        for some, found in self._absorb(y, white, there):
            volume[some] += found.log_volume
        return volume, -np.einsum("bpkq,pkq->b", slope, turn)

    # --- climbing ------------------------------------------------------------------------------------------------

    def approach(self) -> Array:
        """Return the least-squares solution from the machine as expected, shape (n,)."""
        return self.fit(np.zeros(self.n_parameters), self.likelihood.start)[0]

    def polish(self, y: Array) -> Array:
        """Return y with the geometry that is best, by least squares, at its noise."""
        return self.fit(y, self.stand(y[None])[1].pose[0])[0]

    def anchored(self) -> CalibrationPosterior:
        """Return the same posterior that looks for poses from those of the least-squares solution."""
        y, pose = self.fit(np.zeros(self.n_parameters), self.likelihood.start)
        theta, white = self.theta(y[None])[0], self.likelihood.whiten(*self.deviations(y[None]))
        some = self._draw_near(y, pose, white)
        every = self.theta(some)
        near, exact = (
            replace(self, likelihood=self.likelihood.anchored(pose, theta, spread, white)) for spread in (every, None)
        )
        with np.errstate(all="ignore"):  # one of them may be no machine
            error = near.log_density(some) - exact.log_density(some)
        return replace(near, likelihood=near.likelihood.limited(every, error))

    def _draw_near(self, y: Array, pose: Array, white: Whitening) -> Array:
        """Return coordinates (N, n) thrice as far off the best ones (n,) as the posterior's, always the same."""
        with np.errstate(all="ignore"):
            _, slope, by_parameters = self.rows(y, white, pose[None])
            rows = project_out(slope) @ by_parameters
        # by orthogonal steps: of readings that are far off, squares of the rows have lost what the prior adds
        stacked = np.concatenate([np.nan_to_num(rows).reshape(-1, self.n_geometry), np.eye(self.n_geometry)])
        root = np.linalg.qr(stacked, mode="r")
        root *= np.sign(np.diag(root))[:, None]
        normal = np.random.default_rng(1777).standard_normal((self.n_geometry, NEARBY))
        some = np.repeat(y[None], NEARBY, axis=0)
        some[:, : self.n_geometry] += FAR * np.linalg.solve(root, normal).T
        return some

    def fit(self, y: Array, pose: Array) -> tuple[Array, Array]:
        """Return coordinates (n,) and poses (P, q) that explain readings and priors best, by Levenberg and Marquardt.

        Machine, poses and coefficients move together, the latter two eliminated from each step; what is unknown of the
        errors stays that of y.

        Raises
        ------
        NumericalError
            Where the machine does not stand at the start.
        """
        white, damping = self.likelihood.whiten(*self.deviations(y[None])), DAMPING
        columns = self._white_columns(y[None], white, self.likelihood)
        pose = np.broadcast_to(pose, (1, *pose.shape[-2:]))
        here = self.rows(y, white, pose)
        residual, cost = self._cost(y, here[0], columns)
        if not np.isfinite(cost):
            raise NumericalError("found no reading of the machine as expected at some start, expected one that stands")
        for _ in range(MAX_ITERATIONS):
            move, follow = self._propose(y, *here, columns[0], residual, damping)
            other = y.copy()
            other[: self.n_geometry] += move
            stood = self._settle(other, white, columns, pose + follow, damping)
            there = self.rows(other, white, stood)
            rest, new = self._cost(other, there[0], columns)
            if not new < cost:
                damping *= 4.0
                if damping > LARGEST_DAMPING or np.max(np.abs(move), initial=0.0) < STILL:
                    break
                continue
            done = cost - new < GAIN * max(cost, 1.0)
            y, pose, here, residual, cost, damping = other, stood, there, rest, new, damping / 3.0
            if done:
                break
        return y, pose[0]

    def _settle(self, y: Array, white: Whitening, columns: Array, pose: Array, damping: float) -> Array:
        """Return poses (1, P, q) moved to what a machine y (n,) reads: a constraint lets a straight step go no way."""
        error, slope, _ = self.likelihood.linearise(self.theta(y[None]), pose, white)
        residual, _ = self._cost(y, error[0], columns)
        return np.asarray(pose + left_of(invert(slope[0], 1e-9 * damping / DAMPING), residual))

    def _cost(self, y: Array, error: Array, columns: Array) -> tuple[Array, float]:
        """Return white errors (P, K) without what the best coefficients explain, and what all squares sum up to."""
        square, spare = float(y @ y), self.likelihood.n_spare
        if self.errors.has_columns:
            found = self._find(columns, error[None])
            error, square = found.residual[0], square + float(found.mean[0] @ found.mean[0])
        total = square + float(self.errors.outliers.penalise(np.einsum("pk,pk->p", error, error), spare).sum())
        return error, total if self.likelihood.model.layout.inside(self.theta(y[None]))[0] else np.nan

    def _propose(
        self,
        y: Array,
        error: Array,
        slope: Array,
        by_parameters: Array,
        columns: Array,
        residual: Array,
        damping: float,
    ) -> tuple[Array, Array]:
        """Return a damped step of the coordinates (m,) and the poses' (P, q) that follows."""
        m, square = self.n_geometry, np.einsum("pk,pk->p", residual, residual)
        trust = np.sqrt(self.errors.outliers.trust(square, self.likelihood.n_spare))
        # a little of the damping keeps poses that readings hardly tell from running away
        stiff = invert(slope, 1e-9 * damping / DAMPING)
        left = np.eye(slope.shape[1]) - slope @ stiff
        rows = trust[:, None, None] * (left @ by_parameters)
        right = trust[:, None] * left_of(left, error)
        normal = np.einsum("pki,pkj->ij", rows, rows, optimize=True) + np.eye(m)
        side = np.einsum("pki,pk->i", rows, right) - y[:m]
        acted = (trust[:, None, None] * (left @ columns)).reshape(right.size, -1)
        inner = np.eye(acted.shape[1]) + acted.T @ acted
        seen, told = acted.T @ rows.reshape(right.size, -1), acted.T @ right.ravel()
        normal -= seen.T @ np.linalg.solve(inner, seen)
        side -= seen.T @ np.linalg.solve(inner, told)
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), side)
        common = columns @ np.linalg.solve(inner, told - seen @ move)
        return move, left_of(stiff, error - by_parameters @ move - common)

    # --- what inference asks for besides ---------------------------------------------------------------------------

    def jumps(self, y: Array) -> list[tuple[int, Array]]:
        """Return each error that has a switch, switched on or off; no other mode is expected."""
        m = self.n_geometry
        return [(jump, np.concatenate([y[:m], zeta])) for jump, zeta in self.errors.jumps(y[m:])]

    def funnel_errors(self, y: Array) -> Array:
        """Return the noise of each group of channels over the stated one, (B, n) to (B, N), rms of its readings."""
        own, tau = self.deviations(y)
        there, square = self.likelihood.data.present, (own**2 + tau**2) / self.likelihood.sd**2
        mine = there * self.errors.groups(there.shape[1])[:, None]
        return np.sqrt(np.einsum("bpk,gpk->bg", square, mine) / np.maximum(mine.sum(axis=(1, 2)), 1))

    def groups(self) -> list[np.ndarray]:
        """Return all of the geometry as one group."""
        return [np.arange(self.n_geometry)]

    def curved_ridges(self) -> list[tuple[int, np.ndarray]]:
        """Return nothing: no coordinate is expected to have one."""
        return []

    def funnel(self, y: Array) -> Funnel | None:
        """Return how the geometry depends on the noise at y, shape (n,); None where that is known."""
        if not self.errors.has_noise:
            return None
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            _, slope, by_parameters = self.rows(y, white, at.pose)
        left, prior = project_out(slope), np.eye(self.n_geometry)
        trust = self.errors.outliers.trust(at.square, self.likelihood.n_spare)[0]
        rows = left @ by_parameters
        if self.errors.has_columns:  # JᵀS⁻¹J = Gᵀ(W⁻¹ + AAᵀ)G with G = S⁻¹J; the part with A does not hang on the noise
            columns = (left @ self._white_columns(y[None], white, self.likelihood)[0])[None]
            found = self._find(columns, at.error)
            reduced, trust = found.reduce(rows[None])[0], found.trust[0]
            acted = np.einsum("pku,pki->ui", found.columns[0], reduced, optimize=True)
            rows, prior = reduced / trust[:, None, None], prior + acted.T @ acted
        rows = np.sqrt(trust)[:, None, None] * rows
        # information is a sum over white readings, homogeneous in their precisions: each group's share is its readings'
        groups = self.errors.groups(rows.shape[1])
        parts = np.einsum("gk,pki,pkj->gij", groups, rows, rows, optimize=True)
        information, tau = parts.sum(axis=0), self.funnel_errors(y[None])[0]
        share = self._share_of_unknown(left, groups)
        parts /= share[:, None, None]
        known = (groups * self.errors.is_known(rows.shape[1])).any(axis=1)
        parts[known] = information - parts[~known].sum(axis=0)
        return Funnel(information, prior, np.maximum(tau**2 * (1.0 / share - 1.0), 1e-12), tau, parts)

    def _share_of_unknown(self, left: Array, groups: Array) -> Array:
        """Return how much of what groups of channels (N, K) are compared with has noise that is not known, shape (N,).

        What poses leave of reading k, Σ_l Π_kl r_l by a projection (P, K, K), has Π_kl² of its variance from reading l.
        Where readings are compared with some whose noise is known, their information does not grow beyond all bounds
        as their own noise vanishes.
        """
        there = self.likelihood.data.present
        known = there * self.errors.is_known(there.shape[1])
        from_known = np.einsum("gk,pkl,pl->g", groups * ~self.errors.is_known(there.shape[1]), left**2, known)
        every = np.einsum("gk,pkk,pk->g", groups, left, there.astype(np.float64))
        return np.maximum(1.0 - from_known / np.where(every > 0.0, every, 1.0), LEAST_SHARE)

    # --- what a fit is judged by -----------------------------------------------------------------------------------

    @cached_property
    def _alone(self) -> dict[int, CalibrationPosterior]:
        return {}

    def pointwise_of(self, y: Array, row: int) -> Array:
        """Return the log-likelihood of one pose's readings given all others, (B, n) to (B,)."""
        if self.errors.has_columns:
            return self.pointwise(y)[:, row]
        if row not in self._alone:
            self._alone[row] = replace(self, likelihood=self.likelihood.pick(np.array([row])))
        return self._alone[row].pointwise(y)[:, 0]

    def reduced_rows(self, y: Array) -> tuple[Array, Array]:
        """Return white residuals that no pose explains (P, K), and their derivatives (P, K, m + N), at y (n,).

        The derivatives are by the geometry, then by coefficients of errors common to all rows, which are standard
        normal under the prior. Poses that the density trusts less count less.
        """
        with np.errstate(all="ignore"):
            white, at = self.stand(y[None])
            error, slope, by_parameters = self.rows(y, white, at.pose)
            square = np.einsum("cpk,cpk->cp", *[self.residuals(y[None])] * 2)
            trust = np.sqrt(self.errors.outliers.trust(square, self.likelihood.n_spare)[0])
            left, common = project_out(slope), self._white_columns(y[None], white, self.likelihood)[0]
        rows = left @ np.concatenate([by_parameters, common], axis=-1)
        return trust[:, None] * left_of(left, error), trust[:, None, None] * rows

    def row_information(self, y: Array, row: int) -> Array:
        """Return what one pose's readings tell of the geometry at y, shape (m, m)."""
        rows = self.reduced_rows(y)[1][row, :, : self.n_geometry]
        return np.asarray(rows.T @ rows)

    def adopt(self, theta: Array, errors: Array) -> Array:
        """Return the coordinates of machines θ (M, D), brought within the priors' bounds, with those of errors."""
        uniform, width = self._uniform
        away = (theta - self.centre)[:, self._first] / width
        inside = ndtri(np.clip(away + 0.5, EDGE, 1.0 - EDGE))
        return np.concatenate([np.where(uniform, inside, away), errors], axis=1)
