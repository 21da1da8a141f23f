"""Sessions of one machine, or of machines of one design: what they share, and what moves between them.

Free parameters of session s are x_s = x_0 + Σ_k B_sk diag(σ) w_k, where x_0 has the priors of a study, w_k are standard
normal, σ are drift scales, and B says how sessions hang together: steps of a random walk, √Δt_k for all sessions after
it, or a deviation of each machine of a design by itself. Lengths at a temperature T are L (1 + α (T - T_0)); the
coefficients α are part of the state z, which is standard normal under the prior. So are the coefficients of errors that
are functions of the pose: what a model leaves out of one machine stays the same from session to session, and what
drifts in measuring order is new in each.

Rows of a session are what no pose explains of its readings: with H = ∂h/∂v white and Z an orthonormal complement of its
columns, Zᵀ(s - h) has no pose to first order, whatever the covariance of the readings. Linearised at a state, the state
is integrated in closed form. With rows r = c + J u of all poses, u the deviations of the sessions' parameters and the
coefficients of expansion and of errors, and the state z standard normal, the density of the data given τ and σ is
normal; A = 1 + Jᵀ C⁻¹ J, put together from one matrix of each session, is all that it takes: each entry of z is a
column of J times a size and a loading in every session. The states of all sessions are solved for at once: a chain of
them would take turns of a smoother, but what is shared by all sessions joins every link, and A stays small, since only
what may move stands in it more than once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.poses import PoseEstimate
from bayescal.density.linear_gaussian import ConditionalNormal, condition, whiten
from bayescal.density.priors import HalfNormalPrior
from bayescal.errors import NumericalError
from bayescal.numerics.geometry import Array


class LinearisedRows(NamedTuple):
    """Rows at one machine.

    ``errors`` (P, R) and ``slope`` (P, R, D) by θ; ``constant`` (P,) of the log-density; ``covariance`` takes what is
    unknown of the errors, in the posterior's coordinates (..., n), and factors (..., K) on the stated noise, to
    (..., P, R, R). ``basis`` (P, K, R): the directions of white readings that they are; ``left`` (P, R, K): how the
    readings as they are show in them; ``common`` takes what is unknown of the errors to columns of those common to all
    rows, (P, R, N); ``acts`` are those of amplitudes of one, (P, R, N_c) each, none where one has no single amplitude.
    """

    errors: Array
    slope: Array
    constant: Array
    covariance: Callable[..., Array]
    basis: Array
    left: Array
    common: Callable[[Array], Array]
    acts: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class ReadingRows:
    """P rows of one session."""

    posterior: CalibrationPosterior  # of the session by itself: its priors do not count

    @property
    def n_poses(self) -> int:
        """Number of rows."""
        return self.posterior.likelihood.data.n_poses

    @property
    def width(self) -> int:
        """Channels less coordinates."""
        model = self.posterior.likelihood.model
        return len(model.channels) - len(model.coordinates)

    @property
    def n_errors(self) -> int:
        """What is unknown of the noise."""
        return self.posterior.n_parameters - self.posterior.n_geometry

    @cached_property
    def act(self) -> Array:
        """What coefficients of errors common to all rows do to the readings at amplitudes of one, (P, K, N)."""
        data = self.posterior.likelihood.data
        acts = self.posterior.errors.list_acts(data, self.posterior.likelihood.error_gain)
        return np.concatenate([np.zeros((*data.sd.shape, 0)), *acts], axis=-1)

    @cached_property
    def widths(self) -> np.ndarray:
        """How many coefficients each of C such errors has, (C,)."""
        data = self.posterior.likelihood.data
        return np.array([one.shape[-1] for one in self.posterior.errors.list_acts(data)], dtype=int)

    def size_coefficients(self, errors: Array) -> Array:
        """Return the amplitude of each coefficient for errors (..., n), (..., N)."""
        if not len(self.widths):
            return np.zeros((*errors.shape[:-1], 0))
        return np.repeat(self.posterior.errors.amplitudes(errors), self.widths, axis=-1)

    def linearise(self, theta: Array, pose: Array | None = None) -> LinearisedRows:
        """Return what no pose explains of the readings at a machine (D,), white by the stated noise.

        About the poses that explain them best, or about others near these, (P, q).
        """
        likelihood = self.posterior.likelihood
        own, tau = likelihood.noise(self.posterior.errors, np.zeros((1, self.n_errors)))
        white = likelihood.whiten(np.broadcast_to(likelihood.sd, own.shape), np.zeros_like(tau))
        with np.errstate(all="ignore"):
            where = likelihood.stand(theta[None], white).pose if pose is None else pose[None]
            error, slope, by_parameters = likelihood.linearise(theta[None], where, white, with_parameters=True)
            volume = likelihood.log_volume(PoseEstimate(where, error, slope), white)[0]
        q = slope.shape[-1]
        basis = np.linalg.qr(np.nan_to_num(slope[0]), mode="complete")[0][:, :, q:]
        across = np.swapaxes(basis, 1, 2)
        spare = likelihood.n_spare
        constant = white.log_det[0] + volume - 0.5 * spare * np.log(2.0 * np.pi)
        there, n = likelihood.data.present, own.shape[-1]
        # of readings as they are to what no pose explains of white ones
        left = across @ white.rows(np.eye(n)[None, None])[0] * there[:, None, :]
        spread = left if likelihood.error_gain is None else left @ likelihood.error_gain
        absent = across * ~there[:, None, :] @ basis

        plain = likelihood.data.correlation is None

        def covariance(zeta: Array, factor: Array | float = 1.0) -> Array:
            own, tau = likelihood.noise(self.posterior.errors, np.atleast_2d(zeta))
            own = own * (factor[..., None, :] if isinstance(factor, np.ndarray) else factor)
            stated = left * own[:, :, None, :]
            found = (stated if plain else stated @ likelihood.correlation) @ np.swapaxes(stated, -1, -2)
            if tau.any():
                added = spread * tau[:, :, None, :]
                found = found + added @ np.swapaxes(added, -1, -2)
            return np.asarray((found + absent).reshape(*zeta.shape[:-1], *absent.shape))

        terms, data = self.posterior.errors, likelihood.data
        shown = [left @ act for act in terms.list_acts(data, likelihood.error_gain)]

        def common(zeta: Array) -> Array:
            if shown:  # of one amplitude each
                sizes = terms.amplitudes(zeta[None])[0]
                return np.concatenate([size * one for size, one in zip(sizes, shown, strict=True)], axis=-1)
            return np.asarray(left @ terms.columns(zeta[None], data, likelihood.error_gain)[0])

        errors = (across @ error[0][..., None])[..., 0]
        slope = -(across @ by_parameters[0])
        return LinearisedRows(errors, slope, constant, covariance, basis, left, common, tuple(shown))

    def evaluate(self, theta: Array, errors: Array, coefficients: Array | None = None) -> Array:
        """Return the log-likelihood of machines (B, D) with errors (B, n), poses eliminated, (B,).

        Errors common to all rows are what coefficients (B, N) make of them, times their amplitudes; without any they
        are integrated.
        """
        likelihood, terms, found = self.posterior.likelihood, self.posterior.errors, np.empty(len(theta))
        with np.errstate(all="ignore"):
            if coefficients is None or not terms.has_columns:
                return likelihood.density(theta, terms, errors)
            for k, effect in enumerate(np.tensordot(coefficients, self.act, axes=(1, 2))):
                values = likelihood.comparison.add(likelihood.data.values, -effect)
                own = replace(likelihood, data=replace(likelihood.data, values=values))
                white, at = own.explain(theta[k : k + 1], terms, errors[k : k + 1])
                tails = terms.tails(errors[k : k + 1])
                found[k] = (tails.weigh(at.square, own.n_spare) + own.offset(white, at)).sum()
        return found


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of one session at one temperature."""

    rows: ReadingRows
    session: int  # counted from zero
    warmth: float = 0.0  # T - T_0, K


