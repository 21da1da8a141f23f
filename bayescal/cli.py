"""The command line: exit code 0 for success, 2 for bad input, 3 for a failure on the way, 130 for an interrupt."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.padding import Padding

from bayescal.config.trust import allow_own_classes
from bayescal.errors import BayescalError, InputError, NumericalError, name_faults
from bayescal.experiments.frame.interrupts import INTERRUPTED, end_on_interrupt
from bayescal.files.plain_text import make_plain
from bayescal.limits import LARGEST_SEED

if TYPE_CHECKING:
    from bayescal.calibrated.machine import CalibratedMachine
    from bayescal.config.sections import ExperimentConfig

OWN_FAULT = "a fault of bayescal, or of a class of one's own"
TRACEBACK = "BAYESCAL_TRACEBACK"
"""Environment variable that shows where in the code a fault of bayescal's own is."""
WIDTH, WIDE = 120, 160
"""Of what is printed where there is no terminal; comparisons are wide."""

app = typer.Typer(
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Bayesian identification of parallel-kinematic machines.",
)

Experiment = Annotated[Path, typer.Argument(metavar="EXPERIMENT.toml", help="Config of the experiment.")]
Out = Annotated[Path | None, typer.Option(help="Results directory; default results/NAME.")]
Seed = Annotated[int | None, typer.Option(min=0, max=LARGEST_SEED, help="Seed in place of the config's.")]
Workers = Annotated[int | None, typer.Option(min=1, max=1024, help="Processes side by side; default one per core.")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Of dask: an address, a scheduler's JSON file, or local:N; its workers compute."
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Take up an interrupted run of the same config.")]


def _forbid_plugins(forbidden: bool) -> None:
    if forbidden:
        allow_own_classes(False)


NoPlugins = Annotated[
    bool,
    typer.Option(
        "--no-plugins",
        envvar="BAYESCAL_NO_PLUGINS",
        callback=_forbid_plugins,
        is_eager=True,
        help="Refuse classes that are not built in; import no code that a file names.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


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


@app.command(epilog="Example: bayescal run experiments/telescope/study.toml --workers 2")
def run(
    experiment: Experiment,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    no_plugins: NoPlugins = False,
) -> None:
    """Run an experiment of any kind and write its results and its report."""
    del no_plugins
    _run(experiment, None, out, seed, (workers, scheduler), resume, quiet)


@app.command(epilog="Example: bayescal audit experiments/audit/m2_hexapod.toml")
def audit(
    design: Annotated[Path, typer.Argument(metavar="DESIGN.toml", help="Machine, tolerances, plan and requirements.")],
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    no_plugins: NoPlugins = False,
) -> None:
    """Tell what a machine's measurements can and cannot determine: `bayescal run` of an audit."""
    del no_plugins
    _run(design, "audit", out, seed, (workers, scheduler), resume, quiet)


@app.command(epilog="Example: bayescal sweep experiments/audit/m2_hexapod_tracker.toml --workers 2")
def sweep(
    config: Annotated[Path, typer.Argument(metavar="SWEEP.toml", help="Experiment, keys that vary and figures.")],
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    no_plugins: NoPlugins = False,
) -> None:
    """Vary keys of an experiment and tell what becomes of its figures: `bayescal run` of a sweep."""
    del no_plugins
    _run(config, "sweep", out, seed, (workers, scheduler), resume, quiet)


@app.command(epilog="Example: bayescal check experiments/telescope/study.toml --variant six_pus/matrix")
def check(
    study: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Config of the study.")],
    variant: Annotated[list[str] | None, typer.Option(help="Variant to check; default the best by evidence.")] = None,
    data_sets: Annotated[
        int | None, typer.Option(min=4, max=10_000, help="Simulated of priors and posterior each.")
    ] = None,
    out: Out = None,
    seed: Seed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    quiet: Quiet = False,
    no_plugins: NoPlugins = False,
) -> None:
    """Check a study's config: simulation-based calibration, and the usual faults looked for one by one."""
    del no_plugins
    from bayescal.experiments.check.kind import configure_check

    _run_config(configure_check(study, variant or [], data_sets, seed), study, out, (workers, scheduler), resume, quiet)


def _run(
    path: Path,
    kind: str | None,
    out: Path | None,
    seed: int | None,
    engine: tuple[int | None, str | None],
    resume: bool,
    quiet: bool,
) -> None:
    from bayescal.experiments.frame.load import load_experiment, load_kind

    config = load_experiment(path) if kind is None else load_kind(path, kind)
    if seed is not None:
        config = config.model_copy(update={"seed": seed})
    _run_config(config, path, out, engine, resume, quiet)


def _run_config(
    config: ExperimentConfig,
    path: Path,
    out: Path | None,
    engine: tuple[int | None, str | None],
    resume: bool,
    quiet: bool,
) -> None:
    from joblib import cpu_count

    from bayescal.experiments.frame.run import run_experiment

    workers, scheduler = engine
    if workers is not None and scheduler is not None:
        raise InputError("--workers: found it beside --scheduler, expected one of them")
    where = out if out is not None else Path("results") / config.name
    interrupted = f"bayescal: interrupted; finished work is kept, go on with --resume (in {where}.partial)"
    with end_on_interrupt(interrupted), name_faults(path):
        finished = run_experiment(config, path.parent, where, workers or cpu_count(), resume, quiet, scheduler)
    if not quiet:
        finished.show(_make_console())
    if not finished.converged:
        raise NumericalError(
            f"{where}: {'; '.join(finished.failures)}, see the report; the results are written all the same"
        )


@app.command(epilog="Example: bayescal simulate experiments/telescope/simulate.toml --out data --seed 1")
def simulate(
    config: Annotated[Path, typer.Argument(metavar="SIMULATION.toml", help="Config of the simulation.")],
    out: Annotated[Path, typer.Option(help="Directory for the CSV files.")],
    seed: Seed = None,
    no_plugins: NoPlugins = False,
) -> None:
    """Simulate photogrammetry, an instrument's or a machine's own readings; the config states the truth."""
    del no_plugins
    from bayescal.experiments.frame.load import load
    from bayescal.experiments.frame.run import compute_experiment
    from bayescal.experiments.shared.simulated_data import SimulatedData
    from bayescal.files.atomic import check_writable, make_directory, write_atomically

    experiment, loaded = load(config)
    if not isinstance(experiment, SimulatedData):
        raise InputError(f"{config}: kind: found {loaded.kind!r}, expected a kind that simulates data")
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
    _check_out(out)
    if config.data.measurement != "targets":
        raise InputError(f"{experiment}: data.measurement: found {config.data.measurement!r}, expected 'targets'")
    if method is not None:
        look_up(METHODS, method, "--method", experiment)
        config = config.model_copy(update={"data": config.data.model_copy(update={"pose_method": method})})
    _put(format_poses(load_inputs(config, experiment.parent)), out)


Calibrated = Annotated[
    Path, typer.Argument(metavar="RESULTS", help="Results directory of a study, or a machine that export wrote.")
]
Variant = Annotated[str | None, typer.Option(help="Variant by its name; default the best.")]
Config = Annotated[
    Path | None, typer.Option("--experiment", help="Config of results that do not hold the nominal machine.")
]
Force = Annotated[bool, typer.Option("--force", help="Take a posterior that did not converge; files say so.")]
Table = Annotated[Path | None, typer.Option(help="CSV file; default standard output.")]


@app.command(epilog="Example: bayescal export results/m2_hexapod --format urdf --out machines/m2")
def export(
    results: Calibrated,
    variant: Variant = None,
    name: Annotated[
        str, typer.Option("--format", help="mechanism (every command takes it), csv, json, urdf or genhexkins.")
    ] = "mechanism",
    out: Annotated[Path | None, typer.Option(help="Directory; default machines/NAME-VARIANT.")] = None,
    experiment: Config = None,
    force: Force = False,
) -> None:
    """Write the machine as calibrated, with covariance and draws, as files for the next tool."""
    from bayescal.api import export_machine, load_calibrated
    from bayescal.files.atomic import check_writable

    calibrated = load_calibrated(results, variant, experiment, force)
    where = out or Path("machines") / calibrated.source.stem
    check_writable(where)
    for path in export_machine(calibrated, where, name):
        typer.echo(f"wrote {path}")
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal command results/m2_hexapod poses.csv --out actuators.csv")
def command(
    results: Calibrated,
    poses: Annotated[Path, typer.Argument(metavar="POSES.csv", help="pose, x_mm ... z_mm, rx_deg ... rz_deg.")],
    variant: Variant = None,
    out: Table = None,
    mark: Annotated[bool, typer.Option("--mark", help="Mark poses out of reach instead of refusing them.")] = False,
    experiment: Config = None,
    force: Force = False,
) -> None:
    """Tell the actuator positions that hold commanded poses, and how sure they are."""
    from bayescal.api import command_poses, load_calibrated
    from bayescal.calibrated.tables import check_reached, format_command, read_commanded

    calibrated = load_calibrated(results, variant, experiment, force)
    _check_out(out)
    commanded = read_commanded(poses, calibrated.n_legs)
    found = command_poses(calibrated, commanded.position, commanded.rotation)
    if not mark:
        check_reached(commanded, found)
    _put(format_command(calibrated, commanded.names, found), out)
    _tell_missing(results, calibrated)


@app.command(epilog="Example: bayescal predict results/m2_hexapod actuators.csv --out poses.csv")
def predict(
    results: Calibrated,
    actuators: Annotated[Path, typer.Argument(metavar="ACTUATORS.csv", help="pose, rho_1_mm, rho_2_mm ...")],
    variant: Variant = None,
    out: Table = None,
    draws: Annotated[Path | None, typer.Option(help="CSV file for poses by draws of the posterior.")] = None,
    n_draws: Annotated[int, typer.Option(min=1, max=100_000, help="How many of them.")] = 100,
    seed: Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Of the draws' errors.")] = 0,
    experiment: Config = None,
    force: Force = False,
) -> None:
    """Predict the poses of actuator positions with their covariance."""
    import numpy as np

    from bayescal.api import draw_poses, load_calibrated, predict_poses
    from bayescal.calibrated.tables import check_found, format_draws, format_prediction, read_positions

    calibrated = load_calibrated(results, variant, experiment, force)
    _check_out(out)
    _check_out(draws)
    names, positions = read_positions(actuators, calibrated)
    found = predict_poses(calibrated, positions)
    check_found(actuators, names, found)
    if draws is not None:
        drawn = draw_poses(calibrated, positions, n_draws, np.random.default_rng(seed))
        _put(format_draws(calibrated, names, *drawn), draws)
    _put(format_prediction(calibrated, names, found), out)
    _tell_missing(results, calibrated)


def _check_out(out: Path | None) -> None:
    """Find out before anything is computed whether a file of results can be written."""
    from bayescal.files.atomic import check_writable

    if out is not None:
        if out.is_dir():
            raise InputError(f"{out}: is a directory, expected a file name")
        check_writable(out.parent)


def _put(text: str, out: Path | None) -> None:
    """Write a text to a file, or to standard output."""
    from bayescal.files.atomic import make_directory, write_atomically

    if out is None:
        typer.echo(text, nl=False)
    else:
        make_directory(out.parent)
        write_atomically(out, text.encode())
        typer.echo(f"wrote {out}")


def _tell_missing(results: Path, calibrated: CalibratedMachine) -> None:
    """Say on standard error that there is no covariance, and why."""
    if calibrated.covariance is None:
        typer.echo(f"{results}: no draws of the posterior (posterior/*.nc): without covariance and draws", err=True)


Kind = Annotated[
    str | None, typer.Option(help="module:Class or file.py:Class, for results of a kind that is not built in.")
]


@app.command(epilog="Example: bayescal report results/telescope")
def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results directory.")],
    kind: Kind = None,
) -> None:
    """Write the page of a results directory anew, from its files alone."""
    from bayescal.experiments.frame.run import write_report

    typer.echo(f"wrote {write_report(results, kind)}")


@app.command(epilog="Example: bayescal show experiments/audit/m2_hexapod_mechanism.toml --out m2.html")
def show(
    machine: Annotated[Path, typer.Argument(metavar="MACHINE.toml", help="A machine's file.")],
    out: Annotated[Path | None, typer.Option(help="HTML file; default MACHINE.html here.")] = None,
) -> None:
    """Draw a machine as a page in which it can be turned, with its joints and legs."""
    from bayescal.experiments.shared.show import describe_machine
    from bayescal.report.page import render_page

    page = describe_machine(machine)
    _put(render_page(page, {}), out if out is not None else Path(f"{machine.stem}.html"))


@app.command(epilog="Example: bayescal compare results/telescope results/telescope_seed2")
def compare(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="Results directories of one kind.")],
    kind: Kind = None,
) -> None:
    """Set several results side by side; of studies of the same data, rank their variants together."""
    from bayescal.experiments.frame.compare import compare_results

    experiment, table = compare_results(results, kind)
    experiment.show_comparison(table, _make_console(WIDE))


