"""Commands about results and configs: report, show, compare; check a file, begin a project, list names, schema."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from bayescal.cli.app import (
    WIDE,
    AllowChangedFiles,
    Experiment,
    NoCustomCode,
    Trust,
    app,
    echo,
    make_console,
    print_sentence,
    put,
)
from bayescal.errors import InputError
from bayescal.files.manifest import MANIFEST, overlooking


@app.command(epilog="Example: bayescal report results/telescope")
def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results directory.")],
    trust: Trust = False,
    allow_changed_files: AllowChangedFiles = False,
) -> None:
    """Write the page of a results directory again, from its files alone."""
    del trust
    from bayescal.experiments.runner.run import write_report

    with overlooking(allow_changed_files):
        echo(f"wrote {write_report(results)}")


@app.command(epilog="Example: bayescal show experiments/audit/m2_hexapod_mechanism.toml --out m2.html")
def show(
    machine: Annotated[Path, typer.Argument(metavar="MACHINE.toml", help="A machine's file.")],
    out: Annotated[Path | None, typer.Option(help="HTML file; default MACHINE.html.")] = None,
    trust: Trust = False,
) -> None:
    """Draw a machine as a page in which it can be turned, with its joints and legs."""
    del trust
    from bayescal.experiments.shared.show import describe_machine
    from bayescal.report.page import render_page

    page = describe_machine(machine)
    put(render_page(page, {}), out if out is not None else Path(f"{machine.stem}.html"))


@app.command(epilog="Example: bayescal compare results/telescope results/telescope_seed2")
def compare(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="Results directories.")],
    trust: Trust = False,
    allow_changed_files: AllowChangedFiles = False,
) -> None:
    """Set several results side by side; of studies of the same data, rank their variants together."""
    del trust
    from bayescal.experiments.runner.run import compare_results

    with overlooking(allow_changed_files):
        experiment, table = compare_results(results)
    experiment.show_comparison(table, make_console(WIDE))


@app.command(epilog="Example: bayescal validate experiments/telescope/study.toml")
def validate(experiment: Experiment, no_custom_code: NoCustomCode = False, trust: Trust = False) -> None:
    """Find everything at fault in a config and its files without computing, and say what a run would do."""
    del no_custom_code, trust
    from bayescal.experiments.runner.run import check_file
    from bayescal.files.plain_text import add_article

    config, found = check_file(experiment)
    state = "readable, but suspect" if found.suspicions else "fit to run"
    print_sentence(f"{experiment}: {state}, {add_article(config.kind)} {config.name!r} ({config.title})")
    for doubt in (*found.suspicions, *found.doubts):
        print_sentence(f"but {doubt}")
    for line in found.outlook:
        print_sentence(line)
    n_files = len(found.files)
    print_sentence(f"{n_files} files belong to it: {', '.join(found.files)}" if n_files else "no other file")
    if found.suspicions or found.doubts:
        print_sentence(f"next: correct data or config, then bayescal validate {experiment}")
    if found.suspicions:  # as a run would end
        echo(f"bayescal: {experiment}: probable data error", err=True)
        raise typer.Exit(3)
    if found.doubts:
        print_sentence(f"if they are right: bayescal run {experiment}")
        return
    command = "simulate" if config.kind == "simulation" else "run"
    print_sentence(f"next: bayescal {command} {experiment}, into results/{config.name}")


@app.command(epilog="Example: bayescal init my_hexapod --machine hexapod --instrument poses")
def init(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="New folder.")],
    machine: Annotated[str | None, typer.Option(help="hexapod (struts), carriages (fixed legs) or own.")] = None,
    instrument: Annotated[str | None, typer.Option(help="targets, poses or points; not for own.")] = None,
    source: Annotated[Path | None, typer.Option("--from", metavar="FILE", help="Another program's file.")] = None,
    option: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE", help="With --from: what to take.")] = None,
) -> None:
    """Begin a project: a commented machine with simulated data that runs as it is; asks what is not said.

    With --from the machine, and the measurements that stand beside it, of another program's file.
    """
    from bayescal.projects.start import INSTRUMENTS, MACHINES, OWN, start_from, start_project

    if source is not None:
        for name, value in (("--machine", machine), ("--instrument", instrument)):
            if value is not None:
                raise InputError(f"init: {name}: found {value!r}, expected none with --from")
        files, project = start_from(folder, source, _read_options(option or []))
        for path in files:
            echo(f"wrote {path}")
        for line in project.found:
            print_sentence(line)
        echo(f"next: cd {folder}, {project.advice}")
        return
    if option:
        raise InputError("init: --option: expected --from with it")
    machine = machine or _ask("--machine", list(MACHINES))
    if instrument is None and machine != OWN:
        instrument = _ask("--instrument", list(INSTRUMENTS))
    for path in start_project(folder, machine, instrument):
        echo(f"wrote {path}")
    echo(f"simulated data; next: cd {folder}, bayescal run study.toml")


def _read_options(pairs: list[str]) -> dict[str, str]:
    """Return options by name; InputError for one that is no pair."""
    for pair in pairs:
        if "=" not in pair:
            raise InputError(f"init: --option: found {pair!r}, expected KEY=VALUE")
    return {name.strip(): value.strip() for name, _, value in (pair.partition("=") for pair in pairs)}


def _ask(option: str, choices: list[str]) -> str:
    """Return what is chosen at the terminal; InputError where nobody can be asked."""
    if not sys.stdin.isatty():
        raise InputError(f"init: {option}: missing, expected one of {', '.join(choices)}")
    answer: str = typer.prompt(f"{option.removeprefix('--')} ({', '.join(choices)})", default=choices[0])
    return answer.strip()


@app.command("update-manifest", epilog="Example: bayescal update-manifest results/telescope")
def update_manifest(
    results: Annotated[list[Path], typer.Argument(metavar="RESULTS...", help="Results directories.")],
) -> None:
    """Write the manifest of results (SHA-256 of each file) as they are now, for files that you changed on purpose."""
    from bayescal.experiments.runner.results import read_results
    from bayescal.files.manifest import write_manifest

    for folder in results:
        read_results(folder, (), checked=False)  # that they are some
    for folder in results:
        write_manifest(folder)
        echo(f"wrote {folder / MANIFEST}")


@app.command("trust", epilog="Example: bayescal trust examples/own_machine")
def trust_folder(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of configs or results.")],
    look: Annotated[bool, typer.Option("--list", help="List files only.")] = False,
    forget: Annotated[bool, typer.Option("--forget", help="Withdraw trust.")] = False,
) -> None:
    """Trust the code that configs and results in a folder name, as it is now: every command may run it."""
    from bayescal.config.trust import forget as forget_files
    from bayescal.config.trust import list_code, remember

    if not folder.is_dir():
        raise InputError(f"{folder}: found no directory, expected configs or results")
    files = list_code(folder)
    if not look:
        (forget_files if forget else remember)(files)
    for path in files:
        echo(f"{'' if look else 'forgotten: ' if forget else 'trusted: '}{path}")
    if not files:
        echo(f"{folder}: no file with code is named")


@app.command("list", epilog="Example: bayescal list models")
def list_names(
    sort: Annotated[str | None, typer.Argument(metavar="[SORT]", help="kinds, models, sensors, ...")] = None,
) -> None:
    """List what a config can name: kinds, models, deformations, sensors, criteria, methods, own ones too."""
    from rich.padding import Padding

    from bayescal.experiments.runner.load import list_entries, list_sorts

    console = make_console()
    sorts = list_sorts() if sort is None else {sort: list_sorts().get(sort, "")}
    for one in sorts:
        entries = list_entries(one)
        console.print(f"{sorts[one]} ({one})")
        for entry in entries:
            console.print(Padding(f"{entry.name}{' (own)' if entry.own else ''}: {entry.text}", (0, 0, 0, 2)))


@app.command(epilog="Example: bayescal schema study > study.schema.json")
def schema(kind: Annotated[str, typer.Argument(metavar="KIND", help="Kind of experiment.")]) -> None:
    """Print the JSON Schema of a kind's config, by which editors complete and check it."""
    import json

    from bayescal.experiments.runner.load import describe_schema

    echo(json.dumps(describe_schema(kind), indent=1, ensure_ascii=False))
