"""What to use, how good it is and why: headline, first figures and findings, computed from a study's numbers."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pandas as pd

from bayescal.experiments.shared import knowledge_page
from bayescal.experiments.shared.headline import (
    DECISIVE,
    LIKELY,
    NOT_DISTINGUISHABLE,
    RERUN,
    UNDETERMINED,
    find_rivals,
    rate_probability,
    say_accuracy,
    say_choice,
    say_probability,
    say_requirements,
    state_rivals,
    state_ruled_out,
    write_headline,
)
from bayescal.experiments.shared.knowledge_page import show_predicted_error
from bayescal.experiments.shared.rows import ToolUncertaintyRow
from bayescal.experiments.study.page.data import state_claims, state_comparison, state_data
from bayescal.experiments.study.page.errors import state_held_back, state_outliers
from bayescal.experiments.study.page.functions import state_functions
from bayescal.experiments.study.page.model_error import state_terms
from bayescal.experiments.study.page.parameters import state_undetermined
from bayescal.experiments.study.page.results import ALL, StudyResults, get_number
from bayescal.experiments.study.page.solutions import count_solutions, state_left_out
from bayescal.experiments.study.page.soundness import (
    COVERAGE,
    has_warnings,
    is_sound,
    say_misstated,
    state_convergence,
    state_coverage,
    state_soundness,
)
from bayescal.experiments.study.page.suspicion import say_suspicion, silence
from bayescal.experiments.study.rows import RequirementResultRow
from bayescal.limits import OUT_OF_QUESTION, PARETO_K_LIMIT
from bayescal.report.blocks import KeyFigure, Level, Statement
from bayescal.report.numbers import (
    MICROMETRES,
    format_estimate,
    format_fixed,
    format_odds,
    format_percent,
    format_plain,
    format_significant,
    name_some,
)
from bayescal.report.symbols import describe_deformation, format_amount

CLEAR = 2.0  # standard errors of a difference of elpd from which on it says something


# --- the headline ----------------------------------------------------------------------------------------------------


def state_headline(study: StudyResults) -> str:
    """Return which variant to use, how accurate the tool is against what is required, and what to do next."""
    if "suspected_data_error" in study.summary:
        return write_headline([say_suspicion(study)])
    model, deformation = study.split(study.chosen)
    named = model and study.chosen not in study.own_names
    label = f"{study.label_model(model)} {describe_deformation(deformation)}" if named else ""
    choice = say_choice(study.candidates(), label, has_warnings(study))
    if study.is_preliminary:
        choice = f"Preliminary: {choice[0].lower()}{choice[1:]}"
    accuracy = "; ".join(filter(None, (_say_uncertainty(study), say_requirements(study.required))))
    return write_headline([choice, accuracy, _say_next(study)])


def _say_next(study: StudyResults) -> str:
    """Return the most urgent action: of data, inputs and solutions, then of requirements and poses to measure."""
    if said := say_suspicion(study) or say_misstated(study):
        return f"Next: {said[0].lower()}{said[1:]}" if said[1:2].islower() else f"Next: {said}"
    if not study.fit(study.chosen)["converged"] or find_rivals(study.candidates()):
        return f"Next: run again with {RERUN}"
    if study.is_preliminary:
        return 'Next: run with effort = "standard" in [sampler]'
    if count_solutions(study.fit(study.chosen)) > 1:
        return "Next: exclude all solutions but one"
    if not study.required:
        return "Next: state [requirements]"
    if study.required[""] >= LIKELY:
        return "No further measurement is needed"
    found = knowledge_page.state_next(study.tables, study.chosen, study.units)
    return (
        f"Next: measure the {found[0].text[:1].lower()}{found[0].text[1:]}"
        if found
        else "Next: state other requirements"
    )


def _say_uncertainty(study: StudyResults) -> str:
    """Return the tool's uncertainty over the workspace; nothing of a machine without one."""
    every = study.rows(ToolUncertaintyRow, study.chosen)
    known = [row for row in every if math.isfinite(row.posterior_sd)]
    if not known:
        return UNDETERMINED if every else ""
    what = "tool" if study.summary.get("states_tool", True) else "coordinates"
    amounts = {row.coordinate: format_amount(row.posterior_sd, row.unit, 2, study.units) for row in known}
    where = "measured poses" if study.summary.get("region") == "measured" else "workspace"
    return f"{what} {say_accuracy(amounts)}, rms over the {where}"