@app.command(epilog="Example: bayescal validate experiments/telescope/study.toml")
def validate(experiment: Experiment, no_plugins: NoPlugins = False) -> None:
    """Find everything at fault in a config and its files without computing, and say what a run would do."""
    del no_plugins
    from bayescal.experiments.frame.load import load
    from bayescal.experiments.frame.run import check_experiment
    from bayescal.experiments.shared.simulated_data import SimulatedData

    kind, config = load(experiment)
    with name_faults(experiment):
        files, doubts = check_experiment(config, experiment.parent)
    typer.echo(f"{experiment}: fit to run, a {config.kind} {config.name!r} ({config.title})")
    for doubt in doubts:
        typer.echo(f"but {doubt}")
    typer.echo(f"{len(files)} files belong to it: {', '.join(files)}" if files else "no other file belongs to it")
    command = "simulate" if isinstance(kind, SimulatedData) else "run"
    typer.echo(f"next: bayescal {command} {experiment}, into results/{config.name}")


@app.command(epilog="Example: bayescal init my_hexapod --machine hexapod --instrument poses")
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New folder for the project.")],
    machine: Annotated[
        str | None, typer.Option(help="hexapod (struts), carriages (legs of fixed length) or own (one function).")
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(help="targets, poses or points; own machines bring their sensors.")
    ] = None,
) -> None:
    """Begin a project: a commented machine with simulated data that runs as it is; asks what is not said."""
    from bayescal.projects.start import INSTRUMENTS, MACHINES, OWN, start_project

    machine = machine or _ask("--machine", list(MACHINES))
    if instrument is None and machine != OWN:
        instrument = _ask("--instrument", list(INSTRUMENTS))
    for path in start_project(folder, machine, instrument):
        typer.echo(f"wrote {path}")
    typer.echo(f"the data are simulated; next: cd {folder}, bayescal run study.toml, and read README.md")


