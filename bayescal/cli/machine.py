"""Commands that use a calibrated machine: export, command, predict, certificate, verify."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import (
    AllowChangedFiles,
    AllowUnconverged,
    Trust,
    app,
    check_out,
    echo,
    print_sentence,
    put,
    spread_options,
)
from bayescal.errors import InputError, name_faults
from bayescal.limits import LARGEST_SEED

if TYPE_CHECKING:
    from bayescal.calibrated.accuracy import Region
    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.calibrated.verify.plan import VerificationGoal
    from bayescal.calibrated.verify.statistics import TestedParameters
    from bayescal.density.calibration.measurements import Measurements
    from bayescal.numerics.geometry import Array

Calibrated = Annotated[Path, typer.Argument(metavar="RESULTS", help="Results, or an exported machine.")]
COPIES, OF_A_DRAW = 6, 120
"""How often a pose's covariance is there, text among it, and doubles of a draw's pose and its text."""
Table = Annotated[Path | None, typer.Option(help="CSV file; default stdout.")]

DEFAULT_UM, DEFAULT_ARCSEC, DEFAULT_SD = 20.0, 20.0, 10.0


@dataclass(frozen=True)
class MachineOptions:
    """Which machine of some results is taken, and whether it may be."""

    variant: Annotated[str | None, typer.Option(help="Variant; default the best.")] = None
    experiment: Annotated[
        Path | None,
        typer.Option(help="Study config, where results lack the machine."),
    ] = None
    allow_unconverged: AllowUnconverged = False
    allow_changed_files: AllowChangedFiles = False
    trust: Trust = False
    mode: Annotated[int | None, typer.Option(min=1, help="Solution; 1 is most probable.")] = None

    def load(self, results: Path, with_instruments: bool = False) -> CalibratedMachine:
        """Return the machine; see `load_calibrated`."""
        from bayescal.experiments.shared.calibrating import load_calibrated

        return load_calibrated(
            results,
            self.variant,
            self.experiment,
            self.allow_unconverged,
            self.allow_changed_files,
            mode=self.mode,
            with_instruments=with_instruments,
        )


@app.command(epilog="Example: bayescal export results/m2_hexapod --format urdf --out machines/m2")
@spread_options
def export(
    results: Calibrated,
    options: MachineOptions,
    name: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="mechanism or parameters (taken again), toml, json, csv, urdf, dh, klipper, tpoint, grid, ...",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Directory; default machines/NAME-VARIANT.")] = None,
) -> None:
    """Write the machine as calibrated, with covariance and draws, as files for the next tool."""
    from bayescal.calibrated.carried import describe_carried
    from bayescal.calibrated.formats import export_machine
    from bayescal.files.atomic import check_writable

    calibrated = options.load(results)
    where = out or Path("machines") / calibrated.source.stem
    check_writable(where)
    written = export_machine(calibrated, where, name)
    for path in written:
        echo(f"wrote {path}")
    for line in describe_carried(written):
        print_sentence(line)
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal compensate results/m2_hexapod poses.csv --out actuators.csv")
@spread_options
def compensate(
    results: Calibrated,
    poses: Annotated[Path, typer.Argument(metavar="POSES.csv", help="pose, x_mm ... rz_deg, or tool_x_mm ...")],
    options: MachineOptions,
    out: Table = None,
    allow_unreachable: Annotated[bool, typer.Option("--allow-unreachable", help="Mark unreachable poses.")] = False,
) -> None:
    """Compute the corrected actuator positions that hold wanted poses, and their uncertainty."""
    from bayescal.calibrated.one_place import take_one_place
    from bayescal.calibrated.predict import compensate_poses
    from bayescal.calibrated.tables import check_reached, format_command, read_commanded

    calibrated = take_one_place(options.load(results))
    check_out(out)
    commanded = read_commanded(poses, calibrated)
    _check_many(len(commanded.names), 1, calibrated)
    found = compensate_poses(calibrated, commanded.poses, commanded.given, commanded.coordinates)
    if not allow_unreachable:
        check_reached(commanded, found)
    put(format_command(calibrated, commanded.names, found, commanded.given), out)
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal predict results/m2_hexapod actuators.csv --out poses.csv")
@spread_options
def predict(
    results: Calibrated,
    commands: Annotated[Path, typer.Argument(metavar="COMMANDS.csv", help="pose, rho_1_mm, rho_2_mm ...")],
    options: MachineOptions,
    out: Table = None,
    draws_out: Annotated[Path | None, typer.Option(help="CSV file for posterior draws.")] = None,
    n_draws: Annotated[int, typer.Option(min=1, max=100_000, help="How many.")] = 100,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Of draws' errors.")] = 0,
) -> None:
    """Predict where the machine and its tool are at commands (actuator positions), with their covariance."""
    import numpy as np

    from bayescal.calibrated.drawn_machines import draw_poses
    from bayescal.calibrated.one_place import take_one_place
    from bayescal.calibrated.predict import check_determined, predict_poses
    from bayescal.calibrated.tables import (
        check_found,
        format_draws,
        format_prediction,
        read_commands,
        say_contradictory,
    )

    calibrated = take_one_place(options.load(results))
    check_out(out)
    check_out(draws_out)
    check_determined(calibrated)
    names, positions, given = read_commands(commands, calibrated)
    _check_many(len(names), 1 if draws_out is None else n_draws, calibrated)
    found = predict_poses(calibrated, positions, given)
    check_found(commands, names, found)
    if draws_out is not None:
        drawn = draw_poses(calibrated, positions, n_draws, np.random.default_rng(seed), given)
        put(format_draws(calibrated, names, drawn), draws_out)
    put(format_prediction(calibrated, names, found, given), out)
    if said := say_contradictory(commands, names, found):
        echo(said, err=True)
    _tell_missing(results, calibrated)


def _check_many(n_poses: int, n_draws: int, calibrated: CalibratedMachine) -> None:
    """Raise InputError where there is no memory for so many poses by draws, and the text that is made of them."""
    from bayescal.experiments.runner.memory import check_arrays

    model = calibrated.model
    numbers = COPIES * max(len(model.tool_channels) + len(model.coordinates), len(calibrated.commanded)) ** 2
    counts = {"poses": n_poses} | ({"draws": n_draws} if n_draws > 1 else {})
    check_arrays(counts, [(n_poses, numbers), (n_draws, n_poses, OF_A_DRAW)], "fewer of them")


def _tell_missing(results: Path, calibrated: CalibratedMachine) -> None:
    """Say on standard error that there is no covariance, and why."""
    if calibrated.covariance is None:
        echo(f"{results}: no posterior draws: without covariance", err=True)


@app.command(epilog="Example: bayescal certificate results/m2_hexapod --out certificate.html")
@spread_options
def certificate(
    results: Calibrated,
    options: MachineOptions,
    out: Annotated[
        Path | None, typer.Option(help="HTML file, with JSON beside it; default certificate-NAME.html.")
    ] = None,
    coverage: Annotated[float, typer.Option(min=0.5, max=0.9999, help="Coverage probability.")] = 0.95,
    cube: Annotated[float | None, typer.Option(min=1e-3, max=1e5, help="Edge of ISO 9283's cube, mm.")] = None,
    position_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Half extents about home; default the measured box."),
    ] = None,
    rotation_deg: Annotated[tuple[float, float, float] | None, typer.Option(help="With --position-mm.")] = None,
    full_range: Annotated[bool, typer.Option("--full-range", help="Full actuator range.")] = False,
    poses: Annotated[int, typer.Option(min=16, max=100_000, help="Workspace poses.")] = 512,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED - 2, help="Random seed.")] = 0,
) -> None:
    """Certify how sure the poses of a calibrated machine are: budget, expanded uncertainty, ISO figures."""
    from bayescal.experiments.shared.certificate import CertificateOptions, build_certificate, certify, state_headline
    from bayescal.report.page import render_page
    from bayescal.report.pictures import render_picture

    calibrated = options.load(results)
    if out is not None and out.suffix != ".html":
        raise InputError(f"--out: found {out.name!r}, expected NAME.html")
    where = out or Path(f"certificate-{calibrated.source.stem}.html")
    check_out(where)
    region = _read_region(calibrated, position_mm, rotation_deg, full_range)
    wishes = CertificateOptions(coverage, poses, cube_mm=cube, seed=seed, region=region, full_range=full_range)
    found = certify(calibrated, results, wishes)
    print_sentence(state_headline(found))
    page = build_certificate(found)
    pictures = {figure.name: render_picture(figure.draw) for figure in page.figures() if figure.draw is not None}
    put(render_page(page, pictures), where)
    put(json.dumps(found.list_figures(), indent=1, ensure_ascii=False) + "\n", where.with_suffix(".json"))


def _read_region(
    calibrated: CalibratedMachine,
    position_mm: tuple[float, float, float] | None,
    rotation_deg: tuple[float, float, float] | None,
    full_range: bool,
) -> Region | None:
    """Return the box that the options state; None for the default, or for the actuators' range."""
    from math import isfinite

    import numpy as np

    from bayescal.calibrated.accuracy import box_about_home

    if full_range and (position_mm or rotation_deg):
        raise InputError("--full-range: found with --position-mm or --rotation-deg, expected either")
    if position_mm is None:
        if rotation_deg is not None:
            raise InputError("--rotation-deg: expected --position-mm as well")
        return None
    turned = rotation_deg or (0.0, 0.0, 0.0)
    for name, values in (("--position-mm", position_mm), ("--rotation-deg", turned)):
        if not all(isfinite(value) and value >= 0.0 for value in values):
            raise InputError(f"{name}: found {' '.join(f'{v:g}' for v in values)}, expected non-negative half extents")
    units = [one.unit for one in calibrated.model.coordinates]
    half = np.zeros(len(units))
    for unit, name, extents in (
        ("mm", "--position-mm", np.array(position_mm)),
        ("rad", "--rotation-deg", np.radians(turned)),
    ):
        places = [k for k, other in enumerate(units) if other == unit]
        if len(places) == len(extents):
            half[places] = extents
        elif unit == "mm" or places or rotation_deg is not None:
            names = ", ".join(one.name for one in calibrated.model.coordinates)
            raise InputError(f"{name}: found three for {names}, expected three such coordinates")
    return box_about_home(half)


