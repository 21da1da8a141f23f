"""The command that tells whether a calibration still holds: it plans poses, and judges what was measured at them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import check_out, put
from bayescal.cli.machine import Calibrated, Config, Force, Table, Variant
from bayescal.errors import InputError, name_faults

if TYPE_CHECKING:
    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.numerics.geometry import Array


@app.command(epilog="Example: bayescal recheck results/m2 --position-um 10 --orientation-arcsec 1 --out plan.csv")
def recheck(
    results: Calibrated,
    variant: Variant = None,
    measured: Annotated[
        list[Path] | None, typer.Option(help="CSV file of measured poses, once per session: judge them.")
    ] = None,
    actuators: Annotated[Path | None, typer.Option(help="The plan, where --measured has no rho columns.")] = None,
    position_um: Annotated[
        float | None, typer.Option(min=1e-3, max=1e5, help="Standard deviation of a measured position.")
    ] = None,
    orientation_arcsec: Annotated[
        float | None, typer.Option(min=1e-3, max=1e5, help="Standard deviation of a measured rotation.")
    ] = None,
    orientation_urad: Annotated[
        float | None, typer.Option(min=1e-3, max=1e6, help="The same in microradians, in place of arcseconds.")
    ] = None,
    like: Annotated[
        Path | None, typer.Option(help="CSV file of poses with covariances, in place of both, for a plan.")
    ] = None,
    shift_um: Annotated[float, typer.Option(min=1e-2, max=1e5, help="Shift of a leg to be found.")] = 20.0,
    power: Annotated[float, typer.Option(min=0.1, max=0.999, help="Probability of finding it.")] = 0.95,
    false_alarm: Annotated[float, typer.Option(min=1e-3, max=0.5, help="Of all sessions together.")] = 0.01,
    sessions: Annotated[int, typer.Option(min=1, max=12, help="Sessions of the same poses to find it in.")] = 2,
    candidates: Annotated[
        Path | None, typer.Option(help="CSV file of actuator positions to choose from: pose, rho_1_mm ...")
    ] = None,
    share: Annotated[float, typer.Option(min=0.01, max=1.0, help="Of the actuators' range, without one.")] = 0.9,
    out: Table = None,
    experiment: Config = None,
    force: Force = False,
) -> None:
    """Name the fewest poses that tell whether a calibration still holds, or judge what was measured at them."""
    from bayescal.api import load_calibrated
    from bayescal.calibrated.recheck.plan import Demand, list_candidates, plan_recheck
    from bayescal.calibrated.recheck.tables import describe_plan, format_plan, read_candidates
    from bayescal.numerics.units import MICROMETRE

    orientation_arcsec = _choose_arcseconds(orientation_arcsec, orientation_urad)
    calibrated = load_calibrated(results, variant, experiment, force)
    if calibrated.covariance is None:
        raise InputError(f"{results}: found no draws of the posterior (posterior/*.nc), expected those of a run")
    check_out(out)
    if measured:
        stated = _find_stated(results, position_um, orientation_arcsec)
        put(_judge(calibrated, measured, actuators, stated, false_alarm, sessions), out)
        return
    covariance = _find_covariance(results, position_um, orientation_arcsec, like)
    chosen = list_candidates(calibrated, share) if candidates is None else read_candidates(candidates, calibrated)
    demand = Demand(MICROMETRE * shift_um, power, false_alarm, sessions)
    with name_faults(results):
        plan = plan_recheck(calibrated, chosen, covariance, demand)
    said = describe_plan(plan)
    put(format_plan(calibrated, plan, said), out)
    if out is not None:
        typer.echo(said)


def _judge(
    calibrated: CalibratedMachine,
    measured: list[Path],
    actuators: Path | None,
    stated: tuple[float, float] | None,
    false_alarm: float,
    sessions: int,
) -> str:
    """Return in lines what measured sessions say."""
    from bayescal.calibrated.recheck.judge import judge_recheck
    from bayescal.calibrated.recheck.tables import describe_recheck, has_noise, read_session
    from bayescal.data.instruments.read_poses import PoseNoise
    from bayescal.experiments.shared.leg_slips import find_recheck_slip

    noise = [PoseNoise() if has_noise(path) or stated is None else PoseNoise(*stated) for path in measured]
    read = [read_session(path, actuators, one, calibrated) for path, one in zip(measured, noise, strict=True)]
    slips = ((path, find_recheck_slip(calibrated, one)) for path, one in zip(measured, read, strict=True))
    lines = [f"{path}: {slip.say()}; what else is said rests on it" for path, slip in slips if slip is not None]
    lines += describe_recheck(judge_recheck(calibrated, read, false_alarm, sessions))
    return "".join(f"{line}\n" for line in lines)


def _find_covariance(
    results: Path,
    position_um: float | None,
    orientation_arcsec: float | None,
    like: Path | None,
) -> Array:
    """Return the covariance of a measured pose as it is stated, as a table has it, or as the study had it."""
    from bayescal.calibrated.recheck.tables import build_covariance, read_mean_covariance

    if like is not None:
        return read_mean_covariance(like)
    stated = _find_stated(results, position_um, orientation_arcsec)
    if stated is None:
        raise InputError(
            f"{results}: found no noise of an instrument that measures poses, expected --position-um and "
            "--orientation-arcsec, or --like POSES.csv with covariances, as bayescal poses-from-targets writes them"
        )
    return build_covariance(*stated)


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
