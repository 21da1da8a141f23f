"""What speaks for and against relying on a study's numbers: convergence, stability, model error, coverage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayescal.experiments.shared.headline import NOT_DISTINGUISHABLE
from bayescal.experiments.shared.judgement_page import format_factor
from bayescal.experiments.study.page.results import SETTINGS, StudyResults
from bayescal.experiments.study.page.soundness import choose_setting, describe_bounds, has_doubts, state_soundness
from bayescal.experiments.study.page.variants import (
    find_leaders,
    is_told_apart,
    label_variant,
    measure_spread,
    name_variants,
    read_evidence,
)
from bayescal.limits import AGREEMENT, ESS_BULK_LIMIT, OUT_OF_QUESTION, PARETO_K_LIMIT, RHAT_LIMIT
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_fixed, format_percent, format_plain, format_span, join_words

INTERVAL = 0.90
FEW = 3  # variants to name one by one

NOTHING_GAINED = 0.1
"""Difference of log-evidences, nat, that is no reason for anything."""


def list_failures(results: StudyResults) -> list[Statement]:
    """Return everything that speaks against relying on the numbers, posterior by posterior."""
    failures = []
    for variant, setting, fit in results.fits():
        where = label_variant(results, variant)
        where += f", {SETTINGS[setting]}" if len(results.settings) > 1 else ""
        problems = [one for one in fit["problems"].split("; ") if one]
        if not problems and measure_gap(fit) > AGREEMENT:
            problems = [f"the two log-evidences differ by {format_fixed(measure_gap(fit), 2)} nat, limit {AGREEMENT}"]
        if not problems and not fit["converged"]:
            problems = ["not converged"]
        failures += [Statement(f"{where}: {problem}", "bad") for problem in problems]
    return failures


def title_failures(results: StudyResults) -> str:
    """Return how far the failures reach: to the ranking, or only to posteriors without model error."""
    if len(results.settings) > 1 and passes_with_model_error(results):
        return (
            "Do not rely yet on the posteriors listed here, all without model error; the ranking with model error does "
            "not use them."
        )
    return "Do not rely on these numbers yet. What speaks against them:"


def passes_with_model_error(results: StudyResults) -> bool:
    """Whether every posterior with model error converged and both estimators of its log-evidence agree."""
    return all(_passed(fit) for _, setting, fit in results.fits() if setting == "free")


def _passed(fit: Mapping[str, Any]) -> bool:
    return bool(fit["converged"] and measure_gap(fit) <= AGREEMENT and not fit["problems"])


def measure_gap(fit: Mapping[str, Any]) -> float:
    """Return how far the two log-evidences of a posterior lie apart."""
    return abs(float(fit["log_evidence_importance"] - fit["log_evidence_bridge"]))


def name_or_count(words: list[str], total: int) -> str:
    """Return a few variants by name, many as a count."""
    return join_words(words) if len(words) <= FEW else f"{len(words)} of {total} variants (tables below)"


def state_convergence(results: StudyResults) -> Statement:
    """Say whether all posteriors passed their checks, and by what margin."""
    fits = list(results.fits())
    failed = sum(1 for _, _, fit in fits if not _passed(fit))
    if failed:
        return Statement(
            f"{failed} of {len(fits)} posteriors did not pass their checks (listed above).", "bad", "Checks"
        )
    gap = max(measure_gap(fit) for _, _, fit in fits)
    rhat = max(fit["rhat_max"] for _, _, fit in fits)
    bulk = min(fit["ess_bulk_min"] for _, _, fit in fits)
    text = (
        f"All {len(fits)} posteriors converged: R-hat at most {format_fixed(rhat, 4)} (limit {RHAT_LIMIT}), bulk ESS "
        f"at least {format_fixed(bulk, 0)} (limit {format_fixed(ESS_BULK_LIMIT, 0)}). Both evidence estimators agree "
        f"to {format_fixed(gap, 3)} nat or better (limit {AGREEMENT})."
    )
    if has_doubts(results):
        caveat = "That follows from what was stated of noise and tolerances; what speaks against it stands above."
        return Statement(f"{text} {caveat}", "plain", "Checks")
    return Statement(text, "good", "Checks")


# --- stability -------------------------------------------------------------------------------------------------------


def state_stability(results: StudyResults) -> list[Statement]:
    """Say whether the same variants lead with wider and narrower priors."""
    if not results.has("sensitivity"):
        return []
    wide = results.sensitivity_grid
    if len(results.ranking) == 1 or len(wide) == 1:
        return []
    statements = [_compare_widths(results, wide)]
    found = results.table("sensitivity")
    best = found.groupby("factor")["log_evidence"].transform("max")
    matter = found[found["log_evidence"] > best - OUT_OF_QUESTION]
    unreliable = int((matter["pareto_k"] > PARETO_K_LIMIT).sum())
    if unreliable:
        verb = "is" if unreliable == 1 else "are"
        text = f"{unreliable} of {len(matter)} evidences near the best {verb} unreliable (Pareto k)."
        statements.append(Statement(text, "warning", "Stability"))
    return statements


def _compare_widths(results: StudyResults, wide: pd.DataFrame) -> Statement:
    leaders = find_leaders(results)
    names = name_variants(results, leaders)
    span = f"priors {format_plain(wide.index[0])} to {format_plain(wide.index[-1])} times as wide as the study's"
    rivals = wide.drop(columns=leaders)
    if rivals.empty:
        largest = format_fixed(float((wide.max(axis=1) - wide.min(axis=1)).max()), 1)
        return Statement(f"Over {span} the variants lie within {largest} nat of each other.", lead="Stability")
    lead = wide[leaders].min(axis=1) - rivals.max(axis=1)
    lost = lead[lead < -NOT_DISTINGUISHABLE].index
    if len(lost):
        where = [f"{label_variant(results, str(rivals.loc[t].idxmax()))} at {format_factor(t)}" for t in lost]
        text = f"The ranking is not stable over {span}: not {name_variants(results, leaders, 'or')} comes first but "
        return Statement(f"{text}{join_words(where)}.", "bad", "Stability")
    stay = "stays" if len(leaders) == 1 else "stay"
    if lead.min() > NOT_DISTINGUISHABLE:
        where_least = float(lead.index[int(lead.argmin())])
        least = f"never by less than {format_fixed(lead.min(), 1)} nat (at {format_factor(where_least)})"
        text = f"{names} {stay} first, {least}"
    else:
        text = f"no other variant gets ahead of {names} by more than {format_plain(NOT_DISTINGUISHABLE)} nat"
    if len(leaders) > 1:
        within = (wide[leaders].max(axis=1) - wide[leaders].min(axis=1)).max()
        text += f", with {format_fixed(float(within), 1)} nat or less between them"
    text = f"The ranking is stable over {span}: {text}; {_describe_reversals(results, wide)}."
    return Statement(text, "good", "Stability")


def list_reversals(results: StudyResults, values: Mapping[str, float], limit: float) -> list[tuple[str, str]]:
    """Return pairs (passes, passed): told apart by the evidence, and by more than a limit the other way by a score."""
    ranking = results.ranking
    pairs = [(ranking[j], ranking[i]) for j in range(len(ranking)) for i in range(j)]
    return [
        (low, high) for low, high in pairs if values[low] - values[high] > limit and is_told_apart(results, low, high)
    ]


def _describe_reversals(results: StudyResults, wide: pd.DataFrame) -> str:
    """Name who passes whom at which factor on the priors, beyond what is not told apart anyway."""
    passes: dict[str, list[str]] = {}
    for factor, (_, row) in zip(wide.index, wide.iterrows(), strict=True):
        values = {str(name): float(value) for name, value in row.items()}
        passed: dict[str, int] = {}
        for low, _ in list_reversals(results, values, NOT_DISTINGUISHABLE):
            passed[low] = passed.get(low, 0) + 1
        for low, n in passed.items():
            passes.setdefault(low, []).append(f"{n} {'variant' if n == 1 else 'variants'} at {format_factor(factor)}")
    if not passes:
        return "the whole order stays"
    words = [f"{label_variant(results, name)} passes {join_words(where)}" for name, where in passes.items()]
    return f"further down the order changes ({name_or_count(words, len(wide.columns))})"


# --- model error -----------------------------------------------------------------------------------------------------


def state_model_error(results: StudyResults) -> list[Statement]:
    """Say which variants the data want a model error for, and who leads without it."""
    if "zero" not in results.settings:
        return []
    gain = {name: measure_gain(results, name) for name in results.ranking}
    leaders = find_leaders(results)
    one = len(leaders) == 1
    worth = format_span([abs(gain[name]) for name in leaders])
    need, their = ("needs", "its") if one else ("need", "their")
    if all(abs(gain[name]) < NOTHING_GAINED for name in leaders):
        text = (
            f"To {name_variants(results, leaders)} the model error τ makes no difference: without it "
            f"log-evidence changes by less than {format_fixed(NOTHING_GAINED, 1)} nat"
        )
    elif all(gain[name] < 0 for name in leaders):
        text = (
            f"{name_variants(results, leaders)} {need} no model error τ: setting it to zero raises {their} "
            f"log-evidence by {worth} nat"
        )
    elif all(gain[name] >= 0 for name in leaders):
        fall = f"without it {their} log-evidence falls by {worth} nat"
        text = f"{name_variants(results, leaders)} {need} the model error τ: {fall}"
    else:
        wanting = name_variants(results, [name for name in leaders if gain[name] >= 0])
        text = f"Of {name_variants(results, leaders)} only {wanting} would do worse without the model error τ"
    text += _describe_needing(results, {name: gain[name] for name in gain if name not in leaders})
    return [_compare_without(results, leaders, text)]


def _describe_needing(results: StudyResults, gain: Mapping[str, float]) -> str:
    """Say how far the other variants fall without model error."""
    needing = [name for name in gain if gain[name] >= NOTHING_GAINED]
    if not needing:
        return ""
    least = format_fixed(min(gain[name] for name in needing), 1)
    if len(needing) == 1:
        return f"; {label_variant(results, needing[0])} falls by {least} nat"
    which = (
        "the other variants"
        if len(needing) == len(gain)
        else name_or_count([label_variant(results, name) for name in needing], len(gain))
    )
    return f"; without it {which} fall by {least} nat or more"


def _compare_without(results: StudyResults, leaders: list[str], text: str) -> Statement:
    """Add who leads with the model error set to zero; a warning where it is another variant."""
    if len(results.ranking) == 1:
        return Statement(f"{text}.", lead="Model error")
    without = find_leaders(results, "zero")
    others = [name for name in results.ranking if name not in without]
    lead = ""
    if others:
        least = min(read_evidence(results, name, "zero") for name in without)
        lead = f" by {format_fixed(least - max(read_evidence(results, name, 'zero') for name in others), 1)} nat"
    if set(without) == set(leaders) and len(leaders) > 1:
        spread = format_fixed(measure_spread(results, without, "zero"), 1)
        text = f"{text}. With τ = 0 everywhere the same {len(leaders)} lead{lead}, within {spread} nat."
        return Statement(text, lead="Model error")
    verb = "leads" if len(without) == 1 else "lead"
    text = f"{text}. With τ = 0 everywhere, {name_variants(results, without)} {verb}{lead}"
    if not set(without) & set(leaders):
        return Statement(f"{text}: not the variant that leads with model error.", "warning", "Model error")
    return Statement(f"{text}.", lead="Model error")


def measure_gain(results: StudyResults, name: str) -> float:
    """Return what the model error adds to a variant's log-evidence, nats."""
    return read_evidence(results, name) - read_evidence(results, name, "zero")


