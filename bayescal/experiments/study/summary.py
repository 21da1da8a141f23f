"""What a study found, as numbers: every variant's row, in tables and in the summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.density.prediction import Prediction, compute_elpd, compute_joint_elpd
from bayescal.experiments.shared.estimate import Fit
from bayescal.experiments.shared.readings.knowledge import plain
from bayescal.experiments.shared.stacking import tabulate_comparison
from bayescal.experiments.shared.variant_tables import FREE, ZERO, describe_fit
from bayescal.experiments.study.fit import Task, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.structured import describe_structured
from bayescal.numerics.geometry import Array
from bayescal.report.symbols import is_model_error, split_name

SETTINGS = {FREE: "variants", ZERO: "without_model_error"}
"""Names of the variants' tables, by the setting of the model error."""


@dataclass(frozen=True, eq=False)
class Summarised:
    """Variants as tables have them and as the summary has them.

    Attributes
    ----------
    tables : dict of str to DataFrame
        ``variants`` and ``without_model_error``, a row each.
    variants : dict of str to dict
        Each variant's row with what no table has, and under ``without_model_error`` the same of that setting.
    """

    tables: dict[str, pd.DataFrame]
    variants: dict[str, dict[str, Any]]


def summarise_variants(inputs: StudyInputs, posteriors: Mapping[Task, Fit]) -> Summarised:
    """Return what was found for all variants; lengths in mm, angles in degrees."""
    tables, nested = {}, {}
    for setting, name in SETTINGS.items():
        fits = {task.variant: fit for task, fit in posteriors.items() if task.with_model_error == (setting == FREE)}
        found = {variant: _describe(inputs, variant, fit) for variant, fit in fits.items()}
        rows = pd.DataFrame([{"variant": variant, **row} for variant, (row, _) in found.items()])
        table = tabulate_comparison(rows, {variant: fit.left_out for variant, fit in fits.items()}, "data")
        own = {str(row.pop("variant")): plain(row) for row in table.to_dict("records")}
        tables[name] = table
        nested[setting] = {variant: own[variant] | more for variant, (_, more) in found.items()}
    variants = {name: {**one, SETTINGS[ZERO]: nested[ZERO][name]} for name, one in nested[FREE].items()}
    return Summarised(tables, variants)


def _describe(inputs: StudyInputs, variant: str, fit: Fit) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return one posterior's row, and what of it no table has."""
    config, held, prediction = inputs.variant(variant), inputs.verification, read_prediction(fit)
    title = f"{inputs.machine(config).model.title}/{label_class(config.deformation)}"
    errors = {"calibration": summarise_errors(prediction.select(~held))}
    row = {
        "title": variant if config.has_own_name else title,
        "data": f"{int((~held).sum())} poses",
        "n_poses": int((~held).sum()),
        **describe_fit(fit),
        "acceptance": float(fit.acceptance.mean()),
        "elpd": float("nan"),
        "misfit": fit.misfit.factor,
    }
    more: dict[str, Any] = {"wall_seconds": fit.wall_seconds, "verification": None}
    if held.any():
        pointwise = fit.evaluated["log_likelihood"][..., held].reshape(-1, held.sum())
        joint = fit.evaluated["joint_density"].reshape(-1, 1) if "joint_density" in fit.evaluated else pointwise
        row["elpd"], row["elpd_se"] = compute_joint_elpd(joint)
        row["elpd_pose_by_pose"] = compute_elpd(pointwise)
        errors["verification"] = summarise_errors(prediction.select(held))
    for use, one in errors.items():
        for what, unit in (("position", "mm"), ("orientation", "deg")):
            row |= {f"{use}_{what}_error_{k}_{unit}": one[f"{what}_error_{unit}"][k] for k in ("mean", "max")}
    row["distance_from_nominal_mm"] = _measure_distance(inputs, variant, fit)
    row["distance_from_nominal_prior_sd"] = fit.pulls.factor
    if fit.correction is not None:
        row["exact_density_shift"], row["exact_density_se"] = fit.correction.log_ratio, fit.correction.standard_error
        row["exact_density_efficiency"] = float(fit.correction.efficiency)
        row["exact_density_pareto_k"] = float(fit.correction.pareto_k)
    if "structured_mean" in fit.evaluated:
        more["structured_error"] = describe_structured(inputs, variant, fit)
    return row, more | errors


def summarise_errors(prediction: Prediction) -> dict[str, Any]:
    """Return mean and largest errors of a prediction, and the coverage of its intervals."""
    position, orientation = prediction.position_error, np.degrees(prediction.orientation_error)
    return {
        "position_error_mm": _summarise_sizes(position),
        "orientation_error_deg": _summarise_sizes(orientation),
        "interval_90_coverage": prediction.coverage,
        "bound_95_coverage": float(np.mean((position <= prediction.position_bound)[np.isfinite(position)])),
    }


def _summarise_sizes(sizes: Array) -> dict[str, float | None]:
    """Return mean and largest of what was measured; None where nothing was."""
    known = sizes[np.isfinite(sizes)]
    return {"mean": float(known.mean()) if len(known) else None, "max": float(known.max()) if len(known) else None}


def list_nominal(inputs: StudyInputs, variant: str, names: tuple[str, ...]) -> Array:
    """Return nominal values of parameters, zero of what is none of the machine."""
    layout = inputs.likelihood(inputs.variant(variant), verification=False).layout
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    return np.array([float(nominal.get(name, 0.0)) for name in names])


def _measure_distance(inputs: StudyInputs, variant: str, fit: Fit) -> float:
    """Return how far the lengths moved from nominal, rms, mm."""
    own = [not is_model_error(split_name(name)[0]) for name in fit.names]
    lengths = np.array(own) & (np.array(fit.units) == "mm")
    moved = (fit.mean - list_nominal(inputs, variant, fit.names))[lengths]
    return float(np.sqrt(np.mean(moved**2))) if len(moved) else 0.0
