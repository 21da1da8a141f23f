"""The page of an audit, from its results alone."""

from __future__ import annotations

from dataclasses import replace

from bayescal.experiments.audit.page import freedom, illustrations
from bayescal.experiments.audit.page.method import describe_method, tabulate_audit
from bayescal.experiments.audit.page.poses import count_poses
from bayescal.experiments.audit.page.profile_table import tabulate_profiles
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.ridges import build_ridges
from bayescal.experiments.audit.page.sensor_sets import show_counts, show_sets
from bayescal.experiments.audit.page.tables import (
    tabulate_changes,
    tabulate_parameters,
    tabulate_posterior,
    tabulate_requirements,
    tabulate_ridge_help,
    tabulate_symbols,
)
from bayescal.experiments.audit.page.variants import show_selected, show_variants
from bayescal.experiments.audit.page.verdict import list_failures, state_headline, state_verdict
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.knowledge_page import name_titles, show_accuracy, show_next
from bayescal.report.blocks import Absent, Block, Definitions, Fold, Page, Section, Statement, Table
from bayescal.report.numbers import format_plain, join_words
from bayescal.report.symbols import describe_deformation

KIND = "Identifiability audit"
FAILURES = "Do not rely on these numbers yet. What speaks against them:"
RIDGES = (
    "Each sentence is computed with the machine itself: parameters can move together this far and the measured poses "
    "stay as said. What is never seen no plan reveals, only another kind of measurement; what is weak a better plan "
    "may."
)
FREEDOM = (
    "Everything, each parameter with its tolerance as prior. What the poses do not determine stays as unknown as it "
    "was and is part of every prediction; taken for nominal instead it would bend what is estimated, and no interval "
    "would say so. A reduced set serves to reproduce calibrations that freed no more."
)
NO_RIDGES = "There are none: every combination of the parameters is determined."


def build_page(results: Results) -> Page:
    """Return what the page of an audit says.

    Parameters
    ----------
    results : Results
        Without the tables of profiles, draws or sweeps these parts are left out.

    Raises
    ------
    InputError
        Where the results are not what an audit writes.
    """
    audit = AuditResults.of(results)
    return Page(
        kind=KIND,
        name=audit.summary["name"],
        title=audit.summary["title"],
        origin=_find_origin(audit) if audit.is_measured else "",
        headline=state_headline(audit),
        verdict=tuple(state_verdict(audit)),
        sections=_build_sections(audit),
        facts=_list_facts(audit),
        failures=tuple(list_failures(audit)),
        failures_title=FAILURES,
        symbols=tuple(audit.symbols),
    )


def _find_origin(audit: AuditResults) -> str:
    """Return where the data come from that the posterior's draws rest on; nothing without draws."""
    posterior = audit.summary.get("posterior")
    return posterior["origin"] if posterior is not None else ""


def _list_facts(audit: AuditResults) -> tuple[tuple[str, str], ...]:
    facts = [("Machine", _describe_machine(audit)), ("Plan", _describe_plan(audit))]
    titles = name_titles(audit.tables) if "variants" in audit.tables else {}
    return (*facts, ("Details of", titles[audit.best])) if len(titles) > 1 else tuple(facts)


def _describe_machine(audit: AuditResults) -> str:
    summary = audit.summary
    if not audit.is_of_legs:
        return str(summary["machine"])
    model = summary.get("model_title", summary["model"])
    return f"{summary['machine']}, {model} {describe_deformation(summary['deformation'])}"


def _describe_plan(audit: AuditResults) -> str:
    plan = audit.summary["plan"]
    if not audit.is_of_legs:
        return f"{count_poses(audit)}, {plan['poses']}; readings of {join_words(plan['sensors'])}"
    moved, most, noise, model_error = (
        format_plain(plan[key], 3)
        for key in ("largest_displacement_mm", "actuator_range_mm", "actuator_noise_um", "model_error_um")
    )
    sensors = join_words([str(name).replace("_", " ") for name in plan["sensors"]])
    seen = f", seen by {sensors}" if sensors else ""
    beside = f", model error {model_error} µm" if plan["model_error_um"] else ""
    function = plan.get("structured_error")
    if function is not None:
        size = format_plain(function["scale_um"], 3)
        beside += f", and errors that are {function['kernel']} functions of the pose, {size} µm at the range's end"
    return (
        f"{count_poses(audit)}{seen}; displacements up to {moved} mm of {most} mm; noise: actuators {noise} µm{beside}"
    )


# --- sections --------------------------------------------------------------------------------------------------------


