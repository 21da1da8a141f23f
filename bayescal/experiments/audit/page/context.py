"""Everything the report of an audit shows, computed from its results; the template only sets it on the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bayescal.experiments.audit.page import tables
from bayescal.experiments.audit.page.figures.profiles import span_profile
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.ridges import RidgeBlock, build_ridges
from bayescal.experiments.audit.page.verdict import list_failures, state_headline, state_verdict
from bayescal.experiments.audit.page.wording import count, format_fixed_span, format_sd, name_unit
from bayescal.experiments.study.page.variants import describe_deformation, label_model
from bayescal.report.blocks import Column, FigureBlock, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed, join_words
from bayescal.report.symbols import split_name

FOLLOWERS = 3  # named along a profile


@dataclass(frozen=True)
class AuditContext:
    """What the template needs, all of it text."""

    title: str
    name: str
    machine: str
    plan: str
    data_origin: str
    headline: str
    failures: tuple[Statement, ...]
    verdict: tuple[Statement, ...]
    symbols: Table
    parameters: Table
    ridges: tuple[RidgeBlock, ...]
    ridge_formulas: tuple[tuple[str, str], ...]
    selection: Table | None
    requirements: Table | None
    changes: Table | None
    ridge_help: Table | None
    profiles: Table | None
    simulated: list[Table]
    posterior: Table | None
    posterior_origin: str
    method: tuple[tuple[str, str], ...]
    provenance: Table
    figures: dict[str, FigureBlock]


def build_context(results: AuditResults, figures: Mapping[str, FigureBlock]) -> AuditContext:
    """Compute what the report shows.

    Parameters
    ----------
    results : AuditResults
    figures : mapping of str to FigureBlock
        The figures drawn, and those left out with the reason.
    """
    summary = results.summary
    posterior = summary.get("posterior")
    return AuditContext(
        title=summary["title"],
        name=summary["name"],
        machine=_describe_machine(results),
        plan=_describe_plan(results),
        data_origin=posterior["origin"] if posterior is not None and results.is_measured else "",
        headline=state_headline(results),
        failures=tuple(list_failures(results)),
        verdict=tuple(state_verdict(results)),
        symbols=tables.tabulate_symbols(results),
        parameters=tables.tabulate_parameters(results),
        ridges=build_ridges(results),
        ridge_formulas=_list_formulas(results),
        selection=tables.tabulate_selection(results),
        requirements=tables.tabulate_requirements(results),
        changes=tables.tabulate_changes(results),
        ridge_help=tables.tabulate_ridge_help(results),
        profiles=_tabulate_profiles(results),
        simulated=tables.tabulate_simulated(results),
        posterior=tables.tabulate_posterior(results),
        posterior_origin="" if posterior is None else posterior["origin"],
        method=_describe_method(results),
        provenance=_tabulate_provenance(results),
        figures=dict(figures),
    )


def _describe_machine(results: AuditResults) -> str:
    summary = results.summary
    return f"{summary['machine']}, {label_model(summary['model'])} {describe_deformation(summary['deformation'])}"


def _describe_plan(results: AuditResults) -> str:
    plan = results.summary["plan"]
    reach = f"displacements up to {plan['largest_displacement_mm']:.3g} mm of {plan['actuator_range_mm']:.3g} mm"
    sensors = join_words([str(name).replace("_", " ") for name in plan["sensors"]])
    seen = f", seen by {sensors}" if sensors else ""
    noise = f"actuators {plan['actuator_noise_um']:.3g} µm"
    model_error = plan["model_error_um"]
    noise += f", model error {model_error:.3g} µm" if model_error else ""
    kind = "calibration" if results.is_measured else "planned"
    return f"{results.n_poses} {kind} poses{seen}; {reach}; noise: {noise}"


def _list_formulas(results: AuditResults) -> tuple[tuple[str, str], ...]:
    """Return what explains the curve of the first ridge of each kind."""
    first = (next((ridge for ridge in group.ridges if ridge.plot), None) for group in results.groups)
    found = [(ridge.plot, ridge.explanation or ridge.plot["formula"]) for ridge in first if ridge is not None]
    return tuple((f"{plot['y']} against {plot['x']}", text) for plot, text in found if text)


def _tabulate_profiles(results: AuditResults) -> Table | None:
    """Return the 95 % intervals of the profiles and what moves along them; None without any."""
    profiles = results.tables.get("profiles")
    if profiles is None:
        return None
    columns = [
        Column("Symbol", kind="symbol"),
        Column("Leg"),
        Column("Unit", kind="text"),
        Column("measurements alone", "", "95 % interval, from expected"),
        Column("with the tolerances", "", "95 % interval, from expected"),
        Column("Moves along", kind="text"),
    ]
    rows = []
    for name, one in profiles.groupby("parameter", sort=False):
        symbol, leg = split_name(str(name))
        centre = float(one.sort_values("deviance_total")["value"].iloc[0])
        spans = [span_profile(one, key) for key in ("deviance_data", "deviance_total")]
        unit = name_unit(str(one["unit"].iloc[0]))
        intervals = [format_fixed_span(low - centre, high - centre) for low, high in spans]
        rows.append([symbol, str(leg) if leg else NOTHING, unit, *intervals, _name_followers(results, str(name))])
    notes = [Statement("“open”: the deviance stays below 3.84 as far as it was computed.")]
    return make_table("Profile likelihoods.", columns, rows, notes)


def _name_followers(results: AuditResults, name: str) -> str:
    """Return the parameters that move most along a profile, in units of their tolerances."""
    paths = results.tables.get("profile_paths")
    if paths is None:
        return NOTHING
    rows = paths[(paths["parameter"] == name) & paths["other"].isin(list(results.parameters.index))]
    if rows.empty:
        return NOTHING
    reach = rows.groupby("other")["other_value"].agg(lambda v: float(v.max() - v.min()))
    share = (reach / results.parameters["prior_sd"].reindex(reach.index)).sort_values(ascending=False)
    named = share[share > 0.1].head(FOLLOWERS)
    words = [
        f"{other} by {format_sd(float(reach[other]))} {_unit_of(results, str(other))}".strip() for other in named.index
    ]
    return join_words(words) if words else "nothing by a tenth of its tolerance"


def _unit_of(results: AuditResults, name: str) -> str:
    return name_unit(str(results.parameters.loc[name, "unit"]))


def _describe_method(results: AuditResults) -> tuple[tuple[str, str], ...]:
    kind = "calibration" if results.is_measured else "planned"
    return (
        (
            "Can it be told at all?",
            "The rank of the noise-free identification Jacobian J over a workspace far wider than the machine's, its "
            "columns in units of the tolerances, is counted at the gap of its singular values beside the level to "
            "which rounding moves them (computed again at machines that differ in the last digits).",
        ),
        (
            "Is it told by these measurements?",
            f"With the noise of sensors and actuators the {kind} poses carry the information Λ = Jᵀ Σ⁻¹ J; in units of "
            "the tolerances the posterior covariance is (1 + Λ)⁻¹ to first order, the contraction of a direction v is "
            "1 − vᵀ (1 + Λ)⁻¹ v, and −½ log(1 − contraction) nats are learnt of it.",
        ),
        (
            "Does it matter, and does it hold beyond first order?",
            "Ridges are followed with the machine itself, not with its derivatives; requirements are judged by draws "
            "of the remaining uncertainty over the workspace; and where they were asked for, profile likelihoods, "
            "draws of the posterior and simulated calibrations check the linear picture.",
        ),
    )


def _tabulate_provenance(results: AuditResults) -> Table:
    summary, units = results.summary, results.summary["units"]
    gap = summary.get("structural_gap")
    rank = f"{summary['structural_rank']} of {summary['n_parameters']}"
    clear = "clear" if summary["structural_rank_is_clear"] else "NOT clear"
    rows = [
        ["Audit", summary["name"]],
        ["Units of tolerances, results and requirements", f"{name_unit(units['length'])}, {name_unit(units['angle'])}"],
        ["Structural rank", f"{rank}, {clear}{f', gap {format_sd(gap)}' if gap is not None else ''}"],
        ["Learnt in all", f"{format_fixed(summary['total_nats'], 1)} nat"],
        ["Directions", _describe_directions(results)],
        ["Workspace", _describe_workspace(results)],
        ["Seed", str(summary["seed"])],
        ["SHA-256 of the design", summary["config_sha256"]],
    ]
    return make_table("The audit.", [Column("", kind="text"), Column("", kind="text")], rows)


def _describe_directions(results: AuditResults) -> str:
    counts = [(results.summary[f"n_{kind}"], kind) for kind in ("structural", "practical", "informed")]
    return ", ".join(f"{number} {kind}" for number, kind in counts)


def _describe_workspace(results: AuditResults) -> str:
    workspace = results.summary["plan"].get("workspace")
    if not isinstance(workspace, dict):
        return "none stated"
    position, rotation = (
        " × ".join(f"±{float(value):g}" for value in workspace.get(key, [])) for key in ("position_mm", "rotation_deg")
    )
    return (
        f"{position} mm, {rotation} deg, {workspace.get('shape', '')}, {count(int(workspace.get('poses', 0)), 'pose')}"
    )