@dataclass(frozen=True, eq=False)
class ThermalExpansion:
    """Lengths that grow with the temperature by a common coefficient α, normal under the prior."""

    name: str  # of the body
    index: np.ndarray  # where they stand in θ
    mean: float  # of α, 1/K
    sd: float


@dataclass(frozen=True, eq=False)
class DriftModel:
    """Which parameters may move between sessions, and how."""

    loadings: Array  # (S, K): B; of a random walk in √month
    index: np.ndarray  # (d,): the parameters, by their places among the free ones
    unit: np.ndarray  # (d,): which of the U scales each has
    units: tuple[str, ...]  # length U: their names
    scale: Array  # (U,): of the half-normal prior of each scale σ, mm or rad, of a random walk per √month

    def keep(self, units: Sequence[str]) -> DriftModel:
        """Return the same where some units alone may move."""
        chosen = [k for k, name in enumerate(self.units) if name in units]
        place = {old: new for new, old in enumerate(chosen)}
        there = np.isin(self.unit, chosen)
        unit = np.array([place[int(k)] for k in self.unit[there]], dtype=int)
        return replace(
            self,
            index=self.index[there],
            unit=unit,
            units=tuple(self.units[k] for k in chosen),
            scale=self.scale[chosen],
        )


def walk_loadings(days: Array) -> Array:
    """Return B of a random walk over sessions at days (S,), shape (S, S - 1)."""
    steps = np.sqrt(np.diff(days) / DAYS_IN_MONTH)
    return np.tril(np.ones((len(days), len(days) - 1)), k=-1) * steps