@app.command(epilog="Example: bayescal verify results/m2 --position-um 10 --orientation-arcsec 1 --out plan.csv")
@spread_options
def verify(
    results: Calibrated,
    options: MachineOptions,
    measured: Annotated[list[Path] | None, typer.Option(help="CSV file of measurements; repeat per session.")] = None,
    actuators: Annotated[
        Path | None,
        typer.Option(help="CSV with commanded actuator positions."),
    ] = None,
    position_um: Annotated[float | None, typer.Option(min=1e-3, max=1e5, help="Position noise (sd).")] = None,
    orientation_arcsec: Annotated[float | None, typer.Option(min=1e-3, max=1e5, help="Rotation noise (sd).")] = None,
    orientation_urad: Annotated[
        float | None, typer.Option(min=1e-3, max=1e6, help="Rotation noise in microradians.")
    ] = None,
    noise_from: Annotated[Path | None, typer.Option(help="CSV of readings whose noise is used.")] = None,
    sensors: Annotated[list[str] | None, typer.Option(help="Channels; default all of known noise.")] = None,
    instrument: Annotated[str | None, typer.Option(help="Table of [[data]] by its name, of several.")] = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option(help="Parameters under test; default leg lengths, or all free."),
    ] = None,
    shift_um: Annotated[float | None, typer.Option(min=1e-2, max=1e5, help="Length shift; default 20.")] = None,
    shift_arcsec: Annotated[float | None, typer.Option(min=1e-3, max=1e6, help="Angle shift; default 20.")] = None,
    shift_sd: Annotated[float | None, typer.Option(min=1e-2, max=1e6, help="In posterior sd; default 10.")] = None,
    power: Annotated[float, typer.Option(min=0.1, max=0.999, help="Detection probability.")] = 0.95,
    false_alarm: Annotated[float, typer.Option(min=1e-3, max=0.5, help="False alarm probability.")] = 0.01,
    sessions: Annotated[int, typer.Option(min=1, max=12, help="Sessions of the same poses.")] = 2,
    candidates: Annotated[Path | None, typer.Option(help="CSV file of commands: pose, rho_1_mm ...")] = None,
    range_fraction: Annotated[float, typer.Option(min=0.01, max=1.0, help="Fraction of the command range.")] = 0.9,
    out: Table = None,
) -> None:
    """Plan the fewest poses that show whether a calibration still holds, or judge what was measured at them."""
    import numpy as np

    from bayescal.calibrated.tables import read_commands
    from bayescal.calibrated.verify.plan import (
        describe_plan,
        describe_reverification,
        expect_readings,
        format_plan,
        lead_to_contacts,
        list_candidates,
        plan_reverification,
    )
    from bayescal.calibrated.verify.statistics import choose_suspects, judge_reverification
    from bayescal.experiments.shared.pose_readings import find_reverification_slip
    from bayescal.experiments.shared.readings.session_tables import find_session_tables

    orientation_arcsec = _choose_arcseconds(orientation_arcsec, orientation_urad)
    calibrated = options.load(results, with_instruments=True)
    if calibrated.covariance is None:
        raise InputError(f"{results}: found no posterior draws, expected posterior/*.nc")
    check_out(out)
    suspects = choose_suspects(calibrated, parameters or [])
    stated = None if position_um is None else (position_um, orientation_arcsec)
    tables = find_session_tables(results, calibrated, options.experiment, instrument, stated)
    if tables is None and (position_um is not None or orientation_arcsec is not None):
        raise InputError("verify: found --position-um or --orientation-arcsec, expected --noise-from")
    if tables is not None and sensors is not None:
        raise InputError("verify: found --sensors, expected none: an instrument measures the tool")
    if (orientation_arcsec is not None) > (position_um is not None) or (
        tables is not None and tables.instrument is None and position_um is not None and orientation_arcsec is None
    ):
        raise InputError("verify: expected both --position-um and --orientation-arcsec")
    if measured:
        lines, read = [], []
        for path in measured:
            if tables is not None:
                poses, session = tables.read(path, actuators)
                whole = tables.instrument is None and poses.is_whole()
                slip = find_reverification_slip(calibrated, poses) if whole else None
                lines += [] if slip is None else [f"{path}: {slip.say()}; results below depend on it"]
            else:
                session = _read_readings(path, actuators, _find_noise(calibrated, noise_from, sensors), calibrated)
            read.append(session)
        with name_faults(results):
            lines += describe_reverification(judge_reverification(calibrated, suspects, read, false_alarm, sessions))
        put("".join(f"{line}\n" for line in lines), out)
        return
    if tables is not None:
        with name_faults(results):
            planned = tables.expect(noise_from)
    else:
        sd = _find_noise(calibrated, noise_from, sensors)
        unknown = np.flatnonzero(~np.isfinite(sd))  # an exported machine knows nothing of channels beside it
        if sensors is None and len(unknown) and np.isfinite(sd).sum() <= len(calibrated.model.coordinates):
            one = calibrated.model.channels[unknown[0]]
            raise InputError(
                f"{results}: found no noise of {one.name}, expected --noise-from READINGS.csv with "
                f"column {one.stem}_sd_{one.unit}"
            )
        planned = expect_readings(sd)
    touching = tuple[str, ...]()
    if candidates is None:
        anywhere = list_candidates(calibrated, range_fraction)
        commands, given, planned, touching = lead_to_contacts(calibrated, *anywhere, planned)
    else:
        _, commands, given = read_commands(candidates, calibrated)
    demand = _demand(calibrated, suspects, (shift_um, shift_arcsec, shift_sd), power, false_alarm, sessions)
    with name_faults(results):
        plan = plan_reverification(calibrated, suspects, commands, given, planned, demand)
    sentence = describe_plan(plan)
    how = "Touch the instrument of each" if touching else "Read the channels at each"
    put(format_plan(calibrated, plan, sentence, how if tables is None else tables.instruct(), touching), out)
    if out is not None:
        print_sentence(sentence)


