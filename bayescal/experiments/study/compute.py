"""Computing a study, whatever was measured: its posteriors in tasks, then everything that is said of them."""

from __future__ import annotations

from functools import partial

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.estimate import TREE, Fit
from bayescal.experiments.shared.prior_widths import WidthTask, begin_widths, tabulate_widths, weigh_widths
from bayescal.experiments.shared.study_inputs import Inputs, Task
from bayescal.experiments.shared.trees import write_packed
from bayescal.experiments.shared.variant_tables import rank_variants
from bayescal.experiments.study.calibrated import list_machine_files
from bayescal.inference.importance import ImportanceEvidence


def compute_study(inputs: Inputs, run: Run) -> Results:
    """Return what a study found."""
    config, held, fits = inputs.config, inputs.verification, compute_posteriors(inputs, run)
    free, factors = choose_free(fits), config.sensitivity.factor
    await_widths = begin_widths(weigh, inputs, free, factors, run)  # while workers compute them, all that needs none
    found, slip = inputs.describe(fits, run), inputs.slip
    summary = {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine_name,
        "machine_folder": inputs.machine_files[1],
        "origin": config.origin.model_dump(),
        "units": config.units.model_dump(),
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "converged": not any(fit.list_problems() for fit in fits.values()),
        **found.summary,
        "variants": found.variants,
        "rankings": rank_variants(found.variants),
        **({} if slip is None else {"slip": slip.record()}),
    }
    tables = found.tables | inputs.conclude(summary, run)
    if widths := await_widths():
        tables["sensitivity"] = tabulate_widths(free, widths, factors)
    files = {f"posterior/{task.stem}.nc": partial(write_packed, fit.evaluated[TREE]) for task, fit in fits.items()}
    return Results(summary, tables, {**files, **list_machine_files(inputs)})


def compute_posteriors(inputs: Inputs, run: Run) -> dict[Task, Fit]:
    """Return all posteriors."""
    tasks = {inputs.name_task(task): task for task in inputs.list_tasks()}
    found = run.map("sampling", run_task, inputs, tasks, (inputs.fit_class,))
    return {tasks[name]: fit for name, fit in found.items()}


def run_task(inputs: Inputs, task: Task) -> Fit:
    """Compute one task."""
    return inputs.fit(task)


def choose_free(fits: dict[Task, Fit]) -> dict[str, Fit]:
    """Return what was found with model error, by variant, in the order of the tasks."""
    return {task.variant: fit for task, fit in fits.items() if task.with_model_error}


def weigh(inputs: Inputs, task: WidthTask) -> ImportanceEvidence:
    """Return the evidence of a variant with wider or narrower priors."""
    own, config = Task(task.variant), inputs.config
    known = inputs.subject(own).posterior
    return weigh_widths(inputs.subject(own, task.factor), known, task, config.seed, config.sampler, config.evidence)