DAYS_IN_MONTH = 365.25 / 12


@dataclass(frozen=True, eq=False)
class SessionModel:
    """Sessions of one machine, or of machines of one design."""

    parts: tuple[Part, ...]  # of all sessions, in their order
    start: Array  # (D,): θ with all free parameters at their priors' means
    moves: Array  # (m, D): which parameters go with each free one, ones and zeros
    names: tuple[str, ...]  # length m: of the free parameters
    units: tuple[str, ...]  # length m
    mean: Array  # (m,): of their normal priors
    sd: Array  # (m,)
    drift: DriftModel
    expansions: tuple[ThermalExpansion, ...]  # length A
    lasting: tuple[bool, ...] = ()  # length C: which errors common to all rows of a session are so in all sessions

    @property
    def n_sessions(self) -> int:
        """Number of sessions S."""
        return len(self.drift.loadings)

    @property
    def n_steps(self) -> int:
        """Number of steps or deviations K."""
        return self.drift.loadings.shape[1]

    @property
    def size(self) -> int:
        """Length of the state z: m parameters, A coefficients, d times K steps, coefficients of errors."""
        return self._n_moving + len(self._of_errors[0])

    @property
    def _n_moving(self) -> int:
        return len(self.mean) + len(self.expansions) + self.n_steps * len(self.drift.index)

    @property
    def _widths(self) -> np.ndarray:
        return self.parts[0].rows.widths if self.lasting else np.zeros(0, dtype=int)

    def size_coefficients(self, errors: Array) -> Array:
        """Return the amplitude of each of N coefficients of a session's errors (..., n), (..., N)."""
        return self.parts[0].rows.size_coefficients(errors) if self.lasting else np.zeros((*errors.shape[:-1], 0))

    @cached_property
    def _of_errors(self) -> tuple[np.ndarray, Array]:
        """Which of N coefficients each entry of the state's last part is, and in which sessions, (S, n)."""
        widths = self._widths
        lasting = np.repeat(np.array(self.lasting, dtype=bool), widths)
        every, own = np.flatnonzero(lasting), np.flatnonzero(~lasting)
        n = self.n_sessions
        loading = np.concatenate([np.ones((n, len(every))), np.repeat(np.eye(n), len(own), axis=1)], axis=1)
        return np.concatenate([every, np.tile(own, n)]), loading

    def find_coefficients(self, z: Array, errors: Array) -> Array:
        """Return the coefficients of each session times their amplitudes, (B, S, N), of states (B, n)."""
        index, loading = self._of_errors
        found = np.zeros((len(z), self.n_sessions, int(self._widths.sum())))
        for session, row in enumerate(loading):
            there = row > 0.0
            found[:, session, index[there]] = z[:, self._n_moving :][:, there]
        return np.asarray(found * self.size_coefficients(errors)[:, None])

    def find_loadings(self, errors: Array, scales: Array) -> tuple[np.ndarray, Array]:
        """Return of which column of a session's rows each entry of the state is, (n,), and how much of it, (S, n).

        Columns are those by the m parameters, by A coefficients of expansion and by N coefficients of errors.
        """
        m, a, drift, n = len(self.mean), len(self.expansions), self.drift, self.n_sessions
        size = np.concatenate([self.sd, [one.sd for one in self.expansions]])
        steps = drift.loadings[:, :, None] * scales[drift.unit]  # (S, K, d)
        index, loading = self._of_errors
        own = loading * self.size_coefficients(errors)[index]
        columns = np.concatenate([np.arange(m + a), np.tile(drift.index, self.n_steps), m + a + index])
        return columns, np.concatenate([np.tile(size, (n, 1)), steps.reshape(n, -1), own], axis=1)

    @property
    def n_errors(self) -> int:
        """How many numbers are unknown of the errors, the same in all sessions."""
        return self.parts[0].rows.n_errors

    @property
    def n_scales(self) -> int:
        """Number of what is unknown of the errors and of drift scales together."""
        return self.n_errors + len(self.drift.units)

    def keep(self, units: Sequence[str]) -> SessionModel:
        """Return the same sessions where some units alone may move."""
        return replace(self, drift=self.drift.keep(units))

    def read_scales(self, zeta: Array) -> tuple[Array, Array]:
        """Return what is unknown of the errors and drift scales σ (..., U), of standard normal coordinates (..., n)."""
        n = self.n_errors
        return zeta[..., :n], HalfNormalPrior(1.0).value(zeta[..., n:]) * self.drift.scale

    def split(self, z: Array, scales: Array) -> tuple[Array, Array]:
        """Return deviations of x_s from the priors' means (..., S, m), mm, and α (..., A), of states (..., n).

        Drift scales σ have shape (..., U).
        """
        m, a = len(self.mean), len(self.expansions)
        common = self.sd * z[..., :m]
        steps = z[..., m + a : self._n_moving].reshape(*z.shape[:-1], self.n_steps, len(self.drift.index))
        moved = np.einsum("sk,...kd->...sd", self.drift.loadings, steps) * scales[..., None, self.drift.unit]
        x = np.repeat(common[..., None, :], self.n_sessions, axis=-2)
        x[..., self.drift.index] += moved
        means = np.array([one.mean for one in self.expansions])
        sds = np.array([one.sd for one in self.expansions])
        return x, means + sds * z[..., m : m + a]

    def theta(self, part: Part, x: Array, alpha: Array) -> Array:
        """Return θ (..., D) of a part's machine at its temperature; x (..., S, m), α (..., A) as `split` returns."""
        theta = self.start + x[..., part.session, :] @ self.moves
        for k, one in enumerate(self.expansions):
            theta[..., one.index] *= 1.0 + alpha[..., k, None] * part.warmth
        return theta

    def slopes(self, part: Part, x: Array, alpha: Array) -> tuple[Array, Array]:
        """Return dθ/dx (D, m) and dθ/dα (D, A) of a part's machine at one x (S, m) and α (A,)."""
        cold = self.theta(Part(part.rows, part.session), x, alpha)
        factor = np.ones(len(cold))
        by_alpha = np.zeros((len(cold), len(self.expansions)))
        for k, one in enumerate(self.expansions):
            factor[one.index] = 1.0 + alpha[k] * part.warmth
            by_alpha[one.index, k] = cold[one.index] * part.warmth
        return (self.moves * factor).T, by_alpha

    def log_likelihood(self, z: Array, zeta: Array) -> Array:
        """Return the log-likelihood as it is, shape (B,), of states (B, n) at scales ζ (B, n_scales)."""
        errors, scales = self.read_scales(zeta)
        (x, alpha), common = self.split(z, scales), self.find_coefficients(z, errors)
        found = [one.rows.evaluate(self.theta(one, x, alpha), errors, common[:, one.session]) for one in self.parts]
        return np.sum(found, axis=0)


