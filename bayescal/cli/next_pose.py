"""The command that tells which pose to measure next."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.options import RunOptions, spread_options
from bayescal.cli.run import run_file
from bayescal.errors import InputError


@app.command("next", epilog="Example: bayescal next experiments/m2_hexapod/next.toml")
@spread_options
def next_pose(
    question: Annotated[
        Path, typer.Argument(metavar="NEXT.toml", help="Study, workspace, requirements and poses to choose from.")
    ],
    options: RunOptions,
) -> None:
    """Tell after the poses measured so far which one to measure next, what it will bring, and whether to stop."""
    from bayescal.experiments.frame.load import load

    found = load(question)[1].kind
    if found == "study":
        raise InputError(
            f"{question}: kind: found 'study', expected 'next_pose', a file of its own with study = "
            f'"{question.name}", [workspace] and [requirements]'
        )
    run_file(question, "next_pose", options)
