"""Tables of a recheck: the plan that an operator takes to the machine, and the readings that come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.recheck.plan import RecheckPlan
from bayescal.calibrated.recheck.statistics import Recheck, say_shift, say_size
from bayescal.calibrated.tables import name_column, read_commands
from bayescal.data.actuators import check_range
from bayescal.data.instruments.read_poses import (
    DEVIATIONS,
    UNITS,
    PoseNoise,
    check_positive,
    name_covariances,
    read_noise,
    read_poses,
)
from bayescal.data.instruments.readings import COORDINATES, PoseReadings, check_units
from bayescal.density.calibration.measurements import Measurements
from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import format_table, read_table
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

PERCENT = 100.0


# --- measured poses of legs ----------------------------------------------------------------------------------------


def build_covariance(position_um: float, orientation_arcsec: float) -> Array:
    """Return the covariance of a measured pose (6, 6), mm and rad, of equal errors along all axes."""
    sd = [MICROMETRE * position_um] * 3 + [ARCSECOND * orientation_arcsec] * 3
    return np.diag(np.square(sd))


def read_mean_covariance(path: Path) -> Array:
    """Return the mean covariance (6, 6) of the poses of a table, mm and rad, by covariances or by ``sd_`` columns."""
    upper, lower = name_covariances(COORDINATES)
    table = read_table(path, ("pose",), (*read_table(path, None).columns, *upper, *lower))
    if not any(name in table.columns for name in (*upper, *DEVIATIONS)):
        raise InputError(f"{path}: found no noise, expected cov_x_x ... cov_rz_rz or sd_x_um ... sd_rz_urad")
    whole = np.ones((len(table.rows), len(COORDINATES)), dtype=bool)
    covariance = read_noise(table, PoseNoise(), whole)
    check_positive(table, covariance, whole)
    return np.asarray((covariance * np.outer(UNITS, UNITS)).mean(axis=0))


def expect_pose(calibrated: CalibratedMachine, covariance: Array) -> Measurements:
    """Return a row that says that a pose of a machine on legs is measured, with a covariance (6, 6), mm and rad."""
    n_legs = len(calibrated.commanded)
    return place_poses(("plan",), np.zeros((1, n_legs)), np.zeros((1, DEGREES_OF_FREEDOM)), covariance[None])


def place_poses(names: tuple[str, ...], actuators: Array, values: Array, covariance: Array) -> Measurements:
    """Return poses (P, 6) measured at actuator positions (P, N), mm and rad, as readings of legs.

    Parameters
    ----------
    names : tuple of str
    actuators : ndarray, shape (P, N)
    values : ndarray, shape (P, 6)
        NaN where not measured.
    covariance : ndarray, shape (P, 6, 6)
        Of what is measured.
    """
    n = actuators.shape[1]
    measured = np.isfinite(values)
    both = measured[:, :, None] & measured[:, None, :]
    covariance = np.where(both, covariance, np.eye(DEGREES_OF_FREEDOM))
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(n + DEGREES_OF_FREEDOM), (len(values), 1, 1))
    correlation[:, n:, n:] = covariance / (sd[:, :, None] * sd[:, None, :])
    every = np.concatenate([actuators, values], axis=1)
    return Measurements(names, every, np.concatenate([np.ones_like(actuators), sd], axis=1), {}, correlation)


def has_noise(path: Path) -> bool:
    """Return whether a table of poses states its noise itself."""
    columns = read_table(path, None).columns
    return any(name.startswith(("cov_", "sd_")) for name in columns)


def read_session(path: Path, actuators: Path | None, noise: PoseNoise, calibrated: CalibratedMachine) -> PoseReadings:
    """Return the poses of a session in the base frame; actuator positions from its table or the plan's.

    Raises
    ------
    InputError
        For anything at fault in the tables, a rotation that is measured in part, and positions out of range.
    """
    machine = calibrated.legs
    mechanism = machine.mechanism
    readings, _ = read_poses(path, actuators, noise, mechanism.n_legs)
    turned = np.isfinite(readings.values[:, 3:])
    for k in np.flatnonzero(turned.any(axis=1) & ~turned.all(axis=1))[:1]:
        raise InputError(f"{path}: pose {readings.names[k]!r}: found a rotation measured in part, expected all or none")
    with name_faults(path if actuators is None else actuators):
        check_range(readings.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, readings.names)
    check_units(machine, readings, path)
    return readings


# --- readings of any machine ---------------------------------------------------------------------------------------


def expect_readings(sd: Array) -> Measurements:
    """Return a row that says which channels are read, by their noise (K,); NaN for those that are not."""
    return Measurements(("plan",), np.where(np.isfinite(sd), 0.0, np.nan)[None], np.nan_to_num(sd, nan=1.0)[None])


def add_commands(path: Path, plan: Path | None, readings: Measurements, calibrated: CalibratedMachine) -> Measurements:
    """Return a session's readings with the commanded channels of a plan, by the poses' names.

    Raises
    ------
    InputError
        Where commands stand in both or in none, or a pose is not in the plan.
    """
    own, values, given = calibrated.commanded, readings.values.copy(), dict(readings.given)
    there = np.isfinite(values[:, own]).any()
    if plan is None:
        missing = [one.name for one in calibrated.command_channels]
        if not there:
            raise InputError(
                f"{path}: found no reading of {', '.join(missing)}, expected it there, or --actuators PLAN.csv"
            )
        return readings
    if there:
        raise InputError(f"{path}: found commanded channels beside those of {plan}, expected them once")
    names, commands, known = read_commands(plan, calibrated)
    for name in readings.poses:
        if name not in names:
            raise InputError(f"{path}: pose {name!r} is not in {plan}, expected it there")
    rows = [names.index(name) for name in readings.poses]
    values[:, own] = commands[rows]
    given |= {name: value[rows] for name, value in known.items()}
    return Measurements(readings.poses, values, readings.sd, given, readings.correlation)


def check_noise(path: Path, readings: Measurements, calibrated: CalibratedMachine) -> None:
    """Raise InputError for a reading whose noise is not known; that of commanded channels is the machine's own."""
    channels, own = calibrated.model.channels, np.isin(np.arange(len(calibrated.model.channels)), calibrated.commanded)
    for k, channel in np.argwhere(readings.present & ~np.isfinite(readings.sd) & ~own)[:1]:
        one = channels[channel]
        raise InputError(
            f"{path}: pose {readings.poses[k]!r}: found a reading of {one.name} without noise, expected a column "
            f"{one.stem}_sd_{one.unit}, or --like"
        )
    for name, value in readings.given.items():
        for k in np.flatnonzero(~np.isfinite(value))[:1]:
            raise InputError(f"{path}: pose {readings.poses[k]!r}: found no {name}, expected it")


