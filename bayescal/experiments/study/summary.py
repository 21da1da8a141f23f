"""What a study found, as numbers: the variants' summaries and their ranking."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import arviz as az
import numpy as np
import xarray as xr

from bayescal.density.model_error import is_model_error
from bayescal.density.prediction import Prediction, compute_elpd
from bayescal.experiments.study.fit import Arrays, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.structured import compute_joint_elpd, describe_structured
from bayescal.inference.diagnostics import Diagnostics
from bayescal.limits import AGREEMENT, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

ELPD_VARIABLE = "measured_pose"
HOPELESS_K = 10.0  # stands for a tail too heavy for its shape to be found


@dataclass(frozen=True, eq=False)
class Loo:
    """PSIS-LOO over the calibration poses."""

    elpd: float
    se: float
    pareto_k: Array

    @property
    def n_bad(self) -> int:
        """Poses whose Pareto k makes the estimate doubtful."""
        return int(np.sum(self.pareto_k > PARETO_K_LIMIT))


def build_tree(inputs: StudyInputs, variant: str, with_model_error: bool, arrays: Arrays) -> xr.DataTree:
    """Return a posterior as an ArviZ DataTree: draws with chain = ensemble, densities, predictions, data."""
    names = inputs.posterior(inputs.variant(variant), with_model_error).names
    draws = arrays["draws"]
    symbols: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        symbols.setdefault(name.split("[")[0], []).append(k)
    legs = list(range(1, inputs.mechanism.n_legs + 1))
    posterior = {s: draws[..., index] if len(index) > 1 else draws[..., index[0]] for s, index in symbols.items()}
    dims: dict[str, list[str]] = {s: ["leg"] for s, index in symbols.items() if len(index) > 1}
    held = inputs.verification
    names_of = np.array(inputs.names)
    poses = inputs.measured.poses
    data = {
        "posterior": posterior,
        "sample_stats": {"lp": arrays["log_density"]},
        "log_likelihood": {ELPD_VARIABLE: arrays["log_likelihood"][..., ~held]},
        "predictions": {"verification_log_density": arrays["log_likelihood"][..., held]},
        "observed_data": {"position": poses.position, "rotation": poses.rotation},
        "constant_data": {"covariance": poses.covariance, "actuators": poses.actuators},
    }
    dims |= {
        ELPD_VARIABLE: ["calibration_pose"],
        "verification_log_density": ["verification_pose"],
        "position": ["pose", "axis"],
        "rotation": ["pose", "axis", "platform_axis"],
        "covariance": ["pose", "component", "component_other"],
        "actuators": ["pose", "leg"],
    }
    coords = {
        "leg": legs,
        "pose": names_of,
        "calibration_pose": names_of[~held],
        "verification_pose": names_of[held],
        "axis": list("xyz"),
        "platform_axis": list("xyz"),
    }
    tree = az.from_dict(data, coords=coords, dims=dims, pred_dims=dims, pred_coords=coords)
    tree.attrs = {"variant": variant, "model_error": "free" if with_model_error else "zero", "length_unit": "mm"}
    return tree


def compute_loo(tree: xr.DataTree) -> Loo:
    """Return PSIS-LOO over the calibration poses; poses with a large Pareto k are counted, not hidden."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Estimated shape parameter of Pareto distribution")
        loo = az.loo(tree, var_name=ELPD_VARIABLE, pointwise=True)
    pareto_k = np.asarray(loo.pareto_k, dtype=np.float64)
    return Loo(float(loo.elpd), float(loo.se), np.where(np.isfinite(pareto_k), pareto_k, HOPELESS_K))


def summarise_fit(
    inputs: StudyInputs, variant: str, with_model_error: bool, arrays: Arrays, loo: Loo
) -> dict[str, Any]:
    """Return one posterior's summary; lengths in mm, angles in degrees."""
    posterior = inputs.posterior(inputs.variant(variant), with_model_error)
    importance, bridge = arrays["importance"], arrays["bridge"]
    efficiency, pareto_k, n_draws = (float(x) for x in arrays["importance_quality"])
    trusted = pareto_k <= PARETO_K_LIMIT
    primary = importance if trusted else bridge
    problems, prediction = list_problems(arrays), read_prediction(arrays)
    held = inputs.verification
    summary: dict[str, Any] = {
        "n_parameters": posterior.n_parameters,
        "log_evidence": float(primary[0]),
        "log_evidence_se": float(primary[1]),
        "log_evidence_methods": {"importance": float(importance[0]), "bridge": float(bridge[0])},
        "log_evidence_method_se": {"importance": float(importance[1]), "bridge": float(bridge[1])},
        "log_evidence_primary": "importance" if trusted else "bridge",
        "log_evidence_agrees": bool(abs(importance[0] - bridge[0]) <= AGREEMENT),
        "importance": {"efficiency": efficiency, "pareto_k": pareto_k, "n_draws": int(n_draws)},
        "elpd_loo": loo.elpd,
        "elpd_loo_se": loo.se,
        "elpd_loo_pareto_k_max": float(loo.pareto_k.max()),
        "elpd_loo_n_bad_k": loo.n_bad,
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
    if held.any():
        pointwise = arrays["log_likelihood"][..., held]
        summary["verification"]["elpd"] = compute_elpd(pointwise.reshape(-1, pointwise.shape[-1]))
        if inputs.has_kernels:
            summary["verification"]["elpd_joint"] = compute_joint_elpd(arrays, held)
    if "structured_mean" in arrays:
        summary["structured_error"] = describe_structured(inputs, variant, arrays)
    summary["distance_from_nominal"] = _measure_distance(summary["parameters"])
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
    return problems


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
            "unit": units.get(name, "mm"),
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
    """Return the names of the variants, the largest log-evidence first."""
    return sorted(variants, key=lambda name: -variants[name]["log_evidence"])
