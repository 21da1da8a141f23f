"""Data that no machine within its priors comes near, or that the nominal one cannot have: what may have happened.

Both are looked for to first order about the nominal machine, poses found from the readings anew for each case: where
readings have slipped, their poses have, too, and a machine may have no reading there at all. Measured poses of a
machine on legs are weighed by what its legs err by there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.poses import search_poses
from bayescal.density.elimination import find_step, project_out
from bayescal.density.legs import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import BayescalError, InputError, NumericalError
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuredVariant
from bayescal.experiments.shared.slips import (
    BETTER,
    CHANNEL,
    CLEARLY,
    NOTHING,
    OUTLYING,
    REREAD,
    TURN,
    Columns,
    FoundSlip,
    LegData,
    Slip,
    Weight,
    find_slip,
    fit_rows,
    list_leg_slips,
    list_reading_slips,
    weigh_rows,
)
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant, join_words

MOST_ROWS = 30  # of which slips are tried
STARTS, SPREAD = 9, 0.6  # poses of the workspace from which others are looked for, in its half widths
FOLLOWED = 60  # steps
SHIFTED = 10.0  # a shift of readings in units of its scatter, from which on it is one for all
NAMED = 4  # channels in a message
COMMON = 5.0  # misfit of a row without one of its channels, in units of the others' median, up to which it is explained
LOOK = "look at units, signs, zeros, order of channels and of rows"
ERRORS = np.geomspace(1e-4, 1e2, 25)  # mm, of every leg

type LikelihoodOf = Callable[[LegData, np.ndarray], Likelihood]
"""Returns the density of data that are some of the measured poses, (Q,)."""


@dataclass(frozen=True, eq=False)
class Suspicion:
    """Readings of one variant, whose slips are looked for.

    Attributes
    ----------
    posterior : CalibrationPosterior
        With the poses at which the nominal machine explains the readings best.
    low, high : ndarray, shape (q,)
        The workspace, mm and rad.
    """

    posterior: CalibrationPosterior
    low: Array
    high: Array

    @property
    def likelihood(self) -> CalibrationLikelihood:
        """The density of the readings as they are."""
        return self.posterior.likelihood

    @cached_property
    def _rows(self) -> np.ndarray:
        """The rows that slips are tried of."""
        n = self.likelihood.data.n_poses
        return np.unique(np.linspace(0, n - 1, min(MOST_ROWS, n)).astype(int))

    def find(self, denied: Collection[str] = ()) -> FoundSlip | None:
        """Return the slip that explains the readings several times better; None where none does that is not denied."""
        found = find_slip(self.weigh, Columns(self.likelihood.data.values), self.list_slips(), BETTER, denied)
        return self._leave_out() if found is None and not denied else found

    def list_slips(self) -> Iterator[Slip[Columns]]:
        """Yield what may have happened to the readings."""
        model = self.likelihood.model
        units = [one.unit for one in model.channels]
        return list_reading_slips(model.names, units, self.likelihood.data.values, model.given)

    def weigh(self, data: Columns, chosen: np.ndarray | None) -> Weight:
        """Return how well readings fit, those of some rows where these are given."""
        of = np.arange(self.likelihood.data.n_poses) if chosen is None else chosen
        values = data.values if len(data.values) == len(of) else data.values[of]
        some = np.isin(of, self._rows)
        return weigh_rows(lambda: self.judge(Columns(values[some], data.circular), of[some]))

    def judge(self, data: Columns, rows: np.ndarray) -> tuple[Array, int]:
        """Return how far readings (Q, K) of some rows lie from any machine, in their noise, (Q,), and how many count.

        The rms of what no pose explains beside the best machine to first order; infinite for poses that are not found,
        and for those that leave nothing over.
        """
        moved = self._with(data, rows)
        posterior = replace(self.posterior, likelihood=moved)
        y = np.zeros(posterior.n_parameters)
        white = moved.whiten(*posterior.likelihood.noise(posterior.errors, posterior.zeta(y[None])))
        pose = self._locate(posterior, rows)
        error, slope, by_coordinates = posterior.likelihood.rows(*posterior.around(y), white, pose[None])
        found = np.isfinite(error).all(axis=1) & (moved.n_spare > 0)
        beside, n_spare = project_out(slope[found]), moved.n_spare[found]
        rest, moves = np.einsum("pij,pj->pi", beside, error[found]), beside @ by_coordinates[found]
        result = np.full(len(error), np.inf)
        result[found] = fit_rows(rest, moves, n_spare)
        return result, int(moved.n_spare.sum())

    def _with(self, data: Columns, rows: np.ndarray) -> CalibrationLikelihood:
        likelihood = self.likelihood
        some = likelihood.data.pick(rows)
        model = likelihood.model
        if data.circular:  # readings that are compared on a circle
            channels = enumerate(model.channels)
            model = replace(
                model, channels=tuple(replace(one, period=TURN) if k in data.circular else one for k, one in channels)
            )
        return replace(
            likelihood,
            model=model,
            data=replace(some, values=data.values),
            start=likelihood.start[rows],
            expansion=None,
        )

    def _locate(self, posterior: CalibrationPosterior, rows: np.ndarray) -> Array:
        """Return where the nominal machine explains readings best, (Q, q), poses of the workspace tried besides."""
        likelihood = posterior.likelihood
        y = np.zeros((1, posterior.n_parameters))
        with np.errstate(all="ignore"):
            _, at = posterior.likelihood.explain(*posterior.at(y))
        pose, lost = at.pose[0], ~np.isfinite(at.error[0]).all(axis=1) | (at.square[0] > self._usual[rows])
        if not lost.any() or not pose.shape[1]:
            return np.asarray(pose)
        which = np.flatnonzero(lost)
        some, rng = likelihood.pick(which), np.random.default_rng(0)
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        elsewhere = middle + SPREAD * half * np.vstack([0.0 * half, rng.uniform(-1.0, 1.0, (STARTS - 1, len(half)))])
        starts = np.concatenate([some.start[None], np.repeat(elsewhere[:, None], len(which), axis=1)])
        white = some.whiten(*some.noise(posterior.errors, posterior.zeta(y)))
        with np.errstate(all="ignore"):
            found, square = search_poses(some, posterior.sampling.start, white, starts)
        square = np.where(np.isfinite(square), square, np.inf)
        best = square.argmin(axis=0)
        before = np.where(np.isfinite(at.square[0]), at.square[0], np.inf)[which]
        better = square.min(axis=0) < before
        pose = pose.copy()
        pose[which[better]] = found[best, np.arange(len(which))][better]
        return np.asarray(pose)

    @cached_property
    def _usual(self) -> Array:
        """Four times the r² that tolerances let expect, (P,); for rows beyond it poses are looked for elsewhere."""
        posterior = self.posterior
        y = np.zeros(posterior.n_parameters)
        with np.errstate(all="ignore"):
            white, at = posterior.likelihood.explain(*posterior.at(y[None]))
            _, slope, by_coordinates = posterior.likelihood.rows(*posterior.around(y), white, at.pose)
            moved = project_out(slope) @ by_coordinates
        size = np.einsum("pkm,pkm->p", moved, moved) + posterior.likelihood.n_spare
        return np.where(np.isfinite(size), 4.0 * size, np.nanmedian(4.0 * size) if np.isfinite(size).any() else 0.0)

    # --- one channel that does not fit the others --------------------------------------------------------------------

    def _leave_out(self) -> FoundSlip | None:
        """Return the channel without which all others fit, in words that say what it reads."""
        likelihood, rows = self.likelihood, self._rows
        before = self.weigh(Columns(likelihood.data.values), None).misfit
        if before <= BETTER or likelihood.data.n_poses < 3:
            return None
        found: list[tuple[float, int]] = []
        for k in range(len(likelihood.model.channels)):
            values = likelihood.data.values.copy()
            values[:, k] = np.nan
            off, spare = self.judge(Columns(values[rows]), rows)
            after = float(np.median(off))
            if spare >= len(rows) and before > BETTER * after and spare * np.log(before / max(after, 1.0)) > CLEARLY:
                found.append((after, k))
        if not found:
            return None
        after, k = min(found)
        factor = before / max(after, 1.0)
        return FoundSlip(CHANNEL, self._describe(k), float("inf"), factor if np.isfinite(factor) else None)

    def _describe(self, k: int) -> str:
        """Return what a channel reads that the others contradict: always the same, all shifted alike, or anything."""
        likelihood, channel = self.likelihood, self.likelihood.model.channels[k]
        measured, predicted = likelihood.data.values[:, k], self._predict(k)
        good = np.isfinite(measured) & np.isfinite(predicted)
        unit, off = channel.unit, (measured - predicted)[good]
        if np.ptp(measured[good]) <= 2.0 * float(np.median(likelihood.sd[good, k])) < np.ptp(predicted[good]):
            return (
                f"{channel.name} does not move: it reads {measured[good][0]:.6g} {unit} in all rows, where the other "
                f"channels say {predicted[good].min():.4g} to {predicted[good].max():.4g} {unit}"
            )
        middle = float(np.median(off))
        if abs(middle) > SHIFTED * float(np.median(np.abs(off - middle))):
            return (
                f"readings of {channel.name} seem to have another zero, {middle:+.4g} {unit} off in all rows by what "
                "the other channels say"
            )
        slope = np.polyfit(predicted[good], measured[good], 1)
        left = measured[good] - np.polyval(slope, predicted[good])
        if np.ptp(off) > SHIFTED * np.median(np.abs(left)) and abs(slope[0]) > 0.01:
            return f"readings of {channel.name} seem to be {slope[0]:.4g} times what the other channels say"
        return f"readings of {channel.name} do not fit those of the other channels, which fit each other"

    def _predict(self, k: int) -> Array:
        """Return what the nominal machine reads of a channel where the other ones say that it stands, (P,)."""
        likelihood = self.likelihood
        values = likelihood.data.values.copy()
        values[:, k] = np.nan
        rows = np.arange(len(values))
        pose = self._locate(replace(self.posterior, likelihood=self._with(Columns(values), rows)), rows)
        return np.asarray(likelihood.model.read(self.posterior.sampling.start, pose, likelihood.data.given)[:, k])


def find_measured_slip(variants: Sequence[MeasuredReadings], denied: Collection[str] = ()) -> FoundSlip | None:
    """Return what explains the readings many times better than they are; None where some variant fits them.

    Parameters
    ----------
    variants : sequence of MeasuredReadings
        The same measurements, or such of the same kind, under models one of which may be right.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    legs = [one.legs for one in variants if one.legs is not None]
    if legs:
        start, stated = legs[0].machine.mechanism.initial_actuator_positions, max(map(state_error, legs))
        return find_leg_slip((suspect_poses(one, stated) for one in legs), start, denied)
    return find_calibration_slip((Suspicion(one.posterior, one.low, one.high) for one in variants), denied)


