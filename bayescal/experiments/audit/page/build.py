"""The page of an audit, from its results alone."""

from __future__ import annotations

from bayescal.experiments.audit.page import figures, tables
from bayescal.experiments.audit.page.model_error import show_model_error
from bayescal.experiments.audit.page.readings import show_counts, show_selected, show_sets, show_variants
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.verdict import (
    count_poses,
    list_failures,
    list_key_figures,
    state_headline,
    state_verdict,
)
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.knowledge_page import name_titles, show_accuracy, show_next, show_predicted
from bayescal.report.blocks import Absent, Block, Fold, Page, PageSection, Statement
from bayescal.report.numbers import join_words
from bayescal.report.symbols import describe_deformation

KIND = "Identifiability audit"
RIDGES = "Structurally unidentifiable: measure something else. Weak: improve the plan."
NO_RIDGES = "All combinations are determined."


def build_page(results: Results) -> Page:
    """Return what the page of an audit says; without the tables of profiles, draws or sweeps these are left out."""
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
        key_figures=tuple(list_key_figures(audit)),
        symbols=tuple(audit.symbols),
    )


def _find_origin(audit: AuditResults) -> str:
    """Return where the data come from that the posterior's draws rest on; nothing without draws."""
    posterior = audit.summary.get("posterior")
    return posterior["origin"] if posterior is not None else ""


def _list_facts(audit: AuditResults) -> tuple[tuple[str, str], ...]:
    summary, plan = audit.summary, audit.summary["plan"]
    machine = str(summary["machine"])
    if "model" in summary:
        machine += f", {summary['model']} {describe_deformation(summary['deformation'])}"
    poses = "" if audit.is_measured else f", {plan['poses']}"
    facts = [("Machine", machine), ("Plan", f"{count_poses(audit)}{poses}; readings of {join_words(plan['sensors'])}")]
    titles = name_titles(audit.tables)
    return (*facts, ("Details of", titles[audit.best])) if len(titles) > 1 else tuple(facts)


# --- sections --------------------------------------------------------------------------------------------------------


def _build_sections(audit: AuditResults) -> tuple[PageSection, ...]:
    ridges, asked = tables.build_ridges(audit), audit.summary["units"]
    accuracy = show_accuracy(audit.tables, asked=asked)
    requirements = (*_if_any(tables.tabulate_requirements(audit)), figures.show_requirements(audit))
    changes = (*_if_any(tables.tabulate_changes(audit)), figures.show_changes(audit))
    helped = _fold("Best change by weak combination", tables.tabulate_ridge_help(audit))
    sets = _if_any(tables.tabulate_sets(audit))
    steps = _fold("Reduced set", tables.tabulate_selection(audit))
    steps = steps or (Absent("No reduced set requested."),)
    profiles = (figures.show_profiles(audit), *_if_any(tables.tabulate_profiles(audit)))
    simulated = tuple(tables.tabulate_simulated(audit))
    left_out = Absent("No simulated calibrations requested.")
    return (
        *show_predicted(audit.accuracy, bool(audit.summary.get("aligned"))),
        *show_variants(audit),
        *((accuracy,) if accuracy is not None else ()),
        PageSection("Predicted parameter uncertainty", _show_parameters(audit), "parameters", "Parameters"),
        PageSection("Unidentifiable combinations", (RIDGES if ridges else NO_RIDGES, *ridges), "ridges", "Ridges"),
        PageSection("Free parameters", (*sets, *steps), "selection"),
        PageSection("Requirements", requirements, "requirements"),
        *show_model_error(audit),
        *show_sets(audit),
        *show_next(audit.tables, audit.best, asked),
        *show_selected(audit),
        *show_counts(audit),
        PageSection("Design alternatives", (*changes, *helped), "changes"),
        PageSection("Sensitivity to noise, poses and workspace", (figures.show_sweeps(audit),), "sweeps", "Sweeps"),
        PageSection("Profile likelihoods", profiles, "profiles", "Profiles"),
        PageSection("Posterior draws along undetermined combinations", _show_draws(audit), "draws", "Ridge plots"),
        PageSection("Simulated calibrations", simulated or (left_out,), "simulated"),
        PageSection("Method", (tables.tabulate_audit(audit),), "method"),
    )


def _show_parameters(audit: AuditResults) -> tuple[Block, ...]:
    return (
        *figures.show_machine(audit),
        tables.tabulate_symbols(audit),
        figures.show_contraction(audit),
        Fold("Verdict by parameter", (tables.tabulate_parameters(audit),)),
        figures.show_spectrum(audit),
    )


def _show_draws(audit: AuditResults) -> tuple[Block, ...]:
    """Return the ridges in pictures, with the slope of the first of each kind."""
    first, *others = figures.show_ridges(audit)
    blocks: list[Block] = [first]
    for group in audit.groups:
        ridge = next((ridge for ridge in group if ridge.plot_x), None)
        if ridge is not None:
            blocks.append(Statement(f"{ridge.plot_y} against {ridge.plot_x}: {ridge.plot_formula}"))
    blocks += _fold("The other ridges", *others)
    if drawn := _if_any(tables.tabulate_posterior(audit)):
        blocks += [*drawn, Statement(f"Draws: {_find_origin(audit)}.")]
    return tuple(blocks)


def _if_any(block: Block | None) -> tuple[Block, ...]:
    return () if block is None else (block,)


def _fold(title: str, block: Block | None = None) -> tuple[Block, ...]:
    return () if block is None else (Fold(title, (block,)),)