def _ask(option: str, choices: list[str]) -> str:
    """Return what is chosen at the terminal; InputError where nobody can be asked."""
    if not _is_terminal():
        raise InputError(f"init: {option}: missing, expected one of {', '.join(choices)}")
    answer: str = typer.prompt(f"{option.removeprefix('--')} ({', '.join(choices)})", default=choices[0])
    return answer.strip()


def _is_terminal() -> bool:
    """Whether somebody can be asked."""
    return sys.stdin.isatty()


@app.command("list", epilog="Example: bayescal list models")
def list_names(
    sort: Annotated[
        str | None, typer.Argument(metavar="[SORT]", help="kinds, models, sensors, ...; all by default.")
    ] = None,
) -> None:
    """List what a config can name: kinds, models, deformations, sensors, criteria, methods, own ones too."""
    from bayescal.experiments.frame.catalogue import list_entries, list_sorts

    console = _make_console()
    sorts = list_sorts() if sort is None else {sort: list_sorts().get(sort, "")}
    for one in sorts:
        entries = list_entries(one)
        console.print(f"{sorts[one]} ({one})")
        for entry in entries:
            console.print(Padding(f"{entry.name}{' (own)' if entry.own else ''}: {entry.text}", (0, 0, 0, 2)))


@app.command(epilog="Example: bayescal schema study > study.schema.json")
def schema(kind: Annotated[str, typer.Argument(metavar="KIND", help="Kind of experiment, as in its config.")]) -> None:
    """Print the JSON Schema of a kind's config, by which editors complete and check it."""
    import json

    from bayescal.experiments.frame.catalogue import describe_schema

    typer.echo(json.dumps(describe_schema(kind), indent=1, ensure_ascii=False))


