"""Running a study: tasks side by side, finished ones kept, results put in place at the end."""

from __future__ import annotations

import json
import platform
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
from joblib.externals.loky.process_executor import TerminatedWorkerError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from bayescal.config.schema import StudyConfig
from bayescal.errors import NumericalError
from bayescal.experiments.frame.store import PROVENANCE_FILE, Store
from bayescal.experiments.study.fit import Arrays, Task, list_tasks, run_task
from bayescal.experiments.study.inputs import StudyInputs, hash_identity, load_inputs
from bayescal.experiments.study.page.write import write_report
from bayescal.experiments.study.summary import build_tree, compute_loo, rank_variants, summarise_fit
from bayescal.experiments.study.tables import (
    identify_variants,
    tabulate_deformation,
    tabulate_flexure,
    tabulate_least_squares,
    tabulate_parameters,
    tabulate_predictions,
    tabulate_ranking,
    tabulate_ring,
    tabulate_sensitivity,
)
from bayescal.reproductions.rr8096.claims import Subject, tabulate_claims

PACKAGES = ("bayescal", "numpy", "scipy", "emcee", "arviz", "arviz-stats", "pandas", "matplotlib", "h5netcdf", "xarray")


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A finished study.

    Attributes
    ----------
    out : Path
        The results directory.
    summary : dict
        What ``summary.json`` holds.
    """

    out: Path
    summary: dict[str, Any]

    @property
    def converged(self) -> bool:
        """Whether every posterior, with and without model error, converged."""
        variants = self.summary["variants"].values()
        return all(v["converged"] and v["without_model_error"]["converged"] for v in variants)


def run_study(config: StudyConfig, folder: Path, out: Path, workers: int = 1, resume: bool = False) -> StudyResult:
    """Run a study and put its results in ``out``.

    Parameters
    ----------
    config : StudyConfig
        From `bayescal.config.load_experiment`.
    folder : Path
        Where the config's file names start.
    out : Path
        Results directory; replaced as a whole when everything is done.
    workers : int
        Processes side by side; the numbers do not depend on it.
    resume : bool
        Take up an interrupted run of the same config.

    Raises
    ------
    InputError
        For input at fault, results of another config in ``out``, or nothing to resume. Nothing is written then.
    NumericalError
        Where a computation fails; the finished tasks are kept for ``resume``.
    """
    with threadpool_limits(1):
        inputs = load_inputs(config, folder)
        identity = inputs.identity()
        store = Store(out)
        store.check_results(identity)
        store.begin(identity, resume)
        fits = _run_tasks(inputs, store, list_tasks(inputs), workers)
        summary = _write_results(inputs, identity, fits, store.stage())
        store.publish()
    return StudyResult(out, summary)


def _run_tasks(inputs: StudyInputs, store: Store, tasks: list[Task], workers: int) -> dict[Task, Arrays]:
    """Return the arrays of all tasks; one that fails does not keep the others from being finished and kept."""
    found = {task: store.load_task(task.key) for task in tasks}
    missing = [task for task in tasks if found[task] is None]
    failures: list[str] = []
    for task, outcome in _track(_compute(inputs, missing, workers), len(tasks), len(tasks) - len(missing)):
        if isinstance(outcome, str):
            failures.append(f"{task.key}: {outcome}")
            continue
        store.save_task(task.key, outcome)
        found[task] = outcome
    if failures:
        kept = f"{len(tasks) - len(failures)} of {len(tasks)} tasks are kept in {store.partial}"
        raise NumericalError(f"{'; '.join(failures)}; {kept}")
    return {task: arrays for task, arrays in found.items() if arrays is not None}


def _compute(inputs: StudyInputs, tasks: list[Task], workers: int) -> Iterator[tuple[Task, Arrays | str]]:
    if workers == 1 or len(tasks) < 2:
        for task in tasks:
            yield _run_guarded(inputs, task)
        return
    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", inner_max_num_threads=1)
    try:
        yield from parallel(joblib.delayed(_run_in_worker)(inputs, task) for task in tasks)
    except TerminatedWorkerError as error:
        raise NumericalError("a worker was killed, perhaps for want of memory; go on with --resume") from error


def _run_in_worker(inputs: StudyInputs, task: Task) -> tuple[Task, Arrays | str]:
    """Run a task in a process of its own; an interrupt from the terminal is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _run_guarded(inputs, task)


