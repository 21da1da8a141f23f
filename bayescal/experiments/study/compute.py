"""Computing a study: its posteriors in tasks, then everything that is said of them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import pandas as pd

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.shared.prior_widths import WidthTask, begin_widths, tabulate_widths, weigh_widths
from bayescal.experiments.shared.trees import write_packed
from bayescal.experiments.shared.variant_tables import rank_variants
from bayescal.experiments.study.calibrated import list_machine_files
from bayescal.experiments.study.inputs import StudyInputs, Task
from bayescal.experiments.study.readings import ReadingFit, describe_readings, fit_variant
from bayescal.inference.importance import ImportanceEvidence


def compute_study(inputs: StudyInputs, run: Run) -> Results:
    """Return what a study found."""
    config, held, fits = inputs.config, inputs.verification, compute_posteriors(inputs, run)
    factors = config.sensitivity.factor
    await_widths = begin_widths(weigh, inputs, fits, factors, run)  # while workers compute them, all that needs none
    found, slip, claims = describe_readings(inputs, fits, run), inputs.slip, inputs.claims
    summary = {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine,
        "machine_folder": inputs.machine_files[1],
        "origin": config.origin.model_dump(),
        "units": config.units.model_dump(),
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "converged": not any(fit.list_problems() for fit in fits.values()),
        **found.summary,
        "variants": found.variants,
        "rankings": rank_variants(found.variants),
        **({} if slip is None else {"slip": slip.record()}),
        **({} if claims is None else {"publication": claims.describe()}),
    }
    tables = found.tables
    if claims is not None:
        tables |= run.once("claims", _judge, (inputs, dict(summary)))
    if widths := await_widths():
        tables["sensitivity"] = tabulate_widths(fits, widths, factors)
    trees = {Task(name).stem: fit.evaluated[TREE] for name, fit in fits.items()}
    files = {f"posterior/{stem}.nc": partial(write_packed, tree) for stem, tree in trees.items()}
    return Results(summary, tables, {**files, **list_machine_files(inputs)})


def compute_posteriors(inputs: StudyInputs, run: Run) -> dict[str, ReadingFit]:
    """Return what is found of each variant."""
    tasks = {task.variant: task for task in inputs.list_tasks()}
    return run.map("sampling", run_task, inputs, tasks, (ReadingFit,))


def run_task(inputs: StudyInputs, task: Task) -> ReadingFit:
    """Compute one task; all numbers depend on the inputs, the config's seed and the task's name alone."""
    return fit_variant(inputs, task.variant)


def _judge(task: tuple[StudyInputs, Mapping[str, Any]]) -> dict[str, pd.DataFrame]:
    inputs, summary = task
    return {} if inputs.claims is None else inputs.claims.tabulate(inputs, summary)


def weigh(inputs: StudyInputs, task: WidthTask) -> ImportanceEvidence:
    """Return the evidence of a variant with wider or narrower priors."""
    own, config = Task(task.variant), inputs.config
    known = inputs.variants[task.variant].posterior()
    return weigh_widths(inputs.subject(own, task.factor), known, task, config.seed, config.sampler, config.evidence)
