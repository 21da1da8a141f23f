"""How well readings fit a machine if something has happened to them: one linearised residual model of any machine.

Readings s (P, K) with the poses eliminated are rows e = Zᵀ (s - h) (see `bayescal.density.sessions`). About a machine

    e = -G y + Zᵀ B u + ε,    y ~ N(0, 1),   u ~ N(0, τ²),   ε ~ N(0, C),

G the slope by the parameters in their tolerances, B (P, K, k) what a cause does to readings, in k unknowns as large as
the data say: the density is maximal over τ, and pays for having been asked at so many. A parameter whose tolerance is f
times too tight is a column of G once more, τ² = f² - 1. A noise is a factor on C, a row that does not belong is left
out, and what was read otherwise is another table: all are weighed by the same log-density of the readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.model_error import GPTerm
from bayescal.density.calibration.poses import search_poses
from bayescal.density.components import MOST_ROWS, assemble, batches
from bayescal.density.linear_gaussian import condition, condition_white, whiten
from bayescal.density.low_rank import gather_columns
from bayescal.density.pose_kernels import DRIFT
from bayescal.density.sessions import LinearisedRows, ReadingRows
from bayescal.errors import BayescalError
from bayescal.experiments.shared.slip_products import (
    RowProducts,
    ScaledErrors,
    choose_factor,
    choose_size,
    scale_columns,
)
from bayescal.machines.readings import Channel, ReadingModel
from bayescal.numerics.geometry import Array

WIDER = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 40.0, 100.0)
"""Factors on a tolerance that is too tight."""
NARROWER = (0.02, 0.04, 0.07, 0.1, 0.14, 0.2, 0.3, 0.5)
"""The same of one that is too wide."""
WIDE_PRIOR_SD = 1e5
ROW_PENALTY_NAT = float(np.log(1e3))  # nats per reading of a row that is left out
OUTLYING = 10.0
"""Rms of a row in units of the median, beyond which the others are fitted without it."""
STARTS, SPREAD = 9, 0.6  # poses of the workspace from which others are looked for, in its half widths
TURN = 2.0 * float(np.pi)
MOST_KEPT = 8  # products by covariances of single rows
MOST_HELD = 2**20  # numbers of products that are held together, 8 MB


@dataclass(frozen=True, eq=False)
class RowReadings:
    """Readings (Q, K) of some of the rows, NaN where nothing was read, and channels that are taken otherwise.

    ``circular`` ones are compared on a circle; ``vague`` ones may read anything: their noise is `WIDE_PRIOR_SD`
    times as large. ``given`` has what is given of the rows, (Q,) each, where that is taken otherwise.
    """

    values: Array
    rows: np.ndarray  # (Q,): which of the study's
    circular: tuple[int, ...] = ()
    vague: tuple[int, ...] = ()
    log_volume: float = 0.0  # of the change, for densities of changed readings to be compared
    given: Mapping[str, Array] = field(default_factory=dict)

    def pick(self, some: np.ndarray) -> RowReadings:
        """Return some of its rows, by a mask over the study's rows."""
        here = some[self.rows]
        share = float(here.mean()) if len(here) else 0.0
        given = {name: value[here] for name, value in self.given.items()}
        volume = share * self.log_volume
        return replace(self, values=self.values[here], rows=self.rows[here], log_volume=volume, given=given)


