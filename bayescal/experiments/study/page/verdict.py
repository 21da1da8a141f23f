"""What to use, how good it is and why, in sentences computed from a study's numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pandas as pd

from bayescal.experiments.frame.results import Row
from bayescal.experiments.shared import knowledge_page
from bayescal.experiments.shared.headline import (
    DECISIVE,
    LIKELY,
    NOT_DISTINGUISHABLE,
    rate_probability,
    say_accuracy,
    say_choice,
    say_named_first,
    say_odds,
    say_requirements,
    state_rivals,
    state_ruled_out,
    write_headline,
)
from bayescal.experiments.study.page.data import state_claims, state_comparison, state_data
from bayescal.experiments.study.page.errors import state_held_back, state_outliers
from bayescal.experiments.study.page.functions import state_functions
from bayescal.experiments.study.page.model_error import LEAD, state_terms
from bayescal.experiments.study.page.parameters import state_undetermined
from bayescal.experiments.study.page.results import ALL, StudyResults, get_number
from bayescal.experiments.study.page.solutions import say_headline
from bayescal.experiments.study.page.soundness import (
    has_warnings,
    name_or_count,
    say_misstated,
    state_convergence,
    state_coverage,
    state_soundness,
)
from bayescal.experiments.study.page.suspicion import say_suspicion, silence
from bayescal.limits import OUT_OF_QUESTION, PARETO_K_LIMIT
from bayescal.report.blocks import Statement
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_plain,
    format_significant,
    format_span,
    join_words,
)
from bayescal.report.symbols import describe_deformation, format_amount

BEYOND_BELIEF = 15.0  # nats from which odds rest on the assumptions, no longer on the data
CLEAR = 2.0  # standard errors of a difference of elpd from which on it says something
SEVERITY = ("good", "plain", "warning", "bad")


# --- the headline ----------------------------------------------------------------------------------------------------


def state_headline(study: StudyResults) -> str:
    """Return which variant to use and how accurate it is."""
    model, deformation = study.split(study.chosen)
    named = model and study.chosen not in study.own_names
    label = f"{study.label_model(model)} {describe_deformation(deformation)}" if named else ""
    choice = say_choice(study.candidates(), label, has_warnings(study))
    if "slip" in study.summary:
        return write_headline([say_suspicion(study)])
    choice = f"{said} Then {choice[0].lower()}{choice[1:]}" if (said := say_suspicion(study)) else choice
    whole = "; ".join(filter(None, (choice, _say_uncertainty(study))))
    return write_headline(["" if said else say_misstated(study), whole, say_headline(study), _say_required(study)])


def _say_required(study: StudyResults) -> str:
    """Return whether requirements are passed, and how probably."""
    found = study.required
    if not found:
        return f"{say_requirements({})}; state them in [requirements]"
    if not math.isfinite(found[""]):
        return "Requirements fail: its own sensors do not determine where the machine is"
    result = "pass" if found[""] >= LIKELY else "fail"
    return f"Requirements {result}: {say_requirements(found)}"


def _state_required(study: StudyResults) -> list[Statement]:
    """Say which error is kept everywhere, of the requirement that is least likely."""
    rows = [row for row in study.rows("requirements", study.chosen) if row["requirement"] != ALL]
    known = [row for row in rows if math.isfinite(row["probability"])]
    if not known:
        return []
    worst = max(known, key=lambda row: row["error"] / row["limit"])
    amounts = (f"{format_significant(worst[one], 2)} {worst['unit']}" for one in ("error", "limit"))
    error, limit = (one.replace(" °", "°") for one in amounts)
    text = (
        f"{worst['requirement']}: with a probability of 95 % no pose of the workspace errs by more than {error}; "
        f"allowed are {limit}."
    )
    return [Statement(text, rate_probability(study.required[""]), "Requirements")]


def _say_uncertainty(study: StudyResults) -> str:
    """Return the tool's uncertainty over the workspace; nothing of a machine without one."""
    every = study.rows("accuracy", study.chosen)
    known = [row for row in every if math.isfinite(row["after"])]
    if not every:
        return ""
    if not known:
        return "its own sensors do not determine where the machine is"
    what = "tool" if study.summary.get("states_tool", True) else "coordinates"
    amounts = {row["coordinate"]: format_amount(row["after"], row["unit"], 2, study.units) for row in known}
    measured = study.summary.get("region") == "measured"  # no workspace was stated
    where = "the range of the measured poses" if measured else "the workspace"
    said = f"{what} {say_accuracy(amounts)}, rms over {where}"
    said += f" with base and tool aligned{_say_unaligned(study, known)}" if study.aligned else ""
    lengths = [row for row in known if row["unit"] == "mm"] or known[:1]
    worst = max(lengths, key=lambda row: row.get("worst", 0.0))
    if "worst" not in worst:
        return said
    largest = format_amount(worst["worst"], worst["unit"], 2, study.units)
    return f"{said}; largest {worst['coordinate']} {largest}"


