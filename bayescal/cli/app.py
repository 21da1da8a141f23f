"""The application that commands register with, and what it does before any of them."""

from __future__ import annotations

from typing import Annotated

import typer

from bayescal.cli.options import NoPlugins

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Bayesian identification of parallel-kinematic machines.",
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"bayescal {version('bayescal')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def begin(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and end.")
    ] = False,
    no_plugins: NoPlugins = False,
) -> None:
    """Bayesian identification of parallel-kinematic machines."""
    del version, no_plugins
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