def _run_guarded(inputs: StudyInputs, task: Task) -> tuple[Task, Arrays | str]:
    """Return a task's arrays, or in words why it failed; BLAS keeps to one thread."""
    try:
        # whatever is not finite is looked for where it matters; numpy's warnings would only litter the terminal
        with threadpool_limits(1), np.errstate(all="ignore"):
            return task, run_task(inputs, task)
    except (NumericalError, ArithmeticError, ValueError) as error:  # SciPy and LAPACK raise the last two
        return task, str(error)


def _track[T](items: Iterator[tuple[Task, T]], total: int, done: int) -> Iterator[tuple[Task, T]]:
    """Show progress with the time left on a terminal; stay silent in a pipe."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(
        *columns, TextColumn("left"), TimeRemainingColumn(), console=console, disable=not console.is_terminal
    ) as bar:
        line = bar.add_task("sampling", total=total, completed=done)
        for item in items:
            bar.update(line, advance=1, description=item[0].variant)
            yield item


def _write_results(
    inputs: StudyInputs, identity: dict[str, Any], fits: dict[Task, Arrays], folder: Path
) -> dict[str, Any]:
    posteriors = {task: arrays for task, arrays in fits.items() if task.tolerance is None}
    summary = _summarise(inputs, identity, posteriors, folder)
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    identified = identify_variants(inputs)
    tables = {
        "ranking": tabulate_ranking(summary),
        "parameters": tabulate_parameters(summary),
        "predictions": tabulate_predictions(inputs, posteriors),
        "sensitivity": tabulate_sensitivity(inputs, fits),
        "least_squares": tabulate_least_squares(inputs, identified),
        "claims": tabulate_claims(Subject.from_study(inputs, summary, identified)),
        "flexure": tabulate_flexure(inputs.mechanism),
        "ring": tabulate_ring(inputs),
        "deformation": tabulate_deformation(inputs),
    }
    write_tables(tables, folder / "tables")
    (folder / PROVENANCE_FILE).write_text(json.dumps(_describe_provenance(inputs, identity), indent=1) + "\n")
    write_report(folder)
    return summary


def _summarise(
    inputs: StudyInputs, identity: dict[str, Any], posteriors: dict[Task, Arrays], folder: Path
) -> dict[str, Any]:
    variants: dict[str, dict[str, Any]] = {}
    (folder / "posterior").mkdir()
    for task, arrays in posteriors.items():
        tree = build_tree(inputs, task.variant, task.with_model_error, arrays)
        fit = summarise_fit(inputs, task.variant, task.with_model_error, arrays, compute_loo(tree))
        if task.with_model_error:
            variants[task.variant] = fit
            tree.to_netcdf(folder / "posterior" / f"{task.variant.replace('/', '-')}.nc", engine="h5netcdf")
        else:
            variants[task.variant]["without_model_error"] = fit
    return {
        "experiment": inputs.config.name,
        "title": inputs.config.title,
        "data_origin": inputs.config.data.origin,
        "seed": inputs.config.seed,
        "config_sha256": hash_identity(identity),
        "n_poses": {
            "calibration": int((~inputs.survey.verification).sum()),
            "verification": int(inputs.survey.verification.sum()),
        },
        "pose_extraction": {
            "method": inputs.config.data.pose_method,
            "chi2_per_dof": inputs.extraction.chi2_per_dof,
            "rejected_targets": ["/".join(target) for target in inputs.extraction.rejected],
        },
        "variants": variants,
        "ranking": rank_variants(variants),
    }


def write_tables(tables: dict[str, pd.DataFrame], folder: Path) -> None:
    """Write tables as CSV, nine significant digits."""
    folder.mkdir()
    for name, table in tables.items():
        if not table.empty:
            table.to_csv(folder / f"{name}.csv", index=False, float_format="%.9g", lineterminator="\n")


def _describe_provenance(inputs: StudyInputs, identity: dict[str, Any]) -> dict[str, Any]:
    return {
        "config_sha256": hash_identity(identity),
        **identity,
        "title": inputs.config.title,
        "seed": inputs.config.seed,
        "python": platform.python_version(),
        "platform": sys.platform,
        "versions": {name: version(name) for name in PACKAGES},
    }
