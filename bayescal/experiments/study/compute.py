"""Computing a study: its posteriors in tasks, then everything that is said of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from bayescal.config.classes import label_class
from bayescal.density.least_squares import LeastSquaresFit
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results, Writer
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.packing import pack_tree
from bayescal.experiments.shared.trees import write_packed
from bayescal.experiments.study.calibrated import describe_nominal
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.doubts import find_study_slip
from bayescal.experiments.study.fit import Arrays, Task, list_tasks, run_task
from bayescal.experiments.study.held_out import compare_variants, describe_stacking, tabulate_left_out
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.kernels import has_kernels
from bayescal.experiments.study.prior_widths import list_width_tasks, tabulate_sensitivity, weigh_widths
from bayescal.experiments.study.schema import StudyConfig
from bayescal.experiments.study.structured_table import tabulate_structured
from bayescal.experiments.study.summary import rank_variants, summarise_fit
from bayescal.experiments.study.tables import (
    identify_variants,
    tabulate_blunders,
    tabulate_deformation,
    tabulate_flexure,
    tabulate_least_squares,
    tabulate_parameters,
    tabulate_power_scaling,
    tabulate_predictions,
    tabulate_ranking,
    tabulate_ring,
    tabulate_tau_scale,
)
from bayescal.experiments.study.trees import build_study_tree
from bayescal.machines.models.legs import list_dimensions
from bayescal.numerics.units import MICROMETRE

ONLY_SAVED = ("prior", "prior_misfit", "start_error", "whitening")
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
    await_widths = begin_widths(inputs, posteriors, run)  # while workers compute them, all that needs none
    identified = run.once("least squares", identify_variants, inputs, (LeastSquaresFit,))
    summary, files = _summarise(inputs, posteriors)
    slip = find_study_slip(inputs)
    if slip is not None:
        summary["slip"] = asdict(slip)
    before = {
        "ranking": tabulate_ranking(summary, compare_variants(_choose_free(posteriors))),
        "parameters": tabulate_parameters(summary),
        "predictions": tabulate_predictions(inputs, posteriors),
        "left_out": tabulate_left_out(inputs, posteriors),
        "power_scaling": tabulate_power_scaling(inputs, posteriors),
        "blunders": tabulate_blunders(inputs, posteriors),
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
    sensitivity = {"sensitivity": tabulate_sensitivity(inputs, posteriors, await_widths())}
    return Results(summary, before | sensitivity | after, {**files, **describe_nominal(inputs)})


def compute_posteriors(inputs: StudyInputs, run: Run) -> dict[Task, Arrays]:
    """Return the arrays of all posteriors."""
    tasks = {task.key: task for task in list_tasks(inputs)}
    found = run.map("sampling", fit_and_pack, inputs, tasks)
    return {tasks[key]: arrays for key, arrays in found.items()}


def fit_and_pack(inputs: StudyInputs, task: Task) -> Arrays:
    """Return the arrays of a posterior, with its tree's file in place of what only that has."""
    arrays = run_task(inputs, task)
    tree = pack_tree(build_study_tree(inputs, task, arrays))
    return {name: values for name, values in arrays.items() if name not in ONLY_SAVED} | {"tree": tree}


def begin_widths(
    inputs: StudyInputs, posteriors: dict[Task, Arrays], run: Run
) -> Callable[[], dict[tuple[float, str], Arrays]]:
    """Begin with every factor on the priors that is not one, and return what waits for the evidence of every variant.

    It is that with model error, by factor and variant.
    """
    tasks = {task.key: task for task in list_width_tasks(inputs, posteriors)}
    wait = run.begin("prior widths", weigh_widths, inputs, tasks)
    return lambda: {(tasks[key].factor, tasks[key].variant): arrays for key, arrays in wait().items()}


def _judge(task: tuple[Claims, StudyInputs, dict[str, Any], dict[str, LeastSquaresFit]]) -> Any:
    claims, inputs, summary, identified = task
    return claims.tabulate(inputs, summary, identified)


def _summarise(inputs: StudyInputs, posteriors: dict[Task, Arrays]) -> tuple[dict[str, Any], dict[str, Writer]]:
    """Return the summary, and what writes the posteriors' draws."""
    variants: dict[str, dict[str, Any]] = {}
    files: dict[str, Writer] = {}
    for task, arrays in posteriors.items():
        fit = summarise_fit(inputs, task.variant, task.with_model_error, arrays)
        files[f"posterior/{task.stem}.nc"] = partial(write_packed, arrays["tree"])
        if task.with_model_error:
            variants[task.variant] = fit
        else:
            variants[task.variant]["without_model_error"] = fit
    config, held = inputs.config, inputs.verification
    models = {label_class(variant.model): inputs.machine(variant).model.title for variant in config.variants}
    summary = {
        "experiment": config.name,
        "title": config.title,
        "data_origin": config.data.origin,
        "seed": config.seed,
        "models": models,
        "drive": inputs.mechanism.drive,
        "n_poses": {"calibration": int((~held).sum()), "verification": int(held.sum())},
        **inputs.measured.describe(),
        **_describe_noise(inputs),
        **_describe_names(config),
        **_describe_held(inputs),
        "variants": variants,
        "ranking": rank_variants(variants),
        **_stack(inputs, posteriors),
    }
    return summary, files


def _describe_held(inputs: StudyInputs) -> dict[str, dict[str, list[str]]]:
    """Return which dimensions of each variant's model no variant frees; nothing where all are free somewhere."""
    free = {symbol for variant in inputs.config.variants for symbol in variant.free}
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


def _choose_free(posteriors: dict[Task, Arrays]) -> dict[str, Arrays]:
    """Return what was found with model error, by variant."""
    return {task.variant: arrays for task, arrays in posteriors.items() if task.with_model_error}


def _stack(inputs: StudyInputs, posteriors: dict[Task, Arrays]) -> dict[str, Any]:
    """Return the stacked prediction of the variants that predict alike, if several do."""
    free = _choose_free(posteriors)
    stacked = describe_stacking(inputs, free) if len(free) > 1 else None
    return {} if stacked is None else {"stacked": stacked}


def _describe_names(config: StudyConfig) -> dict[str, dict[str, dict[str, str]]]:
    """Return model and deformation of the variants with names of their own, which do not say them."""
    named = {
        variant.name: {"model": label_class(variant.model), "deformation": label_class(variant.deformation)}
        for variant in config.variants
        if variant.has_own_name
    }
    return {"own_names": named} if named else {}