def _build_sections(audit: AuditResults) -> tuple[Section, ...]:
    ridges, tables, asked = build_ridges(audit), audit.tables, audit.summary["units"]
    sweeps, accuracy = illustrations.show_sweeps(audit), show_accuracy(tables, asked)
    return (
        *show_variants(tables, audit.best),
        *((accuracy,) if accuracy is not None else ()),
        Section("Parameters: what will be known", _show_parameters(audit), "parameters", "Parameters"),
        Section("Undetermined combinations", (RIDGES if ridges else NO_RIDGES, *ridges), "ridges", "Ridges"),
        Section("What to free", _show_selection(audit), "selection"),
        Section("Requirements", _show_requirements(audit), "requirements"),
        *show_sets(tables, audit.summary),
        *show_next(tables, audit.best, asked),
        *show_selected(tables, audit.best, asked),
        *show_counts(tables, audit.best, asked),
        Section("What would help", _show_changes(audit), "changes"),
        Section("Noise, number of poses, displacements", (sweeps,), "sweeps", "Sweeps"),
        *_show_checks_of_legs(audit),
        Section("Simulated calibrations", _show_simulated(audit), "simulated"),
        Section("How it was computed", (Definitions(describe_method(audit)), tabulate_audit(audit)), "method"),
    )


def _show_checks_of_legs(audit: AuditResults) -> tuple[Section, ...]:
    if not audit.is_of_legs:
        return ()
    return (
        Section("Profile likelihoods", _show_profiles(audit), "profiles", "Profiles"),
        Section("Ridges as draws show them", _show_draws(audit), "draws", "Ridge plots"),
    )


def _show_parameters(audit: AuditResults) -> tuple[Block, ...]:
    each = Fold("Every parameter with the reason of its verdict", (_set_small(tabulate_parameters(audit)),))
    return (
        *illustrations.show_machine(audit),
        _set_small(tabulate_symbols(audit)),
        illustrations.show_contraction(audit),
        each,
        illustrations.show_spectrum(audit),
    )


def _set_small(table: Table) -> Table:
    return replace(table, style="wide parameters")


def _show_selection(audit: AuditResults) -> tuple[Block, ...]:
    steps = freedom.tabulate_selection(audit)
    found: Block = Absent("No reduced set was looked for.")
    if steps is not None:
        found = Fold("How the reduced set is found", (steps,))
    return (Statement(FREEDOM), *_if_any(freedom.tabulate_sets(audit)), found)


def _show_requirements(audit: AuditResults) -> tuple[Block, ...]:
    table = tabulate_requirements(audit)
    return (*_if_any(table), illustrations.show_requirements(audit))


def _show_changes(audit: AuditResults) -> tuple[Block, ...]:
    table, best = tabulate_changes(audit), tabulate_ridge_help(audit)
    blocks: list[Block] = [illustrations.show_changes(audit)]
    if table is not None:
        blocks.insert(0, replace(table, style="wide"))
    if best is not None:
        blocks.append(Fold("For each weak combination the best change", (best,)))
    return tuple(blocks)


def _show_profiles(audit: AuditResults) -> tuple[Block, ...]:
    return (illustrations.show_profiles(audit), *_if_any(tabulate_profiles(audit)))


def _show_draws(audit: AuditResults) -> tuple[Block, ...]:
    blocks: list[Block] = [illustrations.show_ridges(audit), *_list_formulas(audit)]
    others, drawn = illustrations.show_other_ridges(audit), tabulate_posterior(audit)
    if others is not None:
        blocks.append(Fold("The other ridges", (others,)))
    if drawn is not None:
        blocks += [drawn, Statement(f"Draws: {_find_origin(audit)}.")]
    return tuple(blocks)


def _list_formulas(audit: AuditResults) -> list[Statement]:
    """Return what explains the curve of the first ridge of each kind."""
    first = (next((ridge for ridge in group.ridges if ridge.plot), None) for group in audit.groups)
    found = [(ridge.plot, ridge.explanation or ridge.plot["formula"]) for ridge in first if ridge is not None]
    return [Statement(f"{plot['y']} against {plot['x']}: {text}") for plot, text in found if text]


def _show_simulated(audit: AuditResults) -> tuple[Block, ...]:
    left_out = Absent("Left out: the design asks for no simulated calibrations.")
    return tuple(freedom.tabulate_simulated(audit)) or (left_out,)


def _if_any(table: Table | None) -> tuple[Table, ...]:
    return () if table is None else (table,)