def _say_unaligned(study: StudyResults, known: list[Row]) -> str:
    """Return the same without alignment in brackets, where it is another number."""
    pairs = {}
    for row in known:
        if row["unit"] == "mm":
            both = (format_amount(row[one], row["unit"], 2, study.units) for one in ("after", "unaligned"))
            pairs[row["coordinate"]] = tuple(both)
    if all(after == base for after, base in pairs.values()):
        return ""
    return f" (unaligned {', '.join(f'{name} {base}' for name, (_, base) in pairs.items())})"


def _state_frame(study: StudyResults) -> list[Statement]:
    """Say why accuracy with base and tool aligned is another one than without, where it is."""
    rows = study.rows("accuracy", study.chosen) if study.aligned else []
    if not _say_unaligned(study, [row for row in rows if math.isfinite(row["after"])]):
        return []
    return [Statement(f"Accuracy is stated with base and tool aligned. {knowledge_page.ALIGNED}", lead="Frame")]


# --- the verdict -----------------------------------------------------------------------------------------------------


def state_verdict(study: StudyResults) -> list[Statement]:
    """Return the sentences below the headline, the most important first."""
    found = [
        *state_soundness(study),
        *state_data(study),
        *state_outliers(study),
        *_state_required(study),
        *_state_accuracy(study),
        *_state_frame(study),
        *state_ruled_out(study.candidates(), "largest position error"),
        *state_convergence(study),
        *state_held_back(study),
        *state_prediction(study),
        *state_rivals(study.candidates()),
        *_state_lead(study),
        *_state_deformations(study),
        *_state_models(study),
        *_state_free_sets(study),
        *_state_pairs(study),
        *state_undetermined(study),
        *state_functions(study),
        *state_claims(study),
        *_state_stability(study),
        *state_coverage(study),
        *_state_odds(study),
        *state_comparison(study),
        *knowledge_page.state_next(study.tables, study.chosen, study.units),
    ]
    return silence(study, _tell_model_error(state_terms(study), found, len(state_soundness(study))))


def _tell_model_error(own: list[Statement], others: list[Statement], place: int) -> list[Statement]:
    """Return all that is said of the model error in one statement, at a place among the others."""
    own = [*own, *(one for one in others if one.lead == LEAD)]
    rest = [one for one in others if one.lead != LEAD]
    if not own:
        return rest
    level = max((one.level for one in own), key=SEVERITY.index)
    together = Statement(" ".join(one.text for one in own), level, LEAD)
    return [*rest[:place], together, *rest[place:]]


def _state_accuracy(study: StudyResults) -> list[Statement]:
    """Say how large the errors of measured poses are, of all variants that fit equally well."""
    use = study.use
    seen, errors = [name for name in study.find_leaders() if study.fit(name)[use]], list[str]()
    for scale in study.error_scales if seen else ():  # an instrument may stand beside other variants alone
        sizes = {}
        for which in ("mean", "max"):
            values = [scale.read(study.fit(name)[use], which) for name in seen]
            sizes[which] = " to ".join(dict.fromkeys(format_significant(x, 2) for x in (min(values), max(values))))
        mean, largest = (f"{sizes[which]} {scale.unit}".replace(" °", "°") for which in ("mean", "max"))
        errors.append(f"{mean} mean and {largest} largest {scale.what} error")
    if not errors:
        return []
    noise = study.summary.get("measurement_noise_um", {}).get(use)
    measured = "" if noise is None else f"; the measurement's own noise is {format_significant(noise, 2)} µm rms"
    held = "held back from the fit" if study.n_verification else "used in the fit; none were held back"
    n = study.count_seen(seen[0], use)
    poses = f"{n} {use} pose{'s' if n != 1 else ''}"
    text = f"{study.name_variants(seen)}: {', '.join(errors)} on the {poses} ({held}){measured}."
    return [Statement(text, lead="Accuracy")]


# --- evidence --------------------------------------------------------------------------------------------------------