def _make_console(width: int = WIDTH) -> Console:
    """Return where to print; without a terminal as wide as COLUMNS says, or as is given."""
    found = Console(highlight=False, markup=False)
    if found.is_terminal:
        return found
    told = os.environ.get("COLUMNS", "")
    return Console(width=int(told) if told.isdecimal() and int(told) else width, highlight=False, markup=False)


def main() -> None:
    """Run the command line; errors become one line on standard error and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without Greek letters
    allow_own_classes(True)
    try:
        code = app(standalone_mode=False)
    except typer.TyperException as error:
        code = _complain(f"{error.format_message()} See bayescal --help.", InputError.exit_code)
    except BayescalError as error:
        code = _complain(str(error), error.exit_code)
    except OSError as error:  # a file or directory that may not be read or written, a full disk
        where = error.filename or "a file of the results"
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO)
        code = _complain(
            f"{where}: {error.strerror}, expected {'room to write' if full else 'to read or write there'}",
            NumericalError.exit_code if full else InputError.exit_code,
        )
    except MemoryError:
        code = _complain(
            "found too little memory, expected a smaller task or a larger machine", NumericalError.exit_code
        )
    except (KeyboardInterrupt, typer.Abort):
        code = _complain("interrupted", INTERRUPTED)
    except Exception as error:
        if os.environ.get(TRACEBACK):
            raise
        code = _complain(_describe_own_fault(error), NumericalError.exit_code)
    sys.exit(code or 0)


def _describe_own_fault(error: Exception) -> str:
    """Return what nobody foresaw in a line: where, what, and how to see all of it."""
    where = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"{type(error).__name__}: {error} ({Path(where.filename).name}, line {where.lineno}): {OWN_FAULT}, expected a "
        f"line that says what is wrong; please report it with what {TRACEBACK}=1 shows"
    )


def _complain(message: str, code: int) -> int:
    typer.echo(f"bayescal: {make_plain(' '.join(message.split()))}", err=True)
    return code


if __name__ == "__main__":
    main()
