"""What poses that a posterior has not seen say of the variants: left out one by one, or held back from the fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np

from bayescal.experiments.study.page.checks import name_or_count
from bayescal.experiments.study.page.results import ErrorScale, StudyResults, get_number
from bayescal.experiments.study.page.variants import VARIANT, find_leaders, is_told_apart, label_variant, name_variants
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Column, Statement, Table, make_table
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_pair,
    format_percent,
)

CLEAR = 2.0
"""Standard errors of a difference of elpd from which on it says something."""
NAMES = {
    "calibration": ("Leave-one-out cross-validation (elpd LOO)", "agrees"),
    "verification": ("The poses held back for verification (elpd, all together)", "agree"),
}


def read_elpd(results: StudyResults, name: str, use: str, setting: str = "free") -> float:
    """Return the elpd of a variant: of all calibration poses left out in turn, or of the verification poses jointly."""
    fit = results.fit(name, setting)
    return float(fit["elpd_loo"]) if use == "calibration" else read_verification_elpd(fit)


def read_verification_elpd(fit: dict[str, Any]) -> float:
    """Return the joint elpd of the poses held back, NaN without such poses."""
    return get_number(fit, "elpd")


def measure_error(results: StudyResults, one: str, other: str, use: str, setting: str = "free") -> float:
    """Return the standard error of the difference of two variants' elpd, from the differences pose by pose."""
    table = results.table("poses")
    chosen = table[(table["model_error"] == setting) & (table["use"] == use)]
    pointwise = chosen.pivot(index="pose", columns="variant", values="elpd_loo")
    difference = (pointwise[one] - pointwise[other]).to_numpy()
    return float(np.sqrt(len(difference) * np.var(difference)))


def format_gap(results: StudyResults, one: str, other: str, use: str, setting: str = "free") -> str:
    """Return how far one variant's elpd lies above another's, with the standard error of that."""
    gap = read_elpd(results, one, use, setting) - read_elpd(results, other, use, setting)
    return format_estimate(gap, measure_error(results, one, other, use, setting), 1)


def _is_clear(results: StudyResults, one: str, other: str, use: str) -> bool:
    gap = read_elpd(results, one, use) - read_elpd(results, other, use)
    return bool(gap > CLEAR * measure_error(results, one, other, use))


# --- sentences -------------------------------------------------------------------------------------------------------


def state_prediction(results: StudyResults) -> list[Statement]:
    """Say whether cross-validation and the poses held back name the same variants as the evidence."""
    if len(results.ranking) == 1:
        return []
    by_pose = results.n_verification and results.has("pose_errors")
    statements = [_compare_order(results, use) for use in NAMES if use == "calibration" or by_pose]
    statements += [] if by_pose else _compare_held_back(results)
    refitted = sum(int(results.fit(n)["loo_refitted"]) for n in results.ranking)
    bad = {name: int(results.fit(name, "free")["loo_unreliable"]) for name in results.ranking}
    poses = {name: f"{n} {'pose' if n == 1 else 'poses'}" for name, n in bad.items() if n}
    unreliable = [f"{label_variant(results, name)} ({n})" for name, n in poses.items()]
    if unreliable:
        named = name_or_count(unreliable, len(bad))
        text = f"elpd LOO is approximate where Pareto k exceeds {PARETO_K_LIMIT} and no run left the pose out: {named}."
        statements.append(Statement(text, "warning", "Prediction"))
    elif refitted:
        were = "1 pose was" if refitted == 1 else f"{refitted} poses were"
        text = f"{were} left out by runs of their own, since Pareto k exceeded {PARETO_K_LIMIT} there."
        statements.append(Statement(text, lead="Prediction"))
    return statements


def _compare_order(results: StudyResults, use: str) -> Statement:
    name, verb = NAMES[use]
    values = {variant: read_elpd(results, variant, use) for variant in results.ranking}
    order = sorted(values, key=lambda variant: -values[variant] if values[variant] == values[variant] else math.inf)
    leaders = find_leaders(results)
    others = [variant for variant in order if variant not in leaders]
    first = order[0]
    if not others or first not in leaders:
        rival = order[1] if first in leaders else max(leaders, key=values.__getitem__)
        ahead = f"{format_gap(results, first, rival, use)} nat ahead of {label_variant(results, rival)}"
        lead = f"{label_variant(results, first)} first, {ahead}"
        return _judge_order(name, verb, _is_clear(results, first, rival, use), first in leaders, lead)
    last = min(leaders, key=values.__getitem__)
    clear = _is_clear(results, last, others[0], use)
    among = f"{label_variant(results, first)} first, "
    if len(leaders) > 1:
        spread = format_fixed(max(values.values()) - values[last], 1)
        among = f"the same {len(leaders)} lead with {spread} nat between them, "
    lead = f"{among}{format_gap(results, last, others[0], use)} nat ahead of {label_variant(results, others[0])}"
    if clear:
        lead += _describe_rest(results, use)
    return _judge_order(name, verb, clear, True, lead)


