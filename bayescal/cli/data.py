"""Commands that make data: simulated ones, and poses from targets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import check_out, put
from bayescal.cli.options import Experiment, NoPlugins, Seed
from bayescal.errors import InputError, name_faults


@app.command(epilog="Example: bayescal simulate experiments/telescope/simulate.toml --out data --seed 1")
def simulate(
    config: Annotated[Path, typer.Argument(metavar="SIMULATION.toml", help="Config of the simulation.")],
    out: Annotated[Path, typer.Option(help="Directory for the CSV files.")],
    seed: Seed = None,
    no_plugins: NoPlugins = False,
) -> None:
    """Simulate photogrammetry, an instrument's or a machine's own readings; the config states the truth."""
    del no_plugins
    from bayescal.experiments.frame.load import load_kind
    from bayescal.experiments.frame.run import compute_experiment
    from bayescal.files.atomic import check_writable, make_directory, write_atomically

    loaded = load_kind(config, "simulation")
    check_writable(out)
    if seed is not None:
        loaded = loaded.model_copy(update={"seed": seed})
    with name_faults(config):
        results = compute_experiment(loaded, config.parent)
    make_directory(out)
    for name, text in results.files.items():
        write_atomically(out / name, str(text).encode())
        typer.echo(f"wrote {out / name}")


@app.command(
    "poses-from-targets", epilog="Example: bayescal poses-from-targets experiments/telescope/study.toml --out poses.csv"
)
def poses_from_targets(
    experiment: Experiment,
    out: Annotated[Path | None, typer.Option(help="CSV file for the poses; default standard output.")] = None,
    method: Annotated[str | None, typer.Option(help="robust, line or least_squares, in place of the config's.")] = None,
) -> None:
    """Extract the platform's poses in the base frame, with their covariances, from a study's targets."""
    from bayescal.config.load import look_up
    from bayescal.data.photogrammetry.poses import METHODS
    from bayescal.experiments.frame.load import load_kind
    from bayescal.experiments.study.inputs import load_inputs
    from bayescal.experiments.study.tables import format_poses

    config = load_kind(experiment, "study")
    check_out(out)
    found = "tables of readings" if config.by_tables else config.measured.measurement
    if found != "targets":
        raise InputError(f"{experiment}: data.measurement: found {found!r}, expected 'targets'")
    if method is not None:
        look_up(METHODS, method, "--method", experiment)
        config = config.model_copy(update={"data": config.data.model_copy(update={"pose_method": method})})
    put(format_poses(load_inputs(config, experiment.parent)), out)
