"""An audit as plain values: ``summary.json`` and the tables beside it, in the design's units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import partial

import numpy as np
import pandas as pd

from bayescal.config.classes import label_class
from bayescal.experiments.audit.audit import AuditOutcome, ChangeEffect, judge
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.rows import (
    AXES,
    PREDICTED_SD,
    AlternativeRow,
    AuditCombinationRow,
    AuditParameterRow,
    AuditRequirementRow,
    AuditScenarioRow,
    AuditVariantRow,
    DirectionRow,
    FreeingStepRow,
    PlanSweepRow,
    SpectrumRow,
    SweptRequirementRow,
    SystematicSizeRow,
)
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.function_errors import choose_size_unit
from bayescal.experiments.shared.readings.knowledge import name_data, name_place, plain
from bayescal.experiments.shared.unmodelled_bias import tabulate_hidden
from bayescal.files.rows import TableRow
from bayescal.identifiability.directions import Direction
from bayescal.identifiability.hidden import add, choose_unseen, hide
from bayescal.identifiability.information import nats_from_contraction
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.ridges import Ridge
from bayescal.identifiability.scale_ambiguity import find_levers
from bayescal.limits import COVERAGE, IDENTIFIABLE_CONTRACTION
from bayescal.report.numbers import join_words

NAMED_SHARE = 0.02  # of a direction, for a parameter to be named in a sentence
NAMED = 4
TIMES = (0.0, 1.0, 3.0)  # the expected size of systematic errors


def summarise(audit: AuditOutcome) -> Summary:
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
        "requirement_applies_to": config.requirement_applies_to,
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
        "parameters": {row.parameter: summarise_row(row, "variant", "parameter") for row in list_parameters(audit)},
        "directions": [_summarise_direction(audit, one, ridges.get(id(one))) for one in analysis.directions],
        "free": list(names),
        "reduced_set": _summarise_reduced(audit),
        "also_identifiable": [names[k] for k in analysis.selection.extra],
        "selection": [asdict(row) for row in list_steps(audit)],
        "requirements": {
            row.requirement: summarise_row(row, "variant", "requirement") for row in list_requirements(audit)
        },
        "scenarios": [_summarise_outcome(audit, outcome) for outcome in audit.scenarios],
    }


def _summarise_plan(inputs: DesignVariant) -> Summary:
    """Return machine and plan; how large systematic errors are, and what is stated of unseen ones, and their unit."""
    config, section, model = inputs.config, inputs.section, inputs.variant.model
    said = {"workspace": "random poses", "file": config.poses.file or config.poses.configurations or ""}
    errors = {"systematic": inputs.sizes, "floor": inputs.floors if inputs.sizes else {}}
    factor, unit = choose_size_unit(model)
    plan = {
        "n_poses": inputs.n_poses,
        "sensors": list(dict.fromkeys(one.kind for one in model.channels)),
        "poses": said.get(config.poses.sampling, f"{config.poses.sampling} actuator positions"),
        **{key: {name: factor * size for name, size in one.items()} for key, one in errors.items() if one},
        "model_error_unit": unit,
    }
    if config.data is not None:
        plan["poses"] = "measured"
    if config.workspace:
        plan["workspace"] = config.workspace if isinstance(config.workspace, dict) else config.workspace.model_dump()
    seen = {}
    if section.model is not None:
        seen = {"model": label_class(section.model), "deformation": label_class(section.deformation)}
    machine = str(getattr(inputs.maker.model, "name", config.machine or ""))
    return {"machine": machine, "member": model.member, **seen, "plan": plan}


def _describe_levers(audit: AuditOutcome) -> Summary:
    """Return which channels read far from where a ridge's tolerance turns them, and the longest lever."""
    inputs = audit.inputs
    levers = list(find_levers(inputs.posterior, inputs.expected, [one.direction for one in audit.ridges]))
    if not levers:
        return {}
    far = max(levers, key=lambda one: abs(one.reading))
    named = list(dict.fromkeys(one.channel for one in levers))
    return {"far_readings": {"channels": named, "reading_mm": far.reading, "moved_mm": far.moved}}


# --- parameters --------------------------------------------------------------------------------------------------


