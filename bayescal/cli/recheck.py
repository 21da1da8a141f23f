"""The command that says whether a calibration still holds: it plans poses, and judges what was read at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from bayescal.cli.app import app
from bayescal.cli.console import check_out, put
from bayescal.cli.machine import Calibrated, Config, Force, Table, Variant
from bayescal.cli.options import Trust
from bayescal.errors import InputError, name_faults

if TYPE_CHECKING:
    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.calibrated.recheck.plan import Demand
    from bayescal.calibrated.recheck.statistics import Suspects
    from bayescal.density.calibration.measurements import Measurements
    from bayescal.numerics.geometry import Array

DEFAULT_UM, DEFAULT_ARCSEC, DEFAULT_SD = 20.0, 20.0, 10.0


@app.command(epilog="Example: bayescal recheck results/m2 --position-um 10 --orientation-arcsec 1 --out plan.csv")
def recheck(
    results: Calibrated,
    variant: Variant = None,
    measured: Annotated[
        list[Path] | None, typer.Option(help="CSV file of readings, of poses for legs, once per session: judge them.")
    ] = None,
    actuators: Annotated[Path | None, typer.Option(help="The plan, where --measured lacks what was commanded.")] = None,
    position_um: Annotated[
        float | None, typer.Option(min=1e-3, max=1e5, help="Standard deviation of a measured position, for legs.")
    ] = None,
    orientation_arcsec: Annotated[
        float | None, typer.Option(min=1e-3, max=1e5, help="Standard deviation of a measured rotation.")
    ] = None,
    orientation_urad: Annotated[
        float | None, typer.Option(min=1e-3, max=1e6, help="The same in microradians, in place of arcseconds.")
    ] = None,
    like: Annotated[
        Path | None, typer.Option(help="CSV file of such readings with their noise, in place of options, for a plan.")
    ] = None,
    sensors: Annotated[
        list[str] | None, typer.Option(help="Channels that are read, without legs; default all of known noise.")
    ] = None,
    shift_of: Annotated[
        list[str] | None,
        typer.Option(help="Symbols or parameters that may shift; default the legs' lengths, or all free ones."),
    ] = None,
    shift_um: Annotated[float | None, typer.Option(min=1e-2, max=1e5, help="Shift of a length; default 20.")] = None,
    shift_arcsec: Annotated[float | None, typer.Option(min=1e-3, max=1e6, help="Of an angle; default 20.")] = None,
    shift_sd: Annotated[
        float | None, typer.Option(min=1e-2, max=1e6, help="In standard deviations of the posterior; default 10.")
    ] = None,
    power: Annotated[float, typer.Option(min=0.1, max=0.999, help="Probability of finding it.")] = 0.95,
    false_alarm: Annotated[float, typer.Option(min=1e-3, max=0.5, help="Of all sessions together.")] = 0.01,
    sessions: Annotated[int, typer.Option(min=1, max=12, help="Sessions of the same poses to find it in.")] = 2,
    candidates: Annotated[
        Path | None, typer.Option(help="CSV file of commands to choose from: pose, rho_1_mm ...")
    ] = None,
    share: Annotated[float, typer.Option(min=0.01, max=1.0, help="Of the commands' range, without one.")] = 0.9,
    out: Table = None,
    experiment: Config = None,
    force: Force = False,
    trust: Trust = False,
) -> None:
    """Name the fewest poses that show whether a calibration still holds, or judge what was read at them."""
    from bayescal.calibrated.recheck.plan import list_candidates, plan_recheck
    from bayescal.calibrated.recheck.statistics import choose_suspects, judge_recheck
    from bayescal.calibrated.recheck.tables import describe_plan, describe_recheck, expect_readings, format_plan
    from bayescal.calibrated.tables import read_commands
    from bayescal.experiments.shared.calibrating import load_calibrated
    from bayescal.machines.readings import Legs

    orientation_arcsec = _choose_arcseconds(orientation_arcsec, orientation_urad)
    calibrated = load_calibrated(results, variant, experiment, force, trust)
    if calibrated.covariance is None:
        raise InputError(f"{results}: found no draws of the posterior (posterior/*.nc), expected those of a run")
    check_out(out)
    suspects = choose_suspects(calibrated, shift_of or [])
    legs = isinstance(calibrated.model, Legs)
    stated = _find_stated(results, position_um, orientation_arcsec) if legs else None
    if measured:
        lines, read = [], []
        for path in measured:
            if legs:
                said, session = _read_poses(path, actuators, stated, calibrated)
                lines += said
            else:
                session = _read_readings(path, actuators, _find_noise(calibrated, like, sensors), calibrated)
            read.append(session)
        with name_faults(results):
            lines += describe_recheck(judge_recheck(calibrated, suspects, read, false_alarm, sessions))
        put("".join(f"{line}\n" for line in lines), out)
        return
    if legs:
        planned = _plan_poses(results, stated, like, calibrated)
    else:
        planned = expect_readings(_find_noise(calibrated, like, sensors))
    commands, given = (
        list_candidates(calibrated, share) if candidates is None else read_commands(candidates, calibrated)[1:]
    )
    demand = _demand(calibrated, suspects, (shift_um, shift_arcsec, shift_sd), power, false_alarm, sessions)
    with name_faults(results):
        plan = plan_recheck(calibrated, suspects, commands, given, planned, demand)
    sentence = describe_plan(plan)
    put(format_plan(calibrated, plan, sentence), out)
    if out is not None:
        typer.echo(sentence)


def _demand(
    calibrated: CalibratedMachine,
    suspects: Suspects,
    stated: tuple[float | None, float | None, float | None],
    power: float,
    false_alarm: float,
    sessions: int,
) -> Demand:
    """Return what is demanded of a plan; InputError for a shift in units that the parameters do not have."""
    from bayescal.calibrated.recheck.plan import Demand
    from bayescal.numerics.units import ARCSECOND, MICROMETRE

    um, arcsec, in_sd = stated
    if sum(one is not None for one in stated) > 1:
        raise InputError("recheck: found the shift in several units, expected one of --shift-um, -arcsec and -sd")
    units = set(suspects.units)
    if not any(one is not None for one in stated) and suspects.stated:
        um, arcsec = DEFAULT_UM if units == {"mm"} else None, DEFAULT_ARCSEC if units == {"rad"} else None
    for value, unit, size, option in ((um, "mm", MICROMETRE, "um"), (arcsec, "rad", ARCSECOND, "arcsec")):
        if value is not None:
            if units != {unit}:
                raise InputError(
                    f"recheck: found --shift-{option} for parameters in {', '.join(sorted(units))}, expected --shift-sd"
                )
            return Demand(np.full(len(suspects.names), size * value), power, false_alarm, sessions)
    in_sd = DEFAULT_SD if in_sd is None else in_sd
    known = calibrated.sd[suspects.places]
    for name in np.array(suspects.names)[known <= 0.0][:1]:
        raise InputError(
            f"recheck: found {name}, which is no free parameter, expected --shift-um or --shift-arcsec for it"
        )
    return Demand(in_sd * known, power, false_alarm, sessions, in_sd=in_sd)


# --- legs ----------------------------------------------------------------------------------------------------------


def _read_poses(
    path: Path, actuators: Path | None, stated: tuple[float, float] | None, calibrated: CalibratedMachine
) -> tuple[list[str], Measurements]:
    """Return what is wrong with a session's measured poses, in lines, and the poses."""
    from bayescal.calibrated.recheck.tables import has_noise, place_poses, read_session
    from bayescal.data.instruments.read_poses import PoseNoise
    from bayescal.experiments.shared.leg_slips import find_recheck_slip

    noise = PoseNoise() if has_noise(path) or stated is None else PoseNoise(*stated)
    read = read_session(path, actuators, noise, calibrated)
    slip = find_recheck_slip(calibrated, read.poses) if read.is_whole() else None
    lines = [] if slip is None else [f"{path}: {slip.say()}; what else is said rests on it"]
    return lines, place_poses(read.names, read.actuators, read.values, read.covariance)


