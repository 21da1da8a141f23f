"""What a study found, as numbers: the variants' summaries and their ranking."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayescal.density.prediction import Prediction, compute_elpd, compute_joint_elpd
from bayescal.experiments.shared.estimate import Fit
from bayescal.experiments.study.fit import read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.structured import describe_structured
from bayescal.limits import AGREEMENT
from bayescal.numerics.geometry import Array
from bayescal.report.symbols import is_model_error


def summarise_fit(inputs: StudyInputs, variant: str, with_model_error: bool, fit: Fit) -> dict[str, Any]:
    """Return one posterior's summary; lengths in mm, angles in degrees."""
    posterior = inputs.posterior(inputs.variant(variant), with_model_error)
    importance, bridge, arrays = fit.importance, fit.bridge, fit.evaluated
    problems, prediction = fit.list_problems(), read_prediction(fit)
    held, left_out = inputs.verification, fit.left_out
    elpd, elpd_se = left_out.summarise()
    summary: dict[str, Any] = {
        "n_parameters": posterior.n_parameters,
        "log_evidence": fit.log_evidence,
        "log_evidence_se": fit.log_evidence_se,
        "log_evidence_methods": {"importance": importance.log_evidence, "bridge": bridge.log_evidence},
        "log_evidence_method_se": {"importance": importance.standard_error, "bridge": bridge.standard_error},
        "log_evidence_primary": "importance" if fit.is_importance_trusted else "bridge",
        **_describe_check(fit),
        "log_evidence_agrees": fit.gap <= AGREEMENT,
        "importance": {name: getattr(importance, name) for name in ("efficiency", "pareto_k", "n_draws")},
        "elpd_loo": elpd,
        "elpd_loo_se": elpd_se,
        "elpd_loo_pareto_k_max": float(left_out.pareto_k.max()),
        "elpd_loo_n_refitted": int(left_out.was_refitted.sum()),
        "elpd_loo_n_bad_k": int(left_out.is_doubtful.sum()),
        **fit.describe_chains(),
        "problems": problems,
        "acceptance": float(fit.acceptance.mean()),
        "wall_seconds": fit.wall_seconds,
        "calibration": summarise_errors(prediction.select(~held)),
        "verification": summarise_errors(prediction.select(held)) if held.any() else None,
        "parameters": _summarise_parameters(inputs, variant, fit),
    }
    if fit.correction is not None:
        names = ("standard_error", "efficiency", "pareto_k", "n_draws")
        own = {name: float(getattr(fit.correction, name)) for name in names}
        summary["exact_density"] = {"log_evidence_shift": fit.correction.log_ratio, **own}
    if held.any():
        pointwise = arrays["log_likelihood"][..., held].reshape(-1, held.sum())
        together = arrays["joint_density"].reshape(-1, 1) if "joint_density" in arrays else pointwise
        joint, monte_carlo = compute_joint_elpd(together)
        summary["verification"] |= {
            "elpd": joint,
            "elpd_monte_carlo_se": monte_carlo,
            "elpd_pose_by_pose": compute_elpd(pointwise),
        }
    if "structured_mean" in arrays:
        summary["structured_error"] = describe_structured(inputs, variant, fit)
    summary["distance_from_nominal"] = _measure_distance(summary["parameters"])
    for key, found in (("misfit", fit.misfit), ("pulls", fit.pulls)):
        summary[key] = {"chi2": found.value, "dof": found.dof}
    return summary


def _describe_check(fit: Fit) -> dict[str, Any]:
    """Return what the check by tempering found; nothing where none was asked for."""
    if fit.check is None:
        return {}
    value, se, settled = fit.check.log_evidence, fit.check.standard_error, fit.check.mixed
    return {"log_evidence_check": {"method": "tempered", "log_evidence": value, "se": se, "settled": settled}}


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


def _summarise_parameters(inputs: StudyInputs, variant: str, fit: Fit) -> dict[str, dict[str, Any]]:
    layout = inputs.likelihood(inputs.variant(variant), verification=False).layout
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    return {
        name: {
            "nominal": float(nominal.get(name, 0.0)),
            "unit": fit.units[k],
            "mean": float(fit.mean[k]),
            "sd": float(fit.sd[k]),
            "q05": float(fit.q05[k]),
            "q95": float(fit.q95[k]),
            "prior_sd": float(fit.prior_sd[k]),
            "rhat": float(fit.diagnostics.rhat[k]),
            "ess_bulk": float(fit.diagnostics.ess_bulk[k]),
            "ess_tail": float(fit.diagnostics.ess_tail[k]),
        }
        for k, name in enumerate(fit.names)
    }


def _measure_distance(parameters: dict[str, dict[str, Any]]) -> dict[str, float]:
    """Return how far the geometry moved from nominal: rms in mm of the lengths, rms of all in prior sds."""
    geometry = {name: p for name, p in parameters.items() if not is_model_error(name)}
    lengths = [p["mean"] - p["nominal"] for p in geometry.values() if p["unit"] == "mm"]
    scaled = [(p["mean"] - p["nominal"]) / p["prior_sd"] for p in geometry.values()]
    return {
        "rms_mm": float(np.sqrt(np.mean(np.square(lengths)))) if lengths else 0.0,
        "rms_prior_sd": float(np.sqrt(np.mean(np.square(scaled)))),
    }


def rank_variants(variants: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the names of the variants, the largest log-evidence first; then those that did not converge."""
    return sorted(variants, key=lambda name: (not variants[name]["converged"], -variants[name]["log_evidence"]))
