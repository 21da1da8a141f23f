"""An audit as plain values: ``summary.json`` and the tables beside it, in the design's units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.experiments.audit.audit import Audit
from bayescal.experiments.audit.changes import ChangeEffect, contraction_along, contraction_of_symbols
from bayescal.experiments.audit.far_readings import describe_far_readings
from bayescal.experiments.audit.inputs import AuditInputs, list_measuring
from bayescal.experiments.shared.schema import WorkspaceConfig
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import nats_from_contraction
from bayescal.identifiability.reduced import ReducedSet
from bayescal.identifiability.ridges import Ridge
from bayescal.limits import COVERAGE, INFORMED
from bayescal.numerics.geometry import Array

ROTATION = "rotation"
NAMED_SHARE = 0.02  # of a direction, for a parameter to be named in a sentence
NAMED = 4


def summarise(audit: Audit) -> dict[str, Any]:
    """Return what ``summary.json`` holds; lengths and angles in the design's units, which it states."""
    inputs, analysis = audit.inputs, audit.analysis
    config, knowledge, structure = inputs.config, inputs.knowledge, analysis.structure
    kinds = [direction.kind for direction in analysis.directions]
    names = knowledge.names
    return {
        "name": config.name,
        "title": config.title,
        "machine": knowledge.machine.mechanism.name,
        "model": label_class(config.variants[0].model or ""),
        "model_title": knowledge.machine.model.title,
        "deformation": label_class(config.variants[0].deformation),
        "seed": config.seed,
        "units": {"length": inputs.units.length, "angle": inputs.units.angle},
        "plan": _summarise_plan(audit),
        **describe_far_readings(audit),
        "n_parameters": len(names),
        "structural_rank": structure.rank,
        "structural_gap": structure.gap if np.isfinite(structure.gap) else None,
        "structural_rank_is_clear": structure.is_clear,
        "structural_rank_elsewhere": structure.rank_elsewhere,
        "n_structural": kinds.count("structural"),
        "n_practical": kinds.count("practical"),
        "n_informed": kinds.count("informed"),
        "total_nats": analysis.information.nats,
        "parameters": _summarise_parameters(audit),
        "directions": _summarise_directions(audit),
        "recommended_free": list(names),
        "reduced_set": _summarise_reduced(audit),
        "could_also_be_freed": [names[k] for k in analysis.selection.extra],
        "selection": [vars(step) for step in analysis.selection.steps],
        "requirements": _summarise_requirements(audit),
        "what_if": [_summarise_outcome(audit, outcome) for outcome in audit.what_ifs],
    }


def _summarise_plan(audit: Audit) -> dict[str, Any]:
    inputs = audit.inputs
    plan, mechanism = inputs.plan, inputs.knowledge.machine.mechanism
    moved = np.abs(plan.actuators - mechanism.initial_actuator_positions)
    config, workspace = inputs.config, inputs.config.workspace
    return {
        "n_poses": plan.n_poses,
        "sensors": [] if config.data is not None else list_measuring(config),
        "actuator_noise_um": 1e3 * plan.actuator_noise,
        "model_error_um": 1e3 * plan.model_error,
        **_summarise_function(inputs),
        **({} if inputs.measured is None else {"n_held_back": inputs.measured.n_held_back}),
        "largest_displacement_mm": float(moved.max()),
        "actuator_range_mm": mechanism.actuator_range,
        "workspace": workspace.model_dump(mode="json") if isinstance(workspace, WorkspaceConfig) else None,
    }


def _summarise_function(inputs: AuditInputs) -> dict[str, Any]:
    function = inputs.plan.function
    if function is None:
        return {}
    size = float(np.sqrt(np.mean(np.square(function.scale))))
    return {"structured_error": {"kernel": function.kernel.name, "scale_um": 1e3 * size}}


# --- parameters --------------------------------------------------------------------------------------------------


