"""The ranking of the variants, and what deformation and model add, each by itself."""

from __future__ import annotations

from typing import Any

from bayescal.experiments.study.page.evidence import format_evidence
from bayescal.experiments.study.page.illustrations import illustrate_ranking
from bayescal.experiments.study.page.prediction import tabulate_stacking
from bayescal.experiments.study.page.results import USES, StudyResults, get_number
from bayescal.experiments.study.page.variants import (
    VARIANT,
    find_best,
    find_free_sets,
    group_variants,
    label_model,
    label_variant,
    list_deformations,
    list_models,
    read_evidence,
    split_variant,
)
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import (
    NOTHING,
    format_estimate,
    format_fixed,
    format_pair,
    format_percent,
    format_significant,
    join_words,
)

TEXT = (
    "Log-evidence in nats: a difference of 1 nat is odds of 2.7 to 1, 5 nats of 150 to 1; it is compared between "
    "variants of the same data. elpd is the log density that the posterior gives to poses it has not seen: each pose "
    "left out in turn (LOO), or poses held back."
)
NOMINAL = (
    " “From nominal” is how far the identified geometry moved: rms of all lengths, and rms in units of the stated "
    "tolerances along the directions that the data determine."
)


def show_ranking(study: StudyResults) -> Section:
    """Return the variants, the best first, with what they add to each other."""
    blocks: list[Block] = [TEXT + (NOMINAL if study.has("pose_errors") else "")]
    if study.has("pose_errors"):
        blocks.append(illustrate_ranking(study))
    blocks.append(tabulate_ranking(study, "free"))
    blocks += [table for table in (tabulate_effects(study), tabulate_stacking(study)) if table is not None]
    if "zero" in study.settings:
        blocks.append(Fold("The same ranking without model error (τ = 0)", (tabulate_ranking(study, "zero"),)))
    title = "Ranking" if len(study.names) > 1 else "The variant"
    return Section(title, tuple(blocks), anchor="ranking", short="Ranking")


def tabulate_ranking(study: StudyResults, setting: str) -> Table:
    """Return the variants in one setting of the model error, the largest evidence first, by the data they take."""
    rows: list[list[str | Cell]] = []
    columns, several = list[Column](), len(study.names) > 1
    for names in study.summary["rankings"]:
        fits = {name: study.fit(name, setting) for name in names}
        order = sorted(fits, key=lambda name: (not fits[name]["converged"], -fits[name]["log_evidence"]))
        best = max(one["elpd_loo"] for one in fits.values())
        for rank, name in enumerate(order, start=1):
            apart = fits[name]["log_evidence"] - fits[order[0]]["log_evidence"]
            behind = _compare(fits[name], apart, best) if several else []
            found: Found = [(Column("Rank"), str(rank) if fits[name]["converged"] else "not ranked")] if several else []
            found += _describe(study, name, fits[name], behind)
            columns = [column for column, _ in found]
            rows.append([cell for _, cell in found])
    title = {"free": "with model error τ", "zero": "without model error (τ = 0)"}[setting]
    caption = f"Variants {title}." if "zero" in study.settings else "Variants, best first." if several else "Variant."
    notes = []
    if any(study.fit(name, setting)["loo_unreliable"] for name in study.names):
        text = f"(n) n poses with Pareto k above {PARETO_K_LIMIT} that no run left out: elpd LOO is unreliable."
        notes.append(Statement(text, "warning"))
    if setting == "free":
        notes += _state_names(study)
    return make_table(caption, columns, rows, notes, "wide")


type Found = list[tuple[Column, str | Cell]]


def _compare(fit: dict[str, Any], behind: float, best: float) -> Found:
    """Return how far one of several variants is behind the best: in evidence, then by LOO."""
    error = fit["elpd_loo_difference_se"]
    loo = format_fixed(0.0, 1) if fit["elpd_loo"] == best else format_estimate(fit["elpd_loo"] - best, error, 1)
    return [
        (Column("behind the best", "nat", "Log-evidence"), format_fixed(behind, 1)),
        (Column("behind the best", "nat", "elpd LOO"), loo),
        (Column("stacking weight", "%", "elpd LOO"), format_percent(fit["stacking_weight"]).rstrip(" %")),
    ]


