"""The verdict of a study in sentences computed from its numbers; every claim names the numbers it rests on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pandas as pd

from bayescal.report.blocks import Statement
from bayescal.report.numbers import (
    ARCSECONDS,
    MICROMETRES,
    format_fixed,
    format_odds,
    format_percent,
    format_significant,
    join_words,
)
from bayescal.report.results import SETTINGS, Results, get_number

# The study's own limits (bayescal.inference.diagnostics, bayescal.study.summary): repeated, since importing them costs
# seconds; a test holds them together.
RHAT_LIMIT = 1.01
ESS_BULK_LIMIT = 1000.0
ESS_TAIL_LIMIT = 400.0
PARETO_K_LIMIT = 0.7
AGREEMENT = 0.1

INTERVAL = 0.90
NOT_DISTINGUISHABLE = 1.0  # nats
STRONG = 5.0
BEYOND_BELIEF = 15.0  # nats from which odds rest on the assumptions, no longer on the data


def state_headline(results: Results) -> str:
    """Return which variant wins and by how much."""
    ranking = results.ranking
    if len(ranking) == 1:
        return f"{ranking[0]} is the only variant; its log-evidence is {format_fixed(results.best['log_evidence'], 1)} nat."
    lead = measure_lead(results, "free")
    second = ranking[1]
    if not lead > max(NOT_DISTINGUISHABLE, 2 * _lead_error(results)):
        return f"{ranking[0]} and {second} cannot be told apart: {format_fixed(lead, 2)} nat of log-evidence between them."
    word = "explains the measurements best" if lead > STRONG else "is preferred, not decisively"
    return f"{ranking[0]} {word}, by {format_fixed(lead, 1)} nat over {second} (odds of about {format_odds(lead)})."


def measure_lead(results: Results, setting: str) -> float:
    """Return by how many nats the best variant of a setting leads; NaN for a single variant."""
    values = sorted((results.fit(name, setting)["log_evidence"] for name in results.ranking), reverse=True)
    return values[0] - values[1] if len(values) > 1 else math.nan


def _lead_error(results: Results) -> float:
    return math.hypot(*(results.fit(name, "free")["log_evidence_se"] for name in results.ranking[:2]))


def list_failures(results: Results) -> list[Statement]:
    """Return everything that speaks against relying on the numbers, posterior by posterior."""
    failures = []
    for variant, setting, fit in results.fits():
        where = f"{variant}, {SETTINGS[setting]}"
        problems = [str(problem) for problem in fit["problems"]]
        if not problems and not fit["log_evidence_agrees"]:
            problems = [f"the two log-evidences differ by {measure_gap(fit):.2f} nat, limit {AGREEMENT}"]
        if not problems and not fit["converged"]:
            problems = ["not converged"]
        failures += [Statement(f"{where}: {problem}", "bad") for problem in problems]
    return failures


def measure_gap(fit: dict[str, Any]) -> float:
    """Return how far the two log-evidences of a posterior lie apart."""
    methods = fit["log_evidence_methods"]
    return abs(float(methods["importance"] - methods["bridge"]))


def state_verdict(results: Results) -> list[Statement]:
    """Return the sentences below the headline."""
    statements = [*_state_odds(results), *_state_prediction(results), _state_accuracy(results), _state_convergence(results)]
    statements += [*_state_stability(results), *_state_model_error(results), *state_coverage(results)]
    return statements


def _state_odds(results: Results) -> list[Statement]:
    if not measure_lead(results, "free") > BEYOND_BELIEF:
        return []
    text = (
        "Odds of this size mean that the data rule the other variants out as far as the assumptions hold (noise model, "
        "priors, tolerances); they are no measure of how sure one may be of the assumptions."
    )
    return [Statement(text)]


def _state_prediction(results: Results) -> list[Statement]:
    """Say whether cross-validation and the poses held back name the same variant as the evidence."""
    if len(results.ranking) == 1:
        return []
    statements = [_compare_order(results, "leave-one-out cross-validation (elpd LOO)", lambda fit: float(fit["elpd_loo"]))]
    if results.n_verification:
        statements.append(_compare_order(results, "the verification poses (elpd)", read_verification_elpd))
    bad = {name: int(results.fit(name, "free")["elpd_loo_n_bad_k"]) for name in results.ranking}
    doubtful = [f"{name} ({n} poses)" for name, n in bad.items() if n]
    if doubtful:
        text = f"elpd LOO is approximate where Pareto k exceeds {PARETO_K_LIMIT}: {join_words(doubtful)}."
        statements.append(Statement(text, "warning"))
    return statements


def read_verification_elpd(fit: dict[str, Any]) -> float:
    """Return the elpd of the poses held back, NaN without such poses."""
    return get_number(fit["verification"] or {}, "elpd")


def _compare_order(results: Results, name: str, score: Callable[[dict[str, Any]], float]) -> Statement:
    values = {variant: score(results.fit(variant, "free")) for variant in results.ranking}
    order = sorted(values, key=lambda variant: -values[variant] if values[variant] == values[variant] else math.inf)
    first, second = order[0], order[1]
    lead = format_fixed(values[first] - values[second], 1)
    capital = name[0].upper() + name[1:]
    if first != results.ranking[0]:
        return Statement(f"Disagreement: {name} puts {first} first, {lead} nat ahead of {second}, not {results.ranking[0]}.", "bad")
    if order != results.ranking:
        rest = f"; further down its order differs ({', '.join(order)})"
    else:
        rest = ", and the same order throughout" if len(order) > 2 else ""
    return Statement(f"{capital} agrees: {first} first, {lead} nat ahead of {second}{rest}.", "good")


def _state_accuracy(results: Results) -> Statement:
    use = "verification" if results.n_verification else "calibration"
    errors = results.best[use]
    position = {k: format_significant(MICROMETRES * v, 2) for k, v in errors["position_error_mm"].items()}
    orientation = {k: format_significant(ARCSECONDS * v, 2) for k, v in errors["orientation_error_deg"].items()}
    held = "held back from the fit" if results.n_verification else "used in the fit; none were held back"
    text = (
        f"Accuracy of {results.ranking[0]}: {position['mean']} µm mean and {position['max']} µm largest position error, "
        f"{orientation['mean']}″ mean and {orientation['max']}″ largest orientation error on the "
        f"{results.summary['n_poses'][use]} {use} poses ({held})."
    )
    return Statement(text)


def _state_convergence(results: Results) -> Statement:
    fits = list(results.fits())
    failed = sum(1 for _, _, fit in fits if not fit["converged"] or not fit["log_evidence_agrees"])
    if failed:
        return Statement(f"{failed} of {len(fits)} posteriors did not pass their checks (listed above).", "bad")
    gap = max(measure_gap(fit) for _, _, fit in fits)
    rhat = max(fit["rhat_max"] for _, _, fit in fits)
    bulk = min(fit["ess_bulk_min"] for _, _, fit in fits)
    text = (
        f"All {len(fits)} posteriors converged: R-hat at most {rhat:.4f} (limit {RHAT_LIMIT}), bulk ESS at least {bulk:.0f} "
        f"(limit {ESS_BULK_LIMIT:.0f}). Both evidence estimators agree to {gap:.3f} nat or better (limit {AGREEMENT})."
    )
    return Statement(text, "good")


def _state_stability(results: Results) -> list[Statement]:
    """Say whether the same variant leads under every tolerance of the lengths."""
    if len(results.ranking) == 1:
        return []
    wide = results.sensitivity.pivot(index="tolerance_mm", columns="variant", values="log_evidence").sort_index()
    first = wide.idxmax(axis=1)
    span = f"tolerances of the lengths from {wide.index[0]:g} to {wide.index[-1]:g} mm" if len(wide) > 1 else "the tolerance tried"
    others = first[first != results.ranking[0]]
    if len(others):
        where = join_words([f"{name} at {tolerance:g} mm" for tolerance, name in others.items()])
        return [Statement(f"The ranking is not stable over {span}: {where} takes the first place.", "bad")]
    orders = {tuple(row.sort_values(ascending=False).index) for _, row in wide.iterrows()}
    ranked = wide.apply(lambda row: pd.Series(sorted(row, reverse=True)[:2]), axis=1)
    lead = ranked[0] - ranked[1]
    whole = "the whole order stays" if orders == {tuple(results.ranking)} else "further down the order changes"
    text = (
        f"The ranking is stable over {span}: {results.ranking[0]} stays first, never by less than "
        f"{format_fixed(lead.min(), 1)} nat (at {lead.idxmin():g} mm); {whole}."
    )
    statements = [Statement(text, "good")]
    doubtful = results.sensitivity[results.sensitivity["pareto_k"] > PARETO_K_LIMIT]
    if len(doubtful):
        names = join_words([f"{row.variant} at {row.tolerance_mm:g} mm" for row in doubtful.itertuples()])
        statements.append(Statement(f"Evidence by importance sampling is doubtful (Pareto k) for {names}.", "warning"))
    return statements


def _state_model_error(results: Results) -> list[Statement]:
    """Say which variants the data want a model error for, and who leads without it."""
    gain = {
        name: results.fit(name, "free")["log_evidence"] - results.fit(name, "zero")["log_evidence"] for name in results.ranking
    }
    best = results.ranking[0]
    worth = format_fixed(abs(gain[best]), 1)
    if gain[best] < 0:
        text = f"{best} needs no model error τ: setting it to zero raises its log-evidence by {worth} nat"
    else:
        text = f"{best} needs the model error τ: without it its log-evidence falls by {worth} nat"
    needing = [name for name in results.ranking[1:] if gain[name] > 0]
    if needing:
        least = format_fixed(min(gain[name] for name in needing), 1)
        which = "the other variants fall" if len(needing) == len(gain) - 1 else f"{join_words(needing)} fall"
        text += f"; without it {which} by {least} nat or more" if len(needing) > 1 else f"; {needing[0]} falls by {least} nat"
    if len(gain) > 1:
        leader = max(results.ranking, key=lambda name: results.fit(name, "zero")["log_evidence"])
        lead = format_fixed(measure_lead(results, "zero"), 1)
        text += f". With τ = 0 everywhere, {leader} leads by {lead} nat"
        if leader != best:
            return [Statement(f"{text}: not the variant that leads with model error.", "warning")]
    return [Statement(f"{text}.")]


def state_coverage(results: Results) -> list[Statement]:
    """Say how often the 90 % predictive intervals hold the measurements, in both settings."""
    statements = []
    for setting, words in SETTINGS.items():
        coverage = {name: results.fit(name, setting)["calibration"]["interval_90_coverage"] for name in results.ranking}
        narrow = [name for name, share in coverage.items() if is_too_narrow(share, results.summary["n_poses"]["calibration"])]
        span = " to ".join(dict.fromkeys(format_percent(x) for x in (min(coverage.values()), max(coverage.values()))))
        text = f"{words[0].upper()}{words[1:]}, the 90 % predictive intervals hold {span} of the calibration measurements"
        if narrow:
            shares = join_words([f"{name} ({_cover_both(results, name, setting)})" for name in narrow])
            text += f": too narrow, so the posteriors claim more than the data bear out, for {shares}"
        statements.append(Statement(f"{text}.", "warning" if narrow else "plain"))
    return statements


def _cover_both(results: Results, variant: str, setting: str) -> str:
    fit = results.fit(variant, setting)
    text = format_percent(fit["calibration"]["interval_90_coverage"])
    if fit["verification"]:
        text += f", verification {format_percent(fit['verification']['interval_90_coverage'])}"
    return text


def is_too_narrow(coverage: float, n_poses: int) -> bool:
    """Whether a coverage lies two standard errors below 90 %, counting a pose's six components as one trial."""
    return bool(coverage < INTERVAL - 2 * math.sqrt(INTERVAL * (1 - INTERVAL) / max(n_poses, 1)))