STEPS = 30
MIN_STATE_STEP = 1e-7  # of a state in prior standard deviations, below which a step no longer matters


@dataclass(frozen=True, eq=False)
class LinearSessions:
    """Sessions linearised at a state."""

    model: SessionModel
    # (P, R, m + A + N + 1): J by the deviations of the session's parameters, by coefficients of expansion less their
    # means and by those of errors, and c
    rows: Array
    # takes what is unknown of the errors to the covariances of the rows, (P, R, R)
    covariance: Callable[[Array], Array]
    constant: Array  # (P,)
    first: np.ndarray  # (S,): first pose of each session

    def gather(self, errors: Array) -> tuple[Array, float]:
        """Return XᵀC⁻¹X of the rows X of each session, shape (S, M, M), and what else the log-density has."""
        white, volume = whiten(self.covariance(errors), self.rows)
        of_sessions = [one.reshape(-1, one.shape[-1]) for one in np.split(white, self.first[1:])]
        return np.stack([one.T @ one for one in of_sessions]), float(self.constant.sum() - volume.sum())

    def condition(self, errors: Array, scales: Array) -> ConditionalNormal:
        """Return the state given what is unknown of the errors, and σ (U,); its marginal is the data's."""
        gram, rest = self.gather(errors)
        precision, slope, square = self._assemble(gram, errors, scales)
        precision[np.diag_indices_from(precision)] += 1.0
        try:
            return condition(precision, -slope[:, None], square, rest)
        except np.linalg.LinAlgError as error:
            raise NumericalError("sessions: no joint density at these drift scales") from error

    def _assemble(self, gram: Array, errors: Array, scales: Array) -> tuple[Array, Array, float]:
        """Return JᵀC⁻¹J and JᵀC⁻¹c by the state, and cᵀC⁻¹c."""
        columns, loadings = self.model.find_loadings(errors, scales)
        precision, slope = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
        for own, loading in zip(gram, loadings, strict=True):
            there = np.flatnonzero(loading)
            index, size = columns[there], loading[there]
            precision[np.ix_(there, there)] += own[np.ix_(index, index)] * np.outer(size, size)
            slope[there] += own[index, -1] * size
        return precision, slope, float(gram[:, -1, -1].sum())

    def log_likelihood(self, z: Array, errors: Array, scales: Array) -> float:
        """Return the linearised log-likelihood of one state (n,)."""
        x, alpha = self.model.split(z, scales)
        means = np.array([one.mean for one in self.model.expansions])
        common = self.model.find_coefficients(z[None], errors[None])[0]
        others = [np.broadcast_to(alpha - means, (len(x), len(means))), common, np.ones((len(x), 1))]
        u = np.concatenate([x, *others], axis=1)
        gram, rest = self.gather(errors)
        return rest - 0.5 * float(np.einsum("si,sij,sj->", u, gram, u))


