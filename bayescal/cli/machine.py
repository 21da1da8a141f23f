"""Commands that use a calibrated machine: export, command, predict."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import check_out, put
from bayescal.cli.options import Trust
from bayescal.limits import LARGEST_SEED

if TYPE_CHECKING:
    from bayescal.calibrated.machine import CalibratedMachine

Calibrated = Annotated[
    Path, typer.Argument(metavar="RESULTS", help="Results of a study or calibration, or a machine that export wrote.")
]
Variant = Annotated[str | None, typer.Option(help="Variant by its name; default the best.")]
Config = Annotated[
    Path | None, typer.Option("--experiment", help="Config of results that do not hold the nominal machine.")
]
Force = Annotated[bool, typer.Option("--force", help="Take a posterior that did not converge; files say so.")]
COPIES, OF_A_DRAW = 6, 120
"""How often a pose's covariance is there, text among it, and doubles of a draw's pose and its text."""
Table = Annotated[Path | None, typer.Option(help="CSV file; default standard output.")]


@app.command(epilog="Example: bayescal export results/m2_hexapod --format urdf --out machines/m2")
def export(
    results: Calibrated,
    variant: Variant = None,
    name: Annotated[
        str | None,
        typer.Option("--format", help="mechanism or parameters (taken again), toml, json, csv, urdf, genhexkins."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Directory; default machines/NAME-VARIANT.")] = None,
    experiment: Config = None,
    force: Force = False,
    trust: Trust = False,
) -> None:
    """Write the machine as calibrated, with covariance and draws, as files for the next tool."""
    from bayescal.calibrated.formats import export_machine
    from bayescal.experiments.shared.calibrating import load_calibrated
    from bayescal.files.atomic import check_writable

    calibrated = load_calibrated(results, variant, experiment, force, trust)
    where = out or Path("machines") / calibrated.source.stem
    check_writable(where)
    for path in export_machine(calibrated, where, name):
        typer.echo(f"wrote {path}")
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal command results/m2_hexapod poses.csv --out actuators.csv")
def command(
    results: Calibrated,
    poses: Annotated[
        Path, typer.Argument(metavar="POSES.csv", help="pose, x_mm ... rz_deg, or a tool's tool_x_mm ...")
    ],
    variant: Variant = None,
    out: Table = None,
    mark: Annotated[bool, typer.Option("--mark", help="Mark poses out of reach instead of refusing them.")] = False,
    experiment: Config = None,
    force: Force = False,
    trust: Trust = False,
) -> None:
    """Compute the commands (actuator positions) that hold poses, and their uncertainty."""
    from bayescal.calibrated.predict import command_poses
    from bayescal.calibrated.tables import check_reached, format_command, read_commanded
    from bayescal.experiments.shared.calibrating import load_calibrated

    calibrated = load_calibrated(results, variant, experiment, force, trust)
    check_out(out)
    commanded = read_commanded(poses, calibrated)
    _check_many(len(commanded.names), 1, calibrated)
    found = command_poses(calibrated, commanded.poses, commanded.given, commanded.coordinates)
    if not mark:
        check_reached(commanded, found)
    put(format_command(calibrated, commanded.names, found, commanded.given), out)
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal predict results/m2_hexapod actuators.csv --out poses.csv")
def predict(
    results: Calibrated,
    commands: Annotated[Path, typer.Argument(metavar="COMMANDS.csv", help="pose, rho_1_mm, rho_2_mm ...")],
    variant: Variant = None,
    out: Table = None,
    draws: Annotated[Path | None, typer.Option(help="CSV file for poses by draws of the posterior.")] = None,
    n_draws: Annotated[int, typer.Option(min=1, max=100_000, help="How many of them.")] = 100,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Of the draws' errors.")] = 0,
    experiment: Config = None,
    force: Force = False,
    trust: Trust = False,
) -> None:
    """Predict where the machine and its tool are at commands (actuator positions), with their covariance."""
    import numpy as np

    from bayescal.calibrated.predict import draw_poses, predict_poses
    from bayescal.calibrated.tables import check_found, format_draws, format_prediction, read_commands
    from bayescal.experiments.shared.calibrating import load_calibrated

    calibrated = load_calibrated(results, variant, experiment, force, trust)
    check_out(out)
    check_out(draws)
    names, positions, given = read_commands(commands, calibrated)
    _check_many(len(names), 1 if draws is None else n_draws, calibrated)
    found = predict_poses(calibrated, positions, given)
    check_found(commands, names, found)
    if draws is not None:
        drawn = draw_poses(calibrated, positions, n_draws, np.random.default_rng(seed), given)
        put(format_draws(calibrated, names, drawn), draws)
    put(format_prediction(calibrated, names, found, given), out)
    _tell_missing(results, calibrated)


def _check_many(n_poses: int, n_draws: int, calibrated: CalibratedMachine) -> None:
    """Raise InputError where there is no memory for so many poses by draws, and the text that is made of them."""
    from bayescal.experiments.frame.memory import check_arrays

    model = calibrated.model
    numbers = COPIES * max(len(model.tool_channels) + len(model.coordinates), len(calibrated.commanded)) ** 2
    counts = {"poses": n_poses} | ({"draws": n_draws} if n_draws > 1 else {})
    check_arrays(counts, [(n_poses, numbers), (n_draws, n_poses, OF_A_DRAW)], "fewer of them")


def _tell_missing(results: Path, calibrated: CalibratedMachine) -> None:
    """Say on standard error that there is no covariance, and why."""
    if calibrated.covariance is None:
        typer.echo(f"{results}: no draws of the posterior (posterior/*.nc): without covariance and draws", err=True)
