"""An audit as plain values: ``summary.json`` and the tables beside it, in the design's units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayescal.experiments.audit.audit import Audit
from bayescal.experiments.audit.changes import ChangeEffect, contraction_along, contraction_of_symbols
from bayescal.experiments.audit.far_readings import describe_far_readings
from bayescal.experiments.audit.inputs import AuditInputs
from bayescal.experiments.audit.planned import Planned
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.information import nats_from_contraction
from bayescal.identifiability.requirements import COMPONENTS, Requirement
from bayescal.identifiability.ridges import Ridge
from bayescal.identifiability.selection import ReducedSet
from bayescal.limits import COVERAGE, INFORMED
from bayescal.numerics.geometry import Array

ROTATION = "rotation"
NAMED_SHARE = 0.02  # of a direction, for a parameter to be named in a sentence
NAMED = 4


def summarise(audit: Audit) -> dict[str, Any]:
    """Return what ``summary.json`` says of one variant; lengths and angles in the config's units, which it states."""
    inputs, analysis = audit.inputs, audit.analysis
    config, structure, names = inputs.config, analysis.structure, inputs.names
    kinds = [direction.kind for direction in analysis.directions]
    return {
        "name": config.name,
        "title": config.title,
        **inputs.summarise_plan(),
        "seed": config.seed,
        "units": {"length": inputs.units.length, "angle": inputs.units.angle},
        "required_of": config.required_of,
        **(describe_far_readings(audit, inputs) if isinstance(inputs, AuditInputs) else {}),
        "n_parameters": len(names),
        "structural_rank": structure.rank,
        "structural_gap": structure.gap if np.isfinite(structure.gap) else None,
        "structural_rank_is_clear": structure.is_clear,
        "structural_rank_elsewhere": structure.rank_elsewhere,
        "n_structural": kinds.count("structural"),
        "n_practical": kinds.count("practical"),
        "n_informed": kinds.count("informed"),
        "total_nats": analysis.information.nats,
        "parameters": summarise_parameters(audit),
        "directions": _summarise_directions(audit),
        "recommended_free": list(names),
        "reduced_set": _summarise_reduced(audit),
        "could_also_be_freed": [names[k] for k in analysis.selection.extra],
        "selection": [vars(step) for step in analysis.selection.steps],
        "requirements": summarise_requirements(audit),
        "what_if": [_summarise_outcome(audit, outcome) for outcome in audit.what_ifs],
    }


# --- parameters --------------------------------------------------------------------------------------------------


