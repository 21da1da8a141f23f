"""What readings after a calibration say of shifts since then: a linear model, its scores, and the test of all shifts.

At a pose of any machine what is read differs from the calibrated one's readings by

    s - h(θ̂, v) = H Δv + A Δθ + A_s δ + e:

where the pose is, which nobody knows; what the calibration did not know, Δθ ~ N(0, P); the shifts δ of N parameters;
and errors e of all channels, with covariance C. In the directions Z that no pose explains, Zᵀ C^(-1/2) H = 0, the
residual is y = X_θ Δθ + X_s δ + ε. With Δθ integrated, the score b of δ at zero has mean K δ and covariance K. Each
parameter by itself has the statistic t_k = b_k / √K_kk, standard normal while the calibration holds; the test takes the
largest of all |t_k|. Over several sessions pooled from the first, scores are sums of independent steps, as in any
likelihood.

Errors that are functions of the pose are the same as at the calibration: their coefficients stand beside Δθ, with which
they are known together, and what is known of them is taken off. What drifts in measuring order joins the rows of a
session.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, softmax

from bayescal.calibrated.functions import KnownFunctions
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.density.calibration.measurements import Comparison, Measurements
from bayescal.density.linear_gaussian import whiten
from bayescal.errors import InputError
from bayescal.machines.readings import Given
from bayescal.machines.readings.newton import Function, solve
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

SIMULATED = 100_000
"""Tests simulated for a threshold: a false alarm of 1 % is met to 0.03 %."""
SHOWN = {"mm": ("µm", MICROMETRE), "rad": ("arcsec", ARCSECOND)}
UNITLESS = {"1": ("", 1.0)}
SEEN = 1e-9
"""Share of a parameter's slopes that has to be left of them, the poses eliminated, for a shift of it to show."""
ODD = 1e-3
"""Probability of what a shift of one parameter leaves over, below which something else has happened."""


@dataclass(frozen=True, eq=False)
class TestedParameters:
    """N parameters that may have shifted, one at a time."""

    names: tuple[str, ...]  # as texts call them
    places: np.ndarray  # (N,): in the machine's layout
    units: tuple[str, ...]
    kind: str  # what any of them is called
    stated: bool  # whether they were asked for, and are not all that there are

    def pick(self, some: np.ndarray) -> TestedParameters:
        """Return some of them, by a mask."""
        chosen = np.flatnonzero(some)
        names, units = (tuple(one[k] for k in chosen) for one in (self.names, self.units))
        return TestedParameters(names, self.places[chosen], units, self.kind, self.stated)


def choose_suspects(calibrated: CalibratedMachine, wanted: Sequence[str]) -> TestedParameters:
    """Return the parameters of some symbols, or of these names; without any the lengths of legs, else all free ones.

    InputError for an unknown name, and where nothing is free.
    """
    model = calibrated.model
    layout = model.layout
    wanted = wanted or [symbol for symbol in model.shifting if symbol in layout.index]
    for name in wanted:
        if name not in layout.symbols and name not in layout.names:
            raise InputError(f"verify: found {name!r}, expected one of {', '.join(layout.symbols)}, or a name")
    names = [n for k, n in enumerate(layout.names) if n in wanted or n.partition("[")[0] in wanted]
    names = names or list(calibrated.names)
    if not names:
        raise InputError("verify: found no free parameter, expected --parameters")
    places = np.array([layout.names.index(name) for name in names])
    one_each = bool(wanted) and list(wanted) == list(model.shifting)
    called = tuple(f"{model.member} {n.partition('[')[2].rstrip(']')}" if one_each else n for n in names)
    units = tuple(layout.units[k] for k in places)
    return TestedParameters(called, places, units, model.member if one_each else "parameter", bool(wanted))


def say_size(value: float, unit: str) -> str:
    """Return a size in the unit that shifts are stated in: micrometres, arcseconds, or the parameter's own."""
    shown, size = (SHOWN | UNITLESS).get(unit, (unit, 1.0))
    return f"{value / size:.6g} {shown}".rstrip()


def say_shift(value: float, sd: float, unit: str) -> str:
    """Return a shift with its standard deviation in the same units."""
    shown, size = (SHOWN | UNITLESS).get(unit, (unit, 1.0))
    if unit in SHOWN:
        return f"{value / size:+.1f} ± {sd / size:.1f} {shown}"
    return f"{value:+.3g} ± {sd:.2g} {shown}".rstrip()


