"""The ranking of the variants, and what deformation and model add, each by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.headline import describe_candidate, order_candidates
from bayescal.experiments.shared.rows import USES
from bayescal.experiments.study.page.evidence import format_evidence
from bayescal.experiments.study.page.results import VARIANT, ErrorScale, StudyResults, get_number
from bayescal.experiments.study.page.styles import LONG, Styles, assign_styles
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Figure, PageSection, Statement, Table, make_table
from bayescal.report.numbers import (
    NO_VALUE,
    format_estimate,
    format_fixed,
    format_pair,
    format_percent,
    format_power,
    format_significant,
    join_words,
)
from bayescal.report.style import PALE

STACKING = "Stacking weight: share in the predictive mixture."
NOT_COMPARED = "Unranked variants did not converge."
THICKNESS = 0.62

type NamedCells = list[tuple[Column, str | Cell]]


def show_ranking(study: StudyResults) -> PageSection:
    """Return the variants, the best first, with what they add to each other."""
    blocks = list[Block]()
    if len(study.ranking) > 1 or study.error_scales:
        blocks.append(_illustrate(study))
    blocks.append(tabulate_ranking(study))
    effects = tabulate_effects(study)
    blocks += [] if effects is None else [effects]
    title = "Ranking" if len(study.names) > 1 else "The variant"
    return PageSection(title, tuple(blocks), anchor="ranking", short="Ranking")


def tabulate_ranking(study: StudyResults) -> Table:
    """Return the variants, the largest evidence first, by the data they take."""
    rows: list[list[str | Cell]] = []
    columns, several = list[Column](), len(study.names) > 1
    for names in study.summary["rankings"]:
        fits = {name: study.fit(name) for name in names}
        candidates = [describe_candidate(*one) for one in fits.items()]
        sound = [fits[one.name] for one in candidates if one.converged] or list(fits.values())
        best, highest = (max(one[key] for one in sound) for key in ("elpd_loo", "log_evidence"))
        for rank, name in enumerate((one.name for one in order_candidates(candidates)), start=1):
            apart = fits[name]["log_evidence"] - highest
            behind = _compare(fits[name], apart, best) if several else []
            found: NamedCells = (
                [(Column("Rank"), str(rank) if fits[name]["converged"] else "not ranked")] if several else []
            )
            found += _describe(study, name, fits[name], behind)
            columns = [column for column, _ in found]
            rows.append([cell for _, cell in found])
    caption = "Variants." if several else "Variant."
    notes = [Statement(STACKING)] if several else []
    if any(fit["n_loo_bad_k"] for fit in study.fits.values()):
        text = f"(n): n poses with Pareto k > {PARETO_K_LIMIT}."
        notes.append(Statement(text, "warning"))
    notes += [] if len(study.compared) == len(study.ranking) else [Statement(NOT_COMPARED, "warning")]
    notes += _state_names(study)
    return make_table(caption, columns, rows, notes, "wide")


def _compare(fit: Summary, behind: float, best: float) -> NamedCells:
    """Return how far one of several variants is behind the best, in evidence, then by LOO; dashes if not converged."""
    error, compared = fit["elpd_loo_difference_se"], fit["converged"]
    loo = format_fixed(0.0, 1) if fit["elpd_loo"] == best else format_estimate(fit["elpd_loo"] - best, error, 1)
    return [
        (Column("behind the best", "nat", "Log-evidence"), format_fixed(behind, 1) if compared else NO_VALUE),
        (Column("behind the best", "nat", "elpd LOO"), loo if compared else NO_VALUE),
        (Column("stacking weight", "%", "elpd LOO"), format_percent(fit["stacking_weight"]).rstrip(" %")),
    ]


def _describe(study: StudyResults, name: str, fit: Summary, behind: NamedCells) -> NamedCells:
    """Return what one variant has, and how far it is ``behind`` the best where there are several."""
    bad = int(fit["n_loo_bad_k"])
    loo = format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1)
    found: NamedCells = [
        (VARIANT, study.label(name)),
        (Column("Free"), str(fit["n_parameters"])),
        (Column("", "nat", "Log-evidence"), format_evidence(fit["log_evidence"], fit["log_evidence_se"])),
        *behind[:1],
        (Column("", "nat", "elpd LOO"), Cell(f"{loo} ({bad})", "warning") if bad else Cell(loo)),
        *behind[1:],
    ]
    if any(get_number(one, "elpd") == get_number(one, "elpd") for one in study.fits.values()):
        found.append((Column("elpd held back", "nat"), format_fixed(get_number(fit, "elpd"), 1)))
    found.append((Column("Residual / noise"), format_significant(get_number(fit, "reduced_chi"), 2)))
    for scale in study.error_scales:
        for use in USES if study.n_verification else USES[:1]:
            found.append((Column(use, scale.unit, f"{scale.title}, mean / max"), scale.format_both(fit[use])))
    length = format_significant(get_number(fit, "distance_from_nominal_mm"))
    tolerances = format_significant(get_number(fit, "distance_from_nominal_prior_sd"), 2)
    group = "From nominal, rms"
    found += [(Column("", "mm", group), length)] if (study.geometry["unit"] == "mm").any() else []
    found.append((Column("", "tolerances", group), tolerances))
    passed = Cell("preliminary", "warning") if study.is_preliminary else Cell("passed")
    found.append((Column("Checks", kind="text"), passed if fit["converged"] else Cell("FAILED", "bad")))
    if len(study.summary["rankings"]) > 1:
        found.append((Column("Readings", kind="name"), str(fit["data_set"])))
    return found


def _state_names(study: StudyResults) -> list[Statement]:
    """Say how models are called in config and results, where the report writes them otherwise."""
    titles = {model: study.label_model(model) for model in study.models} if "models" in study.summary else {}
    other = [f"{title} is {model}" for model, title in titles.items() if title != model]
    if not other:
        return []
    example = next((name for name in study.ranking if study.label(name) != name), None)
    if example is None:  # all have names of their own
        return [Statement(f"In the config {join_words(other)}.")]
    return [Statement(f"In config and results {join_words(other)}: {study.label(example)} is {example}.")]


def tabulate_effects(study: StudyResults) -> Table | None:
    """Return the log-evidence by model and deformation, and what either adds with the other unchanged; None for one."""
    models, deformations = study.models, study.deformations
    if len(models) < 2 or len(deformations) < 2:
        return None
    letters = {
        name: chr(ord("A") + k) if k < 26 else str(k)
        for k, group in enumerate(study.group(study.ranking))
        for name in group
    }
    best, first = study.split(study.best_name)[1], models[0]
    columns = [
        Column("Model", kind="text"),
        *(Column(d, "nat", "Below the best variant") for d in deformations),
        *(Column(f"{best} − {d}", "nat", "Deformation effect") for d in deformations if d != best),
        *(Column(d, "nat", f"Against {study.label_model(first)}, same deformation") for d in deformations),
    ]
    own = {(m, d): name for m in models for d in deformations if (name := study.find_best(m, d)) is not None}
    value = {pair: study.evidence(name) for pair, name in own.items()}
    top = study.evidence(study.best_name)

    def subtract(one: tuple[str, str], other: tuple[str, str]) -> str:
        known = one in value and other in value
        return format_fixed(value[one] - value[other], 1, sign=True) if known else NO_VALUE

    below = {pair: f"{format_fixed(value[pair] - top, 1)} {letters[name]}" for pair, name in own.items()}
    rows = [
        [
            study.label_model(m),
            *(below.get((m, d), NO_VALUE) for d in deformations),
            *(subtract((m, best), (m, d)) for d in deformations if d != best),
            *(subtract((m, d), (first, d)) if m != first else NO_VALUE for d in deformations),
        ]
        for m in models
    ]
    note = "Variants that share a letter fit equally well."
    note += " Each by its best free set." if study.free_sets else ""
    return make_table("Log-evidence by variant.", columns, rows, [Statement(note)])


# --- the figure ------------------------------------------------------------------------------------------------------


def _illustrate(study: StudyResults) -> Figure:
    """Return evidence and pose errors of all variants."""
    use, scales = study.use, study.error_scales
    failed = [name for name in study.ranking if name not in study.compared]
    groups = [*study.group(study.ranking), *([failed] if failed else [])]
    best = max((study.evidence(name) for name in study.compared), default=math.nan)
    behind = {name: best - study.evidence(name) if name in study.compared else math.nan for name in study.ranking}
    caption = "Log-evidence below the best, logarithmic beyond 1 nat."
    if scales:
        caption = f"Left: {caption} Right: errors on {use} poses; full bar: mean, pale: largest."
    if len(groups) > 1:
        caption += " Band: equal fit."
    errors = {(name, scale.what): scale.read_both(study.fit(name)[use]) for name in study.ranking for scale in scales}
    return Figure("errors", caption, partial(_draw, groups, behind, errors, scales, use, assign_styles(study)))


def _draw(
    groups: Sequence[Sequence[str]],
    behind: Mapping[str, float],
    errors: Mapping[tuple[str, str], tuple[float, float]],
    scales: Sequence[ErrorScale],
    use: str,
    styles: Styles,
) -> Drawing:
    """Return panels with a row per variant: evidence, position error, orientation error where it was measured.

    Variants of a group, which fit equally well, share a band; ``behind`` is their log-evidence below the best, nats,
    NaN of one that did not converge; ``errors`` are mean and largest one of each kind, NaN where none was measured.
    """
    names = [name for group in groups for name in group]
    rows, colours = range(len(names)), [styles[name].colour for name in names]
    figure = Drawing(figsize=(9.4, 0.75 + 0.265 * len(names)))
    axes = figure.subplots(1, 1 + len(scales), sharey=True, squeeze=False)[0]
    for panel in axes:
        top = -0.5
        for k, group in enumerate(groups):
            if k % 2 == 0 and len(groups) > 1:
                panel.axhspan(top, top + len(group), color=PALE, alpha=0.4, linewidth=0)
            top += len(group)
        panel.grid(axis="x")
        panel.tick_params(axis="y", length=0)
    apart = [behind[name] for name in names]
    room = 1.45 if max(len(styles[name].label) for name in names) <= LONG else 2.0  # for numbers beside long names
    axes[0].barh(rows, np.nan_to_num(apart), height=THICKNESS, color=colours, linewidth=0)
    _label_evidence(axes[0], apart, "Log-evidence below\nthe best (nat)")
    for panel, scale in zip(axes[1:], scales, strict=True):
        both = [errors[name, scale.what] for name in names]
        mean, largest = (np.nan_to_num(one) for one in zip(*both, strict=True))
        panel.barh(rows, largest, height=THICKNESS, color=colours, alpha=0.35, linewidth=0)
        panel.barh(rows, mean, height=THICKNESS, color=colours, linewidth=0)
        _write_at(panel, largest.tolist(), [format_pair(*one, 2) for one in both])
        panel.set_xlim(0, room * float(largest.max()) or 1.0)
        panel.set_xlabel(f"{scale.label},\n{use}")
    axes[0].set_yticks(rows, [styles[name].label for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    return figure


def _label_evidence(axes: Axes, values: Sequence[float], label: str) -> None:
    axes.set_xscale("symlog", linthresh=1.0, linscale=0.5)
    ends = np.nan_to_num(values)
    axes.set_xlim(0, 100 * max(1.0, *ends))
    locator = axes.xaxis.get_major_locator()
    if isinstance(locator, SymmetricalLogLocator):
        locator.set_params(numticks=4)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_power(value, 1)))
    _write_at(axes, ends.tolist(), ["not converged" if math.isnan(one) else format_fixed(-one, 1) for one in values])
    axes.set_xlabel(label)


def _write_at(axes: Axes, ends: Sequence[float], texts: Sequence[str]) -> None:
    """Write numbers at the ends of the bars that they belong to."""
    for k, (end, text) in enumerate(zip(ends, texts, strict=True)):
        axes.annotate(text, (end, k), (5, 0), textcoords="offset points", va="center", fontsize=8)
