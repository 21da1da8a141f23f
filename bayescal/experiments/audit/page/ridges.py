"""The ridges as the page shows them: one sentence for each kind, the other legs behind it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bayescal.experiments.audit.page.results import AuditResults, Ridge, RidgeGroup
from bayescal.experiments.audit.page.tables import EFFECT_LEVELS
from bayescal.experiments.audit.page.verdict import choose_for_ridge
from bayescal.experiments.audit.page.wording import (
    format_change,
    format_contraction,
    format_range,
    format_share,
    name_requirement,
    say_most,
)
from bayescal.report.blocks import Card, Cell, Level
from bayescal.report.symbols import split_name

KIND_WORDS = {"structural": "never seen", "practical": "weak"}
EFFECT_WORDS = {
    "harmless": "harmless to the pose",
    "noticeable": "noticeable in the pose",
    "harmful": "harmful to the pose",
    "unknown": "effect not judged",
}
EFFECT_ORDER = ("harmful", "noticeable", "unknown", "harmless")


def build_ridges(results: AuditResults) -> tuple[Card, ...]:
    """Return all groups of ridges, never seen ones first."""
    return tuple(_build(results, group) for group in results.groups)


def _build(results: AuditResults, group: RidgeGroup) -> Card:
    ridges = group.ridges
    legs = sorted(leg for leg in (split_name(r.pivot)[1] for r in ridges) if leg)
    where = f"{results.member}{'s' if len(legs) > 1 else ''} {', '.join(map(str, legs))}" if legs else "machine"
    worst = min((ridge.effect for ridge in ridges), key=EFFECT_ORDER.index)
    level: Level = "bad" if group.kind == "structural" else "warning"
    marks = (Cell(KIND_WORDS[group.kind], level), Cell(EFFECT_WORDS[worst], EFFECT_LEVELS[worst]))
    facts = [*_describe_contraction(group), *_describe_effect(results, ridges), *_describe_help(results, group)]
    others = tuple(ridge.sentence for ridge in ridges[1:])
    title = f"{len(others)} more of this kind"
    return Card(group.symbol, where, marks, ridges[0].sentence, tuple(facts), title, others)


def _describe_contraction(group: RidgeGroup) -> list[str]:
    facts = []
    if group.kind == "practical":
        facts.append(f"Contraction {format_range([r.contraction for r in group.ridges], format_contraction)}")
    drawn = [r.posterior_contraction for r in group.ridges if not math.isnan(r.posterior_contraction)]
    if drawn:
        facts.append(f"contraction of the draws {format_range(drawn, format_contraction)}")
    return [f"{', '.join(facts)}."] if facts else []


def _describe_effect(results: AuditResults, ridges: Sequence[Ridge]) -> list[str]:
    position, rotation = (max(getattr(r, key) for r in ridges) for key in ("position", "rotation"))
    facts = []
    if position > 0.0 or rotation > 0.0:
        moved = format_change(position, rotation, results.summary["units"])
        of_all = f" (the largest of all {results.member}s)" if len(ridges) > 1 else ""
        facts.append(f"The step above moves a pose anywhere in the workspace by at most {moved}{of_all}.")
    judged = [ridge for ridge in ridges if not math.isnan(ridge.share)]
    if judged:
        worst = max(judged, key=lambda ridge: ridge.share)
        most = say_most(format_share(worst.share))
        limit = name_requirement(worst.limit)
        facts.append(f"What remains unknown moves the predicted pose by {most} of the limit of {limit}.")
    return facts


def _describe_help(results: AuditResults, group: RidgeGroup) -> list[str]:
    if group.kind == "structural":
        return []
    best = choose_for_ridge(results, group.ridges[0].pivot)
    if best is None:
        return []
    change, contraction = best
    return [
        f"Best of the changes looked at: “{change.name}”, contraction {format_contraction(contraction)} on the "
        f"{results.member} shown."
    ]