@dataclass(frozen=True, eq=False)
class LinearisedTable:
    """Rows of a table about a machine y (m,), and where it stands, (Q, q)."""

    rows: np.ndarray
    linear: LinearisedRows
    slope: Array  # (Q, R, m): -G
    errors: Array  # (Q, R): as those of the machine as expected, to first order
    stands: np.ndarray  # (Q,): which rows have a pose and more readings than it takes
    n_spare: np.ndarray  # (Q,): readings more than a pose takes
    pose: Array
    log_volume: float
    shared: ScaledErrors | None = None  # errors common to all rows; none where one has no single amplitude
    kept: dict[str, tuple[object, Array]] = field(default_factory=dict)
    # products by covariances of single rows, and columns
    sums: dict[tuple[int, bytes], tuple[Array, float, int, Array | None]] = field(default_factory=dict)

    @cached_property
    def is_dense(self) -> bool:
        """Whether errors common to all rows are so many that all rows together have a covariance."""
        n_rows, width = self.errors.size, 0 if self.shared is None else int(self.shared.widths.sum())
        return n_rows <= MOST_ROWS and width > 0 and width >= n_rows / 2

    @property
    def at_once(self) -> int:
        """How many sizes of errors are looked at at once."""
        if self.shared is None:
            return 1
        width = self.slope.shape[-1] + (0 if self.is_dense else int(self.shared.widths.sum()))
        return max(1, MOST_HELD // (width + 1) ** 2)

    @property
    def lost(self) -> np.ndarray:
        """Which rows have readings enough, but no pose, (Q,)."""
        return np.asarray(~self.stands & (self.n_spare > 0))

    def split(self, tables: list[RowReadings]) -> list[LinearisedTable]:
        """Return the rows of several tables that were seen one below the other."""
        ends = np.cumsum([0, *(len(one.rows) for one in tables)])
        found = []
        for one, start, end in zip(tables, ends[:-1], ends[1:], strict=True):
            part, linear = slice(int(start), int(end)), self.linear

            def covariance(zeta: Array, factor: Array | float = 1.0, part: slice = part) -> Array:
                key = (zeta.tobytes(), np.asarray(factor).tobytes())
                every = self._keep("covariance", key, lambda: self.linear.covariance(zeta, factor))
                return every[..., part, :, :]

            def common(zeta: Array, part: slice = part) -> Array:
                return self.common(zeta)[part]

            arrays = (linear.errors, linear.slope, linear.constant, linear.basis, linear.left)
            errors, slope, constant, basis, left = (array[part] for array in arrays)
            own = LinearisedRows(errors, slope, constant, covariance, basis, left, common)
            each = {name: getattr(self, name)[part] for name in ("slope", "errors", "stands", "n_spare", "pose")}
            if self.shared is not None:
                each["shared"] = self.shared.pick(part)
            found.append(LinearisedTable(one.rows, own, log_volume=one.log_volume, **each))
        return found

    def _keep(self, what: str, key: object, make: Callable[[], Array]) -> Array:
        """Return what is made of errors, kept for the last ones that were asked for."""
        if what not in self.kept or self.kept[what][0] != key:
            self.kept[what] = (key, make())
        return self.kept[what][1]

    def common(self, zeta: Array) -> Array:
        """Return the columns of errors common to all rows, (Q, R, N)."""
        list_columns = self.linear.common if self.shared is None else self.shared.list_columns
        return self._keep("common", zeta.tobytes(), lambda: list_columns(zeta))

    def share(self, other: LinearisedTable, zeta: Array) -> tuple[Array, Array]:
        """Return the fewest columns of errors common to all rows of this and of another table, of both."""
        both = gather_columns(np.concatenate([self.common(zeta), other.common(zeta)]))
        return both[: len(self.rows)], both[len(self.rows) :]

    def whiten(
        self, zeta: Array, factor: Array | float = 1.0, columns: Array | None = None, common: Array | None = None
    ) -> WhitenedRows:
        """Return them white by errors ζ and factors (K,) on the stated noise, with columns (P, K, c) of all rows.

        Errors common to all rows are the fewest columns, or others (Q, R, N) of the same covariance.
        """
        if common is None:
            common = self._keep("fewest", zeta.tobytes(), lambda: gather_columns(self.common(zeta)))
        shown = np.zeros((*self.errors.shape, 0)) if columns is None else self.linear.left @ columns[self.rows]
        every = np.concatenate([-self.slope, common, shown, self.errors[..., None]], axis=-1)
        every = np.where(self.stands[:, None, None], every, 0.0)
        covariance = np.where(self.stands[:, None, None], self.linear.covariance(zeta, factor), np.eye(every.shape[1]))
        white, volume = whiten(covariance, every)
        constant = self._penalise(np.where(self.stands, self.linear.constant, 0.0) - volume)
        known = self.slope.shape[-1] + common.shape[-1]
        return WhitenedRows(white, constant, known, self.log_volume, *self._count())

    def multiply(self, zeta: Array, factor: Array | float = 1.0, columns: Array | None = None) -> RowProducts:
        """Return products of the white rows by B errors ζ (B, n) and factors (B, K) on the stated noise.

        With columns (P, K, c) of all rows. Errors common to all rows are among what is known, or in the covariance.
        """
        n, r = self.errors.shape
        if self.shared is None or (not self.is_dense and self.shared.widths.sum() > n * r):
            return self._multiply_each(zeta, factor, columns)
        shown = np.zeros((n, r, 0)) if columns is None else self.linear.left @ columns[self.rows]
        acts = () if self.is_dense else self.shared.acts
        every = np.concatenate([-self.slope, *acts, shown, self.errors[..., None]], axis=-1)
        every = np.where(self.stands[:, None, None], every, 0.0)
        if self.is_dense:
            return self._multiply_together(self.shared, zeta, factor, every)
        return self._multiply_by_row(self.shared, zeta, factor, every, columns)

    def weigh(self, zeta: Array, factor: Array) -> Array:
        """Return the log-densities (B,) without any cause; see `multiply`."""
        parts = [slice(k, k + self.at_once) for k in range(0, len(zeta), self.at_once)]
        return np.concatenate([self.multiply(zeta[one], factor[one]).weigh() for one in parts])

    def _multiply_each(self, zeta: Array, factor: Array | float, columns: Array | None) -> RowProducts:
        factors = factor if isinstance(factor, np.ndarray) else [factor] * len(zeta)
        whites = [self.whiten(*one, columns) for one in zip(zeta, factors, strict=True)]
        gram, size = np.stack([one.products for one in whites]), np.stack([one.size for one in whites])
        constant = np.array([one.constant.sum() for one in whites]) + self.log_volume
        return RowProducts(gram, constant, whites[0].known, size)

    def _multiply_together(self, shared: ScaledErrors, zeta: Array, factor: Array | float, every: Array) -> RowProducts:
        """Return products of rows (Q, R, m + c + 1) by a covariance of all of them."""
        n, r, width = every.shape
        gram, volume, flat = np.empty((len(zeta), width, width)), np.empty(len(zeta)), every.reshape(n * r, width)
        weights = shared.amplitudes(zeta) ** 2
        for part in batches(len(zeta), n * r):
            own = self.spread(zeta[part], factor[part] if isinstance(factor, np.ndarray) else factor)
            white, volume[part] = whiten(assemble(own, shared.parts, weights[part]), flat)
            np.matmul(np.swapaxes(white, -1, -2), white, out=gram[part])
        constant = self._penalise(np.where(self.stands, self.linear.constant, 0.0)).sum() + self.log_volume
        size = np.sqrt(np.sum(flat[:, :-1] ** 2, axis=0) / max(int(np.count_nonzero(flat[:, -1])), 1))
        return RowProducts(gram, constant - volume, self.slope.shape[-1], size)

    def _multiply_by_row(
        self, shared: ScaledErrors, zeta: Array, factor: Array | float, every: Array, columns: Array | None
    ) -> RowProducts:
        """Return products of rows (Q, R, m + N + c + 1), columns of errors common to all rows of amplitudes of one.

        Of each covariance of single rows once: it does not depend on these amplitudes.
        """
        own = self.spread(zeta, factor)
        keys = [(id(columns), one.tobytes()) for one in own]
        new = {key: k for k, key in enumerate(keys) if key not in self.sums}
        if new:
            white, volume = whiten(own[list(new.values())], every)
            for key, rows, half in zip(new, white, volume, strict=True):
                flat = rows.reshape(-1, rows.shape[-1])
                constant = self._penalise(np.where(self.stands, self.linear.constant, 0.0) - half).sum()
                count = max(int(np.count_nonzero(flat[:, -1])), 1)
                self.sums[key] = flat.T @ flat, float(constant), count, columns
        grams, constants, counts, _ = zip(*(self.sums[key] for key in keys), strict=True)
        while len(self.sums) > min(MOST_KEPT, self.at_once):
            del self.sums[next(iter(self.sums))]
        scale, m = np.ones((len(zeta), every.shape[-1])), self.slope.shape[-1]
        amplitudes = shared.size_columns(zeta)
        known = m + amplitudes.shape[1]
        scale[:, m:known] = amplitudes
        gram = np.stack(grams) * scale[:, :, None] * scale[:, None, :]
        size = np.sqrt(np.diagonal(gram, axis1=1, axis2=2)[:, :-1] / np.array(counts)[:, None])
        return RowProducts(gram, np.array(constants) + self.log_volume, known, size)

    def spread(self, zeta: Array, factor: Array | float) -> Array:
        """Return the covariances of single rows, (B, Q, R, R)."""
        stands = self.stands[:, None, None]
        return np.where(stands, self.linear.covariance(zeta, factor), np.eye(self.errors.shape[1]))

    def _penalise(self, constant: Array) -> Array:
        """Return the rows' constants (Q,), those of lost rows far below what is usual."""
        if not self.lost.any():
            return constant
        usual = float(np.median(constant[self.stands])) if self.stands.any() else 0.0
        return np.where(self.lost, usual - ROW_PENALTY_NAT * self.errors.shape[1], constant)

    def _count(self) -> tuple[int, int]:
        """Return how many readings more than poses take there are, and of them those of rows without a pose."""
        return int(self.n_spare[self.stands].sum()), int(self.n_spare[self.lost].sum())


@dataclass(frozen=True, eq=False)
class WhitenedRows:
    """White rows (Q, R, m + N + c + 1): slopes of what is standard normal, columns of causes, errors."""

    rows: Array
    constant: Array  # (Q,)
    known: int  # m + N
    log_volume: float
    n_spare: int  # readings more than poses take
    n_lost: int  # the same of rows that have no pose: they are zero

    @cached_property
    def total(self) -> Array:
        """`gram` of all rows."""
        return self.gram(slice(None))

    def gram(self, rows: np.ndarray | slice) -> Array:
        """Return products of what is known and the errors, summed over some of the rows, (m + N + 1, m + N + 1)."""
        known = np.concatenate([self.rows[rows, :, : self.known], self.rows[rows, :, -1:]], axis=-1)
        flat = known.reshape(-1, self.known + 1)
        return np.asarray(flat.T @ flat)

    def weigh(self, gram: Array | None = None, constant: float | None = None) -> float:
        """Return the log-density without any cause, of other products of rows where these are given."""
        gram = self.total if gram is None else gram
        constant = self.log_volume + (float(self.constant.sum()) if constant is None else constant)
        found = condition(np.eye(self.known) + gram[:-1, :-1], gram[:-1, -1:], gram[-1:, -1:], constant)
        return float(found.log_marginal)

    def solve(self, columns: np.ndarray, scale: Array) -> tuple[Array, Array, float]:
        """Return what is known (m + N,), the unknowns (k,) of columns with standard deviations (k,), and the misfit.

        That is the root of χ² of the rows over their number, what is unknown integrated: about one of right data. Lost
        rows count by what they cost.
        """
        flat = self.rows.reshape(-1, self.rows.shape[-1])
        both = np.concatenate([flat[:, : self.known], flat[:, columns] * scale], axis=1)
        found = condition_white(both, flat[:, -1:])
        mean, square = found.mean[:, 0], found.square.item() + self.n_lost * np.exp(2.0 * ROW_PENALTY_NAT)
        misfit = float(np.sqrt(square / max(self.n_spare + self.n_lost, 1)))
        return mean[: self.known], mean[self.known :] * scale, misfit

    @cached_property
    def products(self) -> Array:
        """Products of all columns and the errors, summed over the rows, (m + N + c + 1, m + N + c + 1)."""
        flat = self.rows.reshape(-1, self.rows.shape[-1])
        return np.asarray(flat.T @ flat)

    @cached_property
    def size(self) -> Array:
        """Rms of the white columns, (m + N + c,)."""
        return np.sqrt(np.diag(self.products)[:-1] / max(int(np.count_nonzero(self.rows[..., -1])), 1))

    @cached_property
    def _reduced(self) -> tuple[Array, Array]:
        """S (n, n) and t (n,) of all columns, those known again among them: what is known is integrated."""
        gram = self.products
        left = condition(np.eye(self.known) + gram[: self.known, : self.known], gram[: self.known], gram).square
        return left[:-1, :-1], left[:-1, -1]

    def gain(self, columns: np.ndarray, most: float = np.inf) -> tuple[float, float]:
        """Return by how much columns raise the log-density, and their τ, at most so large."""
        square, side = self._reduced
        scale = scale_columns(self.size[columns])
        gain, size = choose_size(square[np.ix_(columns, columns)], side[columns], scale, most)
        return float(gain), float(size)

    def gain_by_factor(self, parameters: np.ndarray, factors: Sequence[float]) -> tuple[float, float]:
        """Return by how much the best factor on the tolerances of parameters raises the log-density, and that."""
        square, side = self._reduced
        gain, factor = choose_factor(square[np.ix_(parameters, parameters)], side[parameters], factors)
        return float(gain), float(factor)

    def scale_tolerances(self, parameters: np.ndarray, factor: float) -> WhitenedRows:
        """Return the same rows by parameters in tolerances so many times as large."""
        rows = self.rows.copy()
        rows[..., parameters] *= factor
        return replace(self, rows=rows)


@dataclass(frozen=True, eq=False)
class VariantReadings:
    """Readings of one variant, of which causes are weighed."""

    posterior: CalibrationPosterior  # with the poses at which the nominal machine explains the readings best
    low: Array  # with high, (q,): the workspace, mm and rad
    high: Array
    internal: np.ndarray  # (K,): which channels the machine keeps after its calibration

    @property
    def model(self) -> ReadingModel:
        """The machine."""
        return self.posterior.likelihood.model

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Its channels, K of them."""
        return self.model.channels

    @property
    def values(self) -> Array:
        """As they are, (P, K)."""
        return self.posterior.likelihood.data.values

    @property
    def home(self) -> Array:
        """What the machine as expected reads at home, (K,)."""
        given = {name: value[:1] for name, value in self.posterior.likelihood.data.given.items()}
        return self.model.read(self.posterior.theta(self.posterior.begin[None]), self.model.home_pose[None], given)[0]

    @property
    def time(self) -> Array:
        """When rows were measured, from 0 to 1 by their order, (P,)."""
        order = self.posterior.likelihood.data.order
        return np.asarray((order - order.min()) / max(float(np.ptp(order)), 1.0))

    @property
    def begin(self) -> Array:
        """The machine (m,) about which rows are looked at first."""
        return self.posterior.begin[: self.posterior.n_geometry]

    def with_table(self, table: RowReadings) -> VariantReadings:
        """Return them as if a table had been read."""
        return replace(self, posterior=replace(self.posterior, likelihood=self._with(table)))

    def pick(self, rows: np.ndarray) -> VariantReadings:
        """Return some of the rows."""
        return replace(self, posterior=replace(self.posterior, likelihood=self.posterior.likelihood.pick(rows)))

    @cached_property
    def table(self) -> RowReadings:
        """All of them."""
        return RowReadings(self.values, np.arange(len(self.values)))

    def see(
        self, table: RowReadings, y: Array, start: Array | None = None, n_starts: int = 0
    ) -> LinearisedTable | None:
        """Return a table's rows about a machine (m,); None where they have no machine at all.

        Poses are looked for from those of the study, or from others (P, q); with ``n_starts`` from so many other places
        of the workspace, too, by steps that find their way from far.
        """
        likelihood = self._with(table)
        if start is not None:
            likelihood = replace(likelihood, start=start[table.rows])
        posterior = replace(self.posterior, likelihood=likelihood)
        try:
            with np.errstate(all="ignore"):
                theta, change = posterior.around(np.append(y, np.zeros(posterior.errors.n_parameters)))
                pose = self._locate(posterior, theta, n_starts)
                linear = ReadingRows(posterior).linearise(theta, pose)
        except (BayescalError, np.linalg.LinAlgError):
            return None
        slope = linear.slope @ change
        stands = np.isfinite(linear.errors).all(axis=1) & np.isfinite(slope).all(axis=(1, 2))
        stands &= np.isfinite(linear.constant)
        n_spare, errors = likelihood.n_spare, linear.errors - slope @ y
        stands &= n_spare > 0
        shared = None
        if linear.acts or not posterior.errors.has_columns:
            acts = tuple(np.where(stands[:, None, None], one, 0.0) for one in linear.acts)
            shared = ScaledErrors(errors.shape, acts, posterior.errors.amplitudes)
        return LinearisedTable(table.rows, linear, slope, errors, stands, n_spare, pose, table.log_volume, shared)

    def measure_rows(self, n_starts: int = 0) -> Array:
        """Return how far rows lie from any machine within the tolerances, in noise and errors as stated, (P,).

        The rms of what no pose explains of each beside the machine that fits all best to first order, without outlying
        rows; infinite for rows that the machine as expected has no pose of.
        """
        n_spare = self.posterior.likelihood.n_spare
        nowhere = np.where(n_spare > 0, np.inf, 0.0)
        moves, rest, stands = self._whiten(n_starts)
        if not stands.any():
            return nowhere
        left, spare, there = rest, np.maximum(n_spare, 1), np.flatnonzero(stands)
        for _ in range(2):
            off = np.sqrt(np.sum(left[there] ** 2, axis=1) / spare[there])
            used = there[off <= OUTLYING * np.median(off)]
            fit = condition_white(moves[used].reshape(-1, moves.shape[-1]), rest[used].reshape(-1, 1))
            left = rest - moves @ fit.mean[:, 0]
        return np.where(stands, np.sqrt(np.sum(left**2, axis=1) / spare), nowhere)

    def measure_misfit(self) -> float:
        """Return the rms of all rows in noise and errors as stated that the best machine leaves, to first order.

        About the machine as expected; infinite where that has no pose of some row.
        """
        n_spare, (moves, rest, stands) = self.posterior.likelihood.n_spare, self._whiten(0)
        if not stands.any() or (n_spare[~stands] > 0).any():
            return np.inf
        square = condition_white(moves.reshape(-1, moves.shape[-1]), rest.reshape(-1, 1)).square.item()
        return float(np.sqrt(square / n_spare[stands].sum()))

    def _whiten(self, n_starts: int) -> tuple[Array, Array, np.ndarray]:
        """Return slopes (P, R, n) and errors (P, R) of rows, white by noise as stated, and where they stand (P,).

        About the machine as expected, by what is standard normal; zero where it has no pose.
        """
        n_rows, parts = len(self.values), list[tuple[Array, Array, np.ndarray]]()
        zeta = np.zeros(self.posterior.errors.n_parameters)
        for part, _ in self.posterior.likelihood.data.split():
            some, common = (self if len(part) == n_rows else self.pick(part)), None
            seen = some.see(some.table, self.begin, None, n_starts)
            if seen is None or not seen.errors.shape[1]:  # no machine has any of them, or nothing is left over
                return np.zeros((n_rows, 1, 1)), np.zeros((n_rows, 1)), np.zeros(n_rows, dtype=bool)
            if some is not self:  # the fewest columns are of all rows together
                common = seen.common(zeta)
            white = seen.whiten(zeta, common=common)
            parts.append((white.rows[..., : white.known].copy(), white.rows[..., -1].copy(), seen.stands))
        moves, rest, stands = zip(*parts, strict=True)
        return np.concatenate(moves), np.concatenate(rest), np.concatenate(stands)

    def _with(self, table: RowReadings) -> CalibrationLikelihood:
        """Return the density of a table's readings."""
        likelihood = self.posterior.likelihood
        model = likelihood.model
        if table.circular:
            channels = enumerate(model.channels)
            known = tuple(replace(one, period=TURN) if k in table.circular else one for k, one in channels)
            model = replace(model, channels=known)
        data = replace(likelihood.data.pick(table.rows), values=table.values)
        data = replace(data, given={**data.given, **table.given})
        if table.vague:
            vague = np.isin(np.arange(len(self.channels)), table.vague)
            data = replace(data, sd=np.where(vague, WIDE_PRIOR_SD * data.sd, data.sd))
        return replace(likelihood, model=model, data=data, start=likelihood.start[table.rows], expansion=None)

    def _locate(self, posterior: CalibrationPosterior, theta: Array, n_starts: int) -> Array:
        """Return where a machine explains readings best, (Q, q)."""
        likelihood = posterior.likelihood
        if not likelihood.start.shape[1]:
            return likelihood.start
        if n_starts:
            return self._search(likelihood, theta, n_starts)
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, likelihood.sd.shape[1])))
        at = likelihood.stand(theta[None], white)
        pose, lost = at.pose[0].copy(), np.flatnonzero(~np.isfinite(at.error[0]).all(axis=1))
        if len(lost):
            pose[lost] = self._search(likelihood.pick(lost), theta, 3)
        return pose

    def _search(self, likelihood: CalibrationLikelihood, theta: Array, n_starts: int) -> Array:
        """Return the same from the likelihood's poses and from others of the workspace, home first."""
        rng, middle, half = np.random.default_rng(0), 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        spread = middle + SPREAD * half * rng.uniform(-1.0, 1.0, (n_starts, len(half)))
        elsewhere = np.vstack([likelihood.model.home_pose, spread])[: n_starts - 1]
        starts = np.concatenate([likelihood.start[None], np.repeat(elsewhere[:, None], len(likelihood.start), axis=1)])
        white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, likelihood.sd.shape[1])))
        found, off = search_poses(likelihood, theta, white, starts)
        best = np.where(np.isfinite(off), off, np.inf).argmin(axis=0)
        return np.asarray(found[best, np.arange(len(best))])


def leave_out_drift(readings: VariantReadings) -> VariantReadings:
    """Return readings whose errors do not drift in measuring order."""
    errors = readings.posterior.errors
    drifts = [one for one in errors.terms_of(GPTerm) if one.sort == DRIFT]
    return replace(readings, posterior=replace(readings.posterior, errors=errors.without(drifts)))


def leave_out_outliers(readings: VariantReadings) -> VariantReadings:
    """Return readings whose variant expects outliers without the rows that are."""
    if not readings.posterior.errors.outliers.expected:
        return readings
    off = readings.measure_rows()
    kept = np.isfinite(off) & (off <= OUTLYING * np.median(off))
    return readings.pick(np.flatnonzero(kept)) if kept.any() else readings
