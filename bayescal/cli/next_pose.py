"""The command that tells which pose to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.options import RunOptions, spread_options
from bayescal.cli.run import run_config


@app.command("next", epilog="Example: bayescal next experiments/m2_hexapod/next.toml")
@spread_options
def next_pose(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY.toml", help="Config of the study, or a file that names it and asks more.")
    ],
    options: RunOptions,
    variant: Annotated[list[str] | None, typer.Option(help="Variant that may be right; default all.")] = None,
    require: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Largest error of the tool allowed, mm or degrees.")
    ] = None,
) -> None:
    """Tell after the poses measured so far which one to measure next, what it will bring, and whether to stop."""
    from bayescal.experiments.next.kind import configure_next

    run_config(configure_next(study, variant or [], require or [], options.seed), study, options)
