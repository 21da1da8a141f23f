"""What a study found, as numbers: the variants' summaries and their ranking."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayescal.density.model_error import LENGTH
from bayescal.density.prediction import Prediction, compute_elpd, compute_joint_elpd
from bayescal.experiments.study.fit import Arrays, read_left_out, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.structured import describe_structured
from bayescal.inference.diagnostics import (
    Diagnostics,
    list_check_problems,
    list_importance_problems,
    list_scout_problems,
    list_stand_problems,
    list_tail_problems,
)
from bayescal.limits import AGREEMENT, MOVED_LIMIT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array
from bayescal.report.symbols import is_model_error


def summarise_fit(inputs: StudyInputs, variant: str, with_model_error: bool, arrays: Arrays) -> dict[str, Any]:
    """Return one posterior's summary; lengths in mm, angles in degrees."""
    posterior = inputs.posterior(inputs.variant(variant), with_model_error)
    importance, bridge = arrays["importance"], arrays["bridge"]
    efficiency, pareto_k, n_draws = (float(x) for x in arrays["importance_quality"])
    trusted = pareto_k <= PARETO_K_LIMIT
    primary = importance if trusted else bridge
    problems, prediction = list_problems(arrays), read_prediction(arrays)
    held, left_out = inputs.verification, read_left_out(arrays)
    elpd, elpd_se = left_out.summarise()
    summary: dict[str, Any] = {
        "n_parameters": posterior.n_parameters,
        "log_evidence": float(primary[0]),
        "log_evidence_se": float(primary[1]),
        "log_evidence_methods": {"importance": float(importance[0]), "bridge": float(bridge[0])},
        "log_evidence_method_se": {"importance": float(importance[1]), "bridge": float(bridge[1])},
        "log_evidence_primary": "importance" if trusted else "bridge",
        **_describe_check(arrays),
        "log_evidence_agrees": bool(abs(importance[0] - bridge[0]) <= AGREEMENT),
        "importance": {"efficiency": efficiency, "pareto_k": pareto_k, "n_draws": int(n_draws)},
        "elpd_loo": elpd,
        "elpd_loo_se": elpd_se,
        "elpd_loo_pareto_k_max": float(left_out.pareto_k.max()),
        "elpd_loo_n_refitted": int(left_out.was_refitted.sum()),
        "elpd_loo_n_bad_k": int(left_out.is_doubtful.sum()),
        "converged": not problems,
        "problems": problems,
        "rhat_max": float(arrays["rhat"].max()),
        "ess_bulk_min": float(arrays["ess_bulk"].min()),
        "ess_tail_min": float(arrays["ess_tail"].min()),
        "acceptance": float(arrays["acceptance"].mean()),
        "wall_seconds": float(arrays["wall_seconds"]),
        "calibration": summarise_errors(prediction.select(~held)),
        "verification": summarise_errors(prediction.select(held)) if held.any() else None,
        "parameters": _summarise_parameters(inputs, variant, posterior.all_priors(), posterior.names, arrays),
    }
    if "correction" in arrays:
        names = ("log_evidence_shift", "standard_error", "efficiency", "pareto_k", "n_draws")
        summary["exact_density"] = dict(zip(names, (float(x) for x in arrays["correction"]), strict=True))
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
        summary["structured_error"] = describe_structured(inputs, posterior.names, variant, arrays)
    summary["distance_from_nominal"] = _measure_distance(summary["parameters"])
    for key in ("misfit", "pulls"):
        chi2, dof = (float(x) for x in arrays[f"{key}_chi2"])
        summary[key] = {"chi2": chi2, "dof": dof}
    return summary


def list_problems(arrays: Arrays) -> list[str]:
    """Return what speaks against a posterior, in words; empty where it converged."""
    problems = Diagnostics(*(arrays[name] for name in ("rhat", "ess_bulk", "ess_tail"))).list_problems()
    if not arrays["modes_converged"]:
        problems.append("the mode search did not converge")
    if not arrays["bridge_converged"]:
        problems.append("bridge sampling did not converge")
    gap = abs(float(arrays["importance"][0] - arrays["bridge"][0]))
    if not gap <= AGREEMENT:
        problems.append(f"the two log-evidences differ by {gap:.2f}, limit {AGREEMENT}")
    efficiency, pareto_k, n_draws = (float(x) for x in arrays["importance_quality"])
    problems += list_importance_problems(pareto_k, efficiency * n_draws)
    problems += list_stand_problems(*(int(x) for x in arrays["longest_stand"]))
    problems += list_scout_problems(*(int(x) for x in arrays["scouts"]))
    problems += list_tail_problems(*(float(x) for x in arrays["tails"]))
    if "tempered" in arrays:
        trusted = arrays["importance_quality"][1] <= PARETO_K_LIMIT
        value, se, settled = (float(x) for x in arrays["tempered"])
        own, own_se = (float(x) for x in arrays["importance" if trusted else "bridge"])
        problems += list_check_problems((own, own_se), (value, se), bool(settled))
    if "correction" in arrays:
        _, _, efficiency, pareto_k, _ = (float(x) for x in arrays["correction"])
        if not (efficiency >= MOVED_LIMIT and pareto_k <= PARETO_K_LIMIT):
            problems.append(
                f"the evidence by the exact density rests on {100 * efficiency:.0f} % of its draws, limit "
                f"{100 * MOVED_LIMIT:.0f} %, Pareto k {pareto_k:.2f}, limit {PARETO_K_LIMIT}"
            )
    return problems


def _describe_check(arrays: Arrays) -> dict[str, Any]:
    """Return what the check by tempering found; nothing where none was asked for."""
    if "tempered" not in arrays:
        return {}
    value, se, settled = (float(x) for x in arrays["tempered"])
    return {"log_evidence_check": {"method": "tempered", "log_evidence": value, "se": se, "settled": bool(settled)}}


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


def _summarise_parameters(
    inputs: StudyInputs, variant: str, priors: Mapping[str, Any], names: tuple[str, ...], arrays: Arrays
) -> dict[str, dict[str, Any]]:
    layout = inputs.likelihood(inputs.variant(variant), verification=False).layout
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    units = dict(zip(layout.names, layout.units, strict=True))
    return {
        name: {
            "nominal": float(nominal.get(name, 0.0)),
            "unit": units.get(name, "1" if name == LENGTH else "mm"),
            "mean": float(arrays["mean"][k]),
            "sd": float(arrays["sd"][k]),
            "q05": float(arrays["q05"][k]),
            "q95": float(arrays["q95"][k]),
            "prior_sd": float(priors[name].sd),
            "rhat": float(arrays["rhat"][k]),
            "ess_bulk": float(arrays["ess_bulk"][k]),
            "ess_tail": float(arrays["ess_tail"][k]),
        }
        for k, name in enumerate(names)
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