def find_calibration_slip(variants: Iterable[Suspicion], denied: Collection[str] = ()) -> FoundSlip | None:
    """Return the slip that explains readings several times better than they are; None where none does.

    Of variants of the same readings the one that comes nearest is asked: where one of them fits, nothing has slipped.
    """
    groups: dict[tuple[tuple[str, ...], ...], list[Suspicion]] = {}
    for one in variants:
        alike = (tuple(one.likelihood.model.names), tuple(one.likelihood.data.poses))
        groups.setdefault(alike, []).append(one)
    for group in groups.values():
        nearest = min(group, key=lambda one: one.weigh(Columns(one.likelihood.data.values), None).misfit)
        found = nearest.find(denied)
        if found is not None:
            return found
    return None


# --- rows that the nominal machine cannot reach ------------------------------------------------------------------


def check_reach(suspicion: Suspicion) -> None:
    """Raise InputError for a row whose readings the machine has nowhere, neither as expected nor within its tolerances.

    The message names the row, the channels that have no reading where the others lead, and the slip that mends it.
    """
    posterior, data = suspicion.posterior, suspicion.likelihood.data
    lost = _find_lost(posterior)
    off = suspicion.judge(Columns(data.values), np.arange(data.n_poses))[0]
    if not lost.any() and not np.max(np.where(posterior.likelihood.n_spare > 0, off, 0.0), initial=0.0) > OUTLYING:
        return
    if _is_fitted(posterior):
        return
    k = int(np.argmax(lost)) if lost.any() else int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
    row, what = f"row {k + 1} (pose {data.poses[k]!r})", _name_channels(posterior, k)
    said = f"{row} cannot be reached by the nominal machine: {what}"
    if not lost.any():
        said = f"{row} cannot be reached by any machine within the tolerances: {what}"
    n_lost = int(lost.sum() if lost.any() else np.sum(off > OUTLYING * max(float(np.median(off)), 1.0)))
    said += f"; {n_lost} of {data.n_poses} rows are like it" if n_lost > 1 else ""
    slip = suspicion.find()
    if slip is not None:
        raise InputError(f"{said}; {slip.say()}")
    alone = _blame(suspicion, k) if n_lost <= data.n_poses / 2 else ""
    raise InputError(f"{said}; without {alone} the row fits: look at that reading" if alone else f"{said}; {LOOK}")


