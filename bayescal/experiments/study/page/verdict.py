"""What to use, how good it is and why, in sentences computed from a study's numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bayescal.experiments.shared.headline import (
    DECISIVE,
    NOT_DISTINGUISHABLE,
    say_accuracy,
    say_choice,
    say_odds,
    say_requirements,
    state_ruled_out,
    write_headline,
)
from bayescal.experiments.study.page import checks, claims
from bayescal.experiments.study.page.outliers import state_outliers
from bayescal.experiments.study.page.prediction import state_prediction
from bayescal.experiments.study.page.readings import (
    state_comparison,
    state_data,
    state_functions,
    state_held_back,
    state_next,
    state_undetermined,
)
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.soundness import has_doubts, state_soundness
from bayescal.experiments.study.page.variants import (
    find_best,
    find_free_sets,
    find_leaders,
    group_variants,
    label_model,
    label_variant,
    list_best,
    list_deformations,
    list_models,
    measure_spread,
    name_variants,
    read_evidence,
    split_pairs,
    split_variant,
)
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_fixed, format_significant, format_span, join_words
from bayescal.report.symbols import describe_deformation, format_amount

BEYOND_BELIEF = 15.0  # nats from which odds rest on the assumptions, no longer on the data


# --- the headline ----------------------------------------------------------------------------------------------------


def state_headline(results: StudyResults) -> str:
    """Return which variant to use and how accurate it is."""
    model, deformation = split_variant(results, results.chosen)
    named = model and results.chosen not in results.own_names
    label = f"{label_model(results, model)} {describe_deformation(deformation)}" if named else ""
    choice = say_choice(results.candidates(), label, has_doubts(results))
    required = f"{say_requirements({})}; to judge them run an audit of this study"
    return write_headline([f"{choice}; {_say_accuracy(results)}", required])


def _say_accuracy(results: StudyResults) -> str:
    """Return the tool's uncertainty over the workspace, or errors of measured poses and the measurement's noise."""
    if results.has("accuracy"):
        return _say_uncertainty(results)
    n, held = int(results.summary["n_poses"][results.use]), results.n_verification > 0
    scale = next((one for one in results.error_scales if one.what == "position"), None)
    poses = f"{n} {'held-back' if held else 'fitted'} pose{'s' if n != 1 else ''}"
    if scale is None:
        return f"no position was measured whole on its {poses}"
    errors = results.fit(results.chosen)[results.use]
    largest, mean = (format_significant(scale.read(errors, which), 2) for which in ("max", "mean"))
    noise = results.summary.get("measurement_noise_um", {}).get(results.use)
    measured = "" if noise is None else f"; the measurement's own noise is {format_significant(noise, 2)} µm rms"
    return f"largest error on {poses} {largest} {scale.unit}, mean {mean} {scale.unit}{measured}"


def _say_uncertainty(results: StudyResults) -> str:
    known = [row for row in results.rows("accuracy", results.chosen) if math.isfinite(row["after"])]
    if not known:
        return "its own sensors do not determine where the machine is"
    what = "tool" if results.summary.get("states_tool", True) else "coordinates"
    amounts = {row["coordinate"]: format_amount(row["after"], row["unit"], 2, results.units) for row in known}
    said = f"{what} {say_accuracy(amounts)}, rms over the workspace"
    lengths = [row for row in known if row["unit"] == "mm"] or known[:1]
    worst = max(lengths, key=lambda row: row.get("worst", 0.0))
    if "worst" not in worst:
        return said
    largest = format_amount(worst["worst"], worst["unit"], 2, results.units)
    return f"{said}; largest {worst['coordinate']} {largest}, at {worst['worst_at']}"


# --- the verdict -----------------------------------------------------------------------------------------------------


def state_verdict(results: StudyResults) -> list[Statement]:
    """Return the sentences below the headline, the most important first."""
    return [
        *state_soundness(results),
        *state_data(results),
        *state_outliers(results),
        *_state_accuracy(results),
        *state_ruled_out(results.candidates(), "largest position error"),
        checks.state_convergence(results),
        *state_held_back(results),
        *state_prediction(results),
        *_state_lead(results),
        *_state_deformations(results),
        *_state_models(results),
        *_state_free_sets(results),
        *_state_pairs(results),
        *state_undetermined(results),
        *state_functions(results),
        *claims.state_claims(results),
        *checks.state_stability(results),
        *checks.state_model_error(results),
        *checks.state_coverage(results),
        *_state_odds(results),
        *state_comparison(results),
        *state_next(results),
    ]


def _state_lead(results: StudyResults) -> list[Statement]:
    """Say which variant fits best and by how much; nothing of a single one."""
    if len(results.ranking) == 1:
        return []
    error = 2.0 * max(one.se for one in results.candidates())
    if error > DECISIVE:
        text = f"The evidence is uncertain by {format_fixed(error, 0)} nat, too much to compare the variants."
        return [Statement(text, "warning", "Evidence")]
    return [Statement(describe_lead(results), lead="Evidence")]


def describe_lead(results: StudyResults) -> str:
    """Return which variant fits best and by how much, or which fit equally well."""
    best, leaders = results.best_name, find_leaders(results)
    others = [name for name in results.ranking if name not in leaders]
    if len(leaders) > 1:
        within = f"{format_fixed(measure_spread(results, leaders), 2)} nat of log-evidence between them"
        if not others:
            return f"{name_variants(results, leaders)} fit equally well: {within}."
        behind = measure_spread(results, (best, others[0]))
        words = "fit the measurements best and equally well" if behind > DECISIVE else "fit equally well"
        follows = f"{label_variant(results, others[0])} follows {format_fixed(behind, 1)} nat behind"
        return f"{name_variants(results, leaders)} {words}: {within}; {follows}."
    lead = measure_spread(results, results.ranking[:2])
    word = "explains the measurements best" if lead > DECISIVE else "is preferred, not decisively"
    return (
        f"{label_variant(results, best)} {word}, by {format_fixed(lead, 1)} nat over "
        f"{label_variant(results, results.ranking[1])} ({say_odds(lead)})."
    )


def _state_deformations(results: StudyResults) -> list[Statement]:
    """Say what the best variant's deformation adds against the others, model by model."""
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
    """Say which models the evidence distinguishes, deformation by deformation, the best first."""
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
    """Say which free sets of one model and deformation the evidence distinguishes."""
    parts = []
    for (model, deformation), names in find_free_sets(results).items():
        first, *rest = group_variants(results, names)
        lead = join_words([label_variant(results, name) for name in first])
        spread = format_fixed(measure_spread(results, first), 1)
        words = [f"{lead} fit equally well ({spread} nat)" if len(first) > 1 else f"{lead} leads"]
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
    words = [f"{lead} fit equally well ({spread} nat)" if len(first) > 1 else f"{lead} leads"]
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
        f"Of {len(apart) + len(tied)} pairs of variants {len(apart)} are distinguishable, by "
        f"{format_fixed(min(apart), 1)} nat or more; the other {len(tied)} lie within {format_fixed(max(tied), 1)} nat."
    )
    return [Statement(text, lead="Pairs")]


