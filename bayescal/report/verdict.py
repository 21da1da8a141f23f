"""The verdict of a study in sentences computed from its numbers; every claim names the numbers it rests on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pandas as pd

from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, PARETO_K_LIMIT, RHAT_LIMIT
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

INTERVAL = 0.90
NOT_DISTINGUISHABLE = 1.0  # nats
STRONG = 5.0
SMALL_ELPD = 4.0  # nats of elpd below which a difference says little
FEW = 3  # variants to name one by one
BEYOND_BELIEF = 15.0  # nats from which odds rest on the assumptions, no longer on the data


def state_headline(results: Results) -> str:
    """Return which variant wins and by how much."""
    ranking = results.ranking
    if len(ranking) == 1:
        return f"{ranking[0]} is the only variant, log-evidence {format_fixed(results.best['log_evidence'], 1)} nat."
    behind = {name: results.best["log_evidence"] - results.fit(name, "free")["log_evidence"] for name in ranking}
    tied = [name for name in ranking if not behind[name] > _measure_resolution(results, name)]
    following = next((name for name in ranking if name not in tied), None)
    if len(tied) > 1:
        between = format_fixed(behind[tied[-1]], 2)
        text = f"{join_words(tied)} cannot be told apart: {between} nat of log-evidence between them"
        if following is None:
            return f"{text}."
        return f"{text}; {following} follows {format_fixed(behind[following], 1)} nat behind."
    lead, second = behind[ranking[1]], ranking[1]
    word = "explains the measurements best" if lead > STRONG else "is preferred, not decisively"
    return f"{ranking[0]} {word}, by {format_fixed(lead, 1)} nat over {second} (odds of about {format_odds(lead)})."


def measure_lead(results: Results, setting: str) -> float:
    """Return by how many nats the best variant of a setting leads; NaN for a single variant."""
    values = sorted((results.fit(name, setting)["log_evidence"] for name in results.ranking), reverse=True)
    return values[0] - values[1] if len(values) > 1 else math.nan


def _measure_resolution(results: Results, name: str) -> float:
    """Return the difference to the best variant below which nothing is claimed, nats."""
    return max(
        NOT_DISTINGUISHABLE,
        2 * math.hypot(*(results.fit(n, "free")["log_evidence_se"] for n in (name, results.ranking[0]))),
    )


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
    statements = [_state_accuracy(results), *_state_prediction(results), _state_convergence(results)]
    statements += [
        *_state_stability(results),
        *_state_model_error(results),
        *state_coverage(results),
        *_state_odds(results),
    ]
    return statements


def _state_odds(results: Results) -> list[Statement]:
    if not measure_lead(results, "free") > BEYOND_BELIEF:
        return []
    text = (
        "Odds of this size mean that the measurements rule the other variants out as far as the assumptions hold "
        "(noise model, priors, tolerances); they are no measure of how sure one may be of the assumptions."
    )
    return [Statement(text)]


def _state_prediction(results: Results) -> list[Statement]:
    """Say whether cross-validation and the poses held back name the same variant as the evidence."""
    if len(results.ranking) == 1:
        return []
    statements = [
        _compare_order(
            results, "leave-one-out cross-validation (elpd LOO)", "agrees", lambda fit: float(fit["elpd_loo"])
        )
    ]
    if results.n_verification:
        statements.append(
            _compare_order(results, "the poses held back for verification (elpd)", "agree", read_verification_elpd)
        )
    bad = {name: int(results.fit(name, "free")["elpd_loo_n_bad_k"]) for name in results.ranking}
    doubtful = [f"{name} ({n} {'pose' if n == 1 else 'poses'})" for name, n in bad.items() if n]
    if doubtful:
        text = f"elpd LOO is approximate where Pareto k exceeds {PARETO_K_LIMIT}: {_name_or_count(doubtful, len(bad))}."
        statements.append(Statement(text, "warning"))
    return statements


def read_verification_elpd(fit: dict[str, Any]) -> float:
    """Return the elpd of the poses held back, NaN without such poses."""
    return get_number(fit.get("verification") or {}, "elpd")


def _compare_order(results: Results, name: str, verb: str, score: Callable[[dict[str, Any]], float]) -> Statement:
    values = {variant: score(results.fit(variant, "free")) for variant in results.ranking}
    order = sorted(values, key=lambda variant: -values[variant] if values[variant] == values[variant] else math.inf)
    first, second = order[0], order[1]
    capital = name[0].upper() + name[1:]
    best = results.ranking[0]
    gap = values[first] - values[best if first != best else second]
    lead = f"{first} first, {format_fixed(gap, 1)} nat ahead of {best if first != best else second}"
    if not gap > SMALL_ELPD:
        return Statement(f"{capital} hardly {'separates' if verb == 'agrees' else 'separate'} the best: {lead}.")
    if first != best:
        return Statement(f"{capital} dis{verb}: {lead}.", "bad")
    rest = ""
    if order != results.ranking:
        rest = "; further down the order differs" + (f" ({', '.join(order)})" if len(order) <= FEW else "")
    elif len(order) > 2:
        rest = ", and the same order throughout"
    return Statement(f"{capital} {verb}: {lead}{rest}.", "good")


def _name_or_count(words: list[str], total: int) -> str:
    """Return a few variants by name, many as a count."""
    return join_words(words) if len(words) <= FEW else f"{len(words)} of {total} variants (tables below)"


def _state_accuracy(results: Results) -> Statement:
    use = "verification" if results.n_verification else "calibration"
    errors = results.best[use]
    position = {k: format_significant(MICROMETRES * v, 2) for k, v in errors["position_error_mm"].items()}
    orientation = {k: format_significant(ARCSECONDS * v, 2) for k, v in errors["orientation_error_deg"].items()}
    held = "held back from the fit" if results.n_verification else "used in the fit; none were held back"
    text = (
        f"Accuracy of {results.ranking[0]}: {position['mean']} µm mean and {position['max']} µm largest position "
        f"error, {orientation['mean']}″ mean and {orientation['max']}″ largest orientation error on the "
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
        f"All {len(fits)} posteriors converged: R-hat at most {rhat:.4f} (limit {RHAT_LIMIT}), bulk ESS at least "
        f"{bulk:.0f} (limit {ESS_BULK_LIMIT:.0f}). Both evidence estimators agree to {gap:.3f} nat or better (limit "
        f"{AGREEMENT})."
    )
    return Statement(text, "good")


def _state_stability(results: Results) -> list[Statement]:
    """Say whether the same variant leads under every tolerance of the lengths."""
    best = results.ranking[0]
    if len(results.ranking) == 1:
        return []
    wide = results.sensitivity_grid
    span = f"tolerances of the lengths from {wide.index[0]:g} to {wide.index[-1]:g} mm"
    statements = [_compare_tolerances(wide, best, results.ranking, span)]
    doubtful = int((results.sensitivity["pareto_k"] > PARETO_K_LIMIT).sum())
    if doubtful:
        text = f"{doubtful} of {wide.size} of these evidences are doubtful (importance sampling, Pareto k)."
        statements.append(Statement(text, "warning"))
    return statements


def _compare_tolerances(wide: pd.DataFrame, best: str, ranking: list[str], span: str) -> Statement:
    rivals = wide.drop(columns=best)
    lead = wide[best] - rivals.max(axis=1)
    lost = lead[lead < -NOT_DISTINGUISHABLE].index
    if len(lost):
        where = join_words([f"{rivals.loc[tolerance].idxmax()} at {tolerance:g} mm" for tolerance in lost])
        return Statement(f"The ranking is not stable over {span}: not {best} comes first but {where}.", "bad")
    same = all(list(row.sort_values(ascending=False).index) == ranking for _, row in wide.iterrows())
    whole = "the whole order stays" if same else "further down the order changes"
    if lead.min() > NOT_DISTINGUISHABLE:
        stays = f"{best} stays first, never by less than {format_fixed(lead.min(), 1)} nat (at {lead.idxmin():g} mm)"
    else:
        stays = f"no other variant gets ahead of {best} by more than {NOT_DISTINGUISHABLE:g} nat"
    return Statement(f"The ranking is stable over {span}: {stays}; {whole}.", "good")


def _state_model_error(results: Results) -> list[Statement]:
    """Say which variants the data want a model error for, and who leads without it."""
    gain = {
        name: results.fit(name, "free")["log_evidence"] - results.fit(name, "zero")["log_evidence"]
        for name in results.ranking
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
        everyone = len(needing) == len(gain) - 1
        which = "the other variants fall" if everyone else f"{_name_or_count(needing, len(gain))} fall"
        text += (
            f"; without it {which} by {least} nat or more"
            if len(needing) > 1
            else f"; {needing[0]} falls by {least} nat"
        )
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
        narrow = [
            name for name, share in coverage.items() if is_too_narrow(share, results.summary["n_poses"]["calibration"])
        ]
        span = " to ".join(dict.fromkeys(format_percent(x) for x in (min(coverage.values()), max(coverage.values()))))
        text = (
            f"{words[0].upper()}{words[1:]}, the 90 % predictive intervals hold {span} of the calibration measurements"
        )
        if narrow:
            shares = _name_or_count(
                [f"{name} ({_cover_both(results, name, setting)})" for name in narrow], len(coverage)
            )
            text += f": too narrow, so the posteriors claim more than the data bear out, for {shares}"
        statements.append(Statement(f"{text}.", "warning" if narrow else "plain"))
    return statements


def _cover_both(results: Results, variant: str, setting: str) -> str:
    fit = results.fit(variant, setting)
    text = format_percent(fit["calibration"]["interval_90_coverage"])
    if fit.get("verification"):
        text += f", verification {format_percent(fit['verification']['interval_90_coverage'])}"
    return text


def is_too_narrow(coverage: float, n_poses: int) -> bool:
    """Whether a coverage lies two standard errors below 90 %, counting a pose's six components as one trial."""
    return bool(coverage < INTERVAL - 2 * math.sqrt(INTERVAL * (1 - INTERVAL) / max(n_poses, 1)))
