"""Several machines that explain the same data: how probable each is, and in what they differ."""

from __future__ import annotations

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.study.page.results import MAX_SOLUTIONS, StudyResults
from bayescal.report.blocks import Column, PageSection, Statement, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, join_words, name_some
from bayescal.report.symbols import ChosenUnits, shown_in

LEAD = "Several solutions"
NAMED = 3  # parameters of a solution that a sentence names
HOW = "Modes of the posterior; accuracy and functions: mode 1."


def count_solutions(fit: Summary) -> int:
    """Return how many solutions a variant's row of the summary has."""
    return max(len(fit.get("modes", [])), 1)


def say_solutions(fit: Summary, asked: ChosenUnits = None) -> str:
    """Return the solutions of a variant's row of the summary with their probabilities; empty where there is one."""
    return "; ".join(_say(k, one, asked) for k, one in enumerate(fit.get("modes", [])[:MAX_SOLUTIONS], start=1))


def _say(number: int, one: Summary, asked: ChosenUnits) -> str:
    words = []
    for name, (mean, sd, unit) in list(one["parameters"].items())[:NAMED]:
        factor, shown = shown_in(unit, asked)
        words.append(f"{name} = {format_estimate(factor * mean, factor * sd)} {shown}".rstrip())
    share = format_estimate(100.0 * one["probability"], 100.0 * one["standard_error"])
    return f"mode {number} with {share} %" + (f": {', '.join(words)}" if words else "")


def state_solutions(study: StudyResults) -> list[Statement]:
    """Return for each variant with several solutions how many and what to do, that of the variant to use first."""
    found = []
    for name in dict.fromkeys([study.chosen, *study.ranking]):
        fit = study.fit(name)
        if (n := count_solutions(fit)) > 1:
            rows = study.list_solutions(name)
            differ = name_some(list(dict.fromkeys(row.parameter for row in rows if row.verdict == "several")))
            text = f"{study.label(name)} has {n} separate solutions{f', which differ in {differ}' if differ else ''}."
            action = "Add a measurement or tolerance."
            found.append(Statement(text, "warning", LEAD, value=n, limit=1.0, action=action))
    return found


def state_left_out(study: StudyResults) -> list[Statement]:
    """Return for each variant with solutions that are not shown how probable these are together."""
    found = []
    for name in dict.fromkeys([study.chosen, *study.ranking]):
        if small := study.fit(name).get("other_modes"):
            share = format_fixed(100.0 * float(small), 2)
            text = f"{study.label(name)}: solutions of {share} % probability are left out."
            found.append(Statement(text, "plain", LEAD, value=float(small)))
    return found


def show_solutions(study: StudyResults) -> PageSection | None:
    """Return the parameters in which solutions differ, each with its values; None where no variant has several."""
    tables = []
    for name in study.ranking:
        modes = study.fit(name).get("modes", [])[:MAX_SOLUTIONS]
        if len(modes) < 2:
            continue
        rows = [row for row in study.list_solutions(name) if row.verdict == "several"]
        columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("Nominal")]
        cells: dict[str, list[str]] = {}
        for k, one in enumerate(modes, start=1):
            columns.append(Column(f"Mode {k}", f"{format_fixed(100.0 * one['probability'], 1)} %"))
        for row in rows:
            if row.mode is None or row.mode > len(modes):
                continue
            factor, unit = study.shown_in(row.unit)
            line = cells.setdefault(row.parameter, [row.parameter, unit, format_fixed(factor * row.nominal, 3)])
            line.append(format_estimate(factor * row.mean, factor * row.sd))
        caption = f"Solutions of {study.label(name)}: posterior mean ± sd."
        tables.append(make_table(caption, columns, list(cells.values())))
    names = join_words([study.label(name) for name in study.ranking if count_solutions(study.fit(name)) > 1])
    return make_section(f"Solutions of {names}", (HOW,), tuple(tables)) if tables else None