def _summarise_parameters(audit: Audit) -> dict[str, Any]:
    inputs, analysis = audit.inputs, audit.analysis
    knowledge, covariance = inputs.knowledge, analysis.information.covariance
    alone = _describe_alone(analysis.reduced)
    nats = nats_from_contraction(analysis.information.contraction)
    result = {}
    for k, name in enumerate(knowledge.names):
        factor = inputs.units.factor(knowledge.units[k])
        prior, contraction = knowledge.sd[k] / factor, float(analysis.information.contraction[k])
        result[name] = {
            "unit": inputs.units.name(knowledge.units[k]),
            "nominal": float(knowledge.layout.nominal[knowledge.free[k]] / factor),
            "prior_sd": float(prior),
            "posterior_sd": float(prior * np.sqrt(covariance[k, k])),
            "contraction": contraction,
            "nats": float(nats[k]),
            "verdict": analysis.verdicts[k],
            "in_reduced_set": k in analysis.selection.free,
            **_scale(alone.get(k), float(prior)),
            "why": explain(audit, k),
        }
    return result


def _summarise_reduced(audit: Audit) -> dict[str, Any] | None:
    """Return the reduced set as a whole; None where it is empty."""
    names, free, reduced = audit.inputs.knowledge.names, audit.analysis.selection.free, audit.analysis.reduced
    if not free:
        return None
    return {
        "free": [names[k] for k in free],
        "coverage_90": COVERAGE if reduced is None else float(reduced.coverage.mean()),
        "rms_z": 1.0 if reduced is None else reduced.rms_z,
    }


def _describe_alone(reduced: ReducedSet | None) -> dict[int, tuple[float, float, float]]:
    """Return claimed sd and true error in tolerances, and coverage, of each parameter of the reduced set."""
    if reduced is None:
        return {}
    columns = (reduced.free, reduced.claimed, reduced.error, reduced.coverage)
    return {int(k): (float(c), float(e), float(p)) for k, c, e, p in zip(*columns, strict=True)}


def _scale(alone: tuple[float, float, float] | None, prior: float) -> dict[str, float | None]:
    claimed, error, coverage = (None, None, None) if alone is None else (alone[0] * prior, alone[1] * prior, alone[2])
    return {"reduced_claimed_sd": claimed, "reduced_true_error": error, "reduced_coverage_90": coverage}


def explain(audit: Audit, k: int) -> str:
    """Return in words why a parameter has its verdict."""
    analysis, knowledge = audit.analysis, audit.inputs.knowledge
    left = float(np.sqrt(analysis.information.covariance[k, k]))
    shrunk = f"Its tolerance shrinks to {_percent(left)}"
    if analysis.verdicts[k] == "identifiable":
        return f"{shrunk}."
    ridges = [ridge.direction for ridge in audit.ridges]
    weights = [float(d.vector[k] ** 2 * (1.0 - d.contraction)) for d in ridges]
    if not ridges or max(weights) == 0.0:
        return f"{shrunk}: the measurements are too few or too coarse."
    direction = ridges[int(np.argmax(weights))]
    partners = [knowledge.names[i] for i in np.argsort(-np.abs(direction.vector)) if i != k]
    shares = {knowledge.names[i]: float(direction.vector[i] ** 2) for i in range(len(knowledge.names))}
    named = [name for name in partners if shares[name] >= NAMED_SHARE][:NAMED]
    seen = "No measurement of this kind" if direction.kind == "structural" else "The planned measurements hardly"
    if not named:
        return f"{seen} {'sees' if direction.kind == 'structural' else 'see'} it. {shrunk}."
    verb = "tells" if direction.kind == "structural" else "tell"
    return f"{seen} {verb} it from {_join(named)}. {shrunk}."


# --- directions --------------------------------------------------------------------------------------------------


def _summarise_directions(audit: Audit) -> list[dict[str, Any]]:
    described = {id(ridge.direction): ridge for ridge in audit.ridges}
    return [_summarise_direction(audit, d, described.get(id(d))) for d in audit.analysis.directions]