@dataclass(frozen=True, eq=False)
class PoseInformation:
    """What poses say."""

    # (P, k, q + N + 1): white rows, poses eliminated: of Δθ in units of its posterior, of δ in the parameters' units,
    # the residual
    rows: Array
    n_shifts: int  # N
    n_rows: int  # how many of all these rows hold anything
    seen: np.ndarray  # bool (N,): whether a shift changes anything that is read, other than another pose would
    drifting: Array  # (P, k, D): what drifts of one root mean square of D channels do to the rows
    functions: KnownFunctions | None = None  # which tell how drifts hang together

    def pick(self, some: np.ndarray) -> PoseInformation:
        """Return what they say of some of the shifts, by a mask."""
        n = self.n_shifts
        kept = np.concatenate([np.ones(self.rows.shape[-1] - n - 1, dtype=bool), some, [True]])
        return replace(self, rows=self.rows[..., kept], n_shifts=int(some.sum()), seen=self.seen[some])

    def scale(self, shift: Array) -> PoseInformation:
        """Return what they say of the same shifts in units of their own (N,)."""
        scale = np.concatenate([np.ones(self.rows.shape[-1] - self.n_shifts - 1), shift, [1.0]])
        return replace(self, rows=self.rows * scale)

    @cached_property
    def gram(self) -> Array:
        """XᵀX of each pose, shape (P, q + N + 1, q + N + 1)."""
        return np.swapaxes(self.rows, 1, 2) @ self.rows

    @property
    def drifts(self) -> Array:
        """Sizes that a drift may have as probably as any other, of its root mean square, (J,)."""
        return self.functions.drifts if self.functions is not None and self.drifting.any() else np.ones(1)

    def total(self, chosen: Sequence[int] | None = None, drift: float = 1.0) -> Array:
        """Return XᵀX of all poses, or of some in the order in which they are measured; drifts join the noise."""
        some = slice(None) if chosen is None else np.array(chosen, dtype=int)
        rows, drifting = self.rows[some], drift * self.drifting[some]
        if self.functions is None or not drifting.any():
            return np.asarray(self.gram[some].sum(axis=0))
        n, k = rows.shape[:2]
        joined = np.einsum("pad,pq,qbd->paqb", drifting, self.functions.follow(n), drifting, optimize=True)
        white, _ = whiten(np.eye(n * k) + joined.reshape(n * k, n * k), rows.reshape(n * k, -1))
        return np.asarray(white.T @ white)

    def add_each(self, gram: Array, repeats: int) -> Array:
        """Return the diagonal of K, shape (P, N), of each pose beside a sum of the poses' matrices, both so often.

        The pose is a low-rank change of what there is: K grows by RᵀB⁻¹R, with R what of its columns by δ the others
        do not explain, and B the covariance of its rows given those.
        """
        q = gram.shape[-1] - self.n_shifts - 1
        gram, rows = repeats * gram, np.sqrt(repeats) * self.rows
        inverse = np.linalg.inv(gram[:q, :q] + np.eye(q))
        known, moved = rows[..., :q], rows[..., q:-1]
        gain = known @ inverse
        rest = moved - gain @ gram[:q, q:-1]
        spread = gain @ np.swapaxes(known, 1, 2) + np.eye(rows.shape[1])
        own = np.diagonal(self.score(gram)[1])
        return np.asarray(own + np.sum(rest * np.linalg.solve(spread, rest), axis=1))

    def score(self, gram: Array) -> tuple[Array, Array]:
        """Return b (..., N) and K (..., N, N) of sums of the poses' matrices."""
        q = gram.shape[-1] - self.n_shifts - 1
        precision = gram[..., :q, :q] + np.eye(q)
        solved = np.linalg.solve(precision, gram[..., :q, q:])
        reduced = gram[..., q:, q:] - np.swapaxes(gram[..., :q, q:], -1, -2) @ solved
        return reduced[..., :-1, -1], reduced[..., :-1, :-1]

    def left_over(self, gram: Array) -> float:
        """Return yᵀV⁻¹y of a sum of the poses' matrices, V the covariance of y with Δθ in it."""
        q = gram.shape[-1] - self.n_shifts - 1
        return float(gram[-1, -1] - gram[:q, -1] @ np.linalg.solve(gram[:q, :q] + np.eye(q), gram[:q, -1]))


# --- rows of a machine -------------------------------------------------------------------------------------------