def _find_lost(posterior: CalibrationPosterior) -> np.ndarray:
    """Return which rows the nominal machine has no pose of, (P,)."""
    with np.errstate(all="ignore"):
        _, at = posterior.likelihood.explain(*posterior.at(np.zeros((1, posterior.n_parameters))))
    return np.asarray(~np.isfinite(at.error[0]).all(axis=1))


def _is_fitted(posterior: CalibrationPosterior) -> bool:
    """Whether least squares lead to a machine that has all rows, from which a search of the mode can start."""
    try:
        with np.errstate(all="ignore"):
            near = posterior.anchored()
            return bool(np.isfinite(near.log_density(near.approach()[None]))[0])
    except (NumericalError, np.linalg.LinAlgError):
        return False


def _name_channels(posterior: CalibrationPosterior, row: int) -> str:
    """Return which channels have no reading where a row's readings lead, and where that is."""
    likelihood = posterior.likelihood.pick(np.array([row]))
    white = likelihood.whiten(
        *likelihood.noise(posterior.errors, posterior.zeta(np.zeros((1, posterior.n_parameters))))
    )
    model, pose, theta = likelihood.model, likelihood.start[None].copy(), posterior.sampling.start[None]
    given = {name: value[None] for name, value in likelihood.data.given.items()}
    best = pose
    with np.errstate(all="ignore"):
        for _ in range(FOLLOWED):
            error, slope, _ = likelihood.linearise(theta, pose, white)
            read = model.read(theta[:, None], pose, given)[0, 0]
            missing = np.flatnonzero(~np.isfinite(read) & likelihood.data.present[0])
            if len(missing):
                return _say_missing(posterior, missing, pose[0, 0])
            best = pose
            step, _ = find_step(slope, error)
            if not np.isfinite(step).all():
                break
            pose = pose + step
        error, _, _ = likelihood.linearise(theta, best, white)
        raw = likelihood.comparison.subtract(likelihood.data.values, model.read(theta[:, None], best, given))[0, 0]
    worst = int(np.nanargmax(np.where(likelihood.data.present[0], np.abs(error[0, 0]), np.nan)))
    channel = model.channels[worst]
    return (
        f"channel {channel.name} reads {likelihood.data.values[0, worst]:.6g} {channel.unit}, "
        f"{format_significant(abs(raw[worst]), 3)} {channel.unit} from what it reads at the nearest pose"
    )