def _state_lead(study: StudyResults) -> list[Statement]:
    """Say which variant fits best and by how much; nothing of a single one that converged."""
    if len(study.compared) < 2:
        return []
    error = 2.0 * max(one.se for one in study.candidates() if one.converged)
    if error > DECISIVE:
        text = f"The evidence is uncertain by {format_fixed(error, 0)} nat, too much to compare the variants."
        return [Statement(text, "warning", "Evidence")]
    return [Statement(describe_lead(study), lead="Evidence")]


def describe_lead(study: StudyResults) -> str:
    """Return which variant fits best and by how much, or which fit equally well."""
    best, leaders = study.best_name, study.find_leaders()
    others = [name for name in study.compared if name not in leaders]
    if len(leaders) > 1:
        within = f"{format_fixed(study.spread(leaders), 2)} nat of log-evidence between them"
        first = f" {named}." if (named := say_named_first(study.candidates())) else ""
        if not others:
            return f"{study.name_variants(leaders)} fit equally well: {within}.{first}"
        behind = study.spread((best, others[0]))
        words = "fit the measurements best and equally well" if behind > DECISIVE else "fit equally well"
        follows = f"{study.label(others[0])} follows {format_fixed(behind, 1)} nat behind"
        return f"{study.name_variants(leaders)} {words}: {within}; {follows}.{first}"
    lead = study.spread(study.compared[:2])
    word = "explains the measurements best" if lead > DECISIVE else "is preferred, not decisively"
    second = study.label(study.compared[1])
    return f"{study.label(best)} {word}, by {format_fixed(lead, 1)} nat over {second} ({say_odds(lead)})."


def _state_deformations(study: StudyResults) -> list[Statement]:
    """Say what the best variant's deformation adds against the others, model by model."""
    best = study.split(study.best_name)[1]
    parts = {}
    for other in (d for d in study.deformations if d != best):
        gaps = {}
        for model in study.models:
            one, two = (study.find_best(model, deformation) for deformation in (best, other))
            if one is not None and two is not None:
                gaps[study.label_model(model)] = study.evidence(one) - study.evidence(two)
        if gaps:
            parts[other] = (max(gaps.values()), f"of {other} by {_describe_gaps(gaps)}")
    if not parts or len(study.compared) < 3:
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


def _describe_groups(study: StudyResults, labels: Mapping[str, str], against_first: bool) -> str:
    """Return which variants fit equally well and how far below them the others lie, group by group.

    ``labels`` say what to call each; several that lead are represented by their first, by name, or by their best.
    """
    first, *rest = study.group(list(labels))
    lead = join_words([labels[name] for name in first])
    words, below = [f"{lead} leads"], ""
    if len(first) > 1:
        words = [f"{lead} fit equally well ({format_fixed(study.spread(first), 1)} nat)"]
        below = f" {labels[first[0]]}" if against_first else ""
    reference = study.evidence(first[0]) if against_first else max(study.evidence(name) for name in first)
    for group in rest:
        gaps = format_span([reference - study.evidence(name) for name in group])
        words.append(f"{join_words([labels[name] for name in group])} {gaps} nat below{below}")
    return ", ".join(words)


def _state_models(study: StudyResults) -> list[Statement]:
    """Say which models the evidence distinguishes, deformation by deformation, the best first."""
    parts = []
    for deformation in dict.fromkeys(study.split(name)[1] for name in study.compared):
        best = {model: study.find_best(model, deformation) for model in study.models}
        labels = {name: study.label_model(model) for model, name in best.items() if name is not None}
        if len(labels) > 1:
            described = _describe_groups(study, labels, True)
            parts.append(f"{describe_deformation(deformation)}, {described}")
    if not parts or len(study.compared) < 3:
        return []
    text = "; ".join(parts)
    return [Statement(f"{text[0].upper()}{text[1:]}.", lead="Model")]


def _state_free_sets(study: StudyResults) -> list[Statement]:
    """Say which free sets of one model and deformation the evidence distinguishes."""
    parts = []
    for (model, deformation), every in study.free_sets.items():
        names = [name for name in every if name in study.compared]
        if len(names) < 2:
            continue
        described = _describe_groups(study, {name: study.label(name) for name in names}, False)
        parts.append(f"{study.label_model(model)} {describe_deformation(deformation)}: {described}")
    return [Statement(f"{'; '.join(parts)}.", lead="Free parameters")] if parts else []


