"""Several machines that explain the same data: how probable each is, and in what they differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayescal.experiments.study.page.results import MANY, SOLUTIONS, StudyResults, name_some
from bayescal.report.blocks import Column, Section, Statement, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, join_words
from bayescal.report.symbols import Asked, shown_in

LEAD = "Several solutions"
NAMED = 3  # parameters of a solution that a sentence names
HOW = (
    "A solution is a separate peak of the posterior, a machine of its own: its probability is its share of the draws, "
    "its intervals are those of its own draws. Means over several solutions are no machine."
)


def count_solutions(fit: Mapping[str, Any]) -> int:
    """Return how many solutions a variant's row of the summary has."""
    return max(len(fit.get("modes", [])), 1)


def say_solutions(fit: Mapping[str, Any], asked: Asked = None) -> str:
    """Return the solutions of a variant's row of the summary with their probabilities; empty where there is one."""
    return "; ".join(_say(k, one, asked) for k, one in enumerate(fit.get("modes", [])[:MANY], start=1))


def _say(number: int, one: Mapping[str, Any], asked: Asked) -> str:
    words = []
    for name, (mean, sd, unit) in list(one["parameters"].items())[:NAMED]:
        factor, shown = shown_in(unit, asked)
        words.append(f"{name} = {format_estimate(factor * mean, factor * sd)} {shown}".rstrip())
    share = format_estimate(100.0 * one["probability"], 100.0 * one["standard_error"])
    return f"mode {number} with {share} %" + (f": {', '.join(words)}" if words else "")


def say_headline(study: StudyResults) -> str:
    """Return the sentence of the headline; empty where the variant to use has one solution."""
    n = count_solutions(study.fit(study.chosen))
    if n < 2:
        return ""
    return (
        f"{n} separate machines explain these data, and {study.label(study.chosen)} is each of them with a probability"
    )


def state_solutions(study: StudyResults) -> list[Statement]:
    """Say of each variant which solutions it has, that of the variant to use first."""
    found = []
    for name in dict.fromkeys([study.chosen, *study.ranking]):
        fit = study.fit(name)
        n, small = count_solutions(fit), fit.get("other_modes")
        if n > 1:
            rows = study.rows(SOLUTIONS, name)
            differ = list(dict.fromkeys(str(row["parameter"]) for row in rows if row["verdict"] == "several"))
            in_what = f" They differ in {name_some(differ)}." if differ else ""
            text = (
                f"{study.label(name)} has {n} solutions: {say_solutions(fit, study.units)}.{in_what} Choose one by a "
                "measurement or a tolerance that only one of them agrees with; until then `export`, `predict` and all "
                "else that needs one machine takes `--mode 1`. Accuracy and functions of this page are those of mode 1."
            )
            found.append(Statement(text, "warning", LEAD))
        if small:
            share = format_fixed(100.0 * float(small), 2)
            others = "other solutions" if n == 1 else "further solutions"
            text = f"{study.label(name)}: {others} have a probability of {share} % together and are left out."
            found.append(Statement(text, "plain", LEAD))
    return found


def show_solutions(study: StudyResults) -> Section | None:
    """Return the parameters in which solutions differ, each with its values; None where no variant has several."""
    tables = []
    for name in study.ranking:
        modes = study.fit(name).get("modes", [])[:MANY]
        if len(modes) < 2:
            continue
        rows = [row for row in study.rows(SOLUTIONS, name) if row["verdict"] == "several"]
        columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("Nominal")]
        cells: dict[str, list[str]] = {}
        for k, one in enumerate(modes, start=1):
            columns.append(Column(f"Mode {k}", f"{format_fixed(100.0 * one['probability'], 1)} %"))
        for row in rows:
            if row["mode"] > len(modes):
                continue
            factor, unit = study.shown_in(row["unit"])
            line = cells.setdefault(
                str(row["parameter"]), [str(row["parameter"]), unit, format_fixed(factor * row["nominal"], 3)]
            )
            line.append(format_estimate(factor * row["mean"], factor * row["sd"]))
        caption = f"Solutions of {study.label(name)}: posterior mean ± sd of the parameters in which they differ."
        tables.append(make_table(caption, columns, list(cells.values())))
    names = join_words([study.label(name) for name in study.ranking if count_solutions(study.fit(name)) > 1])
    return make_section(f"Solutions of {names}", (HOW,), tuple(tables)) if tables else None
