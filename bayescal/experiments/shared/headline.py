"""The rules by which every page says what to use and how good it is: odds, convergence, accuracy, requirements.

- Variants are compared within one set of data. Where two log-evidences differ by less than 1 nat, or by less than twice
  the error of their estimates, the variants fit equally well, and the simplest of them is the one to use.
- What did not converge is not used, not ranked, not compared and never called converged; where it may be better, that
  is said in words.
- One variant by itself is not ranked.
- A variant that is ruled out is not shown as the more accurate one without saying so.
- An accuracy says whether it is a standard uncertainty or which coverage it has.
- A requirement is met with a probability.
- Where data seem to be wrong, that is said first, and nothing is advised that takes it for the machine's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bayescal.experiments.runner.results import Summary
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_percent, name_some

NOT_DISTINGUISHABLE = 1.0
"""Difference of log-evidences, nat, below which two variants fit equally well."""
DECISIVE = 5.0
"""The same from which on the worse variant is ruled out: odds of 150 to 1."""
UNDETERMINED = "own sensors do not determine the pose"
LIKELY = 0.9
"""Probability from which on a requirement counts as safely met."""
RERUN = "more `steps` and `burn_in` in `[sampler]`"
"""What cures sampling that did not converge, unless its problems name another cure."""
ESTIMATES = (
    *("log_evidence", "log_evidence_se", "log_evidence_importance", "log_evidence_importance_se"),
    *("log_evidence_bridge", "log_evidence_bridge_se", "efficiency", "pareto_k"),
    *("elpd_loo", "elpd_loo_se", "elpd_loo_difference", "elpd_loo_difference_se", "stacking_weight"),
    *("loo_pareto_k_max", "misfit_chi2", "misfit_dof", "prior_chi2", "prior_dof"),
    *("rhat_max", "ess_bulk_min", "ess_tail_min", "elpd", "reduced_chi"),
    *("distance_from_nominal_mm", "distance_from_nominal_prior_sd"),
)
"""Of a variant in a study's summary: numbers that may not have come out, which JSON says by null."""
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


@dataclass(frozen=True)
class Candidate:
    """A variant among those of the same data."""

    name: str  # with label: of the results, and as the page calls it
    label: str
    log_evidence: float  # with se: with the standard error of its estimate, nat
    se: float = 0.0
    converged: bool = True
    # what makes it simple, the first first: free parameters, then whatever else orders variants
    size: tuple[int, ...] = ()
    error: float = math.nan  # of predictions, in any unit that all candidates share; NaN where none is known

    def is_distinguishable(self, other: Candidate) -> bool:
        """Whether two log-evidences differ by more than 1 nat and by more than twice the error of the estimates."""
        gap = abs(self.log_evidence - other.log_evidence)
        return gap > max(NOT_DISTINGUISHABLE, 2.0 * math.hypot(self.se, other.se))