def predict_knowledge(
    calibrated: CalibratedMachine, suspects: TestedParameters, commands: Array, given: Given, planned: Measurements
) -> PoseInformation:
    """Return what poses at commands (P, C), in the channels' units, will say.

    ``planned`` is a row, or one for each pose, that says which channels will be read, by numbers, and their noise; that
    of the commanded channels is the machine's own. InputError where the machine has no pose at one of them, or where
    nothing will show a shift.
    """
    model = calibrated.model
    pose, found = model.locate(calibrated.theta, commands, given, weights=calibrated.weights)
    if not found.all():
        raise InputError(f"pose {int(np.argmin(found)) + 1}: found no pose, expected one")
    n = len(commands)
    values = np.where(planned.present, model.read(calibrated.theta, pose, given), np.nan)
    values[:, calibrated.commanded] = model.read(calibrated.theta, pose, given)[:, calibrated.commanded]
    own = planned.correlation
    correlation = None if own is None else np.broadcast_to(own, (n, *own.shape[1:])).copy()
    names = tuple(f"pose {k}" for k in range(1, n + 1))
    data = Measurements(names, values, np.broadcast_to(planned.sd, values.shape).copy(), given, correlation)
    return _linearise(calibrated, suspects, data, pose)


def compute_knowledge(
    calibrated: CalibratedMachine, suspects: TestedParameters, session: Measurements
) -> PoseInformation:
    """Return what a session's readings of all channels say; the noise of the commanded ones is the machine's own.

    InputError where no pose of the machine is near some readings, or where nothing shows a shift.
    """
    return _linearise(calibrated, suspects, session, find_poses(calibrated, session))


def find_poses(calibrated: CalibratedMachine, session: Measurements) -> Array:
    """Return the poses (P, q) at which the calibrated machine fits readings best; InputError where there is none."""
    model, theta = calibrated.model, calibrated.theta
    commands = session.values[:, calibrated.commanded]
    start, near = np.tile(model.home_pose, (session.n_poses, 1)), np.isfinite(commands).all(axis=1)
    if commands.shape[1] >= len(model.coordinates) and near.any():
        given = {name: value[near] for name, value in session.given.items()}
        pose, found = model.locate(theta, commands[near], given, weights=calibrated.weights)
        near[near] = found
        start[near] = pose[found]
    else:
        near[:] = False
    for rows, follow in ((near, False), (~near, True)):
        if rows.any():
            begin, miss = start[rows], _seek(calibrated, session.pick(rows), start[rows])
            first, _ = miss(begin, np.arange(len(begin)))
            start[rows], there = solve(miss, first, begin, model.pose_scale, follow)
            for k in np.flatnonzero(rows)[~there][:1]:
                raise InputError(f"pose {session.poses[k]!r}: found no pose near its readings")
    return start


def _seek(calibrated: CalibratedMachine, session: Measurements, start: Array) -> Function:
    """Return what `solve` takes to zero: readings less those of a pose, white by their noise at a start."""
    white = _whiten(calibrated, session, start)

    def miss(pose: Array, rows: np.ndarray) -> tuple[Array, Array]:
        error, by_pose, _ = _compare(calibrated, session.pick(rows), pose, False)
        return (white[rows] @ error[..., None])[..., 0], white[rows] @ by_pose

    return miss


def _compare(
    calibrated: CalibratedMachine, session: Measurements, pose: Array, with_parameters: bool = True
) -> tuple[Array, Array, Array]:
    """Return measured minus read at poses, (P, K), and slopes of what is read, (P, K, q), (P, K, D); zero if unread."""
    here = calibrated.model.linearise(calibrated.theta, pose, with_parameters, session.given)
    comparison = Comparison(calibrated.model.channels)
    error = comparison.subtract(session.values, here.values)
    slopes = [here.by_pose, *([here.by_parameters] if with_parameters else [])]
    slopes = [comparison.pull_back(np.nan_to_num(error), here.values, one) for one in slopes]
    unread = ~session.present
    error, *slopes = (np.where(unread.reshape(*unread.shape, *[1] * (x.ndim - 2)), 0.0, x) for x in (error, *slopes))
    return error, slopes[0], slopes[-1]


