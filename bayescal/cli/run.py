"""Commands that run an experiment: of any kind, or of one that has its own word."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import app
from bayescal.cli.console import make_console
from bayescal.cli.options import Experiment, RunOptions, spread_options
from bayescal.errors import InputError, NumericalError, name_faults
from bayescal.experiments.frame.interrupts import end_on_interrupt

if TYPE_CHECKING:
    from bayescal.config.sections import ExperimentConfig


@app.command(epilog="Example: bayescal run experiments/telescope/study.toml --workers 2")
@spread_options
def run(experiment: Experiment, options: RunOptions) -> None:
    """Run an experiment of any kind and write its results and its report."""
    run_file(experiment, None, options)


@app.command(epilog="Example: bayescal audit experiments/audit/m2_hexapod.toml")
@spread_options
def audit(
    design: Annotated[Path, typer.Argument(metavar="DESIGN.toml", help="Machine, tolerances, plan and requirements.")],
    options: RunOptions,
) -> None:
    """Tell what a machine's measurements can and cannot determine: `bayescal run` of an audit."""
    run_file(design, "audit", options)


@app.command(epilog="Example: bayescal sweep experiments/audit/m2_hexapod_tracker.toml --workers 2")
@spread_options
def sweep(
    config: Annotated[Path, typer.Argument(metavar="SWEEP.toml", help="Experiment, keys that vary and figures.")],
    options: RunOptions,
) -> None:
    """Vary keys of an experiment and tell what becomes of its figures: `bayescal run` of a sweep."""
    run_file(config, "sweep", options)


@app.command(epilog="Example: bayescal check experiments/telescope/study.toml --variant six_pus/matrix")
@spread_options
def check(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Config of the study.")],
    options: RunOptions,
    variant: Annotated[list[str] | None, typer.Option(help="Variant to check; default the best by evidence.")] = None,
    data_sets: Annotated[
        int | None, typer.Option(min=4, max=10_000, help="Simulated of priors and posterior each.")
    ] = None,
) -> None:
    """Check a study's config: simulation-based calibration, and the usual faults looked for one by one."""
    from bayescal.experiments.check.kind import configure_check

    run_config(configure_check(study, variant or [], data_sets, options.seed), study, options)


def run_file(path: Path, kind: str | None, options: RunOptions) -> None:
    """Run a config's file; of one kind alone where that is named."""
    from bayescal.experiments.frame.load import load_experiment, load_kind

    config = load_experiment(path) if kind is None else load_kind(path, kind)
    if options.seed is not None:
        config = config.model_copy(update={"seed": options.seed})
    run_config(config, path, options)


def run_config(config: ExperimentConfig, path: Path, options: RunOptions) -> None:
    """Run a config that was read from a file, show what it found, and fail where it did not converge."""
    from joblib import cpu_count

    from bayescal.experiments.frame.engine import stop_workers
    from bayescal.experiments.frame.run import run_experiment

    workers, scheduler = options.workers, options.scheduler
    if workers is not None and scheduler is not None:
        raise InputError("--workers: found it beside --scheduler, expected one of them")
    where = options.out if options.out is not None else Path("results") / config.name
    interrupted = f"bayescal: interrupted; finished work is kept, go on with --resume (in {where}.partial)"
    with end_on_interrupt(interrupted), name_faults(path):
        finished = run_experiment(
            config, path.parent, where, workers or cpu_count(), options.resume, options.quiet, scheduler
        )
    stop_workers()
    if not options.quiet:
        finished.show(make_console())
    if not finished.converged:
        raise NumericalError(
            f"{where}: {'; '.join(finished.failures)}, see the report; the results are written all the same"
        )