def linearise_sessions(model: SessionModel, z: Array, scales: Array) -> LinearSessions:
    """Return sessions linearised at a state (n,) and drift scales (U,)."""
    x, alpha = model.split(z, scales)
    found = [one.rows.linearise(model.theta(one, x, alpha)) for one in model.parts]
    rows = np.concatenate([_combine(model, *both, x, alpha) for both in zip(model.parts, found, strict=True)])
    counts = np.bincount([one.session for one in model.parts], [one.rows.n_poses for one in model.parts])
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)

    def covariance(errors: Array) -> Array:
        return np.concatenate([one.covariance(errors) for one in found])

    return LinearSessions(model, rows, covariance, np.concatenate([one.constant for one in found]), first)


def _combine(model: SessionModel, part: Part, found: LinearisedRows, x: Array, alpha: Array) -> Array:
    """Return the rows of a part, shape (P, R, m + A + N + 1)."""
    errors, slope = found.errors, found.slope
    by_x, by_alpha = model.slopes(part, x, alpha)
    jacobian = slope @ np.concatenate([by_x, by_alpha], axis=1)
    means = np.array([one.mean for one in model.expansions])
    constant = errors - jacobian @ np.concatenate([x[part.session], alpha - means])
    if not np.isfinite(jacobian).all():
        raise NumericalError(f"sessions: session {part.session + 1}: no machine near the prior centres")
    return np.concatenate([jacobian, -(found.left @ part.rows.act), constant[..., None]], axis=2)


def find_state(model: SessionModel, errors: Array, scales: Array, z: Array) -> tuple[LinearSessions, Array]:
    """Return sessions linearised at the most probable state given errors and σ, and that state; from z, shape (n,).

    Raises
    ------
    NumericalError
        Where Gauss and Newton's steps do not settle.
    """
    for _ in range(STEPS):
        linear = linearise_sessions(model, z, scales)
        found = linear.condition(errors, scales).mean[:, 0]
        if np.abs(found - z).max() < MIN_STATE_STEP:
            return linear, found
        z = found
    raise NumericalError(f"sessions: no convergence in {STEPS} Gauss-Newton steps")
