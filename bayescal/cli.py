"""The command line: exit code 0 for success, 2 for bad input, 3 for a numerical failure, 130 for an interrupt."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from bayescal.errors import BayescalError, InputError, NotConvergedError, NumericalError

INTERRUPTED = 130
RUNNERS = {
    "pose_methods": ("bayescal.reproductions.rr8096.pose_methods.run", "run_pose_methods"),
    "pose_selection": ("bayescal.experiments.pose_selection.run", "run_pose_selection"),
    "hexapod_calibrations": ("bayescal.reproductions.yu2023.run", "run_hexapod_calibrations"),
    "sensor_placement": ("bayescal.experiments.sensor_placement.run", "run_sensor_placement"),
    "self_calibration": ("bayescal.experiments.self_calibration.run", "run_self_calibration"),
    "self_calibrations": ("bayescal.reproductions.sika2008.run", "run_self_calibrations"),
}
"""What runs an experiment of a kind, given config, folder, results directory and workers; it returns what to print."""

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Bayesian identification of parallel-kinematic machines.",
)

Experiment = Annotated[Path, typer.Argument(metavar="EXPERIMENT.toml", help="Config of the experiment.")]
Seed = Annotated[int | None, typer.Option(min=0, help="Seed in place of the config's.")]


@app.command(epilog="Example: bayescal run experiments/telescope/study.toml --workers 2")
def run(
    experiment: Experiment,
    out: Annotated[Path | None, typer.Option(help="Results directory; default results/NAME.")] = None,
    seed: Seed = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes side by side; default one per core.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Take up an interrupted run of the same config.")] = False,
) -> None:
    """Run an experiment and write its results and its report."""
    import joblib

    from bayescal.config import StudyConfig, load_experiment

    config = load_experiment(experiment)
    if seed is not None:
        config = config.model_copy(update={"seed": seed})
    where = out if out is not None else Path("results") / config.name
    count = workers if workers is not None else joblib.cpu_count()
    if not isinstance(config, StudyConfig):
        from bayescal.experiments.study.inputs import naming

        module, function = RUNNERS[config.kind]
        with naming(experiment):
            try:
                typer.echo(getattr(import_module(module), function)(config, experiment.parent, where, count))
            except NotConvergedError as error:
                typer.echo(error.found)
                raise
        return
    from bayescal.experiments.study.run import run_study

    interrupted = f"bayescal: interrupted; finished work is kept, go on with --resume (in {where}.partial)"
    try:
        with _end_on_interrupt(interrupted) if count == 1 else nullcontext():
            result = run_study(config, experiment.parent, where, count, resume)
    except KeyboardInterrupt:
        typer.echo(interrupted, err=True)
        raise typer.Exit(INTERRUPTED) from None
    from bayescal.report.terminal import print_ranking

    print_ranking(result.summary, where)
    if not result.converged:
        raise NumericalError(f"{where}: not everything converged, see the report; the results are written all the same")


@app.command(epilog="Example: bayescal simulate experiments/telescope/simulate.toml --out data --seed 1")
def simulate(
    config: Annotated[Path, typer.Argument(metavar="SIMULATION.toml", help="Config of the simulation.")],
    out: Annotated[Path, typer.Option(help="Directory for the CSV files.")],
    seed: Seed = None,
) -> None:
    """Simulate the photogrammetry of a machine whose truth the config states, or readings of its own sensors."""
    import numpy as np

    from bayescal.config import load_reading_simulation, load_simulation
    from bayescal.data.simulation import build_twin, format_survey, simulate_survey
    from bayescal.experiments.self_calibration.simulate import simulate_readings
    from bayescal.experiments.study.inputs import naming
    from bayescal.files.atomic import write_atomically

    readings = load_reading_simulation(config)
    if readings is not None:
        rng = np.random.default_rng(readings.seed if seed is None else seed)
        with naming(config):
            texts = simulate_readings(readings, config.parent, rng)
    else:
        loaded = load_simulation(config)
        twin = build_twin(loaded, config.parent)
        survey = simulate_survey(twin, np.random.default_rng(loaded.seed if seed is None else seed))
        texts = format_survey(survey, loaded.origin)
    make_directory(out)
    for name, text in texts.items():
        write_atomically(out / name, text.encode())
        typer.echo(f"wrote {out / name}")


@app.command(
    "poses-from-targets", epilog="Example: bayescal poses-from-targets experiments/telescope/study.toml --out poses.csv"
)
def poses_from_targets(
    experiment: Experiment,
    out: Annotated[Path | None, typer.Option(help="CSV file for the poses; default standard output.")] = None,
    method: Annotated[str | None, typer.Option(help="robust or line, in place of the config's.")] = None,
) -> None:
    """Extract the platform's poses in the base frame, with their covariances, from a study's targets."""
    from bayescal.config import StudyConfig, load_experiment
    from bayescal.config.load import look_up
    from bayescal.data.photogrammetry.poses import METHODS
    from bayescal.experiments.study.inputs import load_inputs
    from bayescal.experiments.study.tables import format_poses
    from bayescal.files.atomic import write_atomically

    config = load_experiment(experiment)
    if not isinstance(config, StudyConfig):
        raise InputError(f"{experiment}: kind: found {config.kind!r}, expected 'study'")
    if method is not None:
        look_up(METHODS, method, "--method", experiment)
        config = config.model_copy(update={"data": config.data.model_copy(update={"pose_method": method})})
    text = format_poses(load_inputs(config, experiment.parent))
    if out is None:
        typer.echo(text, nl=False)
    else:
        make_directory(out.parent)
        write_atomically(out, text.encode())
        typer.echo(f"wrote {out}")


@app.command(epilog="Example: bayescal audit experiments/audit/telescope.toml")
def audit(
    design: Annotated[Path, typer.Argument(metavar="DESIGN.toml", help="Machine, tolerances, plan and requirements.")],
    out: Annotated[Path | None, typer.Option(help="Directory for the results; default results/NAME.")] = None,
) -> None:
    """Tell what a machine's measurements can and cannot determine, before it is built or after."""
    from bayescal.experiments.audit.i_optimal import propose_i_optimal
    from bayescal.experiments.audit.load import load_audit
    from bayescal.experiments.audit.run import write_audit
    from bayescal.experiments.study.inputs import naming
    from bayescal.report.terminal import print_audit

    config = load_audit(design)
    where = out if out is not None else Path("results") / config.name
    with naming(design):
        summary = write_audit(config, design.parent, where, propose_i_optimal)
    print_audit(summary, where)
    if not summary.get("posterior", {"converged": True})["converged"]:
        raise NumericalError(
            f"{where}: the posterior did not converge, see the report; the results are written all the same"
        )


