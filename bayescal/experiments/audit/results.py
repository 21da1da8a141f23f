"""An audit as plain values: ``summary.json`` and the tables beside it, in the design's units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.experiments.audit.audit import Audit, ChangeEffect, judge
from bayescal.experiments.audit.planned import Planned
from bayescal.experiments.shared.function_errors import has_lengths
from bayescal.experiments.shared.hidden import tabulate_hidden
from bayescal.experiments.shared.readings.knowledge import name_data, name_place
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.hidden import add, choose_unseen, hide
from bayescal.identifiability.information import nats_from_contraction
from bayescal.identifiability.levers import find_levers
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.ridges import Ridge
from bayescal.limits import COVERAGE, INFORMED
from bayescal.numerics.units import MICROMETRE
from bayescal.report.numbers import join_words

NAMED_SHARE = 0.02  # of a direction, for a parameter to be named in a sentence
NAMED = 4
TIMES = (0.0, 1.0, 3.0)  # the expected size of systematic errors


def summarise(audit: Audit) -> dict[str, Any]:
    """Return what ``summary.json`` says of one variant; lengths and angles in the config's units, which it states."""
    inputs, analysis = audit.inputs, audit.analysis
    config, structure, names = inputs.config, analysis.structure, inputs.names
    kinds, ridges = [one.kind for one in analysis.directions], {id(one.direction): one for one in audit.ridges}
    return {
        "name": config.name,
        "title": config.title,
        **_summarise_plan(inputs),
        "seed": config.seed,
        "units": {"length": inputs.units.length, "angle": inputs.units.angle},
        "required_of": config.required_of,
        **_describe_levers(audit),
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
        "directions": [_summarise_direction(audit, one, ridges.get(id(one))) for one in analysis.directions],
        "recommended_free": list(names),
        "reduced_set": _summarise_reduced(audit),
        "could_also_be_freed": [names[k] for k in analysis.selection.extra],
        "selection": [vars(step) for step in analysis.selection.steps],
        "requirements": summarise_requirements(audit),
        "what_if": [_summarise_outcome(audit, outcome) for outcome in audit.what_ifs],
    }


def _summarise_plan(inputs: Planned) -> dict[str, Any]:
    """Return machine and plan; how large systematic errors are, and what is stated of unseen ones, in µm."""
    config, section, model = inputs.config, inputs.section, inputs.variant.model
    said = {"workspace": "random ones of the workspace", "file": config.poses.file or config.poses.configurations or ""}
    errors = {"systematic_um": inputs.sizes, "at_least_um": inputs.floors if inputs.sizes else {}}
    plan = {
        "n_poses": inputs.n_poses,
        "sensors": list(dict.fromkeys(one.kind for one in model.channels)),
        "poses": said.get(config.poses.plan, f"{config.poses.plan} actuator positions"),
        **{key: {name: size / MICROMETRE for name, size in one.items()} for key, one in errors.items() if one},
    }
    if not has_lengths(model):
        plan["model_error_in"] = "noise"
    if config.data is not None:
        plan["poses"] = "measured"
    if config.workspace:
        plan["workspace"] = config.workspace if isinstance(config.workspace, dict) else config.workspace.model_dump()
    seen = {}
    if section.model is not None:
        seen = {"model": label_class(section.model), "deformation": label_class(section.deformation)}
    machine = str(getattr(inputs.maker.model, "name", config.machine or ""))
    return {"machine": machine, "member": model.member, **seen, "plan": plan}


def _describe_levers(audit: Audit) -> dict[str, Any]:
    """Return which channels read far from where a ridge's tolerance turns them, and the longest lever."""
    inputs = audit.inputs
    levers = list(find_levers(inputs.posterior, inputs.expected, [one.direction for one in audit.ridges]))
    if not levers:
        return {}
    far = max(levers, key=lambda one: abs(one.reading))
    named = list(dict.fromkeys(one.channel for one in levers))
    return {"far_readings": {"channels": named, "reading_mm": far.reading, "moved_mm": far.moved}}


# --- parameters --------------------------------------------------------------------------------------------------