def _state_pairs(study: StudyResults) -> list[Statement]:
    gaps = {pair: study.spread(pair) for pair in combinations(study.compared, 2)}
    apart = [gap for pair, gap in gaps.items() if study.distinguishes(*pair)]
    tied = [gap for pair, gap in gaps.items() if not study.distinguishes(*pair)]
    if not apart or not tied or len(study.compared) < 3:
        return []
    text = (
        f"Of {len(gaps)} pairs of variants {len(apart)} are distinguishable, by "
        f"{format_fixed(min(apart), 1)} nat or more; the other {len(tied)} lie within {format_fixed(max(tied), 1)} nat."
    )
    return [Statement(text, lead="Pairs")]


def _state_odds(study: StudyResults) -> list[Statement]:
    others = [name for name in study.compared if name not in study.find_leaders()]
    if not others or not study.spread((study.best_name, others[0])) > BEYOND_BELIEF:
        return []
    text = (
        "Odds of this size mean that the measurements rule the other variants out as far as the assumptions hold "
        "(noise model, priors, tolerances); they say nothing about the assumptions."
    )
    return [Statement(text, lead="Odds")]


# --- prediction: poses left out one by one ---------------------------------------------------------------------------


def measure_error(study: StudyResults, one: str, other: str) -> float:
    """Return the standard error of the difference of two variants' elpd LOO, from the differences pose by pose."""
    pointwise = study.table("poses").pivot(index="pose", columns="variant", values="elpd_loo")
    difference = (pointwise[one] - pointwise[other]).dropna().to_numpy()
    return float(np.sqrt(len(difference) * np.var(difference)))


def _compare(study: StudyResults, one: str, other: str) -> tuple[str, bool]:
    """Return how far a variant's elpd LOO lies above another's, with its standard error, and whether that is clear."""
    gap = get_number(study.fit(one), "elpd_loo") - get_number(study.fit(other), "elpd_loo")
    error = measure_error(study, one, other)
    return format_estimate(gap, error, 1), bool(gap > CLEAR * error)


def state_prediction(study: StudyResults) -> list[Statement]:
    """Say whether cross-validation and what was held back name the same variants as the evidence."""
    if len(study.compared) < 2:
        return []
    statements = [_compare_order(study)]
    elpd = {name: get_number(study.fit(name), "elpd") for name in study.compared}
    first = max((name for name in elpd if math.isfinite(elpd[name])), key=lambda name: elpd[name], default=None)
    if first is not None and first not in study.find_leaders():
        text = f"Held-back readings are predicted best by {study.label(first)}, which the evidence ranks lower."
        statements.append(Statement(text, "warning", "Prediction"))
    refitted = sum(int(study.fit(name)["loo_refitted"]) for name in study.compared)
    bad = {name: int(study.fit(name)["loo_unreliable"]) for name in study.compared}
    unreliable = [f"{study.label(name)} ({n} {'pose' if n == 1 else 'poses'})" for name, n in bad.items() if n]
    if unreliable:
        named = name_or_count(unreliable, len(bad))
        text = f"elpd LOO is approximate where Pareto k exceeds {PARETO_K_LIMIT} and no run left the pose out: {named}."
        statements.append(Statement(text, "warning", "Prediction"))
    elif refitted:
        were = "1 pose was" if refitted == 1 else f"{refitted} poses were"
        text = f"{were} left out by runs of their own, since Pareto k exceeded {PARETO_K_LIMIT} there."
        statements.append(Statement(text, lead="Prediction"))
    return statements


def _compare_order(study: StudyResults) -> Statement:
    name = "Leave-one-out cross-validation (elpd LOO)"
    values = {variant: get_number(study.fit(variant), "elpd_loo") for variant in study.compared}
    order = sorted(values, key=lambda variant: -values[variant] if values[variant] == values[variant] else math.inf)
    leaders = study.find_leaders()
    others = [variant for variant in order if variant not in leaders]
    first = order[0]
    if not others or first not in leaders:
        rival = order[1] if first in leaders else max(leaders, key=values.__getitem__)
        gap, clear = _compare(study, first, rival)
        lead = f"{study.label(first)} first, {gap} nat ahead of {study.label(rival)}"
    else:
        last = min(leaders, key=values.__getitem__)
        gap, clear = _compare(study, last, others[0])
        among = f"{study.label(first)} first"
        if len(leaders) > 1:
            spread = format_fixed(max(values.values()) - values[last], 1)
            among = f"the same {len(leaders)} lead with {spread} nat between them"
        lead = f"{among}, {gap} nat ahead of {study.label(others[0])}"
        lead += _describe_rest(study) if clear else ""
    if not clear:
        return Statement(f"{name} hardly separates the best: {lead}.", lead="Prediction")
    if first not in leaders:
        return Statement(f"{name} disagrees: {lead}.", "bad", "Prediction")
    return Statement(f"{name} agrees: {lead}.", "good", "Prediction")