# --- the first row of figures ----------------------------------------------------------------------------------------


def list_key_figures(study: StudyResults) -> list[KeyFigure]:
    """Return the figures that the page begins with, those of the variant to use."""
    found = [_show_variant(study), *_show_tool_error(study), *_show_required(study), *_show_coverage(study)]
    fit, fits = study.fit(study.chosen), study.fits.values()
    found.append(KeyFigure("Residual / noise", format_significant(get_number(fit, "reduced_chi"), 2)))
    failed = sum(not is_sound(one) for one in fits)
    checks = f"{len(fits) - failed} of {len(fits)}"
    if study.is_preliminary and not failed:
        found.append(KeyFigure("Checks", "preliminary", "no chains", "warning"))
    else:
        found.append(KeyFigure("Checks passed", checks, "", "bad" if failed else "good"))
    return found if len(found) > 3 else [*found, KeyFigure("Poses", str(study.summary["n_poses"]["calibration"]))]


def _show_variant(study: StudyResults) -> KeyFigure:
    """Return the variant to use and its odds against the next that does not fit equally well."""
    leaders = study.find_leaders()
    others = [name for name in study.compared if name not in leaders]
    level: Level = "plain" if study.fit(study.chosen)["converged"] else "bad"
    if not others or level == "bad":
        odds = f"1 of {len(leaders)} equally good" if len(leaders) > 1 else ""
    else:
        odds = f"odds {format_odds(study.spread((study.best_name, others[0])))}"
    return KeyFigure("Best variant", study.label(study.chosen), odds, level)


def _show_tool_error(study: StudyResults) -> list[KeyFigure]:
    """Return the error at the tool before and after: of held-back poses, else as predicted over the workspace."""
    held = study.table("before_after", study.chosen)
    held = held[held["use"] == "verification"]
    if len(held):
        rms = MICROMETRES * np.sqrt((held[["before_mm", "after_mm"]] ** 2).mean())
        before, after = float(rms["before_mm"]), float(rms["after_mm"])
        level: Level = "good" if after < before else "bad"
        value = f"{format_significant(before, 2)} → {format_significant(after, 2)}"
        return [KeyFigure("Tool error (verification, rms)", value, "µm", level)]
    known = [row for row in study.rows(ToolUncertaintyRow, study.chosen) if math.isfinite(row.posterior_sd)]
    return [show_predicted_error(known, study.units)] if known else []


def _show_required(study: StudyResults) -> list[KeyFigure]:
    """Return with which probability all requirements are kept."""
    if not study.required or not math.isfinite(study.required[""]):
        return [KeyFigure("Requirements", "fail", "", "bad")] if study.required else []
    level = rate_probability(study.required[""])
    return [KeyFigure("Probability of all requirements", say_probability(study.required[""]), "", level)]


def _show_coverage(study: StudyResults) -> list[KeyFigure]:
    """Return how many held-back readings lie in their 90 % intervals."""
    for one in state_held_back(study):
        if math.isfinite(one.value) and one.limit == COVERAGE:
            share, expected = format_percent(one.value), f"of {format_percent(COVERAGE)}"
            return [KeyFigure("Coverage", share, expected, one.level)]
    return []


# --- the verdict -----------------------------------------------------------------------------------------------------


def state_verdict(study: StudyResults) -> list[Statement]:
    """Return the findings, the most important first."""
    found = [
        *state_soundness(study),
        *state_data(study),
        *state_outliers(study),
        *_state_required(study),
        *_state_accuracy(study),
        *state_ruled_out(study.candidates()),
        *state_convergence(study),
        *state_held_back(study),
        *state_prediction(study),
        *state_rivals(study.candidates()),
        *_state_lead(study),
        *_state_pairs(study),
        *state_undetermined(study),
        *state_functions(study),
        *state_claims(study),
        *_state_stability(study),
        *state_coverage(study),
        *state_comparison(study),
        *knowledge_page.state_next(study.tables, study.chosen, study.units),
        *state_terms(study),
        *state_left_out(study),
    ]
    return silence(study, found)


