"""Options that several commands have; those of every run stand together and are spread into a command's own."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from bayescal.config.trust import allow_own_classes
from bayescal.limits import LARGEST_SEED


def _forbid_plugins(forbidden: bool) -> None:
    if forbidden:
        allow_own_classes(False)


Experiment = Annotated[Path, typer.Argument(metavar="EXPERIMENT.toml", help="Config of the experiment.")]
Seed = Annotated[int | None, typer.Option(min=0, max=LARGEST_SEED, help="Seed in place of the config's.")]
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


Trust = Annotated[
    bool, typer.Option("--trust-code", help="Run the code of classes of their own that the results keep.")
]


@dataclass(frozen=True)
class RunOptions:
    """How an experiment is run, whatever its kind."""

    out: Annotated[Path | None, typer.Option(help="Results directory; default results/NAME.")] = None
    seed: Seed = None
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes side by side; default one per core.")
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Of dask: an address, a scheduler's JSON file, or local:N; its workers compute."
        ),
    ] = None
    resume: Annotated[bool, typer.Option("--resume", help="Take up an interrupted run of the same config.")] = False
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")] = False
    no_plugins: NoPlugins = False


def spread_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameter of RunOptions is given option by option."""
    names = [field.name for field in fields(RunOptions)]
    hints = get_type_hints(RunOptions, include_extras=True)
    kind = inspect.Parameter.KEYWORD_ONLY
    spread = [
        inspect.Parameter(field.name, kind, default=field.default, annotation=hints[field.name])
        for field in fields(RunOptions)
    ]
    own = list(inspect.signature(command, eval_str=True).parameters.values())
    options = next(one for one in own if one.annotation is RunOptions)

    @functools.wraps(command)
    def take(**given: Any) -> None:
        command(**{options.name: RunOptions(**{name: given.pop(name) for name in names})}, **given)

    take.__signature__ = inspect.Signature([*(one.replace(kind=kind) for one in own if one is not options), *spread])  # type: ignore[attr-defined]
    return take