def _compare_held_back(results: StudyResults) -> list[Statement]:
    """Say whether poses held back, in folds or for verification, are predicted best by another variant."""
    elpd = {name: get_number(results.fit(name), "elpd") for name in results.ranking}
    known = [name for name in elpd if math.isfinite(elpd[name])]
    first = max(known, key=lambda name: elpd[name], default=None)
    if first is None or first in find_leaders(results):
        return []
    text = f"Held-back readings are predicted best by {label_variant(results, first)}, which the evidence ranks lower."
    return [Statement(text, "warning", "Prediction")]


def _judge_order(name: str, verb: str, clear: bool, agrees: bool, lead: str) -> Statement:
    if not clear:
        word = "separates" if verb == "agrees" else "separate"
        return Statement(f"{name} hardly {word} the best: {lead}.", lead="Prediction")
    if not agrees:
        return Statement(f"{name} dis{verb}: {lead}.", "bad", "Prediction")
    return Statement(f"{name} {verb}: {lead}.", "good", "Prediction")


def _describe_rest(results: StudyResults, use: str) -> str:
    """Say whether the order further down contradicts the evidence by more than two standard errors."""
    if len(results.ranking) < 3:
        return ""
    n = len(list_contradictions(results, use))
    if not n:
        return "; no pair that the evidence distinguishes is reversed by more than two standard errors"
    return f"; further down {n} {'pair comes' if n == 1 else 'pairs come'} clearly in the other order"


def list_contradictions(results: StudyResults, use: str) -> list[tuple[str, str]]:
    """Return pairs told apart by the evidence of which the lower predicts better, by two standard errors."""
    return [
        (low, high)
        for high, low in combinations(results.ranking, 2)
        if is_told_apart(results, low, high) and _is_clear(results, low, high, use)
    ]


# --- stacking --------------------------------------------------------------------------------------------------------


def tabulate_stacking(results: StudyResults) -> Table | None:
    """Return the variants that predict alike, and their stacked prediction; None where one predicts best alone."""
    stacked: Mapping[str, Any] | None = results.summary.get("stacked")
    if stacked is None:
        return None
    weights: Mapping[str, float] = stacked["weights"]
    uses, scales = [use for use in NAMES if use in stacked], results.error_scales
    columns = [
        VARIANT,
        Column("Weight", "%"),
        *([Column("verification", "nat", "elpd")] if "verification" in uses else []),
        *(Column(use, one.unit, f"{one.what.capitalize()} error, mean / max") for one in scales for use in uses),
        *(Column(use, "%", "In 90 % intervals") for use in uses),
    ]
    order = sorted(weights, key=lambda name: -weights[name])
    rows = [_describe_one(label_variant(results, n), weights[n], results.fit(n), uses, scales) for n in order]
    rows.append(_describe_one("all, stacked", 1.0, stacked, uses, scales))
    note = (
        "Variants whose elpd LOO lies within two standard errors of the best one's predict equally well on the "
        "calibration poses. Stacking weighs them so that the mixture predicts left-out poses best; a small "
        "weight means that a variant adds nothing to the others, not that it is wrong."
    )
    caption = f"The stacked prediction of {name_variants(results, order)}."
    return make_table(caption, columns, rows, [Statement(note)])


def _describe_one(
    title: str, weight: float, fit: Mapping[str, Any], uses: list[str], scales: tuple[ErrorScale, ...]
) -> list[str]:
    row = [title, format_percent(weight).rstrip(" %")]
    if "verification" in uses:
        row.append(format_fixed(read_verification_elpd(dict(fit)), 1))
    for scale in scales:
        row += [format_pair(scale.read(fit.get(use), "mean"), scale.read(fit.get(use), "max"), 2) for use in uses]
    return row + [format_percent(fit[use]["interval_90_coverage"]).rstrip(" %") for use in uses]