def _say_missing(posterior: CalibrationPosterior, missing: np.ndarray, pose: Array) -> str:
    model = posterior.likelihood.model
    names = [model.channels[k].name for k in missing]
    said = names if len(names) <= NAMED else [*names[: NAMED - 1], f"{len(names) - NAMED + 1} more"]
    place = ", ".join(f"{one.name} = {x:.4g} {one.unit}" for one, x in zip(model.coordinates, pose, strict=True))
    return (
        f"channel{'s' if len(names) > 1 else ''} {join_words(said)} {'have' if len(names) > 1 else 'has'} no reading "
        f"at {place}, where the row's readings lead"
    )


def _blame(suspicion: Suspicion, row: int) -> str:
    """Return the channel without which a row fits as the others do; empty where there is none."""
    data = suspicion.likelihood.data
    off = []
    for k in np.flatnonzero(data.present[row]):
        values = data.values.copy()
        values[row, k] = np.nan
        try:
            found, _ = suspicion.judge(Columns(values), np.arange(data.n_poses))
        except np.linalg.LinAlgError:
            continue
        others = np.delete(found, row)
        if found[row] <= COMMON * max(float(np.median(others)), 1.0):
            off.append((float(found[row]), suspicion.likelihood.model.channels[k].name))
    return min(off)[1] if off else ""


