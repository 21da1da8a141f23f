"""Tables of a recheck: the plan that an operator takes to the machine, and the poses that come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.recheck.judge import Recheck
from bayescal.calibrated.recheck.plan import RecheckPlan
from bayescal.calibrated.tables import read_commands
from bayescal.data.actuators import check_range, name_actuators
from bayescal.data.instruments.plausible import check_units
from bayescal.data.instruments.poses import COORDINATES, PoseReadings
from bayescal.data.instruments.read_poses import UNITS, PoseNoise, read_poses
from bayescal.data.instruments.tables import name_covariances, read_covariances
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import format_table, read_table
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

PERCENT = 100.0


def build_covariance(position_um: float, orientation_arcsec: float) -> Array:
    """Return the covariance of a measured pose (6, 6), mm and rad, of equal errors along all axes."""
    sd = [MICROMETRE * position_um] * 3 + [ARCSECOND * orientation_arcsec] * 3
    return np.diag(np.square(sd))


def read_mean_covariance(path: Path) -> Array:
    """Return the mean covariance (6, 6) of the poses of a table, mm and rad."""
    upper, lower = name_covariances(COORDINATES)
    table = read_table(path, ("pose",), (*read_table(path, None).columns, *upper, *lower))
    covariance = read_covariances(table, COORDINATES, np.ones((len(table.rows), len(COORDINATES)), dtype=bool))
    if covariance is None:
        raise InputError(f"{path}: found no covariances, expected cov_x_x ... cov_rz_rz of whole poses")
    return np.asarray((covariance * np.outer(UNITS, UNITS)).mean(axis=0))


def read_candidates(path: Path, calibrated: CalibratedMachine) -> Array:
    """Return the actuator positions (C, N), mm, that a plan may choose from."""
    return read_commands(path, calibrated)[1]


def has_noise(path: Path) -> bool:
    """Return whether a table of poses states its noise itself."""
    columns = read_table(path, None).columns
    return any(name.startswith(("cov_", "sd_")) for name in columns)


def read_session(path: Path, actuators: Path | None, noise: PoseNoise, calibrated: CalibratedMachine) -> MeasuredPoses:
    """Return the poses of a session, whole and in the base frame; actuator positions from its table or the plan's.

    Raises
    ------
    InputError
        For anything at fault in the tables, a pose that is not measured whole, and positions out of range.
    """
    readings = _read(path, actuators, noise, calibrated.legs.mechanism.n_legs)
    mechanism = calibrated.legs.mechanism
    with name_faults(path if actuators is None else actuators):
        check_range(readings.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, readings.names)
    check_units(calibrated.legs, readings, path)
    return readings.poses


def _read(path: Path, actuators: Path | None, noise: PoseNoise, n_legs: int) -> PoseReadings:
    readings, _ = read_poses(path, actuators, noise, n_legs)
    if not readings.is_whole():
        raise InputError(f"{path}: found poses measured in part, expected positions and rotations of all")
    return readings


def format_plan(calibrated: CalibratedMachine, plan: RecheckPlan, title: str) -> str:
    """Return a plan as CSV text: the poses of one session, the most telling first."""
    comments = [
        *calibrated.source.describe(),
        title,
        "Measure position and orientation of the platform at each, in the base frame, as pose, x_mm, y_mm, z_mm,",
        "rx_deg, ry_deg, rz_deg; then: bayescal recheck RESULTS --measured THAT.csv --actuators THIS.csv",
    ]
    columns = ["pose", "use", *name_actuators(calibrated.legs.mechanism.n_legs)]
    rows = [(f"R{k:02d}", "calibration", *(f"{x:.6f}" for x in one)) for k, one in enumerate(plan.actuators, start=1)]
    return format_table(comments, columns, rows)


def describe_plan(plan: RecheckPlan) -> str:
    """Return in a sentence what a plan does."""
    demand, by_session = plan.demand, PERCENT * plan.power_by_session
    n, worst = len(plan.chosen), PERCENT * plan.power.min()
    sessions = "one session" if demand.sessions == 1 else f"{demand.sessions} sessions"
    first = "" if demand.sessions == 1 else f", {by_session[0]:.0f} % in the first"
    return (
        f"{n} pose{'s' if n > 1 else ''} a session tell a shift of any leg by {demand.shift / MICROMETRE:g} µm with "
        f"{worst:.1f} % in {sessions}{first}; false alarms {PERCENT * demand.false_alarm:g} % over all of them"
    )


def describe_recheck(found: Recheck) -> list[str]:
    """Return in lines what a recheck says."""
    largest = float(np.abs(found.statistic).max())
    alarms = f"{PERCENT * found.false_alarm:g} % false alarms"
    test = f"largest statistic {largest:.2f}, limit {found.threshold:.2f} for {alarms}"
    leg = found.leg
    shift, sd = found.shift / MICROMETRE, found.sd / MICROMETRE
    if found.holds:
        lines = [f"the calibration holds: {test}"]
    else:
        sure = PERCENT * found.probability[leg]
        lines = [
            f"leg {leg + 1} moved by {shift[leg]:+.1f} ± {sd[leg]:.1f} µm ({sure:.1f} % that it is this leg): {test}"
        ]
    lines += [
        f"leg {k + 1}: {x:+.1f} ± {s:.1f} µm if it alone moved" for k, (x, s) in enumerate(zip(shift, sd, strict=True))
    ]
    if found.is_odd:
        lines.append(
            "but what was measured fits neither the calibration nor one leg's shift "
            f"(probability {found.left_over:.1g}): several legs, a frame or the instrument may be off"
        )
    return lines
