"""Rows that the nominal machine cannot reach: refused as data are read, by row, channel and likely cause."""

from __future__ import annotations

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.elimination import find_step
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.shared.slip_rows import OUTLYING, STARTS, RowReadings, VariantReadings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_significant, join_words

FOLLOWED = 60  # steps
NAMED = 4  # channels in a message
COMMON = 5.0  # misfit of a row without one of its channels, in units of the others' median, up to which it is explained
LOOK = "check units, signs, zeros, order of channels and rows"


def check_reach(readings: VariantReadings, calibrating: VariantReadings | None = None) -> None:
    """Raise InputError for a row whose readings the machine has nowhere, neither as expected nor within its tolerances.

    The message names the row, the channels that have no reading where the others lead, and the slip that mends it: of
    all rows, or of those that calibrate where these are others.
    """
    posterior, data = readings.posterior, readings.posterior.likelihood.data
    lost, off = _find_lost(posterior), readings.measure_rows()
    if np.max(off, initial=0.0) > OUTLYING:  # perhaps of poses that were not found
        off = np.minimum(off, readings.measure_rows(STARTS))
    if not lost.any() and not np.max(off, initial=0.0) > OUTLYING:
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
    alone = _blame(readings, k) if n_lost == 1 else ""
    slip = None if alone else find_slip([readings])
    if slip is None and not alone and calibrating is not None:
        slip = find_slip([calibrating])
    if slip is not None:
        raise InputError(f"{said}; {slip.say()}")
    alone = alone or (_blame(readings, k) if 1 < n_lost <= data.n_poses / 2 else "")
    raise InputError(f"{said}; without {alone} the row fits: check it" if alone else f"{said}; {LOOK}")


def _find_lost(posterior: CalibrationPosterior) -> np.ndarray:
    """Return which rows the nominal machine has no pose of, (P,)."""
    with np.errstate(all="ignore"):
        _, at = posterior.likelihood.explain(*posterior.at(posterior.begin[None]))
    return np.asarray(~np.isfinite(at.error[0]).all(axis=1))


def _is_fitted(posterior: CalibrationPosterior) -> bool:
    """Whether least squares lead to a machine that has all rows, from which a search of the mode can start."""
    try:
        with np.errstate(all="ignore"):
            near = posterior.with_pose_guesses()
            at = near.at(near.least_squares_start()[None])
            # a fast form reads what the machine, far from its anchor, does not
            return bool(np.isfinite(near.likelihood.density(*at) + near.likelihood.whole.density(*at))[0])
    except (NumericalError, np.linalg.LinAlgError):
        return False


def _name_channels(posterior: CalibrationPosterior, row: int) -> str:
    """Return which channels have no reading where a row's readings lead, and where that is."""
    likelihood = posterior.likelihood.pick(np.array([row]))
    white = likelihood.whiten(*likelihood.noise(posterior.errors, posterior.zeta(posterior.begin[None])))
    model, pose, theta = likelihood.model, likelihood.start[None].copy(), posterior.theta(posterior.begin[None])
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
        f"{format_significant(abs(raw[worst]), 3)} {channel.unit} off the nearest pose"
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


def _blame(readings: VariantReadings, row: int) -> str:
    """Return the channel without which a row fits as the others do; empty where there is none."""
    likelihood, found = readings.posterior.likelihood, list[tuple[float, str]]()
    for k in np.flatnonzero(likelihood.data.present[row]):
        values = likelihood.data.values.copy()
        values[row, k] = np.nan
        moved = readings.with_table(RowReadings(values, np.arange(len(values))))
        off = moved.measure_rows()
        others = np.delete(off, row)
        if off[row] <= COMMON * max(float(np.median(others)) if len(others) else 0.0, 1.0):
            found.append((float(off[row]), readings.channels[k].name))
    return min(found)[1] if found else ""
