"""Running an experiment of any kind: read, compute, write, put in place as a whole; reports and comparisons."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from joblib import cpu_count
from rich.console import Console
from threadpoolctl import threadpool_limits

from bayescal.config.load import read_extended
from bayescal.config.registry import hash_modules, list_sources
from bayescal.config.sections import ExperimentConfig
from bayescal.config.trust import trusting
from bayescal.errors import BayescalError, InputError, NumericalError, SeveralFaultsError, name_faults
from bayescal.experiments.runner.blocks import PageBlock, add_blocks, find_blocks, find_kept
from bayescal.experiments.runner.engine import Processes, import_all, open_engine, start_ahead
from bayescal.experiments.runner.identity import describe_provenance, identify
from bayescal.experiments.runner.interrupts import hold_lock
from bayescal.experiments.runner.kept_inputs import CONFIG_FILE, keep_inputs
from bayescal.experiments.runner.load import AnyExperiment, find_kind, load, read_inputs
from bayescal.experiments.runner.losses import LOST_PARTS, Loss, attempt, list_losses, note_losses, record_losses
from bayescal.experiments.runner.memory import GIB, MemoryEstimate, check_memory
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import (
    MANIFEST_KEY,
    PROVENANCE_FILE,
    SUMMARY_FILE,
    Results,
    Summary,
    check_results,
    read_results,
    write_json,
    write_results,
    write_table,
)
from bayescal.experiments.runner.store import Store
from bayescal.experiments.runner.terminal import Progress
from bayescal.files.atomic import read_json
from bayescal.files.manifest import MANIFEST, list_written, renew_manifest, write_manifest
from bayescal.files.memory import MemoryPath
from bayescal.report.blocks import Page, Statement
from bayescal.report.findings import FindingRow, tabulate_findings
from bayescal.report.page import PAGE, collect_seldom, is_of_page, show_provenance, write_page
from bayescal.report.pictures import Picture

if TYPE_CHECKING:
    import pandas as pd

FOUND_LATE = "detected during the run"
"""Said of what is at fault with inputs that passed the gate."""
THE_PAGE = "the page"
SHORT = 12.0  # s of one core, up to which other processes take longer to start than they save
LONG, LARGE = 60.0, 1.0  # s and GiB beside processes' own, from which on a run says what it takes before it begins


@dataclass(frozen=True, eq=False)
class RunOutcome:
    """A finished run: its results directory, the kind, the results as they are read back from there, the page."""

    out: Path
    experiment: AnyExperiment
    results: Results
    page: Page

    @property
    def summary(self) -> Summary:
        """What ``summary.json`` holds."""
        return self.results.summary

    @property
    def failures(self) -> list[str]:
        """What forbids to rely on the results, in words."""
        lost = [one.say() for one in list_losses(self.results.summary)]
        return [*self.experiment.list_failures(self.results), *lost]

    @property
    def converged(self) -> bool:
        """Whether nothing forbids to rely on the results."""
        return not self.failures

    def show(self, console: Console) -> None:
        """Print the results on a terminal, and where the page is."""
        self.experiment.show(self.results, self.page, console)
        console.print(f"report: {self.out / PAGE}", soft_wrap=True)


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """An experiment that has passed the gate: nothing in its config and files forbids to compute it."""

    experiment: AnyExperiment
    inputs: Any  # what it computes with
    need: MemoryEstimate  # memory that it takes
    blocks: list[PageBlock]
    identity: dict[str, Any]  # what determines its results, ``files`` among it


def prepare_run(config: ExperimentConfig, folder: Path, workers: int) -> PreparedRun:
    """Return an experiment read and checked: the one gate of all that computes, and of all that only looks.

    ``folder`` is where the config's file names start, ``workers`` how many processes of this machine will compute, zero
    where others do. InputError for everything at fault in the config and its files, and for what there is no memory
    for.
    """
    experiment = find_kind(config.kind, None, folder)
    with threadpool_limits(1), np.errstate(all="ignore"):  # whatever is not finite is looked for where it matters
        inputs = read_inputs(experiment, config, folder)
        need = experiment.estimate_memory(inputs)
        check_memory(need, workers)
        blocks = find_blocks(config.page_sections, None, folder)
        modules = hash_modules([type(one) for one in (experiment, *blocks)]) | experiment.modules(config, folder)
        own = [("KINDS", config.kind), *(("BLOCKS", one) for one in config.page_sections)]
        sources = [file for what, name in own for file in list_sources(what, name, folder)]
        identity = identify(config, folder, [*experiment.files(config, folder), *sources], modules)
    return PreparedRun(experiment, inputs, need, blocks, identity)


def run_experiment(
    config: ExperimentConfig,
    folder: Path,
    out: Path | None,
    workers: int | None = 1,
    resume: bool = False,
    quiet: bool = True,
    scheduler: str | None = None,
) -> RunOutcome:
    """Run an experiment and put its results in ``out``, or keep them in memory where that is None.

    ``workers`` None: a process per core, or this one alone where a run is shorter than others take to start.

    Parameters and errors are those of `bayescal.run_experiment`. Results of another config or another run in ``out``,
    and nothing to resume, are input at fault, too.
    """
    with threadpool_limits(1):
        admitted = prepare_run(config, folder, (workers or cpu_count()) if scheduler is None else 0)
        experiment, identity = admitted.experiment, admitted.identity
        place_of_config, kept = keep_inputs(config, folder, identity["files"])  # as they are now
        store = None if out is None else Store(out, again=experiment.asked_again)
        if store is not None:
            store.check(identity, resume)
        # nobody asks, or nobody knows what a resumed run has left to do
        is_unasked = resume or scheduler is not None or (quiet and workers is not None)
        seconds = None if is_unasked else _estimate_seconds(admitted)
        if workers is None:
            workers = 1 if seconds is not None and seconds <= SHORT else cpu_count()
        with open_engine(workers, scheduler, quiet) as engine, ExitStack() as held:
            if store is not None:
                held.enter_context(hold_lock(store.lock, store.out))
                store = store.begin(identity, resume)
            with start_ahead(workers if scheduler is None else 1, experiment.imports):
                import_all(experiment.imports[:1])
            progress = Progress(quiet)
            if not (quiet or resume) and scheduler is None:
                for doubt in _list_doubts(experiment, admitted.inputs):
                    progress.say(f"warning: {doubt}")
                progress.say(_tell_effort(admitted, seconds, workers))
            results = _compute(admitted, Run(engine, store, progress))
            provenance = {**describe_provenance(config, identity), CONFIG_FILE: place_of_config}
            results = replace(results, files={**results.files, **kept}, provenance=provenance)
            place = MemoryPath(config.name) if store is None else store.stage()
            page = _write(experiment, admitted.blocks, results, place)
            if store is not None:
                store.publish()
    where = place if out is None else out
    return RunOutcome(where, experiment, read_results(where), page)


def _estimate_seconds(admitted: PreparedRun) -> float | None:
    """Return about how long a run takes on one core; None where its kind does not say."""
    with np.errstate(all="ignore"), suppress(BayescalError):  # said where it is computed
        return admitted.experiment.estimate_seconds(admitted.inputs)
    return None


def _tell_effort(admitted: PreparedRun, seconds: float | None, workers: int) -> str:
    """Return how long a run takes and how much memory, where either is much; otherwise nothing."""
    need, said = admitted.need, list[str]()
    if seconds is not None and seconds >= LONG * workers:
        said.append(f"about {max(1, round(seconds / workers / 60.0))} min")
    if need.sizes and need.shared + workers * need.each >= LARGE * GIB:
        said.append(f"at most {need.sum_up(workers) / GIB:.1f} GiB of memory")
    by = f" with {workers} workers" if workers > 1 else ""
    return f"this takes {' and '.join(said)}{by}" if said else ""


def _compute(admitted: PreparedRun, run: Run) -> Results:
    """Return an experiment's results; a NumericalError says besides what is probably wrong with the inputs.

    What a kind refuses only now is one, too, since it was accepted before; nothing is kept of such a run.
    """
    experiment, inputs = admitted.experiment, admitted.inputs
    try:
        with note_losses() as losses:
            results = experiment.compute(inputs, run)
        lost = [*run.losses, *(one for one in losses if one not in run.losses)]
        return replace(results, summary={**results.summary, LOST_PARTS: record_losses(lost)}) if lost else results
    except InputError as error:
        if run.store is not None:
            run.store.discard()
        raise NumericalError(f"{error} ({FOUND_LATE})") from error
    except NumericalError as error:
        doubts = _list_doubts(experiment, inputs)
        if not doubts:
            raise
        raise NumericalError(f"{error}; perhaps since {'; '.join(doubts)}") from error


@dataclass(frozen=True)
class ValidationSummary:
    """What is known of an experiment without computing, in lines.

    Attributes
    ----------
    files : list of str
        Those that belong to it.
    outlook : list of str
        What its inputs can determine, and the memory that a run takes.
    suspicions : list of str
        What is wrong with its data: a run would end with exit code 3.
    doubts : list of str
        What may be wrong with them.
    """

    files: list[str]
    outlook: list[str]
    suspicions: list[str]
    doubts: list[str]


def check_file(path: Path) -> tuple[ExperimentConfig, ValidationSummary]:
    """Read all that the experiment of a file computes with; return its config, and as `check_experiment`.

    `SeveralFaultsError` with all that is wrong with config and files, as far as one does not depend on the other.
    """
    try:
        _, config = load(path)
        with name_faults(path):
            return config, check_experiment(config, path.parent)
    except InputError as error:
        content: dict[str, Any] = {}
        with suppress(InputError):
            content, _ = read_extended(path)
        raise add_file_faults(error, content, path.parent) from error


def add_file_faults(error: InputError, content: Mapping[str, object], folder: Path) -> SeveralFaultsError:
    """Return what is wrong with a config, and with the files that it names, however far it can itself be read."""
    of_files: list[str] = []
    with suppress(InputError):
        of_files = find_kind(str(content.get("kind")), None, folder).list_file_faults(content, folder)
    more = [one for one in of_files if not any(line.endswith(one) for line in error.lines)]
    return SeveralFaultsError([*error.lines, *more])


def check_experiment(config: ExperimentConfig, folder: Path) -> ValidationSummary:
    """Put an experiment through the gate of a run with a process per core; return what is known without computing.

    InputError as `prepare_run`.
    """
    workers = cpu_count()
    admitted = prepare_run(config, folder, workers)
    experiment, inputs = admitted.experiment, admitted.inputs
    with threadpool_limits(1):
        outlook, suspicions = _ask(experiment.outlook, inputs), _ask(experiment.suspect, inputs)
        doubts = _ask(experiment.list_warnings, inputs)
    if admitted.need.sizes:
        outlook = [*outlook, f"a run computes with {admitted.need.describe(workers)}"]
    return ValidationSummary(sorted(admitted.identity["files"]), outlook, suspicions, doubts)


def compute_experiment(config: ExperimentConfig, folder: Path, workers: int = 1) -> Results:
    """Return what an experiment finds, without writing anything."""
    admitted = prepare_run(config, folder, workers)
    with threadpool_limits(1), np.errstate(all="ignore"):
        return _compute(admitted, Run(Processes(workers)))


def _list_doubts(experiment: AnyExperiment, inputs: object) -> list[str]:
    """Return what is, and what may be, wrong with inputs that passed the gate."""
    return [*_ask(experiment.suspect, inputs), *_ask(partial(experiment.list_warnings, before_run=True), inputs)]


def _ask(question: Callable[[object], list[str]], inputs: object) -> list[str]:
    """Return what is said of inputs that passed the gate; a question that fails on them says nothing."""
    try:
        with np.errstate(all="ignore"):
            return question(inputs)
    except BayescalError:
        return []


@collect_seldom()
def _write(experiment: AnyExperiment, blocks: Sequence[PageBlock], results: Results, folder: Path) -> Page:
    """Write results and page into an empty directory; the page is made from what was written."""
    summary = {**results.summary, "config_sha256": results.provenance["config_sha256"]}
    results = replace(results, provenance={**results.provenance, MANIFEST_KEY: MANIFEST})
    write_results(replace(results, summary=summary), folder, experiment.tables_in, experiment.digits)
    written = read_results(folder, checked=False)
    with note_losses() as losses:
        page = attempt(THE_PAGE, lambda: _build_page(experiment, written), None)
        page = _make_empty_page(results) if page is None else page
    page, more = _write_page(page, blocks, written, folder, losses)
    write_table(FindingRow.table, tabulate_findings(page.verdict), folder, experiment.tables_in)
    lost = [*list_losses(summary), *losses, *more]
    summary |= {LOST_PARTS: record_losses(lost)} if lost else {}
    write_json(folder / SUMMARY_FILE, {**summary, "headline": page.headline})
    write_manifest(folder)
    return page


def _build_page(experiment: AnyExperiment, results: Results) -> Page:
    try:
        return experiment.page(results)
    except InputError as error:  # of results that were written just now: nobody's input
        raise NumericalError(str(error)) from error


def _make_empty_page(results: Results) -> Page:
    """Return the page of results whose own page cannot be made."""
    name, kind = (str(results.provenance.get(key, "")) for key in ("name", "kind"))
    said = "Tables and summary were written, no page."
    return Page(kind.capitalize(), name, str(results.provenance.get("title", name)), "", said, (), ())


def _write_page(
    page: Page,
    blocks: Sequence[PageBlock],
    results: Results,
    folder: Path,
    losses: Sequence[Loss],
) -> tuple[Page, list[Loss]]:
    """Write a page and what user-defined blocks show; return it and what could not be shown besides ``losses``."""
    with note_losses() as lost:
        page = add_blocks(page, results, blocks)
    every = dict.fromkeys([*list_losses(results.summary), *losses, *lost])
    page = page.add_failures([Statement(f"{one.say()}.", "bad") for one in every])
    earlier = list_written(folder)
    if earlier is None:  # new ones: all figures are its own
        earlier = [path.relative_to(folder).as_posix() for path in folder.glob("figures/*.png")]
    not_drawn: list[Loss] = []

    def render(calls: Mapping[str, Callable[[], Picture]]) -> dict[str, Picture]:
        drawn = {name: _draw(f"figure {name!r}", call) for name, call in calls.items()}
        not_drawn.extend(loss for _, loss in drawn.values() if loss is not None)
        return {name: picture for name, (picture, _) in drawn.items()}

    write_page(page, folder, (show_provenance(results.provenance),), earlier, render)
    return page, [*lost, *not_drawn]


def _draw(what: str, draw: Callable[[], Picture]) -> tuple[Picture, Loss | None]:
    with note_losses() as losses:
        found = attempt(what, draw, None)
    return (Picture(b"", failure=f"{losses[0].say()}."), losses[0]) if found is None else (found, None)


@collect_seldom()
def write_report(folder: Path, trust: bool = False) -> Path:
    """Write the page of a results directory again, from its files alone.

    With ``trust`` the code of a kind that is not built in, which results keep, is run though nobody has trusted it.
    InputError where a file is missing or not what an experiment of its kind writes, and for code that nobody has
    allowed to run; nothing is written then.
    """
    try:
        with trusting(trust):
            check_results(folder, is_of_page)  # whole but for the page, which is about to be written
            results = read_results(folder, checked=False)
            experiment = find_results_kind(folder, results)
            names = [str(name) for name in results.config.get("page_sections", [])]
            blocks = [one for name in names for one in find_blocks([name], folder, find_kept(results, "BLOCKS", name))]
        known = list_losses(results.summary)
        with note_losses() as losses:
            page = _make_empty_page(results) if THE_PAGE in {one.what for one in known} else experiment.page(results)
        for one in losses:
            if one.what not in {other.what for other in known}:  # a run would have told it
                raise ValueError(one.say())
        _write_page(page, blocks, results, folder, losses)
        renew_manifest(folder, is_of_page)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError, AssertionError) as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        versions, here = read_json(folder / PROVENANCE_FILE).get("versions"), version("bayescal")
        written = versions.get("bayescal") if isinstance(versions, dict) else None
        if written not in (None, here):
            raise InputError(
                f"{folder}: found results of bayescal {written} ({what}), expected {here}: run again"
            ) from error
        raise InputError(f"{folder}: found damaged results ({what})") from error
    return folder / PAGE


def find_results_kind(folder: Path, results: Results) -> AnyExperiment:
    """Return the kind of a results directory; see `write_report`."""
    found = results.provenance.get("kind")
    if not isinstance(found, str):
        raise InputError(f"{folder}: provenance: found no kind of experiment")
    if ":" not in found:
        return find_kind(found, folder, None)
    return find_kind(found, folder, find_kept(results, "KINDS", found))


def compare_results(folders: Sequence[Path], trust: bool = False) -> tuple[AnyExperiment, pd.DataFrame]:
    """Return the kind of results, and what it says of them side by side; InputError where they do not compare."""
    results = {str(folder): read_results(folder) for folder in folders}
    kinds = [one.provenance.get("kind") for one in results.values()]
    for folder, kind in zip(results, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(f"{folder}: found kind {kind!r}, expected {kinds[0]!r} as in {folders[0]}")
    with trusting(trust):
        experiment = find_results_kind(folders[0], next(iter(results.values())))
    return experiment, experiment.compare(results)
