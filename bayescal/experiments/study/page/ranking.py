"""Tables of the ranking, and what deformation and model are worth, each by itself."""

from __future__ import annotations

from typing import Any

from bayescal.experiments.study.page.evidence import format_evidence
from bayescal.experiments.study.page.prediction import measure_error, read_verification_elpd
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
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    MILLIDEGREES,
    NOTHING,
    format_estimate,
    format_fixed,
    format_pair,
    format_significant,
    join_words,
)


def tabulate_ranking(results: StudyResults, setting: str) -> Table:
    """Return the ranking of one setting of the model error, the largest evidence first."""
    names = sorted(
        results.ranking,
        key=lambda name: (not results.fit(name, setting)["converged"], -results.fit(name, setting)["log_evidence"]),
    )
    best = results.fit(names[0], setting)["log_evidence"]
    uses = USES if results.n_verification else USES[:1]
    columns = [
        Column("Rank"),
        VARIANT,
        Column("Free"),
        Column("Log-evidence", "nat"),
        Column("Difference", "nat"),
        Column("LOO", "nat", "elpd"),
        Column("difference", "nat", "elpd"),
        Column("verification", "nat", "elpd"),
        *(Column(use, "µm", "Position error, mean / max") for use in uses),
        *(Column(use, "mdeg", "Orientation error, mean / max") for use in uses),
        Column("rms", "mm", "From nominal"),
        Column("rms", "prior sd", "From nominal"),
        Column("Checks", kind="text"),
    ]
    rows: list[list[str | Cell]] = []
    for rank, name in enumerate(names, start=1):
        fit = results.fit(name, setting)
        rows.append(
            [
                str(rank) if fit["converged"] else "not ranked",
                label_variant(results, name),
                str(fit["n_parameters"]),
                format_evidence(fit["log_evidence"], fit["log_evidence_se"]),
                format_fixed(fit["log_evidence"] - best, 1),
                _format_loo(fit),
                _format_loo_difference(results, name, setting),
                format_fixed(read_verification_elpd(fit), 1),
                *(_format_errors(fit[use], "position_error_mm", MICROMETRES) for use in uses),
                *(_format_errors(fit[use], "orientation_error_deg", MILLIDEGREES) for use in uses),
                format_significant(fit["distance_from_nominal"]["rms_mm"]),
                format_significant(fit["distance_from_nominal"]["rms_prior_sd"]),
                Cell("passed") if fit["converged"] else Cell("FAILED", "bad"),
            ]
        )
    title = {"free": "with model error τ", "zero": "without model error (τ = 0)"}[setting]
    notes = []
    if any(results.fit(name, setting)["elpd_loo_n_bad_k"] for name in names):
        notes.append(
            Statement(
                f"(n) n poses with Pareto k above {PARETO_K_LIMIT} that no run left out: elpd LOO is doubtful.",
                "warning",
            )
        )
    if setting == "free":
        notes += _state_names(results)
    return make_table(f"Ranking {title}.", columns, rows, notes, "wide")


def _state_names(results: StudyResults) -> list[Statement]:
    """Say how models are called in config and results, where the report writes them otherwise."""
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
        "Variants of one letter are not told apart: within 1 nat, or within twice the error of the estimates, of the "
        "best of their letter."
    )
    if find_free_sets(results):
        note += " Of several free sets of one model and deformation the best one stands here."
    return make_table("Log-evidence by model and deformation, with model error.", columns, rows, [Statement(note)])


def _format_difference(value: dict[str, float], one: str, reference: dict[str, float], other: str) -> str:
    there = one in value and other in reference
    return format_fixed(value[one] - reference[other], 1, sign=True) if there else NOTHING


def _format_loo(fit: dict[str, Any]) -> Cell:
    text = format_estimate(fit["elpd_loo"], fit["elpd_loo_se"], 1)
    bad = int(fit["elpd_loo_n_bad_k"])
    return Cell(f"{text} ({bad})", "warning") if bad else Cell(text)


def _format_loo_difference(results: StudyResults, name: str, setting: str) -> str:
    """Return how far a variant's elpd lies below the best one's, with the standard error of the difference."""
    best = max(results.ranking, key=lambda other: results.fit(other, setting)["elpd_loo"])
    if name == best:
        return format_fixed(0.0, 1)
    gap = results.fit(name, setting)["elpd_loo"] - results.fit(best, setting)["elpd_loo"]
    return format_estimate(gap, measure_error(results, name, best, "calibration", setting), 1)


def _format_errors(errors: dict[str, Any] | None, key: str, factor: float) -> str:
    if errors is None:
        return NOTHING
    mean, largest = (factor * get_number(errors[key], which) for which in ("mean", "max"))
    return format_pair(mean, largest, 2)
