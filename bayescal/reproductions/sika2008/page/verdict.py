"""What simulated self-calibrations found, in sentences computed from their tables."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from bayescal.report.blocks import Level, Statement
from bayescal.report.numbers import (
    NOTHING,
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_power,
    format_significant,
    join_words,
)
from bayescal.reproductions.sika2008.page.figures import BAYESIAN, PAPER, Band

COVERED = (0.85, 0.95)
COMMON = (0.05, 0.95)  # of the machines below, between which a figure is none of the rare ones
CLEAR = 0.02  # difference of correlations worth a word
WORDS = {
    "calibrability": "C",
    "lengths": "lengths",
    "guide_angles": "guide angles",
    "tool": "tool's centre",
    "tool_in_use": "tool's centre in use",
    "parameters": "parameters",
}

type Tables = dict[str, pd.DataFrame]


def format_printed(value: float) -> str:
    """Return a published number with the digits that were printed."""
    if not math.isfinite(value) or abs(value) < 1e3:
        return format_plain(value) if math.isfinite(value) else NOTHING
    return format_power(value, 1)


def index_rows(table: pd.DataFrame, keys: list[str]) -> dict[Any, dict[str, Any]]:
    """Return the rows of a table by the values of some columns."""
    rows = [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
    return {tuple(row[key] for key in keys) if len(keys) > 1 else row[keys[0]]: row for row in rows}


def list_steps(names: list[str]) -> list[tuple[str, str]]:
    """Return neighbours."""
    return list(pairwise(names))


def pick_step(steps: pd.DataFrame, pair: tuple[str, str], quantity: str, procedure: str = PAPER) -> dict[str, Any]:
    """Return a row of the table of steps."""
    return index_rows(steps, ["from", "to", "procedure", "quantity"])[*pair, procedure, quantity]


def find_bands(tables: Tables, quantity: str) -> dict[str, Band]:
    """Return published factors by step, and between which a found one counts as the same."""
    if "judged" not in tables:
        return {}
    rows = tables["judged"]
    rows = rows[(rows["quantity"] == quantity) & rows["of"].str.contains(" to ")]
    values = zip(rows["of"], rows["published"], rows["low"], rows["high"], strict=True)
    return {str(of): Band(float(value), float(low), float(high)) for of, value, low, high in values}


def state_headline(tables: Tables, summary: dict[str, Any]) -> str:
    """Return the main result in one sentence."""
    names, errors = summary["sets"], index_rows(tables["errors"], ["set", "procedure"])
    if len(names) < 2:
        rms = format_significant(1e3 * errors[names[0], PAPER]["tool"])
        return f"Calibrated with {names[0]} the tool's centre is known to {rms} µm."
    said, bands = [], find_bands(tables, "tool")
    for before, after in list_steps(names):
        one = pick_step(tables["steps"], (before, after), "tool")
        band = bands.get(f"{before} to {after}")
        printed = "" if band is None else f" (published {format_printed(band.value)})"
        ratio = format_significant(float(one["ratio"]), 2)
        said.append(f"from {before} to {after} by a factor of {ratio}{printed}")
    judged = tables.get("judged", pd.DataFrame())
    holds = (
        "" if judged.empty else ": the published pattern" + (" holds" if judged["reached"].all() else " fails in part")
    )
    return f"The tool's error falls {join_words(said)}{holds}."


def state_verdict(tables: Tables, summary: dict[str, Any]) -> tuple[Statement, ...]:
    """Return what was found, the published first."""
    statements = [*_judge_published(tables), _say_assumed(tables, summary)]
    statements += [_say_bayesian(tables, summary), _judge_coverage(tables), *_judge_failures(tables)]
    statements += [*_say_machines(tables, summary), _say_units(tables, summary), *_say_predictors(tables, summary)]
    return tuple(statements)


def _judge_published(tables: Tables) -> list[Statement]:
    """Compare with print: the sets themselves, then every step."""
    if "judged" not in tables:
        return []
    judged, statements = tables["judged"], []
    sets = judged[~judged["of"].str.contains(" to ")]
    if len(sets):
        own = sets[sets["quantity"] == "calibrability"]
        found = join_words([format_power(float(value)) for value in own["found"]])
        printed = join_words([format_printed(float(value)) for value in own["published"]])
        counts = sets[sets["quantity"] == "n_parameters"]
        numbers = join_words([format_fixed(value, 0) for value in counts["found"]])
        words = f"C = {found} with {join_words(list(own['of']))}, published {printed}; {numbers} parameters"
        words += ", as published." if counts["reached"].all() else ", not as published."
        statements.append(Statement(words, _level(sets), "Calibrability"))
    for of, rows in judged[judged["of"].str.contains(" to ")].groupby("of", sort=False):
        said = []
        for _, row in rows.iterrows():
            error = float(row["standard_error"])
            value = format_power(float(row["found"])) if math.isnan(error) else _estimate(float(row["found"]), error)
            missed = "" if row["reached"] else ", not reached"
            said.append(f"{WORDS[str(row['quantity'])]} {value} (published {format_printed(row['published'])}{missed})")
        statements.append(Statement(f"Factors of improvement: {join_words(said)}.", _level(rows), str(of).capitalize()))
    return statements


def _level(rows: pd.DataFrame) -> Level:
    return "good" if rows["reached"].all() else "warning"


def _estimate(value: float, error: float) -> str:
    return format_estimate(value, error, 0 if error >= 1.0 else 2)


def _say_assumed(tables: Tables, summary: dict[str, Any]) -> Statement:
    noise = join_words([f"{one['sensor']} {format_plain(one['noise'])} {one['unit']}" for one in summary["sensors"]])
    words = f"Dimensions, poses, tolerances and noise are assumed, none of them published; noise here {noise}."
    bands = {of: band for of, band in find_bands(tables, "tool").items() if band.value >= 10.0}
    if "sweep_steps" not in tables or not bands:
        return Statement(words, "warning", "Assumed")
    sweep = tables["sweep_steps"]
    for of, band in bands.items():
        rows = sweep[(sweep["from"] + " to " + sweep["to"] == of) & (sweep["procedure"] == PAPER)]
        rows = rows[rows["quantity"] == "tool"].sort_values("angle_noise_arcsec")
        ratio, arcsec = rows["ratio"].to_numpy(), rows["angle_noise_arcsec"].to_numpy()
        by = [f"{format_significant(r, 2)} at {format_plain(a)}" for a, r in zip(arcsec, ratio, strict=True)]
        words += f" The factor from {of} is a matter of the angle sensors: the tool's is {join_words(by)} arcsec"
        if ratio.min() < band.value < ratio.max():
            at = float(np.exp(np.interp(-math.log(band.value), -np.log(ratio), np.log(arcsec))))
            words += f", and passes {format_printed(band.value)} near {format_significant(at, 1)} arcsec"
        error = float((rows["standard_error"] / rows["ratio"]).max())
        words += f" (fewer calibrations than above, standard errors up to {format_percent(error)})."
    return Statement(words, "warning", "Assumed")


def _say_bayesian(tables: Tables, summary: dict[str, Any]) -> Statement:
    errors, said = index_rows(tables["errors"], ["set", "procedure"]), []
    for name in summary["sets"]:
        paper, ours = (1e3 * errors[name, procedure]["tool"] for procedure in (PAPER, BAYESIAN))
        said.append(f"{format_significant(paper)} to {format_significant(ours)} µm with {name}")
    words = f"Noise as weights and tolerances as priors reduce the tool's error from {join_words(said)}"
    if len(summary["sets"]) > 1:
        pair = list_steps(summary["sets"])[0]
        one = pick_step(tables["steps"], pair, "tool", BAYESIAN)
        ratio = _estimate(float(one["ratio"]), float(one["standard_error"]))
        words += f"; from {pair[0]} to {pair[1]} then gains a factor of {ratio} only"
    before = tables["uncalibrated"]
    if len(before):
        words += f". Uncalibrated it is {format_significant(1e3 * float(before['tool'].iloc[0]))} µm"
    return Statement(f"{words}.", "plain", "Bayesian procedure")


def _judge_coverage(tables: Tables) -> Statement:
    rows = tables["coverage"]
    inside = rows["share"].between(*COVERED).all()
    said = []
    for name, ours in rows.groupby("set", sort=False):
        one = index_rows(ours, ["of"])
        parts = [
            f"{format_estimate(100 * one[of]['share'], 100 * one[of]['standard_error'], 1)} % "
            f"({'parameters' if of == 'parameters' else 'tool'})"
            for of in ("parameters", "tool")
        ]
        said.append(f"{join_words(parts)} with {name}")
    text = f"Intervals stated for 90 % hold the truth in {join_words(said)}."
    return Statement(text, "good" if inside else "bad", "Coverage")


def _judge_failures(tables: Tables) -> list[Statement]:
    rows = tables["errors"][tables["errors"]["n_failed"] > 0]
    if rows.empty:
        return []
    said = [f"{r['n_failed']} with {r['set']}, {r['procedure']} procedure" for _, r in rows.iterrows()]
    return [Statement(f"Calibrations that did not converge and count in nothing: {join_words(said)}.", "warning")]


def _say_machines(tables: Tables, summary: dict[str, Any]) -> list[Statement]:
    if "machine_summary" not in tables:
        return []
    counts, rows = summary["machines"], index_rows(tables["machine_summary"], ["of", "quantity"])
    words = f"Of {counts['drawn']} machines drawn, {counts['dropped']} do not reach their poses or cross their legs. "
    said = []
    for before, after in list_steps(summary["sets"]):
        of = f"{before} to {after}"
        parts = []
        for quantity, word in (("metres_radians", "C"), ("lengths", "lengths"), ("tool", "tool's centre")):
            one = rows[of, quantity]
            part = f"{word} {format_power(one['p50'])} ({format_power(one['p05'])} to {format_power(one['p95'])})"
            if not math.isnan(one["published"]):
                part += f", {format_percent(one['share_within'])} count as published"
            parts.append(part)
        said.append(f"{of}, {'; '.join(parts)}")
    words += (
        f"Of the other {counts['kept']} the median factors, and the middle 90 %: {'. '.join(said)}." if said else ""
    )
    statements = [Statement(words, "plain", "Other machines")]
    printed = tables["machine_summary"]
    printed = printed[printed["of"].isin(summary["sets"]) & printed["published"].notna()]
    if len(printed):
        shares = join_words([f"{format_percent(r['share_below'])} ({r['of']})" for _, r in printed.iterrows()])
        text = f"C itself belongs to the machine: {shares} of the plausible machines have one below that published"
        rare = not printed["share_below"].between(*COMMON).all()
        text += (
            ", so one with the published C is no typical one; the factors above come out without that choice."
            if rare
            else "."
        )
        statements.append(Statement(text, "warning" if rare else "plain", "C of other machines"))
    return statements


def _say_units(tables: Tables, summary: dict[str, Any]) -> Statement:
    table = index_rows(tables["calibrability"], ["set"])
    words = "C compares a radian with a metre, and depends on both units"
    units = {"metres_radians": "m, rad", "millimetres_radians": "mm, rad", "millimetres_degrees": "mm, deg"}
    units["scaled"] = "noise and tolerances"
    if len(table) > 1:
        before, after = list_steps(summary["sets"])[0]
        said = [f"{format_power(table[before][unit] / table[after][unit])} ({word})" for unit, word in units.items()]
        words += f": the same step from {before} to {after} improves it by {join_words(said)}"
    words += (
        ". It says how much worse the worst combination of parameters is known than the best, not how well any is: "
        "with all noise ten times as large C is the same and every error ten times as large."
    )
    return Statement(words, "warning", "Units")


def _say_predictors(tables: Tables, summary: dict[str, Any]) -> list[Statement]:
    if "correlations" not in tables:
        return []
    table = tables["correlations"]
    every = index_rows(table[table["of"] == "tool"], ["set", "predictor"])
    rows = {key: float(row["correlation"]) for key, row in every.items()}

    def say(predictor: str) -> str:
        return join_words([f"{format_fixed(rows[name, predictor], 2)} ({name})" for name in summary["sets"]])

    better = [name for name in summary["sets"] if rows[name, "scaled"] > rows[name, "metres_radians"] + CLEAR]
    worse = [name for name in summary["sets"] if rows[name, "scaled"] < rows[name, "metres_radians"] - CLEAR]
    gains = f"better with {join_words(better)}" if better else "nowhere better"
    gains += f", worse with {join_words(worse)}" if worse else ""
    across = {predictor: format_fixed(rows["all", predictor], 2) for predictor in dict.fromkeys(table["predictor"])}
    text = (
        f"Over the machines the tool's error correlates with C (metres, radians) by {say('metres_radians')}, with C in "
        f"noise and tolerances by {say('scaled')}: {gains}. Across all sets it is {across['metres_radians']} against "
        f"{across['scaled']}, and {across['scaled_alike']} where zeros of angle sensors count as known like guide "
        f"angles: what scaled C tells hangs on their tolerance too. The error predicted to first order correlates by "
        f"{across['tool_predicted']} and is in µm: plan with that."
    )
    return [Statement(text, "plain", "What C tells")]