def summarise_parameters(audit: Audit) -> dict[str, Any]:
    """Return what is known of each parameter before and after the calibration."""
    inputs, analysis = audit.inputs, audit.analysis
    covariance, nominal = analysis.information.covariance, inputs.parameters.nominal
    reduced = analysis.reduced
    places = {} if reduced is None else {int(k): place for place, k in enumerate(reduced.free)}
    nats = nats_from_contraction(analysis.information.contraction)
    result = {}
    for k, name in enumerate(inputs.names):
        factor = inputs.units.factor(inputs.parameters.units[k])
        prior, contraction = inputs.sd[k] / factor, float(analysis.information.contraction[k])
        result[name] = {
            "unit": inputs.units.name(inputs.parameters.units[k]),
            "nominal": float(nominal[k] / factor),
            "prior_sd": float(prior),
            "posterior_sd": float(prior * np.sqrt(covariance[k, k])),
            "contraction": contraction,
            "nats": float(nats[k]),
            "verdict": analysis.verdicts[k],
            "in_reduced_set": k in analysis.selection.free,
            **dict.fromkeys(("reduced_claimed_sd", "reduced_true_error", "reduced_coverage_90")),
            "why": explain(audit, k),
        }
        if reduced is not None and (place := places.get(k)) is not None:
            result[name] |= {
                "reduced_claimed_sd": float(reduced.claimed[place]) * float(prior),
                "reduced_true_error": float(reduced.error[place]) * float(prior),
                "reduced_coverage_90": float(reduced.coverage[place]),
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
    return f"{seen} {verb} it from {join_words(chosen)}. {shrunk}."


# --- directions --------------------------------------------------------------------------------------------------


def _summarise_direction(audit: Audit, direction: Direction, ridge: Ridge | None) -> dict[str, Any]:
    inputs, units = audit.inputs, audit.inputs.units
    used = [int(i) for i in np.argsort(-np.abs(direction.vector)) if direction.vector[i]]
    factors = {i: units.factor(inputs.parameters.units[i]) for i in used}
    names = {i: inputs.names[i] for i in used}
    result: dict[str, Any] = {
        "kind": direction.kind,
        "contraction": direction.contraction,
        "nats": direction.nats,
        "loadings": {names[i]: float(direction.vector[i] * inputs.sd[i] / factors[i]) for i in used},
        "shares": {names[i]: float(direction.vector[i] ** 2) for i in used},
    }
    if ridge is None or direction.pivot is None:
        left = float(np.sqrt(max(0.0, 1.0 - direction.contraction)))
        mostly = [name for i, name in names.items() if direction.vector[i] ** 2 >= NAMED_SHARE][:NAMED]
        return {**result, "sentence": f"Known to {_percent(left)} of its tolerance: mostly {join_words(mostly)}."}
    harm, share, limit = audit.harm(direction)
    length, angle = units.factor("mm"), units.factor("rad")
    return {
        **result,
        "sentence": ridge.sentence,
        "pivot": inputs.names[direction.pivot],
        "step": {name: value / factors[inputs.names.index(name)] for name, value in ridge.loadings.items()},
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
    along = [float(outcome.contraction_along(direction.vector[:, None])[0]) for outcome in within]
    if not along or max(along) <= direction.contraction:
        return None
    best = int(np.argmax(along))
    return {"name": within[best].name, "contraction": along[best]}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.2g} %"


# --- requirements and what would help ----------------------------------------------------------------------------


def unit_of(inputs: Planned, requirement: Requirement) -> str:
    """Return the inner unit of what is required."""
    return inputs.variant.model.tool_channels[requirement.where][0].unit


def summarise_requirements(audit: Audit) -> dict[str, Any]:
    """Return how each requirement stands."""
    inputs, units, result = audit.inputs, audit.inputs.units, {}
    for outlook in audit.outlooks:
        unit = unit_of(inputs, outlook.requirement)
        factor = units.factor(unit)
        lengths = ("prior_sd", "predicted_sd", "geometry_sd", "reduced_sd", "rms_sd", "worst_sd")
        chances = ("prior_probability", "probability", "reduced_probability", "everywhere")
        result[outlook.requirement.name] = {
            "unit": units.name(unit),
            "limit": outlook.requirement.limit / factor,
            **{name: _plain(getattr(outlook, name) / factor) for name in lengths},
            **{name: getattr(outlook, name) for name in chances},
            "worst_at": name_place(inputs.variant, inputs.around.pose[outlook.worst], inputs.config.units),
        }
    return result


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _summarise_outcome(audit: Audit, outcome: ChangeEffect) -> dict[str, Any]:
    weak, names = [one.direction for one in audit.ridges if one.direction.kind == "practical"], audit.inputs.names
    along = outcome.contraction_along(np.reshape([one.vector for one in weak], (-1, len(names))).T.copy())
    information = outcome.information
    return {
        "name": outcome.name,
        "n_poses": outcome.n_poses,
        "possible": information is not None,
        "beyond_actuator_range": outcome.beyond_range,
        "total_nats": None if information is None else information.nats,
        "n_identifiable": None if information is None else int(np.sum(information.contraction >= INFORMED)),
        "ridges": {
            names[one.pivot]: _plain(value) for one, value in zip(weak, along, strict=True) if one.pivot is not None
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
        "what_if": pd.DataFrame(
            [(one["name"], *ridge) for one in summary["what_if"] for ridge in one["ridges"].items()],
            columns=["what_if", "ridge", "contraction"],
        ),
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
    inputs, analysis, model = audit.inputs, audit.analysis, audit.inputs.variant.model
    shares = [one.predicted_sd / one.requirement.limit for one in audit.outlooks]
    return {
        "title": inputs.section.label,
        "data": name_data(inputs.variant),
        "n_equations": inputs.n_poses * (len(model.channels) - len(model.coordinates)),
        "n_parameters": len(inputs.names),
        "n_poses": inputs.n_poses,
        "n_identifiable": analysis.verdicts.count("identifiable"),
        "left": _plain(audit.measure_left()),
        "share_of_limit": _plain(max(shares)) if shares else None,
        "probability": _plain(audit.together),
    }


def _tabulate_directions(summary: dict[str, Any]) -> pd.DataFrame:
    return pd.DataFrame(
        [
            {
                "direction": number,
                **{key: one[key] for key in ("kind", "contraction", "nats")},
                "parameter": name,
                "unit": summary["parameters"][name]["unit"],
                "loading": loading,
                "share": one["shares"][name],
            }
            for number, one in enumerate(summary["directions"], start=1)
            for name, loading in one["loadings"].items()
        ]
    )


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


def _tabulate_sweeps(audit: Audit) -> pd.DataFrame:
    rows = []
    for sweep, value, outcome in audit.sweeps:
        if outcome.information is None:
            continue
        found = pd.Series(outcome.information.contraction).groupby(np.array(audit.inputs.symbols), sort=False)
        for symbol, (least, most) in found.agg(["min", "max"]).iterrows():
            point = {"sweep": sweep, "value": value, "beyond_actuator_range": outcome.beyond_range, "symbol": symbol}
            rows.append({**point, "contraction_least": least, "contraction_most": most})
    return pd.DataFrame(rows)


def _tabulate_sweep_requirements(audit: Audit) -> pd.DataFrame:
    rows = []
    units, required = audit.inputs.units, {one.name: one for one in audit.inputs.requirements}
    for sweep, value, outcome in audit.sweeps:
        for name, sd in outcome.required_sd.items():
            unit = unit_of(audit.inputs, required[name])
            said = {"requirement": name, "unit": units.name(unit), "predicted_sd": sd / units.factor(unit)}
            limit = required[name].limit / units.factor(unit)
            rows.append({"sweep": sweep, "value": value, **said, "limit": limit})
    return pd.DataFrame(rows)


# --- systematic errors -----------------------------------------------------------------------------------------------


def tabulate_errors(audit: Audit) -> dict[str, pd.DataFrame]:
    """Return tables of systematic errors by name, none where an audit has none.

    ``error_sizes`` has standard deviations of parameters, rms by symbol, and how requirements stand, in the config's
    units, with errors so many ``times`` as large as they are expected; ``model_error_hidden`` what those that leave no
    trace hide of each parameter.
    """
    inputs = audit.inputs
    if not inputs.sizes:
        return {}
    rows, units, measured = list[dict[str, object]](), inputs.units, inputs.config.data is not None
    true = inputs.sizes if measured else inputs.config.model_error.sizes(list(inputs.sizes))
    for times in TIMES:
        sizes = {name: times * size for name, size in true.items()}
        changed = inputs if times == 1.0 else inputs.resize(sizes) if measured else inputs.settle(sizes)
        one = audit if times == 1.0 else judge(changed)
        total = float(np.linalg.norm(list(sizes.values()))) / MICROMETRE
        at = {"times": times, "size_um": total}
        variance = inputs.sd**2 * np.diagonal(one.analysis.information.covariance)
        for symbol in dict.fromkeys(inputs.symbols):
            part = np.array([name == symbol for name in inputs.symbols])
            unit = inputs.parameters.units[int(part.argmax())]
            sd = float(np.sqrt(variance[part].mean())) / units.factor(unit)
            rows.append({**at, "what": "parameter", "name": symbol, "unit": units.name(unit), "sd": sd})
        for outlook in one.outlooks:
            unit = unit_of(inputs, outlook.requirement)
            own = {"name": outlook.requirement.name, "unit": units.name(unit)}
            sd = outlook.predicted_sd / units.factor(unit)
            rows.append({**at, "what": "requirement", **own, "sd": sd, "probability": outlook.probability})
    return {"error_sizes": pd.DataFrame(rows), "model_error_hidden": _tabulate_hidden(audit)}


def _tabulate_hidden(audit: Audit) -> pd.DataFrame:
    """Return what errors hide that are as large as stated, or as is usual, and leave no trace."""
    inputs = audit.inputs
    unseen = choose_unseen(inputs.floors, list(inputs.sizes))
    with_floors = inputs.sizes if inputs.floors else add(inputs.sizes, unseen)  # what is stated is among the sizes
    pair = with_floors, add(with_floors, unseen, -1.0)
    covariances = [inputs.resize(sizes).inform().covariance for sizes in pair]
    hidden, sd = hide(*covariances), np.sqrt(np.diagonal(audit.analysis.information.covariance))
    factors = inputs.sd / np.array([inputs.units.factor(unit) for unit in inputs.parameters.units])
    units = [inputs.units.name(unit) for unit in inputs.parameters.units]
    return tabulate_hidden(audit.inputs.config.variants[0].name, inputs.names, units, factors * hidden, factors * sd)