# --- coverage --------------------------------------------------------------------------------------------------------


def state_coverage(results: StudyResults) -> list[Statement]:
    """Say how often the 90 % predictive intervals hold the measurements, in both settings."""
    if not results.has("pose_errors"):
        return []
    statements = []
    n_poses = results.summary["n_poses"]["calibration"]
    for setting, words in SETTINGS.items():
        coverage = {name: results.fit(name, setting)["calibration"]["interval_90_coverage"] for name in results.ranking}
        narrow = [name for name, share in coverage.items() if is_too_narrow(share, n_poses)]
        span = " to ".join(dict.fromkeys(format_percent(x) for x in (min(coverage.values()), max(coverage.values()))))
        text = (
            f"{words[0].upper()}{words[1:]}, the 90 % predictive intervals hold {span} of the calibration measurements"
        )
        if narrow:
            shares = [f"{label_variant(results, name)} ({_cover_both(results, name, setting)})" for name in narrow]
            text += ": intervals too narrow for "
            text += name_or_count(shares, len(coverage))
        statements.append(Statement(f"{text}.", "warning" if narrow else "plain", "Coverage"))
    best = results.ranking[0]
    bounds = describe_bounds(results, best, choose_setting(results, best))
    if any(statement.lead == "Bounds" for statement in state_soundness(results)):
        return statements
    return [*statements, Statement(f"{label_variant(results, best)}: {bounds}.", lead="Coverage")]


def _cover_both(results: StudyResults, variant: str, setting: str) -> str:
    fit = results.fit(variant, setting)
    text = format_percent(fit["calibration"]["interval_90_coverage"])
    if fit.get("verification"):
        text += f", verification {format_percent(fit['verification']['interval_90_coverage'])}"
    return text


def is_too_narrow(coverage: float, n_poses: int) -> bool:
    """Whether a coverage lies two standard errors below 90 %, counting a pose's six components as one trial."""
    return bool(coverage < INTERVAL - 2 * math.sqrt(INTERVAL * (1 - INTERVAL) / max(n_poses, 1)))


def read_prior_scale(results: StudyResults) -> float | None:
    """Return the scale of the model error's prior, µm, if the config states it."""
    scale = results.config.get("model_error", {}).get("scale_um")
    return None if scale is None else float(scale)
