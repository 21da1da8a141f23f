"""What a self-calibration found, in sentences computed from its tables."""

from __future__ import annotations

import math
import re
from typing import Any

import pandas as pd

from bayescal.experiments.shared.slips import state_denied
from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import (
    format_count,
    format_fixed,
    format_odds,
    format_percent,
    format_scientific,
    format_significant,
    join_words,
)
from bayescal.report.symbols import split_name, split_symbol

DOUBT = 4.0  # standard deviations that χ² may be off
NAME = re.compile(r"(?<![\w.])([A-Za-z]+\d?(?:_[A-Za-z])?)\[(\d+)\]|\b(xi|eta)_V\b")
DECISIVE = 5.0  # nats
MOST_ODDS = 50.0  # nats, beyond which odds are no news

type Row = dict[str, Any]


def list_rows(table: pd.DataFrame) -> list[Row]:
    """Return the rows of a table by the names of its columns."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def write_names(text: str) -> str:
    """Return text with parameters such as ``xi_B[3]`` and ``phi0[2]`` as the paper writes them, ξ_B3 and φ_20."""

    def write(found: re.Match[str]) -> str:
        symbol, leg = split_name(found[0])
        head, below, above = split_symbol(symbol)
        return f"{head}_{below}{leg or ''}{above}"

    return NAME.sub(write, text)


def explains(row: Row) -> bool:
    """Whether a variant leaves no more of the readings than their noise; true where nothing can be said."""
    freedom = row["n_equations"] - row["n_parameters"]
    return not (freedom > 0 and (row["misfit"] - 1.0) * (2.0 * freedom) ** 0.5 > DOUBT)


def state_headline(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> str:
    """Return which sensors to use, how well they tell where the tool is, and which model of their readings leads."""
    rows = list_rows(tables["variants"])
    plain = _keep_best([row for row in rows if row["plain"] and not row["n_external"]])
    inside = sorted(plain, key=lambda row: row["n_sensors"]) or rows[:1]
    sound = [row for row in inside if explains(row)]
    best = min(sound or inside, key=lambda row: row["tool_after_um"])
    advice = f"Use “{best['title']}”" if sound else f"Use none yet, for none explains the readings. “{best['title']}”"
    words = f"{advice}{': then' if sound else ' says'} the tool's centre is known to {_um(best['tool_after_um'])} rms "
    words += f"over the workspace, before the calibration to {_um(best['tool_before_um'])}"
    others = [f"“{row['title']}” to {_um(row['tool_after_um'])}" for row in inside if row is not best]
    words += f"; with {join_words(others)}" if others else ""
    titled = {row["variant"]: row for row in rows}
    for names in summary["rankings"][:1]:
        best, second = (titled[name] for name in names[:2])
        words += f". Of {len(names)} models of the same readings, “{best['title']}” leads by "
        words += f"{_nats(best['log_evidence'] - second['log_evidence'])}"
    return f"{words}."


def _keep_best(rows: list[Row]) -> list[Row]:
    """Return of variants with the same sensors the one of the largest evidence, in the order they came in."""
    best: dict[str, Row] = {}
    for row in rows:
        other = best.get(row["sensors"], row)
        best[row["sensors"]] = row if row["log_evidence"] > other["log_evidence"] else other
    return list(best.values())


def _nats(value: float) -> str:
    return f"{format_count(value)} nats" if value > 1000.0 else f"{format_fixed(value, 1)} nats"


def _um(value: float) -> str:
    return f"{format_significant(value, 2)} µm"


def state_verdict(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    """Return what was found, whether it may be relied on last."""
    rows = list_rows(tables["variants"])
    ridges = [str(name) for name in tables["ridges"]["variant"]]
    statements = state_denied(summary)
    statements += [_judge_sensors(row, ridges.count(row["variant"]), summary) for row in rows if row["plain"]]
    statements += _judge_frames(summary, rows)
    titled = {row["variant"]: row for row in rows}
    statements += [_judge_models([titled[name] for name in names]) for names in summary["rankings"]]
    statements += _judge_intervals(rows)
    statements.append(_judge_convergence(rows))
    return statements


def _judge_sensors(row: Row, n_ridges: int, summary: dict[str, Any]) -> Statement:
    audit = summary["audits"][row["variant"]]
    scaled = format_scientific(row["calibrability_scaled"])
    text = (
        f"{row['n_parameters']} parameters from {row['n_equations']} equations, "
        f"C = {format_scientific(row['calibrability'])} (m, rad), {scaled} in tolerances and noise. Tool's centre "
        f"{_um(row['tool_before_um'])} before, {_um(row['tool_after_um'])} after"
    )
    if not math.isnan(row["tool_calibrated_error_um"]):
        text += f" (truly {_um(row['tool_calibrated_error_um'])})"
    level: Level = "good"
    if audit["fixed"]:
        text += f". Told apart are {_list_symbols(audit['recommended'])}, not {_list_symbols(audit['fixed'])}"
        text += f" ({n_ridges} ridge{'s' if n_ridges != 1 else ''} below)" if n_ridges else ""
        level = "warning"
    else:
        text += ". All are identifiable: free them all"
    if not explains(row):
        text += f". It does NOT explain the readings: they are left {format_significant(row['misfit'])} times the noise"
        level = "bad"
    return Statement(f"{text}.", level, str(row["title"]))


def _list_symbols(names: list[str]) -> str:
    """Return parameters by symbol, ``x_P, β``."""
    symbols = dict.fromkeys(split_name(name)[0] for name in names)
    return join_words([_write_symbol(symbol) for symbol in symbols]) or "none"


def _write_symbol(symbol: str) -> str:
    head, below, above = split_symbol(symbol)
    return f"{head}_{below}{above}" if below or above else head


def _judge_frames(summary: dict[str, Any], rows: list[Row]) -> list[Statement]:
    audits = summary["audits"]
    titles = {row["variant"]: row["title"] for row in rows}
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, audit in audits.items():
        groups.setdefault(tuple(audit["unseen"]), []).append(name)
    words = []
    for unseen, names in groups.items():
        what = f" ({join_words([write_names(name) for name in unseen])})" if unseen else ""
        which = join_words([f"“{titles[name]}”" for name in names])
        words.append(f"{len(unseen)} with {which}{what}")
    wrong = [titles[name] for name, audit in audits.items() if set(audit["unseen"]) & set(audit["free"])]
    clear = all(audit["rank_clear"] for audit in audits.values())
    text = f"directions that no reading ever sees, by the rank of all parameters: {'; '.join(words)}. "
    text += f"Some of them are free with {join_words(wrong)}" if wrong else "They define the frames and are given"
    text += "" if clear else "; the rank is not clear"
    level: Level = "good" if clear and not wrong else "warning"
    return [Statement(f"{text[0].upper()}{text[1:]}.", level, "Frames")] if words else []


def _judge_models(rows: list[Row]) -> Statement:
    best = rows[0]
    parts = []
    for row in rows[1:]:
        behind = best["log_evidence"] - row["log_evidence"]
        words = f"“{row['title']}” {_nats(behind)} behind"
        words += f" ({format_odds(behind)})" if behind < MOST_ODDS else ""
        if not explains(row):
            words += f", leaves the readings {format_significant(row['misfit'])} times their noise"
            if not math.isnan(row["tool_calibrated_error_um"]):
                words += (
                    f" and is {_um(row['tool_calibrated_error_um'])} off where it claims {_um(row['tool_after_um'])}"
                )
        parts.append(words)
    ahead = best["log_evidence"] - rows[1]["log_evidence"]
    level: Level = "bad" if not explains(best) else "good" if ahead > DECISIVE else "warning"
    return Statement(f"“{best['title']}” has the largest evidence of {len(rows)}; {'; '.join(parts)}.", level, "Models")


def _judge_intervals(rows: list[Row]) -> list[Statement]:
    known = [row for row in rows if not math.isnan(row.get("inside_90", math.nan))]
    if not known:
        return []
    good, wrong = ([row for row in known if explains(row) == is_good] for is_good in (True, False))
    words = "of the true coordinates of the tool at the verification poses, in their 90 % intervals lie "
    verb = "explain" if len(good) > 1 else "explains"
    parts = [f"{_span(good)} with {_count(good)} that {verb} the readings"] if good else []
    parts += [f"{_span(wrong)} with {_count(wrong)} that do not"] if wrong else []
    level: Level = "good" if good and min(row["inside_90"] for row in good) > 0.5 else "warning"
    text = f"{words}{join_words(parts)}. One machine: all its poses share the errors of its parameters."
    return [Statement(f"{text[0].upper()}{text[1:]}", level, "Intervals")]


def _count(rows: list[Row]) -> str:
    return f"the {len(rows)} variants" if len(rows) > 1 else f"“{rows[0]['title']}”, the one variant"


def _span(rows: list[Row]) -> str:
    values = [row["inside_90"] for row in rows]
    return " to ".join(dict.fromkeys(format_percent(x) for x in (min(values), max(values))))


def _judge_convergence(rows: list[Row]) -> Statement:
    gap = max(abs(row["log_evidence_importance"] - row["log_evidence_bridge"]) for row in rows)
    text = (
        f"R-hat at most {format_fixed(max(row['rhat_max'] for row in rows), 4)}, bulk ESS at least "
        f"{format_fixed(min(row['ess_bulk_min'] for row in rows), 0)}; "
        f"the two log-evidences agree within {format_significant(gap, 2)} nats"
    )
    wrong = [f"“{row['title']}”: {row['problems']}" for row in rows if not row["converged"]]
    if wrong:
        return Statement(f"NOT everything converged: {'; '.join(wrong)}. {text}.", "bad", "Convergence")
    return Statement(f"{text}.", "good", "Convergence")
