"""What the summary of an audit must hold for its page to lean on it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayescal.errors import InputError
from bayescal.report.reading import NUMBER, Kinds, check_keys

VERDICTS = ("identifiable", "weak", "not")
KINDS = ("structural", "practical", "informed")
EFFECTS = ("harmless", "noticeable", "harmful", "unknown")

SUMMARY_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("name", "title", "machine"), str),
    **dict.fromkeys(("n_parameters", "structural_rank", "n_structural", "n_practical", "n_informed"), int),
    **dict.fromkeys(("units", "plan", "parameters", "requirements"), dict),
    **dict.fromkeys(("directions", "recommended_free", "could_also_be_freed", "selection", "what_if"), list),
    "structural_rank_is_clear": bool,
    "total_nats": NUMBER,
}
PLAN_KEYS: dict[str, Kinds] = {"n_poses": int, "sensors": list}
PLAN_OF_LEGS: dict[str, Kinds] = dict.fromkeys(
    ("actuator_noise_um", "model_error_um", "largest_displacement_mm", "actuator_range_mm"), NUMBER
)
PARAMETER_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("unit", "verdict", "why"), str),
    **dict.fromkeys(("nominal", "prior_sd", "posterior_sd", "contraction", "nats"), NUMBER),
    "in_reduced_set": bool,
}
DIRECTION_KEYS: dict[str, Kinds] = {
    "kind": str,
    "contraction": NUMBER,
    "nats": NUMBER,
    "shares": dict,
    "sentence": str,
}
RIDGE_KEYS: dict[str, Kinds] = {
    "pivot": str,
    "effect_on_pose": str,
    **dict.fromkeys(("changes_workspace_position", "changes_workspace_rotation"), NUMBER),
}
FAR_KEYS: dict[str, Kinds] = {"legs": list, "reading_mm": NUMBER, "direction_sd": NUMBER}
DEVIATIONS = ("prior_sd", "predicted_sd", "geometry_sd", "reduced_sd")
REQUIREMENT_NUMBERS = ("limit", *DEVIATIONS, "prior_probability", "probability", "reduced_probability")
ANY_NUMBER = (*NUMBER, type(None))
"""A number that is not known where the machine's own sensors do not determine it."""
REQUIREMENT_KEYS: dict[str, Kinds] = {
    "unit": str,
    **dict.fromkeys(REQUIREMENT_NUMBERS, NUMBER),
    **dict.fromkeys(DEVIATIONS, ANY_NUMBER),
}
STEP_KEYS: dict[str, Kinds] = {"symbol": str, "nats": NUMBER, "contraction": NUMBER, "taken": bool}
CHANGE_KEYS: dict[str, Kinds] = {
    "name": str,
    "n_poses": int,
    "possible": bool,
    "beyond_actuator_range": bool,
    "ridges": dict,
    "requirements": dict,
}
SIMULATED = {
    "simulated_calibrations": "everything free within its tolerance",
    "simulated_calibrations_reduced": "the reduced set free, the rest off by its tolerances and taken for nominal",
}
"""What was free in the simulated calibrations of each key."""
SIMULATED_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("n", "n_converged"), int),
    **dict.fromkeys(("symbols", "requirements"), dict),
    **dict.fromkeys(("coverage_90", "rms_z"), NUMBER),
}
KEPT_KEYS: dict[str, Kinds] = {
    **dict.fromkeys(("kept", "n", "expected_low", "expected_high"), int),
    "claimed_probability": NUMBER,
    "agrees": bool,
}
REDUCED_KEYS: dict[str, Kinds] = {"free": list, "coverage_90": NUMBER, "rms_z": NUMBER}
SYMBOL_KEYS: dict[str, Kinds] = {
    "unit": str,
    **dict.fromkeys(("claimed_sd", "predicted_sd", "simulated_sd", "ratio", "ratio_se", "coverage_90"), NUMBER),
}
POSTERIOR_KEYS: dict[str, Kinds] = {"origin": str, "n_draws": int, "converged": bool}
PLOT_KEYS: dict[str, Kinds] = dict.fromkeys(("x", "y", "x_unit", "y_unit", "formula"), str)


