"""Computing a study: its posteriors in tasks, then everything that is said of them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayescal.config.classes import label_class
from bayescal.density.least_squares import LeastSquaresFit
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.estimate import TREE, Fit
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.prior_widths import WidthTask, begin_widths, tabulate_widths, weigh_widths
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.shared.trees import write_packed
from bayescal.experiments.shared.variant_tables import rank_variants
from bayescal.experiments.study.calibrated import describe_nominal
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.doubts import find_study_slip
from bayescal.experiments.study.fit import Legs, Task, list_tasks, run_task
from bayescal.experiments.study.held_out import describe_stacking, tabulate_poses
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.kernels import has_kernels
from bayescal.experiments.study.structured_table import tabulate_structured
from bayescal.experiments.study.summary import summarise_variants
from bayescal.experiments.study.tables import (
    identify_variants,
    tabulate_all_parameters,
    tabulate_deformation,
    tabulate_flexure,
    tabulate_least_squares,
    tabulate_pose_errors,
    tabulate_ring,
    tabulate_tau_scale,
)
from bayescal.experiments.study.trees import build_study_tree
from bayescal.inference.importance import ImportanceEvidence
from bayescal.machines.models.legs import list_dimensions
from bayescal.numerics.units import MICROMETRE

ONLY_SAVED = ("prior", "prior_misfit")
"""Arrays of a posterior that nothing but its tree has."""


def compute_study(inputs: StudyInputs, claims: Claims | None, run: Run) -> Results:
    """Return what a study found.

    Parameters
    ----------
    inputs : StudyInputs
    claims : Claims or None
        Of a publication, to be tested on the study.
    run : Run
    """
    posteriors = compute_posteriors(inputs, run)
    free, factors = choose_free(inputs, posteriors), inputs.config.sensitivity.factor
    await_widths = begin_widths(weigh, inputs, free, factors, run)  # while workers compute them, all that needs none
    identified = run.once("least squares", identify_variants, inputs, (LeastSquaresFit,))
    variants = summarise_variants(inputs, posteriors)
    summary = _summarise(inputs, posteriors, variants.variants)
    files = {f"posterior/{one.stem}.nc": partial(write_packed, fit.evaluated[TREE]) for one, fit in posteriors.items()}
    slip = find_study_slip(inputs)
    if slip is not None:
        summary["slip"] = slip.record()
    before = {
        **variants.tables,
        "parameters": tabulate_all_parameters(inputs, posteriors),
        "pose_errors": tabulate_pose_errors(inputs, posteriors),
        "poses": tabulate_poses(inputs, posteriors),
    }
    after = {
        "tau_scale": tabulate_tau_scale(inputs, posteriors),
        "least_squares": tabulate_least_squares(inputs, identified),
        "flexure": tabulate_flexure(inputs.mechanism),
        "ring": tabulate_ring(inputs),
        "deformation": tabulate_deformation(inputs),
        "joints": tabulate_joints(inputs.mechanism, inputs.measured.actuators, inputs.names),
    }
    if has_kernels(inputs.config):
        after["structured"] = tabulate_structured(inputs, posteriors)
    if claims is not None:
        after["claims"] = run.once("claims", _judge, (claims, inputs, summary, identified))
        summary["publication"] = claims.describe()
    sensitivity = {"sensitivity": tabulate_widths(free, await_widths(), factors)}
    return Results(summary, before | sensitivity | after, {**files, **describe_nominal(inputs)})


def compute_posteriors(inputs: StudyInputs, run: Run) -> dict[Task, Fit]:
    """Return all posteriors."""
    tasks = {task.key: task for task in list_tasks(inputs)}
    found = run.map("sampling", fit_and_pack, inputs, tasks, (Fit,))
    return {tasks[key]: fit for key, fit in found.items()}


def fit_and_pack(inputs: StudyInputs, task: Task) -> Fit:
    """Return a posterior, with its tree's file in place of what only that has."""
    fit = run_task(inputs, task)
    return replace(fit.pack(build_study_tree(inputs, task, fit), ONLY_SAVED), y=fit.y[:, :0])


def weigh(inputs: StudyInputs, task: WidthTask) -> ImportanceEvidence:
    """Return the evidence of a variant with wider or narrower priors."""
    own, config = Task(task.variant, with_model_error=True), inputs.config
    known = Legs(inputs, own).posterior
    return weigh_widths(Legs(inputs, own, task.factor), known, task, config.seed, config.sampler, config.evidence)


def _judge(task: tuple[Claims, StudyInputs, dict[str, Any], dict[str, LeastSquaresFit]]) -> Any:
    claims, inputs, summary, identified = task
    return claims.tabulate(inputs, summary, identified)


def _summarise(inputs: StudyInputs, posteriors: dict[Task, Fit], variants: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the results as JSON-ready numbers."""
    config, held = inputs.config, inputs.verification
    models = {label_class(variant.seen[0]): inputs.machine(variant).model.title for variant in config.variants}
    return {
        "experiment": config.name,
        "title": config.title,
        "seed": config.seed,
        "machine": config.machine,
        "origin": config.origin.model_dump(),
        "units": config.units.model_dump(),
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        "converged": all(one["converged"] and one["without_model_error"]["converged"] for one in variants.values()),
        "models": models,
        "drive": inputs.mechanism.drive,
        **inputs.measured.describe(),
        **_describe_noise(inputs),
        **_describe_names(config),
        **_describe_held(inputs),
        "variants": variants,
        "rankings": rank_variants(variants),
        **_stack(inputs, posteriors),
    }


def _describe_held(inputs: StudyInputs) -> dict[str, dict[str, list[str]]]:
    """Return which dimensions of each variant's model no variant frees; nothing where all are free somewhere."""
    free = {symbol for variant in inputs.config.variants for symbol in inputs.free(variant)}
    held = {
        variant.name: [one for one in list_dimensions(inputs.machine(variant).layout) if one not in free]
        for variant in inputs.config.variants
    }
    found = {name: symbols for name, symbols in held.items() if symbols}
    return {"not_free": found} if found else {}


def _describe_noise(inputs: StudyInputs) -> dict[str, dict[str, float]]:
    """Return the measurement noise of a position, rms over the poses of each use, µm; nothing of parts of poses."""
    if not inputs.measured.has_poses:
        return {}
    found = {}
    for use, held in (("calibration", False), ("verification", True)):
        poses = inputs.poses(held)
        if poses.n_poses:
            found[use] = float(np.sqrt(np.trace(poses.covariance[:, :3, :3], axis1=1, axis2=2).mean()) / MICROMETRE)
    return {"measurement_noise_um": found}


def choose_free(inputs: StudyInputs, posteriors: dict[Task, Fit]) -> dict[str, Fit]:
    """Return what was found with model error, by variant."""
    return {one.name: posteriors[Task(one.name, with_model_error=True)] for one in inputs.config.variants}


def _stack(inputs: StudyInputs, posteriors: dict[Task, Fit]) -> dict[str, Any]:
    """Return the stacked prediction of the variants that predict alike, if several do."""
    free = choose_free(inputs, posteriors)
    stacked = describe_stacking(inputs, free) if len(free) > 1 else None
    return {} if stacked is None else {"stacked": stacked}


def _describe_names(config: StudyConfig) -> dict[str, dict[str, dict[str, str]]]:
    """Return model and deformation of the variants with names of their own, which do not say them."""
    named = {
        variant.name: dict(zip(("model", "deformation"), map(label_class, variant.seen), strict=True))
        for variant in config.variants
        if variant.has_own_name
    }
    return {"own_names": named} if named else {}