def _state_accuracy(results: StudyResults) -> list[Statement]:
    """Say how large the errors of measured poses are, of all variants that fit equally well."""
    leaders, use = find_leaders(results), results.use
    errors = []
    for scale in results.error_scales:
        sizes = {}
        for which in ("mean", "max"):
            values = [scale.read(results.fit(name)[use], which) for name in leaders]
            sizes[which] = " to ".join(dict.fromkeys(format_significant(x, 2) for x in (min(values), max(values))))
        mean, largest = (f"{sizes[which]} {scale.unit}".replace(" °", "°") for which in ("mean", "max"))
        errors.append(f"{mean} mean and {largest} largest {scale.what} error")
    if not errors:
        return []
    held = "held back from the fit" if results.n_verification else "used in the fit; none were held back"
    n = results.summary["n_poses"][use]
    text = f"{name_variants(results, leaders)}: {', '.join(errors)} on the {n} {use} poses ({held})."
    return [Statement(text, lead="Accuracy")]


def _state_odds(results: StudyResults) -> list[Statement]:
    others = [name for name in results.ranking if name not in find_leaders(results)]
    if not others or not measure_spread(results, (results.best_name, others[0])) > BEYOND_BELIEF:
        return []
    text = (
        "Odds of this size mean that the measurements rule the other variants out as far as the assumptions hold "
        "(noise model, priors, tolerances); they say nothing about the assumptions."
    )
    return [Statement(text, lead="Odds")]