def _describe_rest(study: StudyResults) -> str:
    """Say whether the order further down contradicts the evidence by more than two standard errors."""
    if len(study.compared) < 3:
        return ""
    pairs = [(low, high) for high, low in combinations(study.compared, 2) if study.distinguishes(low, high)]
    n = sum(_compare(study, low, high)[1] for low, high in pairs)
    if not n:
        return "; no pair that the evidence distinguishes is reversed by more than two standard errors"
    return f"; further down {n} {'pair comes' if n == 1 else 'pairs come'} clearly in the other order"


# --- stability with other priors -------------------------------------------------------------------------------------


def _state_stability(study: StudyResults) -> list[Statement]:
    """Say whether the same variants lead with wider and narrower priors."""
    if not study.has("sensitivity"):
        return []
    wide = study.sensitivity_grid[study.compared]
    if len(study.compared) < 2 or len(wide) == 1:
        return []
    statements = [_compare_widths(study, wide)]
    found = study.table("sensitivity")
    best = found.groupby("factor")["log_evidence"].transform("max")
    matter = found[found["log_evidence"] > best - OUT_OF_QUESTION]
    unreliable = int((matter["pareto_k"] > PARETO_K_LIMIT).sum())
    if unreliable:
        verb = "is" if unreliable == 1 else "are"
        text = f"{unreliable} of {len(matter)} evidences near the best {verb} unreliable (Pareto k)."
        statements.append(Statement(text, "warning", "Stability"))
    return statements


def _compare_widths(study: StudyResults, wide: pd.DataFrame) -> Statement:
    leaders = study.find_leaders()
    names = study.name_variants(leaders)
    span = f"priors {format_plain(wide.index[0])} to {format_plain(wide.index[-1])} times as wide as the study's"
    rivals = wide.drop(columns=leaders)
    if rivals.empty:
        largest = format_fixed(float((wide.max(axis=1) - wide.min(axis=1)).max()), 1)
        return Statement(f"Over {span} the variants lie within {largest} nat of each other.", lead="Stability")
    lead = wide[leaders].min(axis=1) - rivals.max(axis=1)
    lost = lead[lead < -NOT_DISTINGUISHABLE].index
    if len(lost):
        where = [f"{study.label(str(rivals.loc[t].idxmax()))} at {format_plain(t)} ×" for t in lost]
        text = f"The ranking is not stable over {span}: not {study.name_variants(leaders, 'or')} comes first but "
        return Statement(f"{text}{join_words(where)}.", "bad", "Stability")
    if lead.min() > NOT_DISTINGUISHABLE:
        verb, where_least = "stays" if len(leaders) == 1 else "stay", float(lead.index[int(lead.argmin())])
        least = f"never by less than {format_fixed(lead.min(), 1)} nat (at {format_plain(where_least)} ×)"
        text = f"{names} {verb} first, {least}"
    else:
        text = f"no other variant gets ahead of {names} by more than {format_plain(NOT_DISTINGUISHABLE)} nat"
    if len(leaders) > 1:
        within = (wide[leaders].max(axis=1) - wide[leaders].min(axis=1)).max()
        text += f", with {format_fixed(float(within), 1)} nat or less between them"
    text = f"The ranking is stable over {span}: {text}; {_describe_reversals(study, wide)}."
    return Statement(text, "good", "Stability")


def _describe_reversals(study: StudyResults, wide: pd.DataFrame) -> str:
    """Name who passes whom at which factor on the priors, beyond what is not distinguishable anyway."""
    ranking = study.compared
    pairs = [(low, high) for k, low in enumerate(ranking) for high in ranking[:k] if study.distinguishes(low, high)]
    passes: dict[str, list[str]] = {}
    for factor, row in zip(wide.index, wide.to_dict("records"), strict=True):
        passing = [low for low, high in pairs if row[low] - row[high] > NOT_DISTINGUISHABLE]
        for low in dict.fromkeys(passing):
            n = passing.count(low)
            said = f"{n} {'variant' if n == 1 else 'variants'} at {format_plain(factor)} ×"
            passes.setdefault(low, []).append(said)
    if not passes:
        return "the whole order stays"
    words = [f"{study.label(name)} passes {join_words(where)}" for name, where in passes.items()]
    return f"further down the order changes ({name_or_count(words, len(wide.columns))})"