def _state_required(study: StudyResults) -> list[Statement]:
    """Return the largest error that is kept everywhere, of the requirement that is least likely."""
    rows = [row for row in study.rows(RequirementResultRow, study.chosen) if row.requirement != ALL]
    known = [row for row in rows if math.isfinite(row.probability)]
    if not known:
        return []
    worst = max(known, key=lambda row: row.error / row.limit)
    amounts = (f"{format_significant(one, 2)} {worst.unit}" for one in (worst.error, worst.limit))
    error, limit = (one.replace(" °", "°") for one in amounts)
    text = f"Maximum {worst.requirement} error {error} (95 %); limit {limit}."
    level = rate_probability(study.required[""])
    return [Statement(text, level, "Requirements", value=worst.error, limit=worst.limit, unit=worst.unit)]


def _state_accuracy(study: StudyResults) -> list[Statement]:
    """Return how large the errors of measured poses are, of all variants that fit equally well."""
    use, found = study.use, list[Statement]()
    seen = [name for name in study.find_leaders() if study.fit(name)[use]]
    for scale in study.error_scales if seen else ():  # an instrument may stand beside other variants alone
        spans, largest = [], math.nan
        for which in ("mean", "max"):
            values = [scale.read(study.fit(name)[use], which) for name in seen]
            spans.append(" to ".join(dict.fromkeys(format_significant(x, 2) for x in (min(values), max(values)))))
            largest = max(values)
        n = study.count_seen(seen[0], use)
        text = (
            f"{scale.title}: mean {spans[0]}, largest {spans[1]} {scale.unit} at {n} {use} pose{'s' if n != 1 else ''}."
        )
        found.append(Statement(text.replace(" °", "°"), lead="Accuracy", value=largest, unit=scale.unit))
    noise = study.summary.get("measurement_noise_um", {}).get(use)
    if found and noise is not None:
        text = f"Noise of {use} measurements: {format_significant(noise, 2)} µm rms."
        found.append(Statement(text, lead="Accuracy", value=float(noise), unit="µm"))
    return found


# --- evidence --------------------------------------------------------------------------------------------------------


def _state_lead(study: StudyResults) -> list[Statement]:
    """Return which variant fits best and by how much; nothing of a single one that converged."""
    if len(study.compared) < 2:
        return []
    error = 2.0 * max(one.se for one in study.candidates() if one.converged)
    if error > DECISIVE:
        text = "Evidence too uncertain to compare variants."
        return [Statement(text, "warning", "Evidence", value=error, limit=DECISIVE, unit="nat")]
    leaders = study.find_leaders()
    others = [name for name in study.compared if name not in leaders]
    if len(leaders) > 1:
        lead, rest = study.spread(leaders), f"; {study.label(others[0])} follows" if others else ""
        text = f"{study.name_variants(leaders)} fit equally well{rest}."
    else:
        lead = study.spread(study.compared[:2])
        how = "explains the data best" if lead > DECISIVE else "is preferred, not decisively,"
        text = f"{study.label(leaders[0])} {how} over {study.label(study.compared[1])} (odds {format_odds(lead)})."
    return [Statement(text, lead="Evidence", value=lead, limit=DECISIVE, unit="nat")]


def _state_pairs(study: StudyResults) -> list[Statement]:
    pairs = list(combinations(study.compared, 2))
    n_apart = sum(study.distinguishes(*pair) for pair in pairs)
    if not 0 < n_apart < len(pairs) or len(study.compared) < 3:
        return []
    text = f"{n_apart} of {len(pairs)} pairs of variants distinguishable."
    return [Statement(text, lead="Pairs", value=n_apart, limit=len(pairs))]


# --- prediction: poses left out one by one ---------------------------------------------------------------------------


def measure_error(study: StudyResults, one: str, other: str) -> float:
    """Return the standard error of the difference of two variants' elpd LOO, from the differences pose by pose."""
    pointwise = study.table("poses").pivot(index="pose", columns="variant", values="elpd_loo")
    difference = (pointwise[one] - pointwise[other]).dropna().to_numpy()
    return float(np.sqrt(len(difference) * np.var(difference)))