def check_summary(summary: dict[str, Any], path: Path) -> None:
    """Raise InputError where an audit's summary lacks something or holds something else."""
    check_keys(summary, SUMMARY_KEYS, path, "")
    check_keys(summary["units"], {"length": str, "angle": str}, path, "units.")
    check_keys(summary["plan"], PLAN_KEYS, path, "plan.")
    if "model" in summary:
        check_keys(summary, dict.fromkeys(("model", "deformation"), str), path, "")
        check_keys(summary["plan"], PLAN_OF_LEGS, path, "plan.")
    if "n_held_back" in summary["plan"]:
        check_keys(summary["plan"], {"n_held_back": int}, path, "plan.")
    if "far_readings" in summary:
        _check_object(summary["far_readings"], FAR_KEYS, path, "far_readings")
    _check_parameters(summary["parameters"], path)
    _check_directions(summary, path)
    for name, content in summary["requirements"].items():
        _check_object(content, REQUIREMENT_KEYS, path, f"requirements.{name}")
        if content["limit"] <= 0.0:
            raise InputError(f"{path}: requirements.{name}.limit: found {content['limit']}, expected a positive number")
    for key, keys in (("selection", STEP_KEYS), ("what_if", CHANGE_KEYS)):
        for k, content in enumerate(summary[key], start=1):
            _check_object(content, keys, path, f"{key} {k}")
    for k, change in enumerate(summary["what_if"], start=1):
        _check_change(change, summary, path, f"what_if {k}")
    _check_names(summary["recommended_free"] + summary["could_also_be_freed"], "recommended_free", summary, path)
    if summary.get("reduced_set") is not None:
        _check_object(summary["reduced_set"], REDUCED_KEYS, path, "reduced_set")
        _check_names(summary["reduced_set"]["free"], "reduced_set.free", summary, path)
    _check_optional(summary, path)


def _check_names(names: list[Any], where: str, summary: dict[str, Any], path: Path) -> None:
    unknown = [name for name in names if name not in summary["parameters"]]
    if unknown:
        raise InputError(f"{path}: {where}: found {unknown[0]!r}, expected parameters")


def _check_parameters(parameters: dict[str, Any], path: Path) -> None:
    if not parameters:
        raise InputError(f"{path}: parameters: found none, expected some")
    for name, content in parameters.items():
        _check_object(content, PARAMETER_KEYS, path, f"parameters.{name}")
        _check_choice(content["verdict"], VERDICTS, path, f"parameters.{name}.verdict")


def _check_directions(summary: dict[str, Any], path: Path) -> None:
    for k, content in enumerate(summary["directions"], start=1):
        where = f"directions {k}"
        _check_object(content, DIRECTION_KEYS, path, where)
        _check_choice(content["kind"], KINDS, path, f"{where}.kind")
        if content["kind"] == "informed":
            continue
        _check_object(content, RIDGE_KEYS, path, where)
        _check_choice(content["effect_on_pose"], EFFECTS, path, f"{where}.effect_on_pose")
        _check_choice(content["pivot"], tuple(summary["parameters"]), path, f"{where}.pivot")
        if content.get("plot") is not None:
            _check_object(content["plot"], PLOT_KEYS, path, f"{where}.plot")


def _check_change(change: dict[str, Any], summary: dict[str, Any], path: Path, where: str) -> None:
    if change["possible"]:
        check_keys(change, {"total_nats": NUMBER, "n_identifiable": int}, path, f"{where}.")
        check_keys(change["ridges"], dict.fromkeys(change["ridges"], NUMBER), path, f"{where}.ridges.")
        check_keys(
            change["requirements"],
            {k: ANY_NUMBER if k in change["requirements"] else NUMBER for k in summary["requirements"]},
            path,
            f"{where}.requirements.",
        )


def _check_optional(summary: dict[str, Any], path: Path) -> None:
    posterior = summary.get("posterior")
    for name in SIMULATED:
        simulated = summary.get(name)
        if simulated is not None:
            _check_object(simulated, SIMULATED_KEYS, path, name)
            for symbol, content in simulated["symbols"].items():
                _check_object(content, SYMBOL_KEYS, path, f"{name}.symbols.{symbol}")
            for requirement, content in simulated["requirements"].items():
                _check_object(content, KEPT_KEYS, path, f"{name}.requirements.{requirement}")
    if posterior is not None:
        _check_object(posterior, POSTERIOR_KEYS, path, "posterior")
        check_keys(posterior, {"parameters": dict}, path, "posterior.")
        for name, content in posterior["parameters"].items():
            _check_choice(name, tuple(summary["parameters"]), path, "posterior.parameters")
            _check_object(content, dict.fromkeys(("mean", "sd"), NUMBER), path, f"posterior.parameters.{name}")


def _check_object(content: Any, keys: Mapping[str, Kinds], path: Path, where: str) -> None:
    if not isinstance(content, dict):
        raise InputError(f"{path}: {where}: found {type(content).__name__}, expected an object")
    check_keys(content, keys, path, f"{where}.")


def _check_choice(value: str, choices: tuple[str, ...], path: Path, where: str) -> None:
    if value not in choices:
        shown = ", ".join(choices[:6]) + (", ..." if len(choices) > 6 else "")
        raise InputError(f"{path}: {where}: found {value!r}, expected one of {shown}")
