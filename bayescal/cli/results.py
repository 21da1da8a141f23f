"""Commands that show what there is: a report anew, a machine, results side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import WIDE, make_console, put
from bayescal.cli.options import Trust


@app.command(epilog="Example: bayescal report results/telescope")
def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results directory.")],
    trust: Trust = False,
) -> None:
    """Write the page of a results directory anew, from its files alone."""
    from joblib import cpu_count

    from bayescal.experiments.frame.engine import stop_workers
    from bayescal.experiments.frame.run import write_report

    typer.echo(f"wrote {write_report(results, trust, cpu_count())}")
    stop_workers()


@app.command(epilog="Example: bayescal show experiments/audit/m2_hexapod_mechanism.toml --out m2.html")
def show(
    machine: Annotated[Path, typer.Argument(metavar="MACHINE.toml", help="A machine's file.")],
    out: Annotated[Path | None, typer.Option(help="HTML file; default MACHINE.html here.")] = None,
) -> None:
    """Draw a machine as a page in which it can be turned, with its joints and legs."""
    from bayescal.experiments.shared.show import describe_machine
    from bayescal.report.page import render_page

    page = describe_machine(machine)
    put(render_page(page, {}), out if out is not None else Path(f"{machine.stem}.html"))


@app.command(epilog="Example: bayescal compare results/telescope results/telescope_seed2")
def compare(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="Results directories of one kind.")],
    trust: Trust = False,
) -> None:
    """Set several results side by side; of studies of the same data, rank their variants together."""
    from bayescal.experiments.frame.compare import compare_results

    experiment, table = compare_results(results, trust)
    experiment.show_comparison(table, make_console(WIDE))