def _demand(
    calibrated: CalibratedMachine,
    suspects: TestedParameters,
    stated: tuple[float | None, float | None, float | None],
    power: float,
    false_alarm: float,
    sessions: int,
) -> VerificationGoal:
    """Return what is demanded of a plan; InputError for a shift in units that the parameters do not have."""
    import numpy as np

    from bayescal.calibrated.verify.plan import VerificationGoal
    from bayescal.numerics.units import ARCSECOND, MICROMETRE

    um, arcsec, in_sd = stated
    if sum(one is not None for one in stated) > 1:
        raise InputError("verify: expected one of --shift-um, --shift-arcsec and --shift-sd")
    units = set(suspects.units)
    if not any(one is not None for one in stated) and suspects.stated:
        um, arcsec = DEFAULT_UM if units == {"mm"} else None, DEFAULT_ARCSEC if units == {"rad"} else None
    for value, unit, size, option in ((um, "mm", MICROMETRE, "um"), (arcsec, "rad", ARCSECOND, "arcsec")):
        if value is not None:
            if units != {unit}:
                raise InputError(
                    f"verify: found --shift-{option} for parameters in {', '.join(sorted(units))}, expected --shift-sd"
                )
            return VerificationGoal(np.full(len(suspects.names), size * value), power, false_alarm, sessions)
    in_sd = DEFAULT_SD if in_sd is None else in_sd
    known = calibrated.sd[suspects.places]
    for name in np.array(suspects.names)[known <= 0.0][:1]:
        raise InputError(f"verify: found {name}, which is fixed, expected --shift-um or --shift-arcsec")
    return VerificationGoal(in_sd * known, power, false_alarm, sessions, in_sd=in_sd)


