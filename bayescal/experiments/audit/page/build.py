"""The page of an audit, from its results alone."""

from __future__ import annotations

from bayescal.experiments.audit.page import figures, tables
from bayescal.experiments.audit.page.model_error import show_model_error
from bayescal.experiments.audit.page.readings import show_counts, show_selected, show_sets, show_variants
from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.verdict import count_poses, list_failures, state_headline, state_verdict
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.knowledge_page import name_titles, show_accuracy, show_next
from bayescal.report.blocks import Absent, Block, Definitions, Fold, Page, Section, Statement
from bayescal.report.numbers import join_words
from bayescal.report.symbols import describe_deformation

KIND = "Identifiability audit"
FAILURES = "Do not rely on these numbers yet. What speaks against them:"
RIDGES = (
    "Each sentence says how far parameters can move together with the readings as good as unchanged, to first order. "
    "What is never seen no plan reveals, only another kind of measurement; what is weak a better plan may."
)
FREEDOM = (
    "Everything, each parameter with its tolerance as prior. What the poses do not determine stays as unknown as it "
    "was and is part of every prediction; taken for nominal instead it would bend what is estimated, and no interval "
    "would say so. A reduced set serves to reproduce calibrations that freed no more."
)
NO_RIDGES = "There are none: every combination of the parameters is determined."


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
        failures_title=FAILURES,
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


def _build_sections(audit: AuditResults) -> tuple[Section, ...]:
    ridges, asked = tables.build_ridges(audit), audit.summary["units"]
    accuracy = show_accuracy(audit.tables, asked=asked)
    requirements = (*_if_any(tables.tabulate_requirements(audit)), figures.show_requirements(audit))
    changes = (*_if_any(tables.tabulate_changes(audit)), figures.show_changes(audit))
    helped = _fold("For each weak combination the best change", tables.tabulate_ridge_help(audit))
    sets = _if_any(tables.tabulate_sets(audit))
    steps = _fold("How the reduced set is found", tables.tabulate_selection(audit))
    steps = steps or (Absent("No reduced set was looked for."),)
    profiles = (figures.show_profiles(audit), *_if_any(tables.tabulate_profiles(audit)))
    simulated = tuple(tables.tabulate_simulated(audit))
    left_out = Absent("Left out: the design asks for no simulated calibrations.")
    return (
        *show_variants(audit),
        *((accuracy,) if accuracy is not None else ()),
        Section("Parameters: what will be known", _show_parameters(audit), "parameters", "Parameters"),
        Section("Undetermined combinations", (RIDGES if ridges else NO_RIDGES, *ridges), "ridges", "Ridges"),
        Section("What to free", (Statement(FREEDOM), *sets, *steps), "selection"),
        Section("Requirements", requirements, "requirements"),
        *show_model_error(audit),
        *show_sets(audit),
        *show_next(audit.tables, audit.best, asked),
        *show_selected(audit),
        *show_counts(audit),
        Section("What would help", (*changes, *helped), "changes"),
        Section("Noise, number of poses, displacements", (figures.show_sweeps(audit),), "sweeps", "Sweeps"),
        Section("Profile likelihoods", profiles, "profiles", "Profiles"),
        Section("Ridges as draws show them", _show_draws(audit), "draws", "Ridge plots"),
        Section("Simulated calibrations", simulated or (left_out,), "simulated"),
        Section("How it was computed", (_describe_method(audit), tables.tabulate_audit(audit)), "method"),
    )


def _show_parameters(audit: AuditResults) -> tuple[Block, ...]:
    return (
        *figures.show_machine(audit),
        tables.tabulate_symbols(audit),
        figures.show_contraction(audit),
        Fold("Every parameter with the reason of its verdict", (tables.tabulate_parameters(audit),)),
        figures.show_spectrum(audit),
    )


def _show_draws(audit: AuditResults) -> tuple[Block, ...]:
    """Return the ridges in pictures, with the slope of the first of each kind."""
    first, *others = figures.show_ridges(audit)
    blocks: list[Block] = [first]
    for group in audit.groups:
        ridge = next((ridge for ridge in group if ridge.plot), None)
        if ridge is not None:
            blocks.append(Statement(f"{ridge.plot['y']} against {ridge.plot['x']}: {ridge.plot['formula']}"))
    blocks += _fold("The other ridges", *others)
    if drawn := _if_any(tables.tabulate_posterior(audit)):
        blocks += [*drawn, Statement(f"Draws: {_find_origin(audit)}.")]
    return tuple(blocks)


def _if_any(block: Block | None) -> tuple[Block, ...]:
    return () if block is None else (block,)


def _fold(title: str, block: Block | None = None) -> tuple[Block, ...]:
    return () if block is None else (Fold(title, (block,)),)


def _describe_method(audit: AuditResults) -> Definitions:
    """Return questions with the answers that the computation gives to them."""
    return Definitions(
        (
            (
                "Can it be determined at all?",
                "The rank of the noise-free identification Jacobian J over a workspace far wider than the machine's, "
                "its columns in units of the tolerances, is counted at the gap of its singular values beside the level "
                "to which rounding moves them (computed again at machines that differ in the last digits).",
            ),
            (
                "Do these measurements determine it?",
                f"With the noise of sensors and actuators the {'calibration' if audit.is_measured else 'planned'} "
                "poses carry the information Λ = Jᵀ Σ⁻¹ J; in units of the tolerances the posterior covariance is "
                "(1 + Λ)⁻¹ to first order, the contraction of a direction v is 1 − vᵀ (1 + Λ)⁻¹ v, and "
                "−½ log(1 − contraction) nats are learnt of it.",
            ),
            (
                "Does it matter, and does it hold beyond first order?",
                "Requirements are judged by draws of the remaining uncertainty over the workspace. Profile likelihoods "
                "follow ridges with the machine itself, not with its derivatives; where they were asked for, draws of "
                "the posterior and simulated calibrations check the linear picture, too.",
            ),
        )
    )