def _plan_poses(
    results: Path, stated: tuple[float, float] | None, like: Path | None, calibrated: CalibratedMachine
) -> Measurements:
    """Return how a pose will be measured: as it is stated, as a table has it, or as the study had it."""
    from bayescal.calibrated.recheck.tables import build_covariance, expect_pose, read_mean_covariance

    if like is not None:
        return expect_pose(calibrated, read_mean_covariance(like))
    if stated is None:
        raise InputError(
            f"{results}: found no noise of an instrument that measures poses, expected --position-um and "
            "--orientation-arcsec, or --like POSES.csv with cov_ or sd_ columns"
        )
    return expect_pose(calibrated, build_covariance(*stated))


def _choose_arcseconds(arcsec: float | None, urad: float | None) -> float | None:
    """Return the noise of a rotation in arcseconds; InputError where it is stated in both units."""
    from bayescal.numerics.units import choose_arcseconds

    try:
        return choose_arcseconds(arcsec, urad)
    except ValueError as error:
        raise InputError(f"recheck: {error}") from error


def _find_stated(
    results: Path, position_um: float | None, orientation_arcsec: float | None
) -> tuple[float, float] | None:
    """Return the noise of position (µm) and rotation (arcsec) by the options, or by the study's config."""
    from bayescal.experiments.frame.results import PROVENANCE_FILE
    from bayescal.files.atomic import read_json

    if (position_um is None) != (orientation_arcsec is None):
        raise InputError("recheck: found --position-um or --orientation-arcsec alone, expected both")
    if position_um is not None and orientation_arcsec is not None:
        return position_um, orientation_arcsec
    if not (results / PROVENANCE_FILE).is_file():
        return None
    data = read_json(results / PROVENANCE_FILE).get("config", {}).get("data", {})
    rotation = _choose_arcseconds(data.get("orientation_arcsec"), data.get("orientation_urad"))
    position = data.get("position_um")
    return None if position is None or rotation is None else (float(position), rotation)