def _whiten(calibrated: CalibratedMachine, session: Measurements, pose: Array, beside: Array | None = None) -> Array:
    """Return what makes readings (P, K) white, (P, K, K): their own noise, and the machine's of commanded channels.

    With ``beside`` (P, K) model errors have that variance instead of what is kept of those of commanded channels.
    """
    there, own, errors = session.present, calibrated.commanded, calibrated.errors
    if beside is not None:
        errors = replace(errors, model_variance=np.zeros_like(errors.model_variance))
    sd = np.where(there, session.sd, 1.0)
    covariance = np.eye(sd.shape[1]) * sd[..., None] ** 2
    if session.correlation is not None:
        covariance = sd[..., None] * session.correlation * sd[:, None]
    covariance[:, own, :] = covariance[:, :, own] = 0.0
    commands = np.nan_to_num(session.values[:, own])
    covariance[np.ix_(np.arange(len(sd)), own, own)] = errors.covariance(pose, commands)
    if beside is not None:
        shown = _gain(calibrated, session, pose) * np.sqrt(beside)[:, None]
        covariance = covariance + shown @ np.swapaxes(shown, 1, 2)
    both = there[:, :, None] & there[:, None, :]
    return np.asarray(np.linalg.inv(np.linalg.cholesky(np.where(both, covariance, np.eye(sd.shape[1])))))


def _gain(calibrated: CalibratedMachine, session: Measurements, pose: Array) -> Array:
    """Return how model errors show in the readings, (P, K, K)."""
    gain = calibrated.model.error_gain(calibrated.theta, pose, session.given)
    n = len(calibrated.model.channels)
    return np.broadcast_to(np.eye(n), (len(pose), n, n)) if gain is None else gain


def _linearise(
    calibrated: CalibratedMachine, suspects: TestedParameters, session: Measurements, pose: Array
) -> PoseInformation:
    if calibrated.covariance is None:
        raise InputError("found no posterior draws, expected them")
    q, n_read = pose.shape[1], session.present.sum(axis=1)
    for k in np.flatnonzero(n_read <= q)[:1]:
        raise InputError(
            f"{session.poses[k]}: found {n_read[k]} channels for {q} pose coordinates, expected more: no shift shows"
        )
    error, by_pose, by_parameters = _compare(calibrated, session, pose)
    known, free = calibrated.functions, by_parameters[..., calibrated.free]
    drifting, beside = np.zeros((*error.shape, 0)), None
    if known is None:
        values, vectors = np.linalg.eigh(calibrated.covariance)
        there = values > 1e-14 * values.max(initial=0.0)  # directions that are known exactly are none
        unknown = free @ (vectors[:, there] * np.sqrt(values[there]))
    else:
        gain, there = _gain(calibrated, session, pose), session.present[..., None]
        read = calibrated.model.read(calibrated.theta, pose, session.given)
        acted, beside = known.show(calibrated.model, session, read)
        shown = np.where(there, gain @ acted, 0.0)
        drifting = np.where(there, gain @ (known.place(calibrated.model) * known.drift), 0.0)
        error, unknown = error - shown @ known.mean, np.concatenate([free, shown], axis=-1) @ known.root
    white = _whiten(calibrated, session, pose, beside)
    columns = np.concatenate([unknown, by_parameters[..., suspects.places], error[..., None]], axis=-1)
    white_columns = white @ columns
    left = np.linalg.qr(white @ by_pose, mode="complete").Q[..., q:]
    rows, drifts = np.swapaxes(left, 1, 2) @ white_columns, np.swapaxes(left, 1, 2) @ (white @ drifting)
    n = len(suspects.places)
    whole, rest = (np.sqrt(np.sum(one[..., -1 - n : -1] ** 2, axis=(0, 1))) for one in (white_columns, rows))
    return PoseInformation(rows, n, int((n_read - q).sum()), rest > SEEN * whole, drifts, known)


def keep_seen(
    suspects: TestedParameters, parts: Sequence[PoseInformation]
) -> tuple[TestedParameters, list[PoseInformation]]:
    """Return those whose shifts show in any of some poses, and what these say of them.

    InputError where one that was asked for does not show, or none does.
    """
    seen = np.logical_or.reduce([one.seen for one in parts])
    if (suspects.stated and not seen.all()) or not seen.any():
        raise InputError(
            f"verify: found that a shift of {suspects.names[int(np.argmin(seen))]} has no effect on "
            "readings, expected other parameters or more channels"
        )
    return suspects.pick(seen), [one.pick(seen) for one in parts]