def list_parameters(audit: AuditOutcome) -> list[AuditParameterRow]:
    """Return the parameters of a variant, prior and predicted posterior."""
    inputs, information, reduced = audit.inputs, audit.analysis.information, audit.analysis.reduced
    nominal, nats = inputs.parameters.nominal, nats_from_contraction(information.contraction)
    fitted = np.full((3, len(inputs.names)), np.nan)  # claimed sd, error, coverage of the reduced set
    if reduced is not None:
        fitted[:, reduced.free] = reduced.claimed, reduced.error, reduced.coverage
    rows = []
    for k, name in enumerate(inputs.names):
        factor = inputs.units.factor(inputs.parameters.units[k])
        prior, (claimed, error, coverage) = inputs.sd[k] / factor, fitted[:, k]
        rows.append(
            AuditParameterRow(
                variant=inputs.section.name,
                parameter=name,
                unit=inputs.units.name(inputs.parameters.units[k]),
                nominal=float(nominal[k] / factor),
                prior_sd=float(prior),
                posterior_sd=float(prior * np.sqrt(information.covariance[k, k])),
                contraction=float(information.contraction[k]),
                nats=float(nats[k]),
                verdict=audit.analysis.verdicts[k],
                reduced_set=k in audit.analysis.selection.free,
                reduced_claimed_sd=float(claimed * prior),
                reduced_true_error=float(error * prior),
                reduced_coverage_90=float(coverage),
                reason=explain(audit, k),
            )
        )
    return rows


def list_steps(audit: AuditOutcome) -> list[FreeingStepRow]:
    """Return the steps of the search for the reduced set."""
    return [
        FreeingStepRow(symbol=one.symbol, nats=one.nats, contraction=one.contraction, is_included=one.taken)
        for one in audit.analysis.selection.steps
    ]


def summarise_row(row: TableRow, *names: str) -> Summary:
    """Return a row as ``summary.json`` has it, without the columns whose values are its keys there."""
    return {name: value for name, value in plain(asdict(row)).items() if name not in names}


def _summarise_reduced(audit: AuditOutcome) -> Summary | None:
    """Return the reduced set as a whole; None where it is empty."""
    names, free, reduced = audit.inputs.names, audit.analysis.selection.free, audit.analysis.reduced
    if not free:
        return None
    return {
        "free": [names[k] for k in free],
        "coverage_90": COVERAGE if reduced is None else float(reduced.coverage.mean()),
        "rms_z": 1.0 if reduced is None else reduced.rms_z,
    }


def explain(audit: AuditOutcome, k: int) -> str:
    """Return in words why a parameter has its verdict."""
    analysis, names = audit.analysis, audit.inputs.names
    left = float(np.sqrt(analysis.information.covariance[k, k]))
    shrunk = f"Its tolerance shrinks to {_percent(left)}"
    if analysis.verdicts[k] == "identifiable":
        return f"{shrunk}."
    ridges = [ridge.direction for ridge in audit.ridges]
    weights = [float(d.vector[k] ** 2 * (1.0 - d.contraction)) for d in ridges]
    if not ridges or max(weights) == 0.0:
        return f"{shrunk}: too few or too coarse measurements."
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


def _summarise_direction(audit: AuditOutcome, direction: Direction, ridge: Ridge | None) -> Summary:
    inputs, units = audit.inputs, audit.inputs.units
    used = [int(i) for i in np.argsort(-np.abs(direction.vector)) if direction.vector[i]]
    factors = {i: units.factor(inputs.parameters.units[i]) for i in used}
    names = {i: inputs.names[i] for i in used}
    result: Summary = {
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
        "sd_over_limit": share if np.isfinite(share) else None,
        "limit": limit,
        "best_scenario": _find_help(audit, direction),
    }


def _find_help(audit: AuditOutcome, direction: Direction) -> Summary | None:
    """Return the what-if within the actuators' reach under which a direction contracts most, if one helps."""
    if direction.kind != "practical":
        return None
    within = [outcome for outcome in audit.scenarios if outcome.information is not None and not outcome.beyond_range]
    along = [float(outcome.contraction_along(direction.vector[:, None])[0]) for outcome in within]
    if not along or max(along) <= direction.contraction:
        return None
    best = int(np.argmax(along))
    return {"name": within[best].name, "contraction": along[best]}


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.2g} %"


# --- requirements and what would help ----------------------------------------------------------------------------


def unit_of(inputs: DesignVariant, requirement: Requirement) -> str:
    """Return the inner unit of what is required."""
    return inputs.variant.model.tool_channels[requirement.where][0].unit


