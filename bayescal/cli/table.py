"""The command for look-up tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.options import RunOptions, spread_options
from bayescal.cli.run import run_config


@app.command(epilog="Example: bayescal table experiments/m2_hexapod_table/table.toml")
@spread_options
def table(
    config: Annotated[Path, typer.Argument(metavar="TABLE.toml", help="Calibration, axes and reference of the table.")],
    options: RunOptions,
    force: Annotated[bool, typer.Option("--force", help="Take a posterior that did not converge, too.")] = False,
) -> None:
    """Tell what actuators have to do by elevation, temperature and the like: `bayescal run` of a look-up table."""
    from bayescal.experiments.frame.load import load_kind

    found = load_kind(config, "table")
    changed = {} if options.seed is None else {"seed": options.seed}
    run_config(found.model_copy(update={**changed, **({"force": True} if force else {})}), config, options)
