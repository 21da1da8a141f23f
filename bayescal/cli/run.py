"""Commands that run an experiment, of any kind or of one that has its own word, and that make data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayescal.cli.app import (
    AllowUnconverged,
    Experiment,
    NoCustomCode,
    RunOptions,
    Seed,
    Trust,
    app,
    check_out,
    echo,
    make_console,
    put,
    spread_options,
)
from bayescal.errors import InputError, NumericalError, name_faults
from bayescal.experiments.runner.interrupts import end_on_interrupt

if TYPE_CHECKING:
    from bayescal.config.sections import ExperimentConfig


@app.command(epilog="Example: bayescal run experiments/telescope/study.toml --workers 2")
@spread_options
def run(
    experiment: Experiment,
    options: RunOptions,
    effort: Annotated[
        str | None, typer.Option(metavar="EFFORT", help="quick (preliminary answer), standard or thorough.")
    ] = None,
) -> None:
    """Run an experiment of any kind and write its results and its report."""
    run_file(experiment, None, options, effort)


@app.command(epilog="Example: bayescal audit experiments/audit/m2_hexapod.toml")
@spread_options
def audit(
    design: Annotated[Path, typer.Argument(metavar="DESIGN.toml", help=("Machine, tolerances, plan, requirements."))],
    options: RunOptions,
) -> None:
    """Audit what a machine's measurements can and cannot determine: `bayescal run` of an audit."""
    run_file(design, "audit", options)


@app.command(epilog="Example: bayescal sweep experiments/audit/m2_hexapod_tracker.toml --workers 2")
@spread_options
def sweep(
    config: Annotated[Path, typer.Argument(metavar="SWEEP.toml", help="Experiment, varied keys, figures.")],
    options: RunOptions,
) -> None:
    """Vary keys of an experiment and compare its results: `bayescal run` of a sweep."""
    run_file(config, "sweep", options)


@app.command(epilog="Example: bayescal selftest experiments/telescope/study.toml --variant six_pus/matrix")
@spread_options
def selftest(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Config of the study.")],
    options: RunOptions,
    variant: Annotated[list[str] | None, typer.Option(help="Variant; default the best.")] = None,
    data_sets: Annotated[int | None, typer.Option(min=4, max=10_000, help="Number of simulations.")] = None,
) -> None:
    """Test a study's config: simulation-based calibration, and the usual faults looked for one by one."""
    from bayescal.experiments.selftest.kind import configure_selftest

    run_config(configure_selftest(study, variant or [], data_sets, options.seed), study, options)


def run_file(path: Path, kind: str | None, options: RunOptions, effort: str | None = None) -> None:
    """Run a config's file; of one kind alone where that is named."""
    from bayescal.experiments.runner.load import load_experiment, load_kind

    config = load_experiment(path) if kind is None else load_kind(path, kind)
    if options.seed is not None:
        config = config.model_copy(update={"seed": options.seed})
    if effort is not None:
        from bayescal.experiments.shared.study_schema import change_effort

        config = change_effort(config, effort)
    run_config(config, path, options)


def run_config(config: ExperimentConfig, path: Path, options: RunOptions) -> None:
    """Run a config that was read from a file, show what it found, and fail where it did not converge."""
    from bayescal.experiments.runner.engine import stop_workers
    from bayescal.experiments.runner.run import run_experiment

    workers, scheduler = options.workers, options.dask_scheduler
    if workers is not None and scheduler is not None:
        raise InputError("--workers: found with --dask-scheduler, expected either")
    where = options.out if options.out is not None else Path("results") / config.name
    interrupted = f"bayescal: interrupted; continue with --resume (in {where}.partial)"
    with end_on_interrupt(interrupted), name_faults(path):
        finished = run_experiment(config, path.parent, where, workers, options.resume, options.quiet, scheduler)
    stop_workers()
    if not options.quiet:
        finished.show(make_console())
    if not finished.converged:
        raise NumericalError(f"{where}: {'; '.join(finished.failures)}; see the report")


@app.command("next-pose", epilog="Example: bayescal next-pose experiments/m2_hexapod/next_pose.toml")
@spread_options
def next_pose(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Study or next-pose config.")],
    options: RunOptions,
    variant: Annotated[list[str] | None, typer.Option(help="Variants; default all.")] = None,
    require: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Largest tool error, mm or degrees.")
    ] = None,
) -> None:
    """Recommend the next pose to measure, with what it will bring, or to stop."""
    from bayescal.experiments.next_pose.kind import configure_next_pose

    run_config(configure_next_pose(study, variant or [], require or [], options.seed), study, options)


@app.command(epilog="Example: bayescal table experiments/m2_hexapod_table/table.toml")
@spread_options
def table(
    config: Annotated[Path, typer.Argument(metavar="TABLE.toml", help="Calibration, axes, reference.")],
    options: RunOptions,
    allow_unconverged: AllowUnconverged = False,
) -> None:
    """Compute what actuators have to do by elevation, temperature and the like: `bayescal run` of a look-up table."""
    from bayescal.experiments.runner.load import load_kind

    found = load_kind(config, "table")
    changed = {} if options.seed is None else {"seed": options.seed}
    run_config(
        found.model_copy(update={**changed, **({"allow_unconverged": True} if allow_unconverged else {})}),
        config,
        options,
    )


@app.command(epilog="Example: bayescal simulate experiments/telescope/simulate.toml --out data --seed 1")
def simulate(
    config: Annotated[Path, typer.Argument(metavar="SIMULATION.toml", help="Config of the simulation.")],
    out: Annotated[Path, typer.Option(help="Output directory.")],
    seed: Seed = None,
    no_custom_code: NoCustomCode = False,
    trust: Trust = False,
) -> None:
    """Simulate photogrammetry, an instrument's or a machine's own readings; the config states the truth."""
    del no_custom_code, trust
    from bayescal.experiments.runner.load import load_kind
    from bayescal.experiments.runner.run import compute_experiment
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
        echo(f"wrote {out / name}")


@app.command(
    "poses-from-targets", epilog="Example: bayescal poses-from-targets experiments/telescope/study.toml --out poses.csv"
)
def poses_from_targets(
    experiment: Experiment,
    out: Annotated[Path | None, typer.Option(help="CSV file; default stdout.")] = None,
    method: Annotated[str | None, typer.Option(help="robust, line or least_squares.")] = None,
    trust: Trust = False,
) -> None:
    """Extract the platform's poses in the base frame, with their covariances, from a study's targets."""
    del trust
    from bayescal.config.load import look_up
    from bayescal.data.photogrammetry.poses import METHODS
    from bayescal.experiments.runner.load import load_kind
    from bayescal.experiments.shared.readings.data_schema import TargetDataConfig
    from bayescal.experiments.shared.readings.inputs import read_first_machine
    from bayescal.experiments.shared.readings.measurement import measure_tables
    from bayescal.experiments.study.tables import format_poses

    config = load_kind(experiment, "study")
    check_out(out)
    tables = [one for one in config.data if isinstance(one, TargetDataConfig)]
    if len(tables) != 1:
        raise InputError(f"{experiment}: data: found {len(tables)} tables of targets, expected one")
    if method is not None:
        look_up(METHODS, method, "--method")
        tables = [tables[0].model_copy(update={"pose_estimator": method})]
    config = config.model_copy(update={"data": tables})
    folder = experiment.parent
    measured = measure_tables(config, folder, read_first_machine(config, folder))
    put(format_poses(measured[0], config.provenance), out)
