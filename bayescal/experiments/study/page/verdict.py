"""The verdict of a study in sentences computed from its numbers; every claim names the numbers it rests on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayescal.experiments.shared.headline import DECISIVE, NOT_DISTINGUISHABLE, state_ruled_out
from bayescal.experiments.study.page import checks, claims
from bayescal.experiments.study.page.blunders import state_blunders
from bayescal.experiments.study.page.prediction import state_prediction
from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.experiments.study.page.soundness import state_soundness
from bayescal.experiments.study.page.variants import (
    find_best,
    find_free_sets,
    find_leaders,
    group_variants,
    label_model,
    label_variant,
    list_best,
    list_candidates,
    list_deformations,
    list_models,
    measure_spread,
    name_variants,
    read_evidence,
    split_pairs,
    split_variant,
)
from bayescal.report.blocks import Statement
from bayescal.report.numbers import (
    MICROMETRES,
    MILLIDEGREES,
    NOTHING,
    format_fixed,
    format_odds,
    format_significant,
    format_span,
    join_words,
)
from bayescal.report.variant_names import describe_deformation

BEYOND_BELIEF = 15.0  # nats from which odds rest on the assumptions, no longer on the data


def describe_lead(results: StudyResults) -> str:
    """Return which variant wins and by how much, or which share the first place."""
    best = results.ranking[0]
    if len(results.ranking) == 1:
        evidence = format_fixed(results.best["log_evidence"], 1)
        return f"{label_variant(results, best)} is the only variant, log-evidence {evidence} nat."
    leaders = find_leaders(results)
    others = [name for name in results.ranking if name not in leaders]
    if len(leaders) > 1:
        between = format_fixed(measure_spread(results, leaders), 2)
        if not others:
            return (
                f"{name_variants(results, leaders)} cannot be told apart: {between} nat of log-evidence between them."
            )
        behind = measure_spread(results, (best, others[0]))
        words = "explain the measurements best and cannot" if behind > DECISIVE else "cannot"
        return (
            f"{name_variants(results, leaders)} {words} be told apart: {between} nat of log-evidence between them; "
            f"{label_variant(results, others[0])} follows {format_fixed(behind, 1)} nat behind."
        )
    lead = measure_spread(results, results.ranking[:2])
    word = "explains the measurements best" if lead > DECISIVE else "is preferred, not decisively"
    return (
        f"{label_variant(results, best)} {word}, by {format_fixed(lead, 1)} nat over "
        f"{label_variant(results, results.ranking[1])} (odds of about {format_odds(lead)})."
    )


def state_verdict(results: StudyResults) -> list[Statement]:
    """Return the sentences below the headline."""
    return [
        *state_soundness(results),
        *state_blunders(results),
        _state_accuracy(results),
        *state_ruled_out(list_candidates(results, results.ranking), "largest position error"),
        checks.state_convergence(results),
        *state_prediction(results),
        Statement(describe_lead(results), lead="Evidence"),
        *_state_deformations(results),
        *_state_models(results),
        *_state_free_sets(results),
        *_state_pairs(results),
        *claims.state_claims(results),
        *checks.state_stability(results),
        *checks.state_model_error(results),
        *checks.state_coverage(results),
        *_state_odds(results),
    ]


def _state_deformations(results: StudyResults) -> list[Statement]:
    """Say what the best variant's deformation is worth against the others, model by model."""
    best = split_variant(results, results.ranking[0])[1]
    parts = {}
    for other in (d for d in list_deformations(results) if d != best):
        gaps = {}
        for model in list_models(results):
            one, two = (find_best(results, model, deformation) for deformation in (best, other))
            if one is not None and two is not None:
                gaps[label_model(results, model)] = read_evidence(results, one) - read_evidence(results, two)
        if gaps:
            parts[other] = (max(gaps.values()), f"of {other} by {_describe_gaps(gaps)}")
    if not parts or len(results.ranking) < 3:
        return []
    nearest_first = "; ".join(text for _, text in sorted(parts.values()))
    first = "no deformation" if best == "none" else best
    return [Statement(f"With the same model, {first} is ahead {nearest_first}.", lead="Deformation")]


def _describe_gaps(gaps: Mapping[str, float]) -> str:
    """Return differences as spans, those of models alike taken together."""
    clusters: list[list[str]] = []
    for label in sorted(gaps, key=lambda label: -gaps[label]):
        if clusters and gaps[clusters[-1][-1]] - gaps[label] <= NOT_DISTINGUISHABLE:
            clusters[-1].append(label)
        else:
            clusters.append([label])
    words = []
    for cluster in clusters:
        names = [label for label in gaps if label in cluster]
        whose = f" ({join_words(names)})" if len(gaps) > 1 else ""
        words.append(f"{format_span([gaps[name] for name in cluster])} nat{whose}")
    return join_words(words)