def _choose_arcseconds(arcsec: float | None, urad: float | None) -> float | None:
    """Return the noise of a rotation in arcseconds; InputError where it is stated in both units."""
    from bayescal.numerics.units import choose_arcseconds

    try:
        return choose_arcseconds(arcsec, urad)
    except ValueError as error:
        raise InputError(f"verify: {error}") from error


# --- readings of any machine -----------------------------------------------------------------------------------------


def _read_readings(path: Path, plan: Path | None, sd: Array, calibrated: CalibratedMachine) -> Measurements:
    """Return a session's readings, with the noise that is stated where its table does not."""
    import numpy as np

    from bayescal.calibrated.verify.plan import add_commands, check_noise

    read = _read_table(path, calibrated)
    known = np.where(np.isfinite(read.sd), read.sd, sd)
    session = add_commands(path, plan, replace(read, sd=known), calibrated)
    check_noise(path, session, calibrated)
    return session


def _read_table(path: Path, calibrated: CalibratedMachine) -> Measurements:
    from bayescal.density.calibration.measurements import Measurements
    from bayescal.experiments.shared.readings.data_schema import ReadingsDataConfig
    from bayescal.experiments.shared.readings.reading_tables import complete_readings, read_tables

    section, model = ReadingsDataConfig.model_construct(file=path.name), calibrated.model
    found = complete_readings(read_tables([section], path.parent, model.channels, model.given), model)
    return Measurements(found.poses, found.values, found.sd, found.given, found.correlation)