def list_requirements(audit: AuditOutcome) -> list[AuditRequirementRow]:
    """Return how each requirement stands in a variant."""
    inputs, units, rows = audit.inputs, audit.inputs.units, []
    for outlook in audit.outlooks:
        unit = unit_of(inputs, outlook.requirement)
        factor = units.factor(unit)
        rows.append(
            AuditRequirementRow(
                variant=inputs.section.name,
                requirement=outlook.requirement.name,
                unit=units.name(unit),
                limit=outlook.requirement.limit / factor,
                prior_sd=outlook.prior_sd / factor,
                predicted_sd=outlook.predicted_sd / factor,
                parameter_sd=outlook.geometry_sd / factor,
                reduced_sd=outlook.reduced_sd / factor,
                rms_sd=outlook.rms_sd / factor,
                max_sd=outlook.worst_sd / factor,
                prior_probability=outlook.prior_probability,
                probability=outlook.probability,
                reduced_probability=outlook.reduced_probability,
                p_all_poses=outlook.everywhere,
                max_sd_pose=name_place(inputs.variant, inputs.around.pose[outlook.worst], inputs.config.units),
            )
        )
    return rows


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _summarise_outcome(audit: AuditOutcome, outcome: ChangeEffect) -> Summary:
    weak, names = [one.direction for one in audit.ridges if one.direction.kind == "practical"], audit.inputs.names
    along = outcome.contraction_along(np.reshape([one.vector for one in weak], (-1, len(names))).T.copy())
    information = outcome.information
    return {
        "name": outcome.name,
        "n_poses": outcome.n_poses,
        "is_feasible": information is not None,
        "is_beyond_range": outcome.beyond_range,
        "total_nats": None if information is None else information.nats,
        "n_identifiable": None
        if information is None
        else int(np.sum(information.contraction >= IDENTIFIABLE_CONTRACTION)),
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


def tabulate(summary: Summary, audit: AuditOutcome) -> dict[str, pd.DataFrame]:
    """Return the tables of an audit by name."""
    scenarios = [
        AuditScenarioRow(scenario=one["name"], ridge=name, contraction=np.nan if value is None else value)
        for one in summary["scenarios"]
        for name, value in one["ridges"].items()
    ]
    directions = [
        DirectionRow(
            direction=number,
            kind=one["kind"],
            contraction=one["contraction"],
            nats=one["nats"],
            parameter=name,
            unit=summary["parameters"][name]["unit"],
            loading=loading,
            share=one["shares"][name],
        )
        for number, one in enumerate(summary["directions"], start=1)
        for name, loading in one["loadings"].items()
    ]
    tables = {
        "directions": DirectionRow.collect(directions),
        "selection": FreeingStepRow.collect(list_steps(audit)),
        "spectrum": _tabulate_spectrum(audit),
        "scenarios": AuditScenarioRow.collect(scenarios),
        "sweeps": PlanSweepRow.collect(_list_sweeps(audit)),
    }
    if summary["requirements"]:
        tables["sweep_requirements"] = SweptRequirementRow.collect(_list_swept_requirements(audit))
    return tables


def tabulate_help(summary: Summary) -> dict[str, pd.DataFrame]:
    """Return combinations that are not determined, and changed plans, from what a summary says of them."""
    combinations = [
        AuditCombinationRow(
            number=number,
            kind=one["kind"],
            contraction=float(one["contraction"]),
            pivot=one["pivot"],
            sentence=one["sentence"],
            effect=one["effect_on_pose"],
            sd_over_limit=_fill(one.get("sd_over_limit")),
            limit=one.get("limit") or "",
            position=float(one["changes_workspace_position"]),
            rotation=float(one["changes_workspace_rotation"]),
            posterior_contraction=_fill(one.get("posterior_contraction")),
            **{f"plot_{axis}": str((one.get("plot") or {}).get(axis, "")) for axis in AXES},
        )
        for number, one in enumerate(summary["directions"], start=1)
        if one["kind"] != "informed"
    ]
    alternatives = [
        AlternativeRow(
            alternative=one["name"],
            n_poses=one["n_poses"],
            is_feasible=one["is_feasible"],
            is_beyond_range=one["is_beyond_range"],
            nats=_fill(one.get("total_nats")),
            n_identifiable=int(one.get("n_identifiable") or 0),
            others={f"{PREDICTED_SD}{name}": _fill(value) for name, value in one["requirements"].items()},
        )
        for one in summary["scenarios"]
    ]
    return {
        AuditCombinationRow.table: AuditCombinationRow.collect(combinations),
        AlternativeRow.table: AlternativeRow.collect(alternatives),
    }


def _fill(value: float | None) -> float:
    return np.nan if value is None else float(value)


def tabulate_variants(audits: Mapping[str, AuditOutcome]) -> dict[str, pd.DataFrame]:
    """Return all variants, their parameters and requirements."""
    tables = {
        "variants": AuditVariantRow.collect(map(describe_variant, audits.values())),
        "parameters": AuditParameterRow.collect(row for one in audits.values() for row in list_parameters(one)),
        "requirements": AuditRequirementRow.collect(row for one in audits.values() for row in list_requirements(one)),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def describe_variant(audit: AuditOutcome) -> AuditVariantRow:
    """Return a variant in a row: what it takes in, what it determines, how likely it keeps what is required."""
    inputs, analysis, model = audit.inputs, audit.analysis, audit.inputs.variant.model
    return AuditVariantRow(
        variant=inputs.section.name,
        title=inputs.section.label,
        data_set=name_data(inputs.variant),
        n_equations=int(inputs.variant.data.present.sum()) - inputs.n_poses * len(model.coordinates),
        n_parameters=len(inputs.names),
        n_poses=inputs.n_poses,
        n_identifiable=analysis.verdicts.count("identifiable"),
        error_ratio=audit.measure_left(),
        sd_over_limit=max((one.predicted_sd / one.requirement.limit for one in audit.outlooks), default=np.nan),
        probability=audit.together,
    )


def _tabulate_spectrum(audit: AuditOutcome) -> pd.DataFrame:
    """Return the singular values over the wide workspace, and what rounding does to them."""
    structure = audit.analysis.structure
    values = structure.singular_values
    return SpectrumRow.tabulate(
        number=np.arange(1, len(values) + 1),
        wide_workspace=values,
        planned=np.sqrt(audit.analysis.information.spectrum()[0][::-1]),
        noise_floor=structure.rounding,
        is_in_rank=np.arange(len(values)) < structure.rank,
    )


def _list_sweeps(audit: AuditOutcome) -> Iterator[PlanSweepRow]:
    for sweep, value, outcome in audit.sweeps:
        if outcome.information is None:
            continue
        found = pd.Series(outcome.information.contraction).groupby(np.array(audit.inputs.symbols), sort=False)
        for symbol, (least, most) in found.agg(["min", "max"]).iterrows():
            yield PlanSweepRow(
                sweep=sweep,
                value=value,
                is_beyond_range=outcome.beyond_range,
                symbol=str(symbol),
                contraction_min=least,
                contraction_max=most,
            )


def _list_swept_requirements(audit: AuditOutcome) -> Iterator[SweptRequirementRow]:
    units, required = audit.inputs.units, {one.name: one for one in audit.inputs.requirements}
    for sweep, value, outcome in audit.sweeps:
        for name, sd in outcome.required_sd.items():
            unit = unit_of(audit.inputs, required[name])
            yield SweptRequirementRow(
                sweep=sweep,
                value=value,
                requirement=name,
                unit=units.name(unit),
                predicted_sd=sd / units.factor(unit),
                limit=required[name].limit / units.factor(unit),
            )


# --- systematic errors -----------------------------------------------------------------------------------------------


def tabulate_errors(audit: AuditOutcome) -> dict[str, pd.DataFrame]:
    """Return tables of systematic errors by name, none where an audit has none.

    ``error_sizes`` has standard deviations of parameters, rms by symbol, and how requirements stand, in the config's
    units, with multiples of the expected size of errors; ``model_error_bias`` what those that leave no trace hide of
    each parameter.
    """
    inputs = audit.inputs
    if not inputs.sizes:
        return {}
    sizes = SystematicSizeRow.collect(_list_sizes(audit))
    return {"error_sizes": sizes, "model_error_bias": _tabulate_hidden(audit)}


def _list_sizes(audit: AuditOutcome) -> Iterator[SystematicSizeRow]:
    """Yield what is expected of parameters and requirements with systematic errors of several sizes."""
    inputs, units, measured = audit.inputs, audit.inputs.units, audit.inputs.config.data is not None
    factor, size_unit = choose_size_unit(inputs.variant.model)
    true = inputs.sizes if measured else inputs.config.model_error.sizes(list(inputs.sizes))
    for times in TIMES:
        sizes = {name: times * size for name, size in true.items()}
        changed = inputs if times == 1.0 else inputs.resize(sizes) if measured else inputs.settle(sizes)
        one = audit if times == 1.0 else judge(changed)
        row = partial(
            SystematicSizeRow,
            size_factor=times,
            size=factor * float(np.linalg.norm(list(sizes.values()))),
            size_unit=size_unit,
        )
        variance = inputs.sd**2 * np.diagonal(one.analysis.information.covariance)
        for symbol in dict.fromkeys(inputs.symbols):
            part = np.array([name == symbol for name in inputs.symbols])
            unit = inputs.parameters.units[int(part.argmax())]
            sd = float(np.sqrt(variance[part].mean())) / units.factor(unit)
            yield row(quantity="parameter", name=symbol, unit=units.name(unit), sd=sd, probability=np.nan)
        for outlook in one.outlooks:
            unit = unit_of(inputs, outlook.requirement)
            yield row(
                quantity="requirement",
                name=outlook.requirement.name,
                unit=units.name(unit),
                sd=outlook.predicted_sd / units.factor(unit),
                probability=outlook.probability,
            )


def _tabulate_hidden(audit: AuditOutcome) -> pd.DataFrame:
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
