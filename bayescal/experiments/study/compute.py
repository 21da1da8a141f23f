"""Computing a study: its posteriors in tasks, then everything that is said of them."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

import pandas as pd

from bayescal.experiments.runner.losses import attempt
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import PRELIMINARY, Results, Summary
from bayescal.experiments.shared.estimate import TREE
from bayescal.experiments.shared.posterior_files import write_packed
from bayescal.experiments.shared.slips import MisstatedInput
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.calibrated import list_machine_files
from bayescal.experiments.study.doubts import doubt_zero
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.prior_widths import begin_widths, tabulate_widths
from bayescal.experiments.study.readings import ReadingFit, describe_readings, fit_variant
from bayescal.experiments.study.tables import rank_variants


def compute_study(inputs: StudyInputs, run: Run) -> Results:
    """Return what a study found."""
    config, held, factors = inputs.config, inputs.verification, inputs.config.sensitivity.prior_width_factors
    fits = run.map("sampling", fit_variant, inputs, {name: name for name in inputs.variants}, (ReadingFit,), spare=True)
    await_widths = begin_widths(inputs, fits, run)  # while workers compute them, all that needs none
    (variants, tables, more), slip, claims = describe_readings(inputs, fits, run), inputs.slip, inputs.claims
    summary = {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": inputs.machine,
        "machine_folder": inputs.machine_folder,
        "origin": config.provenance.model_dump(),
        "units": config.units.model_dump(),
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "converged": not (config.sampler.is_preliminary or any(fit.list_problems() for fit in fits.values())),
        **({PRELIMINARY: True} if config.sampler.is_preliminary else {}),
        **more,
        "variants": variants,
        "rankings": rank_variants(variants),
        **({} if slip is None else {"suspected_data_error": slip.record()}),
        **({} if inputs.denied is None else {"ignored_data_errors": [inputs.denied.say()]}),
        **({"shifted": shifted} if slip is None and (shifted := doubt_zero(inputs)) else {}),
        **({} if claims is None else {"publication": claims.describe()}),
    }
    if slip is None:
        # of the largest evidence, of those that converged if any did
        best = max(fits, key=lambda name: (not fits[name].list_problems(), fits[name].log_evidence))
        found = run.once("noise and tolerances", _find_misstated, (inputs, best), (MisstatedInput,))
        summary["misstated"] = None if found is None else asdict(found)
    if claims is not None:
        judge = partial(run.once, "claims", _judge, (inputs, dict(summary)))
        tables |= attempt(f"the claims of {config.published_claims}", judge, dict[str, pd.DataFrame]())
    if widths := await_widths():
        tables["sensitivity"] = tabulate_widths(fits, widths, factors)
    trees = {name: fit.evaluated[TREE] for name, fit in fits.items() if TREE in fit.evaluated}
    files = {f"posterior/{stem_of(name)}.nc": partial(write_packed, tree) for name, tree in trees.items()}
    return Results(summary, tables, {**files, **list_machine_files(inputs)})


def _find_misstated(task: tuple[StudyInputs, str]) -> MisstatedInput | None:
    inputs, name = task
    return inputs.find_misstated([name])


def _judge(task: tuple[StudyInputs, Summary]) -> dict[str, pd.DataFrame]:
    inputs, summary = task
    return {} if inputs.claims is None else inputs.claims.tabulate(inputs, summary)