def state_prediction(study: StudyResults) -> list[Statement]:
    """Return whether cross-validation and what was held back name the same variants as the evidence."""
    if len(study.compared) < 2:
        return []
    found = [_compare_order(study)]
    elpd = {name: get_number(study.fit(name), "elpd") for name in study.compared}
    first = max((name for name in elpd if math.isfinite(elpd[name])), key=lambda name: elpd[name], default=None)
    if first is not None and first not in study.find_leaders():
        text = f"{study.label(first)} predicts verification best, with lower evidence."
        found.append(Statement(text, "warning", "Prediction", value=elpd[first], unit="nat"))
    bad = {study.label(name): n for name in study.compared if (n := int(study.fit(name)["n_loo_bad_k"]))}
    if bad:
        text = f"elpd LOO of {name_some(list(bad))} approximate: Pareto k."
        found.append(Statement(text, "warning", "Prediction", value=sum(bad.values()), limit=0.0))
    return found


def _compare_order(study: StudyResults) -> Statement:
    """Return whether elpd LOO has the same variants first as the evidence, by how much, and whether that is clear."""
    values = {variant: get_number(study.fit(variant), "elpd_loo") for variant in study.compared}
    order = sorted(values, key=lambda variant: -values[variant] if values[variant] == values[variant] else math.inf)
    leaders = study.find_leaders()
    others = [variant for variant in order if variant not in leaders]
    agrees = bool(others) and order[0] in leaders
    one = min(leaders, key=values.__getitem__) if agrees else order[0]
    rival = others[0] if agrees else order[1] if one in leaders else max(leaders, key=values.__getitem__)
    gap, error = values[one] - values[rival], measure_error(study, one, rival)
    lead = f"{study.label(order[0])} leads {study.label(rival)} by {format_estimate(gap, error, 1)} nat"
    how: tuple[str, Level] = ("agrees", "good") if order[0] in leaders else ("disagrees", "bad")
    if not gap > CLEAR * error:
        how = "hardly separates the best", "plain"
    text = f"Leave-one-out cross-validation {how[0]}: {lead}."
    return Statement(text, how[1], "Prediction", value=gap, limit=CLEAR * error, unit="nat")


# --- stability with other priors -------------------------------------------------------------------------------------


def _state_stability(study: StudyResults) -> list[Statement]:
    """Return whether the same variants lead with wider and narrower priors."""
    if not study.has("sensitivity"):
        return []
    wide = study.sensitivity_grid[study.compared]
    if len(study.compared) < 2 or len(wide) == 1:
        return []
    found = [_compare_widths(study, wide)]
    rows = study.table("sensitivity")
    best = rows.groupby("factor")["log_evidence"].transform("max")
    matter = rows[rows["log_evidence"] > best - OUT_OF_QUESTION]
    unreliable = int((matter["pareto_k"] > PARETO_K_LIMIT).sum())
    if unreliable:
        text = f"{unreliable} of {len(matter)} leading evidences unreliable (Pareto k)."
        found.append(Statement(text, "warning", "Stability", value=unreliable, limit=0.0))
    return found


def _compare_widths(study: StudyResults, wide: pd.DataFrame) -> Statement:
    leaders = study.find_leaders()
    span = f"priors {format_plain(wide.index[0])} to {format_plain(wide.index[-1])} times as wide"
    rivals = wide.drop(columns=leaders)
    if rivals.empty:
        largest = float((wide.max(axis=1) - wide.min(axis=1)).max())
        text = f"With {span}, all variants stay within {format_fixed(largest, 1)} nat."
        return Statement(text, lead="Stability", value=largest, unit="nat")
    lead = wide[leaders].min(axis=1) - rivals.max(axis=1)
    least = float(lead.min())
    if least < -NOT_DISTINGUISHABLE:
        factor = float(lead.index[int(lead.argmin())])
        text = f"Ranking not stable: {study.label(str(rivals.loc[factor].idxmax()))} leads with priors "
        text += f"{format_plain(factor)} times as wide."
        return Statement(text, "bad", "Stability", value=least, limit=-NOT_DISTINGUISHABLE, unit="nat")
    text = f"Ranking stable with {span}."
    return Statement(text, "good", "Stability", value=least, limit=-NOT_DISTINGUISHABLE, unit="nat")