def _summarise_direction(audit: Audit, direction: Direction, ridge: Ridge | None) -> dict[str, Any]:
    knowledge, units = audit.inputs.knowledge, audit.inputs.units
    used = [int(i) for i in np.argsort(-np.abs(direction.vector)) if direction.vector[i]]
    factors = {i: units.factor(knowledge.units[i]) for i in used}
    names = {i: knowledge.names[i] for i in used}
    result: dict[str, Any] = {
        "kind": direction.kind,
        "contraction": direction.contraction,
        "nats": direction.nats,
        "loadings": {names[i]: float(direction.vector[i] * knowledge.sd[i] / factors[i]) for i in used},
        "shares": {names[i]: float(direction.vector[i] ** 2) for i in used},
    }
    if ridge is None or direction.pivot is None:
        return {**result, "sentence": _praise(direction, names)}
    harm, share, limit = audit.harm(direction)
    length, angle = units.factor("mm"), units.factor("rad")
    return {
        **result,
        "sentence": ridge.sentence,
        "pivot": knowledge.names[direction.pivot],
        "step": {name: value / factors[knowledge.names.index(name)] for name, value in ridge.loadings.items()},
        "changes_measured_position": ridge.position_change / length,
        "changes_measured_rotation": ridge.rotation_change / angle,
        "changes_workspace_position": ridge.workspace_position / length,
        "changes_workspace_rotation": ridge.workspace_rotation / angle,
        "effect_on_pose": harm,
        "share_of_limit": share if np.isfinite(share) else None,
        "limit": limit,
        "helped_most_by": _find_help(audit, direction),
    }


def _find_help(audit: Audit, direction: Direction) -> dict[str, Any] | None:
    """Return the what-if within the actuators' reach under which a direction contracts most, if one helps."""
    if direction.kind != "practical":
        return None
    within = [outcome for outcome in audit.what_ifs if outcome.information is not None and not outcome.beyond_range]
    along = [float(contraction_along(outcome, direction.vector[:, None])[0]) for outcome in within]
    if not along or max(along) <= direction.contraction:
        return None
    best = int(np.argmax(along))
    return {"name": within[best].name, "contraction": along[best]}


def _praise(direction: Direction, names: dict[int, str]) -> str:
    left = float(np.sqrt(max(0.0, 1.0 - direction.contraction)))
    named = [name for i, name in names.items() if direction.vector[i] ** 2 >= NAMED_SHARE][:NAMED]
    return f"Known to {_percent(left)} of its tolerance: mostly {_join(named)}."


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.2g} %"