# --- what is written -----------------------------------------------------------------------------------------------


def format_plan(calibrated: CalibratedMachine, plan: RecheckPlan, title: str) -> str:
    """Return a plan as CSV text: the poses of one session, the one that shows most first."""
    channels = calibrated.command_channels
    back = "then: bayescal recheck RESULTS --measured THAT.csv --actuators THIS.csv"
    if isinstance(calibrated.model, Legs):
        how = [
            "Measure position and orientation of the platform at each, in the base frame, as pose, x_mm, y_mm, z_mm,",
            f"rx_deg, ry_deg, rz_deg; {back}",
        ]
    else:
        how = ["Read the channels at each, as in the data of the calibration;", back]
    comments = [*calibrated.source.describe(), title, *how]
    columns = ["pose", "use", *plan.given, *map(name_column, channels)]
    turned = np.array([180.0 / np.pi if one.rotation else 1.0 for one in channels])
    known = list(zip(*plan.given.values(), strict=True)) or [()] * len(plan.commands)
    rows = [
        (f"R{k:02d}", "calibration", *map(repr, map(float, own)), *(f"{x:.6f}" for x in one))
        for k, (own, one) in enumerate(zip(known, plan.commands * turned, strict=True), start=1)
    ]
    return format_table(comments, columns, rows)


def describe_plan(plan: RecheckPlan) -> str:
    """Return in a sentence what a plan does."""
    demand, by_session = plan.demand, PERCENT * plan.power_by_session
    n, worst = len(plan.chosen), PERCENT * plan.power.min()
    sessions = "one session" if demand.sessions == 1 else f"{demand.sessions} sessions"
    first = "" if demand.sessions == 1 else f", {by_session[0]:.0f} % in the first"
    return (
        f"{n} pose{'s a session show' if n > 1 else ' a session shows'} a shift of {_describe_shift(plan)} with "
        f"{worst:.1f} % in {sessions}{first}; false alarms {PERCENT * demand.false_alarm:g} % over all of them"
    )


def _describe_shift(plan: RecheckPlan) -> str:
    """Return whose shift is found, and how large it is."""
    suspects, shift = plan.suspects, plan.demand.shift
    any_of_them = f"any {suspects.kind}" if len(shift) > 1 else suspects.names[0]
    if plan.demand.in_sd is not None:
        return f"{any_of_them} by {plan.demand.in_sd:g} of its standard deviations"
    return f"{any_of_them} by {say_size(float(shift[0]), suspects.units[0])}"


def describe_recheck(found: Recheck) -> list[str]:
    """Return in lines what a recheck says."""
    suspects, worst = found.suspects, found.worst
    largest = float(np.abs(found.statistic).max())
    alarms = f"{PERCENT * found.false_alarm:g} % false alarms"
    test = f"largest statistic {largest:.2f}, limit {found.threshold:.2f} for {alarms}"
    sizes = [say_shift(x, s, u) for x, s, u in zip(found.shift, found.sd, suspects.units, strict=True)]
    if found.holds:
        lines = [f"the calibration holds: {test}"]
    else:
        sure, moved = PERCENT * found.probability[worst], "moved" if suspects.kind != "parameter" else "shifted"
        which = f"that it is this {suspects.kind}"
        lines = [f"{suspects.names[worst]} {moved} by {sizes[worst]} ({sure:.1f} % {which}): {test}"]
    lines += [f"{name}: {size} if it alone moved" for name, size in zip(suspects.names, sizes, strict=True)]
    if found.is_odd:
        lines.append(
            f"but what was measured fits neither the calibration nor a shift of one {suspects.kind} "
            f"(probability {found.left_over:.1g}): several of them, a frame or the instrument may be off"
        )
    return lines