def _describe(study: StudyResults, name: str, fit: dict[str, Any], behind: Found) -> Found:
    """Return what one variant has, and how far it is ``behind`` the best where there are several."""
    bad = int(fit["loo_unreliable"])
    loo = format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1)
    found: Found = [
        (VARIANT, label_variant(study, name)),
        (Column("Free"), str(fit["n_parameters"])),
        (Column("", "nat", "Log-evidence"), format_evidence(fit["log_evidence"], fit["log_evidence_se"])),
        *behind[:1],
        (Column("", "nat", "elpd LOO"), Cell(f"{loo} ({bad})", "warning") if bad else Cell(loo)),
        *behind[1:],
    ]
    if any(get_number(one, "elpd") == get_number(one, "elpd") for _, _, one in study.fits()):
        found.append((Column("elpd held back", "nat"), format_fixed(get_number(fit, "elpd"), 1)))
    found.append((Column("Residual / noise"), format_significant(get_number(fit, "misfit"), 2)))
    for scale in study.error_scales:
        for use in USES if study.n_verification else USES[:1]:
            column = Column(use, scale.unit, f"{scale.what.capitalize()} error, mean / max")
            found.append((column, format_pair(scale.read(fit[use], "mean"), scale.read(fit[use], "max"), 2)))
    if "distance_from_nominal_mm" in fit:
        length = format_significant(fit["distance_from_nominal_mm"])
        tolerances = format_significant(get_number(fit, "distance_from_nominal_prior_sd"), 2)
        group = "From nominal, rms"
        found += [(Column("", "mm", group), length), (Column("", "tolerances", group), tolerances)]
    found.append((Column("Checks", kind="text"), Cell("passed") if fit["converged"] else Cell("FAILED", "bad")))
    if len(study.summary["rankings"]) > 1:
        found.append((Column("Readings", kind="name"), str(fit["data"])))
    return found


def _state_names(results: StudyResults) -> list[Statement]:
    """Say how models are called in config and results, where the report writes them otherwise."""
    if "models" not in results.summary:
        return []
    other = [
        f"{label_model(results, model)} is {model}"
        for model in list_models(results)
        if label_model(results, model) != model
    ]
    if not other:
        return []
    example = next((name for name in results.ranking if label_variant(results, name) != name), None)
    if example is None:  # all have names of their own
        return [Statement(f"In the config {join_words(other)}.")]
    return [Statement(f"In config and results {join_words(other)}: {label_variant(results, example)} is {example}.")]


def tabulate_effects(results: StudyResults) -> Table | None:
    """Return the log-evidence by model and deformation, and what either is worth with the other kept; None for one."""
    models, deformations = list_models(results), list_deformations(results)
    if len(models) < 2 or len(deformations) < 2:
        return None
    letters = {
        name: chr(ord("A") + k) if k < 26 else str(k)
        for k, group in enumerate(group_variants(results, results.ranking))
        for name in group
    }
    best = split_variant(results, results.ranking[0])[1]
    columns = [
        Column("Model", kind="text"),
        *(Column(d, "nat", "Below the best variant") for d in deformations),
        *(Column(f"{best} − {d}", "nat", "What the deformation adds") for d in deformations if d != best),
        *(Column(d, "nat", f"Against {label_model(results, models[0])}, same deformation") for d in deformations),
    ]
    top = read_evidence(results, results.ranking[0])
    rows = []
    for model in models:
        own = {d: name for d in deformations if (name := find_best(results, model, d)) is not None}
        value = {d: read_evidence(results, name) for d, name in own.items()}
        other = {d: read_evidence(results, n) for d in deformations if (n := find_best(results, models[0], d))}
        row = [label_model(results, model)]
        row += [f"{format_fixed(value[d] - top, 1)} {letters[own[d]]}" if d in own else NOTHING for d in deformations]
        row += [_format_difference(value, best, value, d) for d in deformations if d != best]
        row += [_format_difference(value, d, other, d) if model != models[0] else NOTHING for d in deformations]
        rows.append(row)
    note = (
        "Variants of one letter fit equally well: within 1 nat, or within twice the error of the estimates, of the "
        "best of their letter."
    )
    if find_free_sets(results):
        note += " Of several free sets of one model and deformation the best one stands here."
    return make_table("Log-evidence by model and deformation, with model error.", columns, rows, [Statement(note)])


def _format_difference(value: dict[str, float], one: str, reference: dict[str, float], other: str) -> str:
    there = one in value and other in reference
    return format_fixed(value[one] - reference[other], 1, sign=True) if there else NOTHING