# --- machines on legs --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Suspect:
    """Data under one machine on legs, in which slips are looked for.

    They are weighed with an error of the legs as large as suits each case best.

    Attributes
    ----------
    likelihood_of : LikelihoodOf
    start : ndarray, shape (D,)
        The machine.
    free, scale : ndarrays, shape (n,)
        Which of its parameters are free, and their tolerances.
    data : LegData
    stated : float
        Error of a leg that noise and model error let expect, mm.
    """

    likelihood_of: LikelihoodOf
    start: Array
    free: np.ndarray
    scale: Array
    data: LegData
    stated: float

    def weigh(self, data: LegData, chosen: np.ndarray | None) -> Weight:
        """Return how well data fit under the priors to first order; some of the measured poses where these are given.

        The covariance is C + S Sᵀ, S the slope by the parameters in tolerances, by the determinant lemma.
        """
        some = np.arange(len(data.actuators)) if chosen is None else chosen
        picked = data if len(data.actuators) == len(some) else data.pick(some)
        try:
            with np.errstate(all="ignore"):
                likelihood = self.likelihood_of(picked, some)
                errors, slope = likelihood.error_jacobian(self.start)
                slope = slope[..., self.free] * self.scale
                if not (np.isfinite(errors).all() and np.isfinite(slope).all()):
                    return NOTHING
                n = likelihood.n_model_errors
                densities = [
                    _log_density(errors, slope, likelihood.error_covariance(np.full(n, size))) for size in ERRORS
                ]
        except (BayescalError, np.linalg.LinAlgError):
            return NOTHING
        best = int(np.argmax(densities))
        return Weight(densities[best], float(ERRORS[best]) / self.stated)


def _log_density(errors: Array, slope: Array, covariance: Array) -> float:
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, errors[..., None])[..., 0]
    rows = np.linalg.solve(factor, slope)
    log_det = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    along = np.einsum("pik,pi->k", rows, white)
    inner = np.eye(slope.shape[-1]) + np.einsum("pik,pil->kl", rows, rows)
    _, more = np.linalg.slogdet(inner)
    square = float(np.sum(white**2) - along @ np.linalg.solve(inner, along))
    return -0.5 * (square + log_det + float(more))


def find_leg_slip(suspects: Iterable[Suspect], start: Array, denied: Collection[str] = ()) -> FoundSlip | None:
    """Return the slip that explains the data best; None where some machine fits, or none helps.

    Parameters
    ----------
    suspects : iterable of Suspect
        The same data under machines one of which may be right.
    start : ndarray, shape (N,)
        Initial positions, mm.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    weighed: list[tuple[Weight, Suspect]] = []
    for one in suspects:
        weighed.append((one.weigh(one.data, None), one))
        if weighed[-1][0].misfit < REREAD:
            return None
    _, best = max(weighed, key=lambda pair: pair[0].log_density)
    return find_slip(best.weigh, best.data, list_leg_slips(best.data, start), REREAD, denied)


def suspect_poses(measured: MeasuredVariant, stated: float, whole: bool = False) -> Suspect:
    """Return measured poses in which slips are looked for; of the poses' own form, too, where these are ``whole``."""
    likelihood_of = weigh_poses(measured.machine, measured.poses, measured.actuator_noise)
    data = LegData(measured.poses.actuators, measured.poses if whole else None)
    known = measured.posterior.sampling.coordinates
    return Suspect(likelihood_of, known.start, known.free, known.scale, data, stated)


def weigh_poses(machine: Machine, poses: MeasuredPoses, noise: float) -> LikelihoodOf:
    """Return what makes the density of data that are some of the poses, read otherwise where the data say so."""

    def likelihood_of(data: LegData, chosen: np.ndarray) -> Likelihood:
        moved = poses.select(chosen) if data.poses is None else data.poses
        return PoseLikelihood(machine, replace(moved, actuators=data.actuators), noise)

    return likelihood_of


def find_recheck_slip(calibrated: CalibratedMachine, poses: MeasuredPoses) -> FoundSlip | None:
    """Return what explains poses measured after a calibration many times better than they are; None without any.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With its posterior's covariance.
    poses : MeasuredPoses
        Whole, in the base frame.
    """
    sd, start = calibrated.sd, calibrated.legs.mechanism.initial_actuator_positions
    free = np.flatnonzero(sd > 0.0)
    of_legs = (np.diagonal(calibrated.errors.noise) + calibrated.errors.model_variance).mean()
    weigh, stated = weigh_poses(calibrated.legs, poses, 0.0), float(np.sqrt(of_legs + _position_variance(poses)))
    return find_leg_slip([Suspect(weigh, calibrated.theta, free, sd[free], LegData(poses.actuators), stated)], start)


def state_error(measured: MeasuredVariant) -> float:
    """Return what a leg may err by as stated: model error, actuators, the measured position, mm."""
    scale = measured.posterior.errors.model_error.scale or 0.0
    return float(np.sqrt(_position_variance(measured.poses) + scale**2 + measured.actuator_noise**2))


def _position_variance(poses: MeasuredPoses) -> float:
    return float(np.diagonal(poses.covariance, axis1=1, axis2=2)[:, :3].mean())