# --- the test ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ShiftTest:
    """The test of the largest statistic of all N parameters at any of several looks."""

    threshold: float  # of |t|
    false_alarm: float  # with which the threshold is passed at any look while the calibration holds
    information: Array  # (J, N, N): K at each look

    def find_power(self) -> Array:
        """Return with which probability a shift of one unit of each parameter is found at any look, shape (N,)."""
        noise = _simulate(self.information, SIMULATED // 2)
        scale = np.sqrt(np.diagonal(self.information, axis1=1, axis2=2))[:, None]
        found = []
        for k in range(self.information.shape[1]):
            moved = noise + self.information[:, None, :, k] / scale
            found.append(np.mean(np.abs(moved).max(axis=(0, 2)) > self.threshold))
        return np.array(found)


def build_test(information: Array, false_alarm: float) -> ShiftTest:
    """Return the test of information K (J, N, N) at J looks that gives false alarms so often, all looks together."""
    largest = np.abs(_simulate(information, SIMULATED)).max(axis=(0, 2))
    return ShiftTest(float(np.quantile(largest, 1.0 - false_alarm)), false_alarm, information)


def _simulate(information: Array, n: int) -> Array:
    """Return statistics t of a calibration that holds, shape (J, n, N); the same ones at every call."""
    rng = np.random.default_rng(0)
    score = np.zeros((n, information.shape[-1]))
    looks = []
    for now, before in zip(information, [np.zeros_like(information[0]), *information[:-1]], strict=True):
        values, vectors = np.linalg.eigh(now - before)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        score = score + rng.standard_normal(score.shape) @ root.T
        looks.append(score / np.sqrt(np.diag(now)))
    return np.stack(looks)


def look_again(knowledge: PoseInformation, grams: Sequence[Array], n_looks: int) -> Array:
    """Return K at each of n looks, shape (J, N, N): sums of the sessions' matrices, the last session repeated."""
    there = [*grams, *[grams[-1]] * (n_looks - len(grams))]
    return knowledge.score(np.cumsum(there, axis=0))[1]


@dataclass(frozen=True, eq=False)
class Reverification:
    """What the sessions of a reverification say."""

    suspects: TestedParameters  # N parameters, one of which may have shifted
    holds: bool  # whether no statistic of any session passed the threshold
    statistic: Array  # (J, N): t of every parameter, the sessions pooled from the first
    threshold: float
    false_alarm: float
    # (N,): of every parameter as if it alone had shifted, all sessions together, in its unit
    shift: Array
    sd: Array
    probability: Array  # (N,): that it is this one, where one shifted
    # with which probability as much is left over by chance, beside the shift of the most probable parameter, where
    # the calibration does not hold; on average over the sizes that a drift may have
    left_over: float

    @property
    def worst(self) -> int:
        """The most probable parameter, counted from zero."""
        return int(np.argmax(self.probability))

    @property
    def is_odd(self) -> bool:
        """Whether what was measured fits neither the calibration nor one shift."""
        return self.left_over < ODD


def judge_reverification(
    calibrated: CalibratedMachine,
    suspects: TestedParameters,
    sessions: Sequence[Measurements],
    false_alarm: float,
    n_looks: int,
) -> Reverification:
    """Return what sessions, readings of all channels in their order, say together, a look at each of them.

    False alarms are those of all looks together, ``n_looks`` the sessions that are planned, if these are more.
    """
    suspects, parts = keep_seen(suspects, [compute_knowledge(calibrated, suspects, one) for one in sessions])
    grams = np.stack([one.total() for one in parts])
    knowledge, pooled = parts[0], np.cumsum(grams, axis=0)
    test = build_test(look_again(knowledge, list(grams), max(n_looks, len(grams))), false_alarm)
    score, information = knowledge.score(pooled)
    own = np.diagonal(information, axis1=1, axis2=2)
    statistic = score / np.sqrt(own)
    holds = bool(np.abs(statistic).max() <= test.threshold)
    return Reverification(
        suspects,
        holds,
        statistic,
        test.threshold,
        false_alarm,
        score[-1] / own[-1],
        1.0 / np.sqrt(own[-1]),
        softmax(0.5 * statistic[-1] ** 2 - 0.5 * np.log(own[-1])),
        weigh_left_over(parts, not holds),
    )


def weigh_left_over(sessions: Sequence[PoseInformation], shifted: bool) -> float:
    """Return with which probability as much is left over by chance, beside the most probable shift or none.

    It is the mean over the sizes that a drift may have: what is rare with one of its mean size is not where the size is
    hardly known.
    """
    first, n_rows, found = sessions[0], sum(one.n_rows for one in sessions), []
    for size in first.drifts.tolist():
        pooled = np.sum([one.total(drift=size) for one in sessions], axis=0)
        score, information = first.score(pooled)
        explained = float((score**2 / np.diagonal(information)).max()) if shifted else 0.0
        found.append(chdtrc(n_rows - shifted, first.left_over(pooled) - explained))
    return float(np.mean(found))
