"""Readings whose errors are functions of the pose, by one covariance of all rows: fast where machines are much alike.

About a machine that explains the readings, H of the best poses hardly turns with the machine. With Z of orthonormal
columns that span what H leaves of a pose's white readings there, and poses flat along H,

    ∫ N(e; H v, R + A D Aᵀ) dv = N(Zᵀ e; 0, Zᵀ R Z + Zᵀ A D Aᵀ Z) |HᵀH|^(-1/2)

whatever the errors are that R and D stand for: rows Zᵀ e are free of the poses, and functions of one amplitude s add s²
times a matrix that is known a priori (`bayescal.density.components`). That costs one factorisation of all rows, where
columns cost those of all coefficients, which are more wherever smooth functions are allowed for.

Coefficients u of the errors given the rows are drawn by Matheron's rule: with u' and rows e' = A u' + ε' of the prior,

    u = u' + Aᵀ S⁻¹ (e - e'),    S = Zᵀ R Z + A Aᵀ.

Of many rows functions are of few columns (`bayescal.density.low_rank_covariance`), whose coefficients are drawn.

Without functions the covariance is one of single poses, which is how noise is seen that is known but for a factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from bayescal.density.calibration.model_error import GPTerm, LowRankGPTerm, RandomTerm
from bayescal.density.calibration.poses import MANY_ROWS
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.components import MOST_ROWS, LinearRows, assemble, batches
from bayescal.density.directions import list_directions
from bayescal.density.elimination import Whitening
from bayescal.density.linear_gaussian import (
    condition,
    factorise,
    half_log_det,
    invert,
    solve_factor,
    weigh,
    weigh_left_out,
    whiten,
)
from bayescal.density.low_rank_covariance import LowRankCovariance, LowRankFactor
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.density.calibration.likelihood import CalibrationLikelihood


@dataclass(frozen=True, eq=False)
class FixedCovarianceRows:
    """The density of readings about a machine, with errors whose columns have one amplitude each."""

    anchor: Array  # (D,): the machine
    white: Whitening  # by the stated noise, (1, P, K)
    left: Array  # (P, K, m): Z
    kept: np.ndarray  # (M,): which of all P m rows show something: those of channels that were not read do not
    # (M, N) each: what coefficients of each of C errors do to the rows at an amplitude of one; empty where functions
    # are of few columns
    shown: tuple[Array, ...]
    few: LowRankCovariance | None = None  # functions of few columns

    @cached_property
    def parts(self) -> Array:
        """What errors of an amplitude of one add to the rows' covariance, (C, M, M)."""
        return np.stack([one @ one.T for one in self.shown])

    @cached_property
    def _spots(self) -> tuple[np.ndarray, np.ndarray]:
        """Where numbers of the poses' blocks stand, of all (P m m), and where in a covariance of the rows, of (M M)."""
        n_poses, _, m = self.left.shape
        place = np.full(n_poses * m, -1)
        place[self.kept] = np.arange(len(self.kept))
        place = place.reshape(n_poses, m)
        row, column = place[:, :, None], place[:, None, :]
        there = (row >= 0) & (column >= 0)
        return np.flatnonzero(there), (row * len(self.kept) + column)[there]

    @cached_property
    def _products(self) -> Array:
        """Products of the columns of Z channel by channel, (P, K, m m)."""
        n_poses, n, m = self.left.shape
        return np.ascontiguousarray((self.left[..., :, None] * self.left[..., None, :]).reshape(n_poses, n, m * m))

    @property
    def is_single(self) -> bool:
        """Whether rows of a pose depend on none of another: there are no functions."""
        return not self.shown and self.few is None

    @property
    def is_whole(self) -> bool:
        """Whether all rows show something."""
        return len(self.kept) == self.left.shape[0] * self.left.shape[2]

    @classmethod
    def build(
        cls,
        likelihood: CalibrationLikelihood,
        errors: ErrorModel,
        theta: Array,
        *,
        whole: bool = False,
        single: bool = False,
    ) -> FixedCovarianceRows | None:
        """Return it about a machine (D,) for a density that starts where that explains the readings; None if it cannot.

        Rows of channels that were not read are left out unless the ``whole`` is asked for. ``single``: without
        functions, rows of single poses.

        It cannot where single rows may be outliers, where columns have more than an amplitude, and with too many rows
        unless all functions are of few columns.
        """
        data = likelihood.data
        n_poses, n = data.sd.shape
        thin = errors.terms_of(LowRankGPTerm)
        is_few = bool(thin) and len(thin) == len(errors.common)
        m = n - len(likelihood.model.coordinates)
        if errors.has_columns == single or errors.is_common_known or errors.outliers.expected or m < 1:
            return None
        n_rows = data.present.sum() - n_poses * (n - m)
        if not is_few and not single and n_rows > MOST_ROWS:  # before their columns are made
            return None
        acts = [] if is_few or single else errors.list_acts(data, likelihood.error_gain)
        if not acts and not is_few and not single:
            return None
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, n)))
        slope = likelihood.stand(theta[None], white).slope[0]
        if not np.isfinite(slope).all():
            return None
        size = np.linalg.norm(slope, axis=1, keepdims=True)
        axes, _ = np.linalg.qr(slope / np.where(size > 0.0, size, 1.0), mode="complete")
        left = np.ascontiguousarray(axes[..., slope.shape[-1] :])
        if single or is_few:  # what no channel shows stays: white by itself, it adds nothing
            left = left if data.present.all() else turn_to_present(left, data.present)[0]
            found = cls(theta, white, left, np.arange(n_poses * m), ())
            return found if single else replace(found, few=found._find_few(likelihood, errors, thin))
        kept = np.arange(n_poses * m)
        if not data.present.all():
            left, shows = turn_to_present(left, data.present)
            kept = kept if whole else np.flatnonzero(shows)
        if len(kept) > MOST_ROWS:
            return None
        turned = np.swapaxes(left, -1, -2)
        seen = (white.rows(np.where(data.present[..., None], act, 0.0)[None])[0] for act in acts)
        return cls(theta, white, left, kept, tuple((turned @ one).reshape(n_poses * m, -1)[kept] for one in seen))

    def density(self, likelihood: CalibrationLikelihood, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-likelihood, shape (B,), for machines (B, D) and coordinates of errors (B, k)."""
        if self.is_single:
            return np.asarray(self.density_by_row(likelihood, theta, errors, zeta).sum(axis=1))
        rows, rest = self._find_rows(likelihood, theta)
        total = rest.sum(axis=1)
        if self.few is not None:
            if _list_alone(errors) is not None:
                total += self.few.weigh(_list_variances(errors, zeta), rows)
            else:
                white = (self._factorise(self.few, likelihood, errors, one) for one in zeta)
                total += np.array([one.weigh(row) for one, row in zip(white, rows, strict=True)])
            return np.where(np.isfinite(total), total, -np.inf)
        for part in batches(len(theta), rows.shape[1]):
            own, weights = self._blocks(likelihood, errors, zeta[part]), errors.weights(zeta[part])
            total[part] += weigh(self._assemble(own, weights), rows[part])
        return np.where(np.isfinite(total), total, -np.inf)

    def density_by_row(self, likelihood: CalibrationLikelihood, theta: Array, errors: ErrorModel, zeta: Array) -> Array:
        """Return the log-likelihood of each pose's readings given all others, shape (B, P)."""
        rows, found = self._find_rows(likelihood, theta)
        if self.is_single:
            blocks = self._blocks(likelihood, errors, zeta)
            found += weigh(blocks, rows.reshape(blocks.shape[:-1]))
            return np.where(np.isfinite(found), found, -np.inf)
        if self.few is not None:
            for k, row in enumerate(rows):
                found[k] += self._factorise(self.few, likelihood, errors, zeta[k]).weigh_left_out(row)
            return np.where(np.isfinite(found), found, -np.inf)
        for part in batches(len(theta), rows.shape[1]):
            own, weights = self._blocks(likelihood, errors, zeta[part]), errors.weights(zeta[part])
            found[part] += self._weigh_left_out(self._assemble(own, weights), rows[part])
        return np.where(np.isfinite(found), found, -np.inf)

    def density_of_row(
        self, likelihood: CalibrationLikelihood, theta: Array, errors: ErrorModel, zeta: Array, pose: int
    ) -> Array:
        """Return the log-likelihood of one pose's readings given all others, shape (B,).

        Its rows stand last in the covariance: the last rows of a Cholesky factor are those given all before.
        """
        if self.few is not None:
            return self.density_by_row(likelihood, theta, errors, zeta)[:, pose]
        rows, rest = self._find_rows(likelihood, theta)
        mine = self.kept // self.left.shape[-1] == pose
        order, n = np.argsort(mine, kind="stable"), np.count_nonzero(mine)
        found = rest[:, pose].copy()
        for part in batches(len(theta), rows.shape[1]) if n else ():
            own, weights = self._blocks(likelihood, errors, zeta[part]), errors.weights(zeta[part])
            factor = factorise(self._assemble(own, weights)[:, order[:, None], order])
            white = solve_factor(factor, rows[part][:, order, None])[:, -n:, 0]
            found[part] -= half_log_det(factor[:, -n:, -n:]) + 0.5 * np.einsum("bi,bi->b", white, white)
        return np.where(np.isfinite(found), found, -np.inf)

    def density_of_others(
        self,
        likelihood: CalibrationLikelihood,
        other: CalibrationLikelihood,
        theta: Array,
        errors: ErrorModel,
        zeta: Array,
    ) -> Array | None:
        """Return the log-density of each of Q other poses' readings given these, (B, Q); None where it cannot.

        Given the rows others are normal about C S⁻¹ e with the covariance that they have less C S⁻¹ Cᵀ.
        """
        beyond = FixedCovarianceRows.build(other, errors, self.anchor, whole=True)
        if beyond is None:
            return None
        rows, rest = self._find_rows(likelihood, theta)
        there, found = beyond._find_rows(other, theta)
        found[~np.isfinite(rest).all(axis=1)] = -np.inf
        if self.few is not None and beyond.few is not None:
            for k, row in enumerate(rows):
                white = self._factorise(self.few, likelihood, errors, zeta[k])
                expected, spread = white.predict(row, beyond.few.shown, beyond.few.basis)
                own = beyond._blocks(other, errors, zeta[k : k + 1])[0] + spread
                found[k] += weigh(own, there[k].reshape(expected.shape) - expected)
            return np.where(np.isfinite(found), found, -np.inf)
        n_poses, m = other.data.n_poses, beyond.left.shape[-1]
        across = np.stack([one @ two.T for one, two in zip(beyond.shown, self.shown, strict=True)])
        by_pose = [one.reshape(n_poses, m, -1) for one in beyond.shown]
        inner = np.stack([one @ np.swapaxes(one, -1, -2) for one in by_pose])
        for part in batches(len(theta), rows.shape[1] + there.shape[1]):
            weights = errors.weights(zeta[part])
            total = self._assemble(self._blocks(likelihood, errors, zeta[part]), weights)
            shared = np.tensordot(weights, across, 1)
            given = condition(total, rows[part, :, None], 0.0)  # others are C S⁻¹ e, less C S⁻¹ Cᵀ
            mean, told = given.predict(shared.reshape(len(weights), n_poses, m, -1))
            own = beyond._blocks(other, errors, zeta[part]) + np.tensordot(weights, inner, 1) - told
            found[part] += weigh(own, there[part].reshape(mean.shape[:-1]) - mean[..., 0])
        return np.where(np.isfinite(found), found, -np.inf)

    def draw(
        self,
        likelihood: CalibrationLikelihood,
        theta: Array,
        errors: ErrorModel,
        zeta: Array,
        rng: np.random.Generator,
    ) -> Array:
        """Return draws of the coefficients of all errors given the rows, one for each machine, shape (B, N)."""
        if self.few is not None:
            every = list[Array]()
            for part in likelihood.batches(len(theta), MANY_ROWS):
                rows, _ = self._find_rows(likelihood, theta[part])
                normal = rng.standard_normal((len(rows), self.few.n_columns))
                thin = (self._factorise(self.few, likelihood, errors, one) for one in zeta[part])
                every += [one.draw(*own) for one, *own in zip(thin, rows, normal, strict=True)]
            # from channel by channel to error by error
            return np.stack(every)[:, np.argsort(np.tile(self.few.sorts, len(self.few.basis)), kind="stable")]
        rows, _ = self._find_rows(likelihood, theta)
        ends = np.cumsum([one.shape[1] for one in self.shown])
        n_poses, _, m = self.left.shape
        drawn, noise = rng.standard_normal((len(theta), ends[-1])), rng.standard_normal((len(theta), n_poses, m, 1))
        for part in batches(len(theta), rows.shape[1]):
            own, amplitudes = self._blocks(likelihood, errors, zeta[part]), errors.amplitudes(zeta[part])
            weights, each = errors.weights(zeta[part]), np.split(drawn[part], ends[:-1], axis=1)  # views of ``drawn``
            is_known = [term.is_known for term in errors.common]
            left, known = rows[part].copy(), list[Array]()
            if errors.known:  # noise that they depend on is drawn with them
                apart = self._assemble(own, weights * is_known)
                flat = noise[part].reshape(len(own), -1, 1)[:, self.kept]
                drawn_apart, known = self._draw_known(errors, apart, flat, each)
                left -= drawn_apart
            else:
                left -= (np.linalg.cholesky(own) @ noise[part]).reshape(len(own), -1)[:, self.kept]
            for k, shown in enumerate(self.shown):
                if not is_known[k]:
                    left -= amplitudes[:, k, None] * (each[k] @ shown.T)
            told = np.linalg.solve(self._assemble(own, weights), left[..., None])[..., 0]
            for k, term in enumerate(errors.common):
                if not is_known[k]:
                    each[k] += amplitudes[:, k, None] * (told @ self.shown[k])
                elif term.sign > 0.0:
                    each[k][:] = known.pop(0) + told @ self.shown[k]
                else:
                    each[k][:] = 0.0
        return drawn

    def _draw_known(
        self, errors: ErrorModel, covariance: Array, flat: Array, each: list[Array]
    ) -> tuple[Array, list[Array]]:
        """Return draws of what rows have beside functions, (B, M), and of known errors' coefficients given these.

        Parameters
        ----------
        errors : Errors
        covariance : ndarray, shape (B, M, M)
            Of the rows without functions.
        flat : ndarray, shape (B, M, 1)
            Standard normal numbers.
        each : list of ndarray, shapes (B, N)
            The same for the coefficients of each term.
        """
        factor, found = np.linalg.cholesky(covariance), list[Array]()
        for term, shown, own in zip(errors.common, self.shown, each, strict=True):
            if term.is_known and term.sign > 0.0:
                turned = np.linalg.solve(factor, np.broadcast_to(shown, (len(factor), *shown.shape)))
                back = np.swapaxes(turned, -1, -2)
                rest = np.linalg.cholesky(np.eye(turned.shape[-1]) - back @ turned)
                found.append((back @ flat + rest @ own[..., None])[..., 0])
        return (factor @ flat)[..., 0], found

    def _find_rows(self, likelihood: CalibrationLikelihood, theta: Array) -> tuple[Array, Array]:
        """Return rows (B, M), and what log-densities have beside theirs, (B, P); -inf where there is no machine."""
        if likelihood.lone is not None:
            bound, rest = likelihood.lone.find_white(theta)
            rows = self._take(bound.reshape(len(theta), -1))
        else:
            white = self.white.repeat(len(theta))
            at = likelihood.stand(theta, white)
            rows = self._take(np.swapaxes(np.swapaxes(at.error, 0, 1) @ self.left, 0, 1).reshape(len(theta), -1))
            rest = likelihood.offset(white, at)
        rest = rest - 0.5 * np.log(2.0 * np.pi) * likelihood.n_spare
        good = np.isfinite(rows).all(axis=1) & np.isfinite(rest).all(axis=1)
        return np.where(good[:, None], rows, 0.0), np.where(good[:, None], rest, -np.inf)

    def linear_rows(
        self, likelihood: CalibrationLikelihood, theta: Array, change: Array, errors: ErrorModel, cause: str = ""
    ) -> LinearRows | None:
        """Return rows about a machine (D,) with dθ/dy (D, m) as linear in the geometry, and in a cause's directions."""
        at = likelihood.stand(theta[None], self.white)
        error, _, by_parameters = likelihood.rows(theta, change, self.white, at.pose)
        left = np.swapaxes(self.left, -1, -2)
        residual = (left @ error[..., None]).ravel()[self.kept]
        slope = -(left @ by_parameters).reshape(left.shape[0] * left.shape[1], -1)[self.kept]
        if cause:
            shown = self._show_directions(likelihood, errors, cause, at.pose[0])
            if shown is None:
                return None
            slope = np.concatenate([slope, shown], axis=1)
        m = slope.shape[1]

        both, none = np.column_stack([slope, residual]), (np.zeros((m, m)), np.zeros(m))
        few = self.few
        whole = few.square(both) if few is not None and _list_alone(errors) is not None else None

        def square(zeta: Array) -> tuple[Array, Array]:
            if self.is_single:
                return self._square_single(likelihood, errors, zeta, both)
            if whole is not None:
                found = [whole(one) for one in _list_variances(errors, zeta)]
            elif few is not None:
                found = [self._factorise(few, likelihood, errors, one).square(both) for one in zeta]
            else:
                found = list[tuple[Array, float]]()
                for part in batches(len(zeta), len(both)):
                    own, weights = self._blocks(likelihood, errors, zeta[part]), errors.weights(zeta[part])
                    white, volume = whiten(self._assemble(own, weights), both)
                    found += zip(np.swapaxes(white, -1, -2) @ white, volume, strict=True)
            return np.stack([one for one, _ in found]), np.array([half_log_det for _, half_log_det in found])

        return LinearRows(*none, square)

    def _square_single(
        self, likelihood: CalibrationLikelihood, errors: ErrorModel, zeta: Array, both: Array
    ) -> tuple[Array, Array]:
        """Return XᵀS⁻¹X of rows X (M, n) at ζ (B, k), (B, n, n), and ½ log |S|, where poses are by themselves."""
        squares, volumes = list[Array](), list[Array]()
        for part in likelihood.batches(len(zeta)):
            blocks = self._blocks(likelihood, errors, zeta[part])
            by_pose = both.reshape(*blocks.shape[1:3], -1)
            white, volume = whiten(blocks, np.broadcast_to(by_pose, (len(blocks), *by_pose.shape)))
            rows = white.reshape(len(white), -1, both.shape[-1])
            squares.append(np.swapaxes(rows, 1, 2) @ rows)
            volumes.append(volume.sum(axis=1))
        return np.concatenate(squares), np.concatenate(volumes)

    def _show_directions(
        self, likelihood: CalibrationLikelihood, errors: ErrorModel, cause: str, pose: Array
    ) -> Array | None:
        """Return what a named cause's directions do to the rows, (M, A), at poses (P, q); None where it has none."""
        model, data = likelihood.model, likelihood.data
        functions = errors.terms_of(GPTerm)
        if not functions:
            return None
        own = functions[0].own
        angles = np.array([one.unit == "rad" for one in model.coordinates], dtype=bool)
        travel = own.place_of(data).travel * ~own.covered.diagonal()
        columns = list_directions(cause, pose - model.home_pose, angles, travel)
        if columns is None:
            return None
        act = np.zeros((*data.sd.shape, columns.shape[-1]))
        act[:, own.places] = columns / own.levers[:, None]
        act = act if likelihood.error_gain is None else likelihood.error_gain @ act
        seen = self.white.rows(np.where(data.present[..., None], act, 0.0)[None])[0]
        return (np.swapaxes(self.left, -1, -2) @ seen).reshape(-1, columns.shape[-1])[self.kept]

    # --- rows of channels that were read -------------------------------------------------------------------------

    def _take(self, rows: Array) -> Array:
        """Return the rows that show something, (B, P m) to (B, M)."""
        return rows if self.is_whole else rows[:, self.kept]

    def _assemble(self, own: Array, weights: Array) -> Array:
        """Return the rows' covariance (B, M, M) of the poses' blocks (B, P, m, m) and weights (B, C) of the parts."""
        if self.is_whole:
            return assemble(own, self.parts, weights)
        size, (source, target) = len(self.kept), self._spots
        total = np.asarray(weights @ self.parts.reshape(len(self.parts), -1))
        total[:, target] += own.reshape(len(own), -1)[:, source]
        return total.reshape(-1, size, size)

    def _weigh_left_out(self, covariance: Array, rows: Array) -> Array:
        """Return log-densities of each pose's rows given all others', (B, P), of covariances (B, M, M), used up.

        Rows (B, M) that show nothing are zero and white beside.
        """
        (n_poses, _, m), n, (source, target) = self.left.shape, len(rows), self._spots
        pull, precision = np.zeros((n, n_poses * m)), np.tile(np.eye(m).ravel(), (n, n_poses))
        inverse, pull[:, self.kept] = invert(covariance, rows)
        precision[:, source] = inverse.reshape(n, -1)[:, target]
        return weigh_left_out(precision.reshape(n, n_poses, m, m), pull.reshape(n, n_poses, m))

    # --- functions of few columns --------------------------------------------------------------------------------

    def _find_few(
        self, likelihood: CalibrationLikelihood, errors: ErrorModel, thin: Sequence[LowRankGPTerm]
    ) -> LowRankCovariance:
        """Return functions of few columns beside errors of single rows, each of a variance of its own, that add up.

        Where other noise is unknown, too, D is not made of these: then nothing is left out here, but in that noise.
        """
        data, own, (n_poses, n) = likelihood.data, thin[0].own, likelihood.data.sd.shape
        acts = np.zeros((n, len(own.places)))
        acts[own.places, np.arange(len(own.places))] = 1.0 / own.levers
        gained = acts if likelihood.error_gain is None else likelihood.error_gain @ acts
        seen = self.white.rows(np.where(data.present[..., None], gained, 0.0)[None])[0]
        shown, m = np.swapaxes(self.left, -1, -2) @ seen, self.left.shape[-1]
        alone = _list_alone(errors)
        by_term = [shown * one.channels[own.places] for one in alone or ()]
        blocks = np.array([one @ np.swapaxes(one, -1, -2) for one in by_term]).reshape(-1, n_poses, m, m)
        bases = [one.find_basis(data) for one in thin]
        return LowRankCovariance(
            np.broadcast_to(np.eye(m), (n_poses, m, m)),
            blocks,
            shown,
            np.concatenate(bases, axis=-1),
            np.repeat(np.arange(len(thin)), [one.shape[-1] for one in bases]),
            np.array([0.0 if alone is None else one.left for one in thin]),
        )

    def _factorise(
        self, few: LowRankCovariance, likelihood: CalibrationLikelihood, errors: ErrorModel, zeta: Array
    ) -> LowRankFactor:
        """Return the rows' covariance at coordinates (k,) of the errors."""
        if _list_alone(errors) is not None:
            return few.factorise(_list_variances(errors, zeta[None])[0])
        return few.factorise_beside(self._blocks(likelihood, errors, zeta[None])[0], errors.amplitudes(zeta) ** 2)

    def _blocks(self, likelihood: CalibrationLikelihood, errors: ErrorModel, zeta: Array) -> Array:
        """Return Zᵀ R Z of coordinates (B, k), shape (B, P, m, m)."""
        there = likelihood.data.present
        own, tau = likelihood.noise(errors, zeta)
        if self.white.matrix is None:
            ratio = np.where(there, (own**2 + tau**2) / likelihood.sd**2, 1.0)
            products = np.swapaxes(np.swapaxes(ratio, 0, 1) @ self._products, 0, 1)
            return products.reshape(*ratio.shape[:2], *2 * self.left.shape[-1:])
        covariance = own[..., :, None] * likelihood.correlation * own[..., None, :]
        gain = likelihood.error_gain
        spread = tau[..., None, :] * (np.eye(there.shape[1]) if gain is None else gain)
        covariance = covariance + spread @ np.swapaxes(spread, -1, -2)
        white = self.white.rows(np.swapaxes(self.white.rows(covariance), -1, -2))
        both = there[:, :, None] & there[:, None, :]
        white = np.where(both, white, np.eye(there.shape[1]))  # of what was not read nothing is known
        return np.asarray(np.swapaxes(self.left, -1, -2) @ white @ self.left)


def turn_to_present(left: Array, present: np.ndarray) -> tuple[Array, np.ndarray]:
    """Return the span of Z (P, K, m) by columns of channels that were read, (P, K), or not, and which were, (P, m)."""
    missing = np.where(present[..., None], 0.0, left)
    share, axes = np.linalg.eigh(np.swapaxes(missing, -1, -2) @ missing)
    return np.ascontiguousarray(left @ axes), share < 1.0 - 1e-9


def _list_alone(errors: ErrorModel) -> list[RandomTerm] | None:
    """Return the errors of single rows where they are all that is unknown of the noise; None where there is more."""
    found = errors.terms_of(RandomTerm)
    return found if len(errors.noisy) == len(found) + len(errors.terms_of(LowRankGPTerm)) else None


def _list_variances(errors: ErrorModel, zeta: Array) -> Array:
    """Return variances of these errors, then of functions, (B, G + C), at coordinates (B, k)."""
    own = [term.square(part) for term, part in errors.parts_of(RandomTerm, zeta)]
    return np.column_stack([*own, errors.amplitudes(zeta) ** 2])