# --- readings of any machine -----------------------------------------------------------------------------------------


def _read_readings(path: Path, plan: Path | None, sd: Array, calibrated: CalibratedMachine) -> Measurements:
    """Return a session's readings, with the noise that is stated where its table does not."""
    from bayescal.calibrated.recheck.tables import add_commands, check_noise

    read = _read_table(path, calibrated)
    known = np.where(np.isfinite(read.sd), read.sd, sd)
    session = add_commands(path, plan, replace(read, sd=known), calibrated)
    check_noise(path, session, calibrated)
    return session


def _read_table(path: Path, calibrated: CalibratedMachine) -> Measurements:
    from bayescal.density.calibration.measurements import Measurements
    from bayescal.experiments.shared.readings.reading_tables import read_tables
    from bayescal.experiments.shared.readings.schema import DataTableConfig

    section = DataTableConfig.model_construct(file=path.name)
    found = read_tables([section], path.parent, calibrated.model.channels, calibrated.model.given)
    return Measurements(found.poses, found.values, found.sd, found.given, found.correlation)


def _find_noise(calibrated: CalibratedMachine, like: Path | None, sensors: Sequence[str] | None) -> Array:
    """Return the noise of each channel, (K,): as a table has it, or as the calibration found it; NaN if not read."""
    model = calibrated.model
    sd = np.full(len(model.channels), np.nan) if calibrated.noise is None else calibrated.noise.copy()
    if like is not None:
        read = _read_table(like, calibrated)
        square = np.where(read.present & np.isfinite(read.sd), read.sd**2, np.nan)
        stated = np.isfinite(square).any(axis=0)
        sd = np.where(read.present.any(axis=0), sd, np.nan)
        sd[stated] = np.sqrt(np.nanmean(square[:, stated], axis=0))
    if sensors is not None:
        chosen = model.select(sensors)
        for k in chosen[~np.isfinite(sd[chosen]) & ~np.isin(chosen, calibrated.commanded)][:1]:
            raise InputError(
                f"--sensors: found {model.names[k]} whose noise is not known, expected --like READINGS.csv"
            )
        sd[~np.isin(np.arange(len(sd)), chosen)] = np.nan
    sd[calibrated.commanded] = 1.0
    return sd