@app.command(epilog="Example: bayescal report results/telescope")
def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results directory of a study or of an audit.")],
) -> None:
    """Write the report of a results directory anew."""
    if (results / "audit.json").is_file():
        from bayescal.experiments.audit.page.write import write_audit_report

        typer.echo(f"wrote {write_audit_report(results)}")
        return
    from bayescal.experiments.study.page.write import write_report
    from bayescal.files.atomic import read_json

    provenance = results / "provenance.json"
    config = read_json(provenance).get("config") if provenance.is_file() else None
    kind = config.get("kind") if isinstance(config, dict) else None
    if isinstance(kind, str) and kind in RUNNERS:
        raise InputError(
            f"{results}: found results of kind {kind!r}, whose page `bayescal run` writes, "
            "expected those of a study or an audit"
        )
    typer.echo(f"wrote {write_report(results)}")


@app.command(epilog="Example: bayescal compare results/telescope results/telescope_seed2")
def compare(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="Results directories of studies.")],
) -> None:
    """Rank the variants of several studies of the same data together."""
    from bayescal.experiments.study.compare import compare_results
    from bayescal.report.terminal import print_comparison

    print_comparison(compare_results(results))


def make_directory(path: Path) -> None:
    """Make a directory; InputError where a file is in the way or it may not be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a directory ({error.strerror})") from error


@contextmanager
def _end_on_interrupt(message: str) -> Iterator[None]:
    """Let an interrupt end the process at once, with a message.

    Where the sampling is done in this process, a KeyboardInterrupt would be printed with its traceback by emcee, or
    lost in a callback from C. Nothing needs to be unwound: every file is written whole or not at all. A process that
    was started to ignore interrupts, in the background of a script, goes on ignoring them.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    show_cursor = "\x1b[?25h\n" if sys.stderr.isatty() else ""  # the progress bar hides it

    def end(*_: object) -> None:
        os.write(2, f"{show_cursor}{message}\n".encode())
        os._exit(INTERRUPTED)

    before = signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def main() -> None:
    """Run the command line; errors become one line on standard error and an exit code."""
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        code = _complain(f"{error.format_message()} See bayescal --help.", InputError.exit_code)
    except BayescalError as error:
        code = _complain(str(error), error.exit_code)
    except OSError as error:  # a file or directory that may not be read or written, a full disk
        code = _complain(f"{error.filename}: {error.strerror}, expected to read or write there", InputError.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        code = _complain("interrupted", INTERRUPTED)
    sys.exit(code or 0)


def _complain(message: str, code: int) -> int:
    typer.echo(f"bayescal: {' '.join(message.split())}", err=True)
    return code


if __name__ == "__main__":
    main()