def _find_noise(calibrated: CalibratedMachine, noise_from: Path | None, sensors: Sequence[str] | None) -> Array:
    """Return the noise of each channel, (K,): as a table has it, or as the calibration found it; NaN if not read."""
    import numpy as np

    model = calibrated.model
    sd = np.full(len(model.channels), np.nan) if calibrated.noise is None else calibrated.noise.copy()
    if noise_from is not None:
        read = _read_table(noise_from, calibrated)
        square = np.where(read.present & np.isfinite(read.sd), read.sd**2, np.nan)
        stated = np.isfinite(square).any(axis=0)
        sd = np.where(read.present.any(axis=0), sd, np.nan)
        sd[stated] = np.sqrt(np.nanmean(square[:, stated], axis=0))
        for k in np.flatnonzero(read.present.any(axis=0) & ~np.isfinite(sd)):
            asked = sensors is None or k in model.select(sensors)
            if asked and k not in calibrated.commanded:
                one = model.channels[k]
                raise InputError(
                    f"{noise_from}: found no noise of {one.name}, expected column {one.stem}_sd_{one.unit}"
                )
    if sensors is not None:
        chosen = model.select(sensors)
        for k in chosen[~np.isfinite(sd[chosen]) & ~np.isin(chosen, calibrated.commanded)][:1]:
            one = model.channels[k]
            raise InputError(
                f"--sensors: found no noise of {one.name}, expected --noise-from READINGS.csv with "
                f"column {one.stem}_sd_{one.unit}"
            )
        sd[~np.isin(np.arange(len(sd)), chosen)] = np.nan
    sd[calibrated.commanded] = 1.0
    return sd
