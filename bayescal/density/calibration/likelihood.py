"""The density of readings with the poses eliminated, for every machine: rows free of the poses, errors afterwards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from bayescal.density.calibration.fixed_covariance import FixedCovarianceRows
from bayescal.density.calibration.independent_rows import IndependentRowsLikelihood
from bayescal.density.calibration.joint_fit import JointFit
from bayescal.density.calibration.poses import MANY_ROWS, PoseElimination, PoseEstimate
from bayescal.density.calibration.terms import CommonDraws, ErrorModel
from bayescal.density.components import LinearRows
from bayescal.density.elimination import Whitening, half_log_volume, invert, left_of, orthonormalise, project_out
from bayescal.density.low_rank import Coefficients, find_coefficients, split
from bayescal.density.posterior import Elimination, Posterior, Sampling, ScaleDependence
from bayescal.density.priors import Prior
from bayescal.density.sampling import build_sampling
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import Array
from bayescal.numerics.threads import map_in_threads

VOLUME_STEP = 1e-4  # of a coordinate, for the slope of the logarithms of volumes
NEARBY, FAR = 8, 3.0  # machines by which the density is tried about its anchor, and how many deviations they are off
GOOD = 0.1  # of what the log-density differs by among them: a fast form that is off by no more is good
ROUGH = 0.4  # the same of one that takes what rows have in common, where it is known, for each of them alone
CLOSE = 0.001  # the same of readings in no machine's own form, which have a density without it
FAR_NATS = 300.0  # below the anchor, from where such a form is not asked
MOST_TURNED = 0.5  # share of these for which slopes have to be near enough to the anchor's
LEAST_DIFFERENCE = 15.0  # nats that these count at least for: few parameters differ by less than errors of a matrix do
LEAST_SHARE = 1e-3  # of a variance, that an unknown noise is taken to have


@dataclass(frozen=True, eq=False)
class CalibrationLikelihood(PoseElimination, Elimination[Sampling, ErrorModel]):
    """Log-density of the readings of P poses under machines θ (B, D) and errors with coordinates ζ (B, k).

    ``frozen`` and ``lone``: fast forms of it about a machine that explains the readings, where errors are functions of
    the pose, and where each pose is by itself. ``straight``: whether coordinates are such that the machine's ridges are
    straight; those of each parameter by itself are standard normal under the prior. ``hidden``: whether errors that are
    functions of the pose may hide parameters, which coordinates then follow.
    """

    frozen: FixedCovarianceRows | None = None
    lone: IndependentRowsLikelihood | None = None
    straight: bool = True
    hidden: bool = True
    floor: float = -np.inf  # log-density below which machines are too far off for the fast form
    begin: Array | None = (
        None  # (D,): a machine near which that lies which explains the readings; None: the expected one
    )

    def pick(self, which: np.ndarray) -> Self:
        """Return the density of the readings of some poses, in no fast form."""
        return replace(super().pick(which), frozen=None, lone=None, floor=-np.inf)

    @property
    def layout(self) -> ParameterLayout:  # type: ignore[override]
        """Of θ."""
        return self.model.layout

    def sampling(
        self, priors: Mapping[str, Prior], fixed: Mapping[str, float], common: Mapping[str, tuple[str, ...]]
    ) -> Sampling:
        """Return each parameter by itself, or as the machine's ridges are straight; see `Elimination.sampling`."""
        straighten = partial(self.model.straighten, hidden=self.hidden) if self.straight else None
        return build_sampling(self.layout, priors, fixed, common, straighten)

    def begin_at(self, sampling: Sampling) -> Array:
        """Return the coordinates (m,) from which searches begin; see `Elimination.begin_at`."""
        return super().begin_at(sampling) if self.begin is None else sampling.to_coordinates(self.begin[None])[0]

    def noise(self, errors: ErrorModel, zeta: Array) -> tuple[Array, Array]:
        """Return f σ (B, P, K) and the root of the variances beside (B, 1 or P, K)."""
        return errors.noise(zeta, self.data, self.sd)

    def stand(self, theta: Array, white: Whitening, start: Array | None = None) -> PoseEstimate:
        """Return machines (C, D) where they explain the readings best; see `PoseElimination.stand`."""
        if self.lone is not None and start is None:
            return self.lone.stand(self, theta, white)
        return super().stand(theta, white, start)

    def read(self, theta: Array, pose: Array) -> Array:
        """Return the readings (C, P, K) of machines (C, D) at poses (C, P, q), or (P, q), near the measured ones."""
        if self.lone is not None:
            return self.lone.read(self, theta, pose)
        return self._near.read(theta[:, None], pose, self._given)

    def explain(self, theta: Array, errors: ErrorModel, zeta: Array) -> tuple[Whitening, PoseEstimate]:
        """Return the whitening, and where machines explain the readings best."""
        white = self.whiten(*self.noise(errors, zeta))
        return white, self.stand(theta, white)

    # --- density -------------------------------------------------------------------------------------------------

    def density(self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-likelihood, shape (B,); see `Elimination.density`."""
        total = self._weigh(theta, errors, zeta)
        far = np.flatnonzero(total < self.floor)
        if len(far):
            total[far] = self.whole._weigh(theta[far], errors, zeta[far])
        return total

    def _weigh(self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        if self._is_by_row(errors) or not errors.has_columns:
            return np.asarray(self._weigh_rows(theta, errors, zeta).sum(axis=1))
        total = np.empty(len(theta))
        if self.frozen is not None:
            for part in self.batches(len(theta), MANY_ROWS):
                total[part] = self.frozen.density(self, theta[part], errors, zeta[part])
            return total
        for part, white, at in self._explain_in_parts(theta, errors, zeta):
            rest = self.offset(white, at)
            for some, found in self._absorb(errors, zeta[part], white, at):
                weighed = errors.tails(zeta[part][some]).weigh(found.square, self.n_spare) + rest[some]
                total[part][some] = weighed.sum(axis=1) + found.penalty
        return total

    def _is_by_row(self, errors: ErrorModel) -> bool:
        """Whether each row counts by itself in the fast form."""
        single = not errors.has_columns or errors.is_common_known
        return self.lone is not None and self.frozen is None and single

    def density_by_row(self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-likelihood of each pose's readings given all others, shape (B, P)."""
        result = self._weigh_rows(theta, errors, zeta)
        far = np.flatnonzero(result.sum(axis=1) < self.floor) if np.isfinite(self.floor) else np.empty(0, dtype=int)
        if len(far):
            result[far] = self.whole._weigh_rows(theta[far], errors, zeta[far])
        return result

    def _weigh_rows(self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        result = np.empty((len(theta), self.data.n_poses))
        if self.frozen is not None:
            for part in self.batches(len(theta), MANY_ROWS):
                result[part] = self.frozen.density_by_row(self, theta[part], errors, zeta[part])
            return result
        if self.lone is not None and self._is_by_row(errors):
            for part in self.batches(len(theta), MANY_ROWS):
                result[part] = self.lone.density_by_row(self, theta[part], errors, zeta[part])
            return result

        def weigh(part: slice) -> None:
            white, at = self.explain(theta[part], errors, zeta[part])
            rest, tails = self.offset(white, at), errors.tails(zeta[part])
            if not errors.has_columns:
                result[part] = tails.weigh(at.square, self.n_spare) + rest
                return
            for some, found in self._absorb(errors, zeta[part], white, at):
                result[part][some] = rest[some] + found.condition_each(tails.pick(some), self.n_spare)

        map_in_threads(weigh, list(self.batches(len(theta))))
        return np.where(np.isfinite(result), result, -np.inf)

    @cached_property
    def _alone(self) -> dict[int, Self]:
        return {}

    def density_of_row(self, theta: Array, errors: ErrorModel, zeta: Array, row: int) -> Array:
        """Return the log-likelihood of one pose's readings given all others, shape (B,)."""
        if self.frozen is not None and errors.has_columns:
            parts = self.batches(len(theta), MANY_ROWS)
            return np.concatenate(
                [self.frozen.density_of_row(self, theta[part], errors, zeta[part], row) for part in parts]
            )
        if errors.has_columns:
            return super().density_of_row(theta, errors, zeta, row)
        if row not in self._alone:
            self._alone[row] = self.pick(np.array([row]))
        return self._alone[row].density_by_row(theta, errors, zeta)[:, 0]

    def density_of_others(self, other: Self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-density of each of Q other poses' readings given these, shape (B, Q)."""
        if not errors.has_columns:
            return other.density_by_row(theta, errors, zeta)
        if self.frozen is not None:
            known = self.frozen.density_of_others(self, other, theta, errors, zeta)
            if known is not None:
                return known
        result = np.empty((len(theta), other.data.n_poses))
        for part, white, at in self._explain_in_parts(theta, errors, zeta):
            beyond = other.whiten(*other.noise(errors, zeta[part]))
            there = other.stand(theta[part], beyond)
            for some, found in self._absorb(errors, zeta[part], white, at):
                own = zeta[part][some]
                columns = other.columns(errors, own, beyond.pick(some), there.slope[some])
                result[part][some] = found.condition_others(
                    there.error[some], columns, errors.tails(own), other.n_spare
                )
            result[part] += other.offset(beyond, there)
        return np.where(np.isfinite(result), result, -np.inf)

    def residuals(self, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return white residuals of the best poses and of the mean errors common to all rows, shape (B, P, K)."""
        white, at = self.explain(theta, errors, zeta)
        if not errors.has_columns:
            return at.error
        return np.concatenate([found.residual for _, found in self._absorb(errors, zeta, white, at)])

    def exact(self) -> Self | None:
        """Return the density that is not frozen; None where it is none.

        That of rows by themselves is close enough to be explored; `whole` corrects what was found.
        """
        return None if self.frozen is None else self.whole

    @property
    def whole(self) -> Self:
        """The density in no fast form, which leaves nothing out."""
        return replace(self, frozen=None, lone=None, floor=-np.inf)

    @property
    def plain(self) -> Self:
        """The same with each parameter by itself for a coordinate, standard normal under the prior."""
        return replace(self, straight=False)

    def _explain_in_parts(
        self, theta: Array, errors: ErrorModel, zeta: Array
    ) -> Iterator[tuple[slice, Whitening, PoseEstimate]]:
        """Yield machines that are looked at together, with whitening and where they explain readings best."""
        for part in self.batches(len(theta)):
            yield part, *self.explain(theta[part], errors, zeta[part])

    # --- errors common to all rows -------------------------------------------------------------------------------

    def columns(self, errors: ErrorModel, zeta: Array, white: Whitening, slope: Array) -> Array:
        """Return what coefficients do to white readings that are free of the poses, (B, P, K, N), for slopes H."""
        acted = self.white_columns(errors, zeta, white)
        with np.errstate(all="ignore"):
            axes = orthonormalise(slope)
            return np.asarray(acted - axes @ (np.swapaxes(axes, -1, -2) @ acted))

    def white_columns(self, errors: ErrorModel, zeta: Array, white: Whitening) -> Array:
        """Return what coefficients do to white readings at poses that stay, (B, P, K, N)."""
        return white.rows(np.where(self.data.present[..., None], errors.columns(zeta, self.data, self.error_gain), 0.0))

    def draw_common(
        self,
        theta: Array,
        errors: ErrorModel,
        zeta: Array,
        rng: np.random.Generator,
        known: tuple[Whitening, PoseEstimate] | None = None,
    ) -> CommonDraws:
        """Return draws of the errors common to all rows, one for each machine; ``known`` is what `explain` returns."""
        if not errors.has_columns:
            return CommonDraws(errors, ())
        if self.frozen is not None:
            return CommonDraws(errors, ((zeta, self.frozen.draw(self, theta, errors, zeta, rng)),))
        white, at = self.explain(theta, errors, zeta) if known is None else known
        absorbed = self._absorb(errors, zeta, white, at)
        return CommonDraws(errors, tuple((zeta[some], found.draw(rng)) for some, found in absorbed))

    def _absorb(
        self, errors: ErrorModel, zeta: Array, white: Whitening, at: PoseEstimate
    ) -> Iterator[tuple[slice, Coefficients]]:
        """Yield the coefficients of errors common to all rows given the readings, of machines worked on together."""
        n_columns = errors.columns(zeta[:1], self.data).shape[-1]
        (n_machines, n_poses, n_channels), signs = at.error.shape, errors.signs(self.data)
        for some in split(n_machines, n_poses, n_channels, n_columns):
            columns = self.columns(errors, zeta[some], white.pick(some), at.slope[some])
            tails = errors.tails(zeta[some])
            yield some, find_coefficients(at.error[some], columns, tails, self.n_spare, signs)

    # --- derivatives ---------------------------------------------------------------------------------------------

    def rows(self, theta: Array, change: Array, white: Whitening, pose: Array) -> tuple[Array, Array, Array]:
        """Return white errors (P, K), H (P, K, q) and derivatives of readings by coordinates (P, K, m) at θ (D,)."""
        error, slope, by_parameters = self.linearise(theta[None], pose, white, with_parameters=True)
        return error[0], slope[0], by_parameters[0] @ change

    def reduced_rows(self, theta: Array, change: Array, errors: ErrorModel, zeta: Array) -> tuple[Array, Array]:
        """Return white residuals that no pose explains (P, K), and their derivatives (P, K, m + N), at θ (D,), ζ (k,).

        The derivatives are by the geometry, then by coefficients of errors common to all rows, which are standard
        normal under the prior. Poses that the density trusts less count less.
        """
        with np.errstate(all="ignore"):
            white, at = self.explain(theta[None], errors, zeta[None])
            error, slope, by_parameters = self.rows(theta, change, white, at.pose)
            left, common = project_out(slope), self.white_columns(errors, zeta[None], white)[0]
            error, rows = left_of(left, error), left @ np.concatenate([by_parameters, common], axis=-1)
            if not errors.outliers.expected:
                return error, rows
            residual = self.residuals(theta[None], errors, zeta[None])
            trust = np.sqrt(
                errors.tails(zeta[None]).trust(np.einsum("cpk,cpk->cp", residual, residual), self.n_spare)[0]
            )
        return trust[:, None] * error, trust[:, None, None] * rows

    def inform(self, theta: Array, change: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the information of the data on the geometry's coordinates, shape (m, m)."""
        m, rows = change.shape[1], self.reduced_rows(theta, change, errors, zeta)[1]
        whole = np.einsum("pki,pkj->ij", rows, rows, optimize=True)
        across, inner = whole[m:, :m], whole[m:, m:]
        signs = errors.signs(self.data)
        prior = np.eye(len(inner)) if signs is None else np.diag(signs)
        return np.asarray(whole[:m, :m] - across.T @ np.linalg.solve(prior + inner, across))

    def inform_row(self, theta: Array, change: Array, errors: ErrorModel, zeta: Array, row: int) -> Array:
        """Return what one pose's readings tell of the geometry, shape (m, m)."""
        rows = self.reduced_rows(theta, change, errors, zeta)[1][row, :, : change.shape[1]]
        return np.asarray(rows.T @ rows)

    def differentiate(
        self, theta: Array, change: Array, errors: ErrorModel, zeta: Array, newton: bool
    ) -> tuple[Array, Array]:
        """Return gradient and Gauss and Newton's Hessian of the log-likelihood; see `Elimination.differentiate`.

        Exact but for differences of logarithms of volumes, and of how H turns.
        """
        del newton
        if self.lone is not None and self._is_by_row(errors):
            return self.lone.differentiate(self, theta, change, errors, zeta)
        with np.errstate(all="ignore"):
            white, at = self.explain(theta[None], errors, zeta[None])
            error, slope, by_parameters = self.rows(theta, change, white, at.pose)
            tails = errors.tails(zeta[None])
            trust = tails.trust(at.square, self.n_spare)[0]
            left = project_out(slope)
            rows, error = left @ by_parameters, left_of(left, error)
            weighed, found, turn = trust[:, None, None] * rows, None, None
            if errors.has_columns:
                acted = self.white_columns(errors, zeta[None], white)[0]
                signs = errors.signs(self.data)
                found = find_coefficients(error[None], (left @ acted)[None], tails, self.n_spare, signs)
                error, trust, weighed = found.residual[0], found.trust[0], found.reduce(rows[None])[0]
                follow = left_of(invert(slope, 0.0), acted @ found.mean[0])  # what coefficients make of the poses
                turn = (trust[:, None] * error)[..., None] * follow[:, None]
            m, n = change.shape[1], change.shape[1] + len(zeta)
            gradient, hessian = np.zeros(n), np.zeros((n, n))
            gradient[:m] = np.einsum("p,pki,pk->i", trust, rows, error)
            gradient[: n if found is not None else m] += self._volume_slope(
                theta, change, errors, zeta, white, slope, turn
            )
            hessian[:m, :m] = -np.einsum("pki,pkj->ij", rows, weighed, optimize=True)
            if n > m:
                by_errors, curvature = self._differentiate_by_errors(errors, zeta, white, left, error, trust, found)
                gradient[m:] += by_errors
                hessian[m:, m:] = -curvature
                by_own = tails.slopes(np.einsum("pk,pk->p", error, error)[None], self.n_spare)[0]
                own = slice(n - by_own.shape[1], n)
                gradient[own] += by_own.sum(axis=0)
                hessian[own, own] -= by_own.T @ by_own
        return gradient, hessian

    def _differentiate_by_errors(
        self,
        errors: ErrorModel,
        zeta: Array,
        white: Whitening,
        left: Array,
        error: Array,
        trust: Array,
        found: Coefficients | None,
    ) -> tuple[Array, Array]:
        """Return gradient (k,) and expected curvature (k, k) by what is unknown of the errors.

        Without logarithms of volumes where there are coefficients, ``found``.
        """
        there = self.data.present
        slopes = errors.covariance_slopes(zeta, self.data, self.sd, self.correlation, self.error_gain)
        slopes = np.where(there[:, :, None] & there[:, None, :], slopes, 0.0)
        both = white.rows(np.swapaxes(white.rows(slopes), -1, -2))
        seen = left @ both
        gradient = 0.5 * np.einsum("p,pk,npkl,pl->n", trust, error, both, error, optimize=True)
        curvature = 0.5 * np.einsum("npkl,oplk->no", seen, seen, optimize=True)
        if found is None:
            return gradient - 0.5 * np.trace(seen, axis1=-2, axis2=-1).sum(axis=-1), curvature
        acted = errors.column_slopes(zeta, self.data, self.error_gain)
        moved = left @ white.rows(np.where(there[..., None], acted, 0.0))
        gradient += np.einsum("p,pk,npku,u->n", trust, error, moved, found.mean[0], optimize=True)
        return gradient, curvature + found.inform(both, trust[:, None, None] * left @ both, moved)

    def _volume_slope(
        self,
        theta: Array,
        change: Array,
        errors: ErrorModel,
        zeta: Array,
        white: Whitening,
        slope: Array,
        turn: Array | None,
    ) -> Array:
        """Return the derivative of log-volumes by the coordinates at a white H, (m,); (m + k,) with coefficients.

        By the expansion where the density takes H from there, else by central differences. Coefficients move the poses
        by δ, to first order; residuals r change with H by -r dH δ, ``turn`` being r δ, (P, K, q).
        """
        m, k = change.shape[1], 0 if turn is None else len(zeta)
        if turn is None:
            by_parameters = self.differentiate_volume(theta, white, slope)
            if by_parameters is not None:
                return np.asarray(by_parameters @ change)
        n, moves = m + k, VOLUME_STEP * np.eye(m + k)
        both = np.concatenate([moves, -moves])
        machines = theta + both[:, :m] @ change.T
        noises = np.repeat(zeta[None], 2 * n, axis=0)
        noises[:, :k] += both[:, m:]
        parts = [self._log_volume(machines[part], errors, noises[part], white, turn) for part in self.batches(2 * n)]
        values = np.concatenate(parts)
        return np.asarray((values[:n] - values[n:]) / (2.0 * VOLUME_STEP))

    def _log_volume(
        self, theta: Array, errors: ErrorModel, zeta: Array, reference: Whitening, turn: Array | None
    ) -> Array:
        """Return log-volumes of machines where they explain readings best, (B,), with those of coefficients and -r H δ.

        The last is by H of a whitening that stays: as the noise changes H is scaled, which is no turn.
        """
        white, at = self.explain(theta, errors, zeta)
        near = self.expansion if self.is_near(theta).all() else None  # H of a pose close by for machines much alike
        raw = self.linearise_raw(theta, at.pose)[1] if near is None else near.predict(theta)[1]
        there = PoseEstimate(at.pose, at.error, white.rows(raw))
        volume = self.log_volume(there, white).sum(axis=1)
        if turn is None:
            return volume
        volume += white.log_det.sum(axis=1)
        for some, found in self._absorb(errors, zeta, white, there):
            volume[some] += found.log_volume
        return np.asarray(volume - np.einsum("bpkq,pkq->b", reference.rows(raw), turn))

    # --- search for the mode -------------------------------------------------------------------------------------

    def least_squares_start(self, sampling: Sampling, errors: ErrorModel) -> Array:
        """Return the least-squares solution from the machine as expected, shape (n,)."""
        return self._fit(sampling, errors)[0]

    def refine_geometry(self, sampling: Sampling, errors: ErrorModel, y: Array) -> Array:
        """Return y with the geometry that is best, by least squares, at its noise."""
        m = sampling.size
        theta, zeta = sampling.theta_from_y(y[None, :m]), y[None, m:]
        pose = self.explain(theta, errors, zeta)[1].pose[0]
        return np.append(JointFit(self, sampling, errors, y[m:]).run(y[:m], pose)[0], y[m:])

    def _fit(self, sampling: Sampling, errors: ErrorModel) -> tuple[Array, Array]:
        """Return coordinates (n,) and poses (P, q) of least squares, from the machine as expected."""
        zeta = np.zeros(errors.n_parameters)
        y, pose = JointFit(self, sampling, errors, zeta).run(self.begin_at(sampling), self.start)
        return np.append(y, zeta), pose

    def with_pose_guesses(self, sampling: Sampling, errors: ErrorModel) -> Self:
        """Return the same density that looks for poses from those of the least-squares solution."""
        alone = errors.without(errors.common) if errors.list_acts(self.data) else errors
        (y, pose), m = self._fit(sampling, alone if errors.is_common_known else errors), sampling.size
        theta, zeta = sampling.theta_from_y(y[None, :m])[0], np.zeros((NEARBY, alone.n_parameters))
        white = self.whiten(*self.noise(alone, zeta[:1]))
        every = sampling.theta_from_y(self._draw_near(sampling, y[:m], pose, white))
        near, exact = (self.anchored_at(pose, theta, spread, white) for spread in (every, None))
        with np.errstate(all="ignore"):  # one of them may be no machine
            error = near.density(every, alone, zeta) - exact.density(every, alone, zeta)
        found = near.limited(every, np.where(self.layout.inside(every), error, np.nan))
        frozen = FixedCovarianceRows.build(found, errors, theta)
        single = errors if errors.is_common_known else errors.without(errors.common)
        # where slopes turn with the machine chords lead nowhere, and poses cost derivatives
        nearby = found.expansion is not None and found.expansion.measure(every) <= found.expansion.limit
        turns = bool(np.mean(nearby) < MOST_TURNED)
        lone = IndependentRowsLikelihood.build(found, single, theta, turns=turns)
        whole = self.data.present.all()
        if frozen is None and lone is not None and (errors.has_factors or not whole):
            frozen = FixedCovarianceRows.build(found, errors, theta, single=True)
            lone = None if frozen is None else lone
        fast = replace(found, frozen=frozen, lone=lone, begin=theta)
        off = fast._find_roughness(every, errors)
        if lone is not None and lone.is_own and off > GOOD:  # slopes whose scale changes, or poses that go far
            other = replace(fast, lone=lone.followed)
            fast, off = min((fast, off), (other, other._find_roughness(every, errors)), key=lambda one: one[1])
        if lone is not None and not lone.is_own and off < CLOSE:
            here = fast.density(theta[None], errors, np.zeros((1, errors.n_parameters)))
            return replace(fast, floor=float(here[0]) - FAR_NATS)
        if lone is None or (lone.is_own and off < (ROUGH if errors.is_common_known else GOOD)):
            return fast
        return replace(fast, lone=None, frozen=None if frozen is not None and frozen.is_single else frozen)

    def _find_roughness(self, theta: Array, errors: ErrorModel) -> float:
        """Return by how much the fast form for single rows is off from what leaves nothing out, at machines (N, D).

        As a share of what these differ by: along ridges that bend they lie far off, and all is off by as much more.
        Of rows that functions have in common it is that by the stated noise alone, the least that they can have.
        """
        if self.lone is None:
            return 0.0
        fast = self
        if self.lone.is_own and self.frozen is not None and not self.frozen.is_single:
            fast, errors = replace(self, frozen=None), errors.without([*errors.noisy, *errors.common])
        at = theta, errors, np.zeros((len(theta), errors.n_parameters))
        with np.errstate(all="ignore"):
            whole = self.whole.density(*at)
            error = fast.density(*at) - whole
        good = np.isfinite(error)
        if not good.any():
            return 0.0
        off, differ = (float(np.median(np.abs(one[good] - np.median(one[good])))) for one in (error, whole))
        return off / max(differ, LEAST_DIFFERENCE)

    def _draw_near(self, sampling: Sampling, y: Array, pose: Array, white: Whitening) -> Array:
        """Return coordinates (N, m) thrice as far off the best ones (m,) as the posterior's, always the same."""
        theta = sampling.theta_from_y(y[None])[0]
        with np.errstate(all="ignore"):
            _, slope, by_parameters = self.rows(theta, sampling.jacobian(theta), white, pose[None])
            rows = project_out(slope) @ by_parameters
        # by orthogonal steps: of readings that are far off, squares of the rows have lost what the prior adds
        prior = sampling.prior_slope(sampling.jacobian(theta))
        stacked = np.concatenate([np.nan_to_num(rows).reshape(-1, len(y)), prior])
        root = np.linalg.qr(stacked, mode="r")
        root *= np.sign(np.diag(root))[:, None]
        normal = np.random.default_rng(1777).standard_normal((len(y), NEARBY))
        return np.asarray(y + FAR * np.linalg.solve(root, normal).T)

    # --- straightening -------------------------------------------------------------------------------------------

    def funnel_errors(self, errors: ErrorModel, zeta: Array) -> Array:
        """Return the noise of each group of channels over the stated one, (B, k) to (B, N), rms of its readings."""
        own, tau = self.noise(errors, zeta)
        there, square = self.data.present, (own**2 + tau**2) / self.sd**2
        mine = there * errors.groups(there.shape[1])[:, None]
        return np.sqrt(np.einsum("bpk,gpk->bg", square, mine) / np.maximum(mine.sum(axis=(1, 2)), 1))

    def linear_rows(self, sampling: Sampling, errors: ErrorModel, y: Array, cause: str = "") -> LinearRows | None:
        """Return rows as linear in the geometry about y, shape (n,); None where all of their noise is known.

        None, too, before a machine is known that explains the readings, where errors common to all rows are not frozen,
        and where rows may be outliers.
        """
        theta = sampling.theta_from_y(y[None, : sampling.size])
        change = sampling.jacobian(theta[0])
        if self.frozen is not None:
            return self.frozen.linear_rows(self, theta[0], change, errors, cause)
        if cause or self.expansion is None or errors.has_columns or errors.outliers.expected or not errors.noisy:
            return None
        if sampling.curved_ridges():  # which no closed form follows
            return None
        if self.lone is not None:
            return self.lone.linear_rows(self, theta[0], change, errors)
        _, at = self.explain(theta, errors, y[None, sampling.size :])
        error, slope, by_parameters = self.linearise_raw(theta, at.pose, with_parameters=True)
        both = np.concatenate([-by_parameters @ change, error[..., None]], axis=-1)

        def look(zeta: Array) -> tuple[Array, Array]:
            white = self.whiten(*self.noise(errors, zeta))
            by_pose, own = (white.rows(one) for one in (slope, both))
            rows = project_out(by_pose.reshape(-1, *by_pose.shape[2:])) @ own.reshape(-1, *own.shape[2:])
            rows = rows.reshape(len(zeta), -1, both.shape[-1])
            return np.swapaxes(rows, 1, 2) @ rows, (half_log_volume(by_pose) - white.log_det).sum(axis=-1)

        def square(zeta: Array) -> tuple[Array, Array]:
            parts = [look(zeta[part]) for part in self.batches(len(zeta))]
            return np.concatenate([one for one, _ in parts]), np.concatenate([one for _, one in parts])

        return LinearRows(np.zeros((sampling.size,) * 2), np.zeros(sampling.size), square)

    def scale_dependence(self, sampling: Sampling, errors: ErrorModel, y: Array) -> ScaleDependence | None:
        """Return how the geometry depends on the noise at y, shape (n,); None where that is known."""
        if not errors.noisy:
            return None
        m, zeta = sampling.size, y[None, sampling.size :]
        theta = sampling.theta_from_y(y[None, :m])
        with np.errstate(all="ignore"):
            white, at = self.explain(theta, errors, zeta)
            change = sampling.jacobian(theta[0])
            _, slope, by_parameters = self.rows(theta[0], change, white, at.pose)
        left, own = project_out(slope), sampling.prior_slope(change)
        prior = own.T @ own
        tails = errors.tails(zeta)
        trust = tails.trust(at.square, self.n_spare)[0]
        rows = left @ by_parameters
        # JᵀS⁻¹J = Gᵀ(W⁻¹ + AAᵀ)G with G = S⁻¹J; the part with A does not hang on the noise
        if errors.has_columns and not errors.is_common_known:
            columns = (left @ self.white_columns(errors, zeta, white)[0])[None]
            found = find_coefficients(at.error, columns, tails, self.n_spare, errors.signs(self.data))
            reduced, trust = found.reduce(rows[None])[0], found.trust[0]
            acted = np.einsum("pku,pki->ui", found.columns[0], reduced, optimize=True)
            rows, prior = reduced / trust[:, None, None], prior + acted.T @ acted
        rows = np.sqrt(trust)[:, None, None] * rows
        # information is a sum over white readings, homogeneous in their precisions: each group's share is its readings'
        groups = errors.groups(rows.shape[1])
        parts = np.einsum("gk,pki,pkj->gij", groups, rows, rows, optimize=True)
        information, tau = parts.sum(axis=0), self.funnel_errors(errors, zeta)[0]
        share = self._share_of_unknown(errors, left, groups)
        parts /= share[:, None, None]
        known = (groups * errors.is_known(rows.shape[1])).any(axis=1)
        parts[known] = information - parts[~known].sum(axis=0)
        return ScaleDependence(information, prior, np.maximum(tau**2 * (1.0 / share - 1.0), 1e-12), tau, parts)

    def _share_of_unknown(self, errors: ErrorModel, left: Array, groups: Array) -> Array:
        """Return how much of what groups of channels (N, K) are compared with has noise that is not known, shape (N,).

        What poses leave of reading k, Σ_l Π_kl r_l by a projection (P, K, K), has Π_kl² of its variance from reading l.
        Where readings are compared with some whose noise is known, their information does not grow beyond all bounds
        as their own noise vanishes.
        """
        there = self.data.present
        is_known = errors.is_known(there.shape[1])
        from_known = np.einsum("gk,pkl,pl->g", groups * ~is_known, left**2, there * is_known)
        every = np.einsum("gk,pkk,pk->g", groups, left, there.astype(np.float64))
        return np.maximum(1.0 - from_known / np.where(every > 0.0, every, 1.0), LEAST_SHARE)


type CalibrationPosterior = Posterior[CalibrationLikelihood, Sampling, ErrorModel]
"""The posterior of any machine, from its readings."""