def _join(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


# --- requirements and what would help ----------------------------------------------------------------------------


def _factor(audit: Audit, requirement: str) -> float:
    return audit.inputs.units.factor("rad" if requirement.startswith(ROTATION) else "mm")


def _summarise_requirements(audit: Audit) -> dict[str, Any]:
    units = audit.inputs.units
    result = {}
    for outlook in audit.outlooks:
        name = outlook.requirement.name
        factor = _factor(audit, name)
        result[name] = {
            "unit": units.name("rad" if name.startswith(ROTATION) else "mm"),
            "limit": outlook.requirement.limit / factor,
            "prior_sd": outlook.prior_sd / factor,
            "predicted_sd": outlook.predicted_sd / factor,
            "geometry_sd": outlook.geometry_sd / factor,
            "prior_probability": outlook.prior_probability,
            "probability": outlook.probability,
            "reduced_sd": outlook.reduced_sd / factor,
            "reduced_probability": outlook.reduced_probability,
        }
    return result


def _weak_vectors(audit: Audit) -> tuple[list[str], Array]:
    """Return the practical ridges' parameters and directions, shape (n, k)."""
    ridges = [ridge.direction for ridge in audit.ridges if ridge.direction.kind == "practical"]
    names = [audit.inputs.knowledge.names[d.pivot] for d in ridges if d.pivot is not None]
    n = len(audit.inputs.knowledge.names)
    return names, np.stack([d.vector for d in ridges], axis=1) if ridges else np.empty((n, 0))


def _summarise_outcome(audit: Audit, outcome: ChangeEffect) -> dict[str, Any]:
    names, vectors = _weak_vectors(audit)
    along = contraction_along(outcome, vectors)
    information = outcome.information
    return {
        "name": outcome.name,
        "n_poses": outcome.n_poses,
        "possible": information is not None,
        "beyond_actuator_range": outcome.beyond_range,
        "total_nats": None if information is None else information.nats,
        "n_identifiable": None if information is None else int(np.sum(information.contraction >= INFORMED)),
        "ridges": {
            name: float(value) if np.isfinite(value) else None for name, value in zip(names, along, strict=True)
        },
        "requirements": {name: sd / _factor(audit, name) for name, sd in outcome.required_sd.items()},
    }


# --- tables ------------------------------------------------------------------------------------------------------


def tabulate(summary: dict[str, Any], audit: Audit) -> dict[str, pd.DataFrame]:
    """Return the tables of an audit by name."""
    tables = {
        "parameters": pd.DataFrame([{"parameter": n, **values} for n, values in summary["parameters"].items()]),
        "directions": _tabulate_directions(summary),
        "selection": pd.DataFrame(summary["selection"]),
        "spectrum": _tabulate_spectrum(audit),
        "what_if": _tabulate_what_if(summary),
        "sweeps": _tabulate_sweeps(audit),
    }
    if summary["requirements"]:
        rows = [{"requirement": name, **values} for name, values in summary["requirements"].items()]
        tables["requirements"] = pd.DataFrame(rows)
        tables["sweep_requirements"] = _tabulate_sweep_requirements(audit)
    return tables


def _tabulate_directions(summary: dict[str, Any]) -> pd.DataFrame:
    rows = []
    for number, direction in enumerate(summary["directions"], start=1):
        for name, loading in direction["loadings"].items():
            rows.append(
                {
                    "direction": number,
                    "kind": direction["kind"],
                    "contraction": direction["contraction"],
                    "nats": direction["nats"],
                    "parameter": name,
                    "unit": summary["parameters"][name]["unit"],
                    "loading": loading,
                    "share": direction["shares"][name],
                }
            )
    return pd.DataFrame(rows)


def _tabulate_spectrum(audit: Audit) -> pd.DataFrame:
    """Return the singular values over the wide workspace, and what rounding does to them."""
    structure = audit.analysis.structure
    values = structure.singular_values
    planned = np.sqrt(audit.analysis.information.spectrum()[0][::-1])
    return pd.DataFrame(
        {
            "number": np.arange(1, len(values) + 1),
            "wide_workspace": values,
            "planned": planned,
            "rounding": structure.rounding,
            "counts": np.arange(len(values)) < structure.rank,
        }
    )


def _tabulate_what_if(summary: dict[str, Any]) -> pd.DataFrame:
    rows = []
    for outcome in summary["what_if"]:
        for ridge, contraction in outcome["ridges"].items():
            rows.append({"what_if": outcome["name"], "ridge": ridge, "contraction": contraction})
    return pd.DataFrame(rows, columns=["what_if", "ridge", "contraction"])


def _tabulate_sweeps(audit: Audit) -> pd.DataFrame:
    symbols = audit.inputs.knowledge.symbols
    rows = []
    for point in audit.sweeps:
        information = point.outcome.information
        base = {"sweep": point.sweep, "value": point.value, "beyond_actuator_range": point.outcome.beyond_range}
        if information is None:
            continue
        for symbol, (least, most) in contraction_of_symbols(information, symbols).items():
            rows.append({**base, "symbol": symbol, "contraction_least": least, "contraction_most": most})
    return pd.DataFrame(rows)


def _tabulate_sweep_requirements(audit: Audit) -> pd.DataFrame:
    rows = []
    limits = {r.name: r.limit for r in audit.inputs.requirements}
    for point in audit.sweeps:
        for name, sd in point.outcome.required_sd.items():
            factor = _factor(audit, name)
            rows.append(
                {
                    "sweep": point.sweep,
                    "value": point.value,
                    "requirement": name,
                    "unit": audit.inputs.units.name("rad" if name.startswith(ROTATION) else "mm"),
                    "predicted_sd": sd / factor,
                    "limit": limits[name] / factor,
                }
            )
    return pd.DataFrame(rows)