def summarise_parameters(audit: Audit) -> dict[str, Any]:
    """Return what is known of each parameter before and after the calibration."""
    inputs, analysis = audit.inputs, audit.analysis
    covariance, nominal = analysis.information.covariance, inputs.nominal
    alone = _describe_alone(analysis.reduced)
    nats = nats_from_contraction(analysis.information.contraction)
    result = {}
    for k, name in enumerate(inputs.names):
        factor = inputs.units.factor(inputs.parameter_units[k])
        prior, contraction = inputs.sd[k] / factor, float(analysis.information.contraction[k])
        result[name] = {
            "unit": inputs.units.name(inputs.parameter_units[k]),
            "nominal": float(nominal[k] / factor),
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
    names, free, reduced = audit.inputs.names, audit.analysis.selection.free, audit.analysis.reduced
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
    analysis, names = audit.analysis, audit.inputs.names
    left = float(np.sqrt(analysis.information.covariance[k, k]))
    shrunk = f"Its tolerance shrinks to {_percent(left)}"
    if analysis.verdicts[k] == "identifiable":
        return f"{shrunk}."
    ridges = [ridge.direction for ridge in audit.ridges]
    weights = [float(d.vector[k] ** 2 * (1.0 - d.contraction)) for d in ridges]
    if not ridges or max(weights) == 0.0:
        return f"{shrunk}: the measurements are too few or too coarse."
    direction = ridges[int(np.argmax(weights))]
    partners = [names[i] for i in np.argsort(-np.abs(direction.vector)) if i != k]
    shares = {names[i]: float(direction.vector[i] ** 2) for i in range(len(names))}
    chosen = [name for name in partners if shares[name] >= NAMED_SHARE][:NAMED]
    seen = "No measurement of this kind" if direction.kind == "structural" else "The planned measurements hardly"
    if not chosen:
        return f"{seen} {'sees' if direction.kind == 'structural' else 'see'} it. {shrunk}."
    verb = "distinguishes" if direction.kind == "structural" else "distinguish"
    return f"{seen} {verb} it from {_join(chosen)}. {shrunk}."


# --- directions --------------------------------------------------------------------------------------------------


def _summarise_directions(audit: Audit) -> list[dict[str, Any]]:
    described = {id(ridge.direction): ridge for ridge in audit.ridges}
    return [_summarise_direction(audit, d, described.get(id(d))) for d in audit.analysis.directions]


def _summarise_direction(audit: Audit, direction: Direction, ridge: Ridge | None) -> dict[str, Any]:
    inputs, units = audit.inputs, audit.inputs.units
    used = [int(i) for i in np.argsort(-np.abs(direction.vector)) if direction.vector[i]]
    factors = {i: units.factor(inputs.parameter_units[i]) for i in used}
    names = {i: inputs.names[i] for i in used}
    result: dict[str, Any] = {
        "kind": direction.kind,
        "contraction": direction.contraction,
        "nats": direction.nats,
        "loadings": {names[i]: float(direction.vector[i] * inputs.sd[i] / factors[i]) for i in used},
        "shares": {names[i]: float(direction.vector[i] ** 2) for i in used},
    }
    if ridge is None or direction.pivot is None:
        return {**result, "sentence": _praise(direction, names)}
    harm, share, limit = audit.harm(direction)
    length, angle = units.factor("mm"), units.factor("rad")
    return {
        **result,
        "sentence": ridge.sentence,
        "pivot": inputs.names[direction.pivot],
        "step": {name: value / factors[inputs.names.index(name)] for name, value in ridge.loadings.items()},
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


def unit_of(inputs: Planned, requirement: Requirement) -> str:
    """Return the inner unit of what is required."""
    if requirement.components == COMPONENTS:
        return "rad" if requirement.name.startswith(ROTATION) else "mm"
    return inputs.tool_units[requirement.components.index(requirement.name)]


def summarise_requirements(audit: Audit) -> dict[str, Any]:
    """Return how each requirement stands."""
    units, result = audit.inputs.units, {}
    for outlook in audit.outlooks:
        unit = unit_of(audit.inputs, outlook.requirement)
        factor = units.factor(unit)
        lengths = ("prior_sd", "predicted_sd", "geometry_sd", "reduced_sd", "rms_sd", "worst_sd")
        chances = ("prior_probability", "probability", "reduced_probability", "everywhere")
        result[outlook.requirement.name] = {
            "unit": units.name(unit),
            "limit": outlook.requirement.limit / factor,
            **{name: _plain(getattr(outlook, name) / factor) for name in lengths},
            **{name: getattr(outlook, name) for name in chances},
            "worst_at": audit.inputs.name_workspace_pose(outlook.worst),
        }
    return result


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _weak_vectors(audit: Audit) -> tuple[list[str], Array]:
    """Return the practical ridges' parameters and directions, shape (n, k)."""
    ridges = [ridge.direction for ridge in audit.ridges if ridge.direction.kind == "practical"]
    names = [audit.inputs.names[d.pivot] for d in ridges if d.pivot is not None]
    n = len(audit.inputs.names)
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
        "requirements": {
            one.name: _plain(outcome.required_sd[one.name] / audit.inputs.units.factor(unit_of(audit.inputs, one)))
            for one in audit.inputs.requirements
            if one.name in outcome.required_sd
        },
    }


# --- tables ------------------------------------------------------------------------------------------------------


def tabulate(summary: dict[str, Any], audit: Audit) -> dict[str, pd.DataFrame]:
    """Return the tables of an audit by name."""
    tables = {
        "directions": _tabulate_directions(summary),
        "selection": pd.DataFrame(summary["selection"]),
        "spectrum": _tabulate_spectrum(audit),
        "what_if": _tabulate_what_if(summary),
        "sweeps": _tabulate_sweeps(audit),
    }
    if summary["requirements"]:
        tables["sweep_requirements"] = _tabulate_sweep_requirements(audit)
    return tables


def tabulate_variants(audits: Mapping[str, Audit]) -> dict[str, pd.DataFrame]:
    """Return all variants, their parameters and requirements."""
    parameters, requirements = [], []
    for name, audit in audits.items():
        parameters += [{"variant": name, "parameter": k, **v} for k, v in summarise_parameters(audit).items()]
        requirements += [{"variant": name, "requirement": k, **v} for k, v in summarise_requirements(audit).items()]
    tables = {
        "variants": pd.DataFrame([{"variant": name, **describe_variant(audit)} for name, audit in audits.items()]),
        "parameters": pd.DataFrame(parameters),
        "requirements": pd.DataFrame(requirements),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def describe_variant(audit: Audit) -> dict[str, Any]:
    """Return a variant in a row: what it takes in, what it determines, how likely it keeps what is required."""
    inputs, analysis = audit.inputs, audit.analysis
    shares = [one.predicted_sd / one.requirement.limit for one in audit.outlooks]
    return {
        **inputs.describe_variant(),
        "n_parameters": len(inputs.names),
        "n_poses": inputs.n_poses,
        "n_identifiable": analysis.verdicts.count("identifiable"),
        "left": _plain(audit.measure_left()),
        "share_of_limit": _plain(max(shares)) if shares else None,
        "probability": _plain(audit.together),
    }


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
    symbols = audit.inputs.symbols
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
    units, required = audit.inputs.units, {one.name: one for one in audit.inputs.requirements}
    for point in audit.sweeps:
        for name, sd in point.outcome.required_sd.items():
            unit = unit_of(audit.inputs, required[name])
            rows.append(
                {
                    "sweep": point.sweep,
                    "value": point.value,
                    "requirement": name,
                    "unit": units.name(unit),
                    "predicted_sd": sd / units.factor(unit),
                    "limit": required[name].limit / units.factor(unit),
                }
            )
    return pd.DataFrame(rows)