def group_candidates(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return candidates in groups by evidence, the best group first; none is distinguishable from its group's best.

    Those that did not converge are in none. Within a group the simplest comes first; those that are equally simple keep
    their order.
    """
    groups: list[list[Candidate]] = []
    sound = [one for one in candidates if one.converged]
    for one in sorted(sound, key=lambda one: -one.log_evidence):
        if groups and not groups[-1][0].is_distinguishable(one):
            groups[-1].append(one)
        else:
            groups.append([one])
    return [sorted(group, key=lambda one: (one.size, candidates.index(one))) for group in groups]


def order_candidates(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return candidates by evidence, but those that fit as well as the best before all, the simplest of them first.

    Those that did not converge come last.
    """
    first = next(iter(group_candidates(candidates)), [])
    others = [one for one in candidates if one not in first]
    return [*first, *sorted(others, key=lambda one: (not one.converged, -rank_evidence(one.log_evidence)))]


def rank_evidence(log_evidence: float | None) -> float:
    """Return a log-evidence by which variants are ordered: one that did not come out is behind all others."""
    return -math.inf if log_evidence is None or not math.isfinite(log_evidence) else log_evidence


def find_rivals(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return those that did not converge and that may be better than the one to use; none where none converged."""
    chosen = choose_candidate(candidates)
    failed = [one for one in candidates if chosen.converged and not one.converged]
    return [one for one in failed if not one.log_evidence < chosen.log_evidence or not one.is_distinguishable(chosen)]


def choose_candidate(candidates: Sequence[Candidate]) -> Candidate:
    """Return the one to use: the simplest that fits as well as the best, of those that converged where any did."""
    groups = group_candidates(candidates)
    return groups[0][0] if groups else max(candidates, key=lambda one: rank_evidence(one.log_evidence))


def read_rows(summary: Summary) -> dict[str, Summary]:
    """Return what a study's summary says of each variant, NaN for an estimate that has no number."""
    return {name: _fill_row(row) if isinstance(row, dict) else row for name, row in summary["variants"].items()}


def _fill_row(row: Summary) -> Summary:
    return {key: math.nan if value is None and key in ESTIMATES else value for key, value in row.items()}


def list_candidates(summary: Summary) -> list[Candidate]:
    """Return the variants of the most data of a study's summary, of which one is to be used, in the study's order."""
    rows = read_rows(summary)
    ranking = max(summary["rankings"], key=lambda names: (rows[names[0]].get("n_equations", 0), len(names)))
    return [describe_candidate(name, row) for name, row in rows.items() if name in ranking]


def describe_candidate(name: str, row: Summary) -> Candidate:
    """Return a variant of a row of the summary."""
    title, evidence = str(row["title"]), (float(row["log_evidence"]), float(row["log_evidence_se"]))
    errors = (row.get(f"{use}_position_error_max_mm") for use in ("verification", "calibration"))
    error = next((float(one) for one in errors if one is not None), math.nan)
    return Candidate(name, label_title(title), *evidence, bool(row["converged"]), (int(row["n_parameters"]),), error)


def label_title(title: str) -> str:
    """Return what pages call a variant of a title: in quotation marks where it has several words."""
    return f"“{title}”" if " " in title else title


def choose_best(summary: Summary) -> str:
    """Return the name of the variant to use."""
    return choose_candidate(list_candidates(summary)).name


def say_choice(candidates: Sequence[Candidate], label: str = "", careful: bool = False) -> str:
    """Return ``Use X, the simplest of three that fit equally well``, or that none may be used yet.

    Parameters
    ----------
    candidates : sequence of Candidate
        Of the same data.
    label : str
        What to call the chosen one, where that is not its label.
    careful : bool
        Whether warnings speak against assumptions.
    """
    chosen = choose_candidate(candidates)
    words, failed = f"Use {label or chosen.label}", [one for one in candidates if not one.converged]
    if not chosen.converged:
        return f"Use none yet: not converged (best so far: {label or chosen.label})"
    if rivals := find_rivals(candidates):
        names = name_some([one.label for one in rivals])
        return f"Use none yet: {names} did not converge (best so far: {label or chosen.label})"
    alike = group_candidates(candidates)[0]
    if len(candidates) == 1:
        words += ", the only variant"
    elif len(alike) > 1:
        simplest = "the simplest" if alike[0].size < alike[1].size else "one"
        words += f", {simplest} of {say_count(len(alike))} that fit equally well"
    if failed:
        words += f" ({say_count(len(failed))} of {len(candidates)} did not converge)"
    return f"{words}, with care (see warnings)" if careful else words


def state_rivals(candidates: Sequence[Candidate]) -> list[Statement]:
    """Return the variants that did not converge and may be better than the one to use."""
    rivals = find_rivals(candidates)
    if not rivals:
        return []
    text = f"{name_some([one.label for one in rivals])} did not converge and may be better."
    return [Statement(text, "warning", "Evidence", value=len(rivals), limit=0.0, action=f"Use {RERUN}.")]


def state_ruled_out(candidates: Sequence[Candidate]) -> list[Statement]:
    """Return the variant with the smallest error where the data reject it against the one to use."""
    chosen = choose_candidate(candidates)
    less = [
        one
        for one in candidates
        if one.error < chosen.error
        and one.converged
        and chosen.log_evidence - one.log_evidence > DECISIVE
        and chosen.is_distinguishable(one)
    ]
    if not less:
        return []
    best = min(less, key=lambda one: one.error)
    text = f"{best.label} has the smaller position error, but is rejected by the data."
    value = best.log_evidence - chosen.log_evidence
    return [Statement(text, "warning", "Accuracy", value=value, limit=-DECISIVE, unit="nat")]


# --- phrases ---------------------------------------------------------------------------------------------------------


def say_count(number: int) -> str:
    """Return a small number as a word."""
    return NUMBERS[number] if number < len(NUMBERS) else str(number)


def say_probability(probability: float, decimals: int = 0) -> str:
    """Return a probability as per cent, never as certain."""
    least = 10.0 ** (-2 - decimals)
    if probability > 1.0 - 0.5 * least:
        return f"more than {format_percent(1.0 - least, decimals)}"
    if probability < 0.5 * least:
        return f"less than {format_percent(least, decimals)}"
    return format_percent(probability, decimals)


def say_accuracy(amounts: Mapping[str, str], coverage: float | None = None) -> str:
    """Return ``x 0.013 mm, y 0.020 mm (standard uncertainty, k = 1)``.

    Parameters
    ----------
    amounts : mapping of str to str
        What is uncertain, with its uncertainty and unit.
    coverage : float, optional
        Probability of the interval, where the uncertainty is expanded.
    """
    words = ", ".join(f"{name} {amount}" for name, amount in amounts.items())
    what = "standard uncertainty, k = 1" if coverage is None else f"{format_percent(coverage)} coverage"
    return f"{words} ({what})"


def say_requirements(probabilities: Mapping[str, float]) -> str:
    """Return whether requirements pass and with which probability, with the least likely of several.

    Parameters
    ----------
    probabilities : mapping of str to float
        Of each requirement by its name; of one called ``""``, of all of them together.
    """
    each = {name: one for name, one in probabilities.items() if name}
    if not each:
        return "requirements not stated"
    if not all(map(math.isfinite, each.values())):
        return f"requirements fail: {UNDETERMINED}"
    least = min(each, key=lambda name: each[name])
    together = probabilities.get("", math.nan)
    together = together if math.isfinite(together) else each[least]
    words = f"requirements {'pass' if together >= LIKELY else 'fail'}: P = {say_probability(together)}"
    return words if len(each) == 1 else f"{words} for all {len(each)}, least {least} {say_probability(each[least])}"


def rate_probability(probability: float) -> Level:
    """Return how good the news is that a requirement is met with a probability."""
    return "good" if probability >= LIKELY else "warning" if probability >= 0.5 else "bad"


def say_data_first(suspicion: str) -> str:
    """Return the first sentence of a headline of data that seem to be wrong: nothing else is advised beside it."""
    return f"Correct the data first: {suspicion}"


def write_headline(parts: Iterable[str]) -> str:
    """Return sentences in one line: each begins with a capital letter and ends with a full stop."""
    said = [one.strip().rstrip(".") for one in parts if one.strip()]
    return " ".join(f"{one[0].upper()}{one[1:]}." for one in said)
