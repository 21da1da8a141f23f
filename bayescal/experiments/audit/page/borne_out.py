"""Sentences of an audit's verdict on what checks it: simulated calibrations and draws of the posterior."""

from __future__ import annotations

from typing import Any

from bayescal.experiments.audit.page.results import AuditResults, Requirement
from bayescal.experiments.audit.page.wording import (
    format_probability,
    format_range,
    format_share,
    name_requirement,
)
from bayescal.experiments.shared.headline import LIKELY
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_count, format_fixed, join_words

KEPT = LIKELY  # probability from which on a requirement counts as kept
OFF = 3.0  # standard errors of a ratio of simulated to predicted sd
OFF_SHARE = 0.05
SIMULATED_LEAD = "Simulated calibrations"
AGREED_DEG = 10.0  # principal angle between the ridges from draws and from information


def state_simulated(results: AuditResults) -> list[Statement]:
    """Say whether simulated calibrations with everything free bear the predictions out."""
    simulated = results.summary.get("simulated_calibrations")
    if simulated is None or not simulated["symbols"]:
        return []
    return [_judge_simulated(simulated), *_judge_kept(simulated)]


def _judge_simulated(simulated: dict[str, Any]) -> Statement:
    ratios = {s: v["ratio"] for s, v in simulated["symbols"].items()}
    off = [symbol for symbol, values in simulated["symbols"].items() if is_off(values["ratio"], values["ratio_se"])]
    made = f"{simulated['n_converged']} of {simulated['n']} simulated calibrations with everything free converged"
    span = format_range(list(ratios.values()), _two)
    held = f"their 90 % intervals hold {format_share(simulated['coverage_90'])} of the true values"
    if not off:
        text = f"{made}; {held}, and their errors bear the predicted standard deviations out (ratio {span})."
        level: Level = "good" if simulated["n_converged"] == simulated["n"] else "warning"
        return Statement(text, level, SIMULATED_LEAD)
    text = (
        f"{made}; {held}, but the errors of {join_words(off)} are not the predicted ones (ratio {span} over all "
        "symbols): the linear prediction does not hold there."
    )
    return Statement(text, "warning", SIMULATED_LEAD)


def _judge_kept(simulated: dict[str, Any]) -> list[Statement]:
    """Warn where calibrated machines keep a requirement more or less often than is claimed."""
    off = {name: one for name, one in simulated["requirements"].items() if not one["agrees"]}
    words = [
        f"{name_requirement(name)} ({one['kept']} of {one['n']}, expected {one['expected_low']} to "
        f"{one['expected_high']})"
        for name, one in off.items()
    ]
    if not words:
        return []
    text = f"Calibrated machines do not meet {join_words(words)} as often as is claimed."
    return [Statement(text, "warning", "Requirements, simulated")]


def is_off(ratio: float, se: float) -> bool:
    """Whether a simulated sd differs from the predicted one by more than chance and by more than a twentieth."""
    return abs(ratio - 1.0) > max(OFF * se, OFF_SHARE)


def read_drawn_probabilities(results: AuditResults) -> dict[str, float]:
    """Return the probability to keep each requirement by draws of the posterior; empty without them."""
    posterior = results.summary.get("posterior") or {}
    found = {name: values.get("probability") for name, values in (posterior.get("requirements") or {}).items()}
    return {name: float(value) for name, value in found.items() if value is not None}


def find_probability(results: AuditResults, requirement: Requirement) -> float:
    """Return with which probability a requirement is kept: the smaller one where draws of the posterior say another."""
    return min(requirement.probability, read_drawn_probabilities(results).get(requirement.name, 1.0))


def is_kept(results: AuditResults, requirement: Requirement) -> bool:
    """Whether a requirement counts as kept, in verdict, table and picture alike."""
    return find_probability(results, requirement) >= KEPT


def state_posterior(results: AuditResults) -> list[Statement]:
    """Say what draws of the posterior add; nothing without them."""
    posterior = results.summary.get("posterior")
    if posterior is None:
        return []
    angle = posterior.get("principal_angle_deg")
    level: Level = "plain"
    text = f"{format_count(posterior['n_draws'])} draws, {posterior['origin'].rstrip('.')}"
    if angle is not None:
        level = "good" if angle <= AGREED_DEG else "warning"
        text += f": the space of its ridges lies within {format_fixed(angle, 1)}° of that from the information"
        text += "" if level == "good" else ", so the ridges are curved or the linear picture does not hold there"
    statements = [Statement(f"{text}.", level, "Posterior")]
    drawn, now = read_drawn_probabilities(results), {r.name: r.probability for r in results.requirements}
    lost = [name for name, value in drawn.items() if value < KEPT <= now.get(name, 0.0)]
    if lost:
        words = [f"{name_requirement(name)} ({format_probability(drawn[name])})" for name in lost]
        text = f"By the draws the machine does not reliably meet {join_words(words)}, against the linear prediction."
        statements.append(Statement(text, "bad", "Requirements by draws"))
    return statements


def _two(value: float) -> str:
    return format_fixed(value, 2)