def _state_models(results: StudyResults) -> list[Statement]:
    """Say which models the evidence tells apart, deformation by deformation, the best first."""
    parts = []
    for deformation in dict.fromkeys(split_variant(results, name)[1] for name in results.ranking):
        names = list_best(results, deformation)
        if len(names) > 1:
            groups = group_variants(results, names)
            parts.append(f"{describe_deformation(deformation)}, {_describe_groups(results, groups)}")
    if not parts or len(results.ranking) < 3:
        return []
    text = "; ".join(parts)
    return [Statement(f"{text[0].upper()}{text[1:]}.", lead="Model")]


def _state_free_sets(results: StudyResults) -> list[Statement]:
    """Say which free sets of one model and deformation the evidence tells apart."""
    parts = []
    for (model, deformation), names in find_free_sets(results).items():
        first, *rest = group_variants(results, names)
        lead = join_words([label_variant(results, name) for name in first])
        spread = format_fixed(measure_spread(results, first), 1)
        words = [f"{lead} are not told apart ({spread} nat)" if len(first) > 1 else f"{lead} leads"]
        best = max(read_evidence(results, name) for name in first)
        for group in rest:
            below = format_span([best - read_evidence(results, name) for name in group])
            words.append(f"{join_words([label_variant(results, name) for name in group])} {below} nat below")
        parts.append(f"{label_model(results, model)} {describe_deformation(deformation)}: {', '.join(words)}")
    return [Statement(f"{'; '.join(parts)}.", lead="Free parameters")] if parts else []


def _describe_groups(results: StudyResults, groups: Sequence[Sequence[str]]) -> str:
    first, *rest = groups
    lead = join_words([label_model(results, split_variant(results, name)[0]) for name in first])
    spread = format_fixed(measure_spread(results, first), 1)
    words = [f"{lead} are not told apart ({spread} nat)" if len(first) > 1 else f"{lead} leads"]
    reference = read_evidence(results, first[0])
    for group in rest:
        models = join_words([label_model(results, split_variant(results, name)[0]) for name in group])
        below = format_span([reference - read_evidence(results, name) for name in group])
        of = f" {label_model(results, split_variant(results, first[0])[0])}" if len(first) > 1 else ""
        words.append(f"{models} {below} nat below{of}")
    return ", ".join(words)


def _state_pairs(results: StudyResults) -> list[Statement]:
    apart, tied = split_pairs(results)
    if not apart or not tied or len(results.ranking) < 3:
        return []
    text = (
        f"Of {len(apart) + len(tied)} pairs of variants the measurements tell {len(apart)} apart, by "
        f"{format_fixed(min(apart), 1)} nat or more; the other {len(tied)} lie within {format_fixed(max(tied), 1)} nat."
    )
    return [Statement(text, lead="Pairs")]


ERRORS = (
    ("position_error_mm", MICROMETRES, "µm", "position"),
    ("orientation_error_deg", MILLIDEGREES, "mdeg", "orientation"),
)


def _state_accuracy(results: StudyResults) -> Statement:
    use = "verification" if results.n_verification else "calibration"
    leaders = find_leaders(results)
    texts = {}
    for key, factor, _, _ in ERRORS:
        for which in ("mean", "max"):
            values = [factor * get_number(results.fit(name, "free")[use][key], which) for name in leaders]
            words = dict.fromkeys(format_significant(x, 2) for x in (min(values), max(values)))
            texts[key, which] = " to ".join(words)
    held = "held back from the fit" if results.n_verification else "used in the fit; none were held back"
    errors = [
        f"{texts[key, 'mean']} {unit} mean and {texts[key, 'max']} {unit} largest {what} error"
        for key, _, unit, what in ERRORS
        if texts[key, "mean"] != NOTHING
    ]
    return Statement(
        f"{name_variants(results, leaders)}: {', '.join(errors)} on the "
        f"{results.summary['n_poses'][use]} {use} poses ({held}).",
        lead="Accuracy",
    )


def _state_odds(results: StudyResults) -> list[Statement]:
    others = [name for name in results.ranking if name not in find_leaders(results)]
    if not others or not measure_spread(results, (results.ranking[0], others[0])) > BEYOND_BELIEF:
        return []
    text = (
        "Odds of this size mean that the measurements rule the other variants out as far as the assumptions hold "
        "(noise model, priors, tolerances); they are no measure of how sure one may be of the assumptions."
    )
    return [Statement(text, lead="Odds")]
