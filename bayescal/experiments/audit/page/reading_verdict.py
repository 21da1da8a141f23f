"""What an audit of a machine of one function says, in sentences computed from its tables."""

from __future__ import annotations

import math
from itertools import groupby
from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.sensor_sets import state_counts, state_sets
from bayescal.experiments.shared.knowledge_page import state_next
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import format_percent, join_words
from bayescal.report.reading import Row, list_rows
from bayescal.report.units import Asked, format_amount

LIKELY = 0.9  # probability, from which what is required counts as safely met


def choose_best(tables: dict[str, pd.DataFrame]) -> str:
    """Return the set of sensors with the largest margin; where nothing is required, that which leaves least error."""
    rows = list_rows(tables["variants"])
    known = [row for row in rows if math.isfinite(row["margin"])]
    if known:
        return str(max(known, key=lambda row: row["margin"])["variant"])
    return str(min(rows, key=lambda row: row["left"] if math.isfinite(row["left"]) else math.inf)["variant"])


def state_headline(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> str:
    """Return with which sensors the machine meets what is required; else how well it would know where it stands."""
    rows = list_rows(tables["variants"])
    if "requirements" in tables:
        met = [f"“{row['title']}” ({format_percent(row['margin'])} margin)" for row in rows if row["met"]]
        if not met:
            return "Plan other sensors or poses: no set of sensors meets what is required."
        others = "" if len(met) == len(rows) else ", and with no other set"
        return f"Use {join_words(met, 'or')}: what is required is met{others}."
    best = choose_best(tables)
    mine = [row for row in list_rows(tables["accuracy"]) if row["variant"] == best and math.isfinite(row["after"])]
    words = [f"{row['coordinate']} to {format_amount(row['after'], row['unit'], 2, summary['units'])}" for row in mine]
    title = next(row["title"] for row in rows if row["variant"] == best)
    if not words:
        return "The machine's own sensors do not tell where it stands."
    return f"With “{title}” the machine would know {join_words(words)} rms over its workspace."


def state_verdict(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    """Return what was found, the most important first."""
    best = choose_best(tables)
    found = [*_state_requirements(tables, summary), *_state_alignment(summary), *_state_data(tables)]
    found += _state_ignorance(tables, summary["member"])
    found += [*state_sets(tables, summary), *state_next(tables, best, summary["units"])]
    return [*found, *_state_selected(tables, summary, best), *state_counts(tables, best)]


def _state_requirements(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    if "requirements" not in tables:
        return [Statement("Nothing is required: [requirements] says what has to be met.", "plain", "Requirement")]
    titles = {row["variant"]: row["title"] for row in list_rows(tables["variants"])}
    together = {row["variant"]: row["probability"] for row in list_rows(tables["variants"])}
    found = []
    for name, rows in groupby(list_rows(tables["requirements"]), key=lambda row: row["variant"]):
        mine = list(rows)
        met, sure = all(row["met"] for row in mine), together[name] >= LIKELY
        level: Level = "good" if met and sure else "warning" if met else "bad"
        words = "; ".join(_compare(row, summary["units"]) for row in mine)
        chance = f"; all of it with {format_percent(together[name])} probability" if together[name] >= 0.0 else ""
        found.append(Statement(f"“{titles[name]}”: {words}{chance}.", level, "Requirement"))
    return found


def _compare(row: Row, asked: Asked) -> str:
    limit = format_amount(row["limit"], row["unit"], 3, asked)
    if not math.isfinite(row["error"]):
        return f"{row['coordinate']} is not told by the machine's own sensors"
    words = f"{row['coordinate']} errs by {format_amount(row['error'], row['unit'], 3, asked)} rms, {limit} allowed"
    if row["met"]:
        return f"{words}, {format_percent(row['margin'])} margin"
    if row["noise"] > row["limit"]:
        return f"{words}: the noise of its own sensors alone is too much, no calibration helps"
    return f"{words}, {format_percent(-row['margin'])} too much"


def _state_alignment(summary: dict[str, Any]) -> list[Statement]:
    text = "All accuracies are after alignment: one motion each of base and tool, the same at all poses, is no error."
    return [Statement(text, "plain", "Frames")] if summary["aligned"] else []


def _state_data(tables: dict[str, pd.DataFrame]) -> list[Statement]:
    return [
        Statement(
            f"“{row['title']}”: {row['n_equations']} equations for {row['n_parameters']} unknowns; what the readings "
            "do not tell would rest on the tolerances stated beforehand.",
            "warning",
            "Data",
        )
        for row in list_rows(tables["variants"])
        if row["n_equations"] < row["n_parameters"]
    ]


def _state_ignorance(tables: dict[str, pd.DataFrame], member: str) -> list[Statement]:
    found = []
    for row in list_rows(tables["variants"]):
        mine = tables["parameters"][tables["parameters"]["variant"] == row["variant"]]
        words = []
        for verdict, said in (("not", "tells hardly anything of"), ("weak", "does not halve the tolerances of")):
            names = [str(name) for name in mine[mine["verdict"] == verdict]["parameter"]]
            words += [f"{said} {_name(names, member)}"] if names else []
        level: Level = "warning" if words else "good"
        text = "; it ".join(words) or "at least halves the tolerance of every free parameter"
        found.append(Statement(f"“{row['title']}” {text}.", level, "Parameters"))
    return found


def _name(names: list[str], member: str) -> str:
    """Return parameters in words, those of one symbol together: ``l of columns 1 and 2``."""
    words = []
    for symbol, group in groupby(names, key=lambda name: name.partition("[")[0]):
        numbers = [name.partition("[")[2].rstrip("]") for name in group]
        if not all(one.isdigit() for one in numbers):
            words += [f"{symbol}[{one}]" if one else symbol for one in numbers]
        else:
            words.append(f"{symbol} of {member}{'s' if len(numbers) > 1 else ''} {join_words(numbers)}")
    return ", ".join(words)


def _state_selected(tables: dict[str, pd.DataFrame], summary: dict[str, Any], best: str) -> list[Statement]:
    if "selected" not in tables:
        return []
    mine = list_rows(tables["selected"][tables["selected"]["variant"] == best])
    planned = {row["coordinate"]: row for row in list_rows(tables["accuracy"]) if row["variant"] == best}
    if not mine:
        return []
    words = [
        f"{name} to {format_amount(mine[-1][f'after_{name}_{row["unit"]}'], row['unit'], 2, summary['units'])} "
        f"({format_amount(row['after'], row['unit'], 2, summary['units'])})"
        for name, row in planned.items()
    ]
    return [
        Statement(
            f"{len(mine)} poses chosen out of {summary['candidates']} would tell {join_words(words)}; in brackets what "
            f"the {summary['n_poses']} planned ones tell.",
            "plain",
            "Poses",
        )
    ]
