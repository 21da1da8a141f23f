"""The page of sessions, from their results alone."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import figure as mpl

from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.headline import say_odds, write_headline
from bayescal.experiments.shared.slips import state_denied
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import Block, Cell, Column, Definitions, Figure, Page, Section, Statement, Table, make_table
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import name_parameter

CLEAR = 3.0
"""Nats, odds of twenty to one, from which on evidence is called clear."""
LEARNT = 0.3
"""Share of the prior's interval that data have to take off for a motion to be a finding: half of the variance."""
METHOD = (
    (
        "What is shared?",
        "All sessions have the study's priors, noise and model errors; parameters that may not move are the same in "
        "all of them. Those that may move walk at random from session to session, or differ from machine to machine; "
        "how far is learnt, with a half-normal prior on each scale.",
    ),
    (
        "How is it computed?",
        "Given the scales, parameters of all sessions together are solved for in closed form about their mode; "
        "scales and evidence come from importance sampling of their marginal density. Every draw is then weighted by "
        "the exact density of its poses.",
    ),
    (
        "How does a leg move?",
        "Its motion is the change of all parameters that may move, as a change of its length that would do the same at "
        "home. Single parameters that are not distinguishable still add up to a motion that can.",
    ),
)


def build_page(results: Results) -> Page:
    """Return what the page of sessions says."""
    summary = results.summary
    walk = summary["hierarchy"] == "walk"
    what, _, _ = _find_motions(results)
    sections = [
        Section(f"Motion of the {what}s", (_plot_motions(results, walk), _tabulate_motions(results, walk)), f"{what}s"),
        Section("Scales", (_tabulate_scales(results, walk),), "scales"),
    ]
    if len(results.table("expansion")):
        sections.append(Section("Expansion", (_tabulate_expansion(results),), "expansion"))
    sections += [
        Section("Sessions", (_tabulate_sessions(results),), "sessions"),
        Section("Evidence", (_tabulate_models(results),), "evidence"),
        Section("How it was computed", (Definitions(METHOD),), "method"),
    ]
    return Page(
        kind="Sessions",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(results),
        verdict=tuple(_list_statements(results, walk)),
        sections=tuple(sections),
        facts=(
            ("Study", f"{summary['study']}, {summary['variant']}"),
            ("Sessions" if walk else "Machines", str(summary["n_sessions"])),
            ("Poses", str(summary["n_poses"])),
        ),
    )


def _find_motions(results: Results) -> tuple[str, pd.DataFrame, list[str]]:
    """Return whether legs move or channels, by how much, and the unit of each row."""
    what = "leg" if len(results.table("legs")) else "channel"
    table = results.table(f"{what}s")
    table = table if "learnt" in table else table.assign(learnt=1.0)  # results that do not say
    return what, table, [str(one) for one in table["unit"]] if "unit" in table else ["µm"] * len(table)


def state_headline(results: Results) -> str:
    """Return in one sentence what to do, whether anything moved, and what."""
    summary, scales = results.summary, results.table("scales")
    walk, nats = summary["hierarchy"] == "walk", summary["log_evidence_drift"]
    differ, differs = ("moved", "moved") if walk else ("differ", "differs")
    if nats < -CLEAR:
        advice = "Keep the calibration" if walk else "One calibration serves all machines"
        return write_headline([f"{advice}: nothing {differs}, {say_odds(-nats)} against it"])
    if nats < CLEAR:
        apart = f"the evidence differs by {format_significant(abs(nats), 2)} nats"
        return write_headline([f"Measure more poses: whether anything {differs} is open, {apart}"])
    advice = "Calibrate again" if walk else "Calibrate each machine for itself"
    moved = [name_parameter(str(one)) for one in scales.loc[scales["log_odds_moved"] > CLEAR, "unit"]]
    if not moved:
        return write_headline([f"{advice}: something {differs}, {say_odds(nats)}; which part is open"])
    verb = differs if len(moved) == 1 else differ
    against = "no motion at all" if walk else "machines that are all alike"
    return write_headline([f"{advice}: {join_words(moved)} {verb}, {say_odds(nats)} against {against}"])


def _list_statements(results: Results, walk: bool) -> list[Statement]:
    summary, found = results.summary, state_denied(results.summary)
    nats, error = summary["log_evidence_drift"], summary["log_evidence_drift_se"]
    text = f"Log-evidence of motion against none: {format_estimate(nats, max(error, 0.01), sign=True)} nats."
    found.append(Statement(text, "warning" if nats > CLEAR else "plain", "Evidence"))
    what, moved, units = _find_motions(results)
    moved = moved.assign(unit=units)
    last = moved[moved["session"] == moved["session"].iloc[-1]]
    last = last[last["since"] == last["since"].iloc[-1]] if walk else moved
    known = last[last["learnt"] >= LEARNT]
    if known.empty:
        text = f"The data do not determine by how much any {what} moved: posteriors are as wide as their priors."
        found.append(Statement(text, "warning", "Largest motion"))
    else:
        largest = known.iloc[int(np.argmax(np.abs(known["mean"])))]
        where = f"between {largest['since']} and {largest['session']}" if walk else f"in {largest['session']}"
        text = (
            f"{what.capitalize()} {largest[what]} is off most {where}: "
            f"{format_estimate(largest['mean'], largest['sd'], sign=True)} {largest['unit']}; "
            f"beyond {_name_shift(summary, str(largest['unit']))} with a probability of "
            f"{format_percent(largest['beyond'], 1)}."
        )
        if len(known) < len(last):
            few = [str(one) for one in last.loc[last["learnt"] < LEARNT, what]]
            text += f" The data do not determine by how much {what}{'s' * (len(few) > 1)} {join_words(few)} moved."
        found.append(Statement(text, "plain", "Largest motion"))
    for _, one in results.table("expansion").iterrows():
        expected = format_estimate(one["prior_mean"], one["prior_sd"])
        text = (
            f"{str(one['body']).capitalize()} expand by {format_estimate(one['mean'], one['sd'])} ppm/K; "
            f"{expected} were expected."
        )
        if one["sd"] > (1.0 - LEARNT) * one["prior_sd"]:
            text = f"The data do not determine how {one['body']} expand; {expected} ppm/K are expected."
        found.append(Statement(text, "plain", "Temperature"))
    models = results.table("models")
    worst = float(max(models["pareto_k"].max(), models["exact_pareto_k"].max()))
    good = worst <= PARETO_K_LIMIT
    text = (
        "Draws agree with the exact density: "
        f"at least {format_percent(float(models['exact_efficiency'].min()))} of them count; "
        f"largest Pareto k {format_fixed(worst, 2)}."
        if good
        else f"Weights have too heavy a tail (Pareto k {format_fixed(worst, 2)}): more draws, or fewer symbols."
    )
    found.append(Statement(text, "good" if good else "bad", "Computation"))
    return found


# --- tables ------------------------------------------------------------------------------------------------------


def _name_shift(summary: dict[str, Any], unit: str) -> str:
    """Return the motion from which on one counts, in a unit."""
    return f"{format_plain(summary['shift_um'] if unit == 'µm' else summary.get('shift_arcsec', 0.0))} {unit}"


def _tabulate_motions(results: Results, walk: bool) -> Table:
    what, table, units = _find_motions(results)
    by_leg, summary = what == "leg", results.summary
    unit = "µm" if by_leg else ""
    columns = [
        Column("Since" if walk else "From", kind="name"),
        Column("Session" if walk else "Machine", kind="name"),
        Column(what.capitalize(), kind="text" if by_leg else "name"),
        Column("moved by", unit),
        Column("90 % interval", unit),
        *([] if by_leg else [Column("Unit", kind="text")]),
        Column("beyond", _name_shift(summary, unit) if by_leg else "the limit"),
    ]
    rows: list[list[str | Cell]] = []
    for one, own in zip(table.to_dict("records"), units, strict=True):
        interval = f"{format_fixed(one['q05'], 1)} to {format_fixed(one['q95'], 1)}"
        sure = Cell(format_percent(one["beyond"], 1), "warning" if one["beyond"] > 0.5 else "plain")
        sure = sure if one["learnt"] >= LEARNT else Cell("not determined")
        moved = format_estimate(one["mean"], one["sd"], sign=True)
        unit_of = [] if by_leg else [own]
        rows.append([str(one["since"]), str(one["session"]), str(one[what]), moved, interval, *unit_of, sure])
    if by_leg:
        caption = "Motion of every leg, as a change of its length, with its standard deviation."
        return make_table(caption, columns, rows)
    limits = " and ".join(_name_shift(summary, one) for one in dict.fromkeys(units))
    caption = f"What every channel of the machine reads more at home, with its standard deviation; limit {limits}."
    return make_table(caption, columns, rows)


def _tabulate_scales(results: Results, walk: bool) -> Table:
    unit = "" if "in" in results.table("scales") else "µm per √month" if walk else "µm"
    columns = [Column("Moves", kind="name"), Column("scale", unit), Column("90 % interval", unit), Column("odds, log")]
    rows: list[list[str | Cell]] = []
    for one in results.table("scales").to_dict("records"):
        interval = f"{format_fixed(one['q05'], 1)} to {format_fixed(one['q95'], 1)}"
        nats = one["log_odds_moved"]
        odds = Cell(format_fixed(nats, 1, sign=True), "warning" if nats > CLEAR else "plain")
        own = f" {one['in']}{' per √month' * walk}" if "in" in one else ""
        rows.append([str(one["unit"]), f"{format_estimate(one['mean'], one['sd'])}{own}", interval, odds])
    caption = (
        "Scales of what may move, and log-odds that it does against that it alone does not move, at even prior odds."
    )
    return make_table(caption, columns, rows)


def _tabulate_expansion(results: Results) -> Table:
    columns = [Column("Body", kind="name"), Column("expected", "ppm/K"), Column("found", "ppm/K")]
    rows = [
        [str(one["body"]), format_estimate(one["prior_mean"], one["prior_sd"]), format_estimate(one["mean"], one["sd"])]
        for one in results.table("expansion").to_dict("records")
    ]
    return make_table("Coefficients of expansion.", columns, rows)


def _tabulate_sessions(results: Results) -> Table:
    columns = [Column("Session", kind="name"), Column("Day"), Column("Poses"), Column("Temperature", "°C")]
    rows = [
        [
            str(one["session"]),
            format_plain(one["day"]) if np.isfinite(one["day"]) else "–",
            str(one["n_poses"]),
            format_fixed(one["temperature_celsius"], 1),
        ]
        for one in results.table("sessions").to_dict("records")
    ]
    return make_table("What was measured.", columns, rows)


def _tabulate_models(results: Results) -> Table:
    columns = [
        Column("Model", kind="name"),
        Column("log-evidence", "nats"),
        Column("efficiency", group="Scales"),
        Column("k", group="Scales"),
        Column("efficiency", group="Against the exact density"),
        Column("k", group="Against the exact density"),
    ]
    rows = [
        [
            str(one["model"]),
            format_estimate(one["log_evidence"], max(one["se"], 0.001)),
            format_percent(one["efficiency"]),
            format_fixed(one["pareto_k"], 2),
            format_percent(one["exact_efficiency"]),
            format_fixed(one["exact_pareto_k"], 2),
        ]
        for one in results.table("models").to_dict("records")
    ]
    return make_table("Evidence of every model, and how good the draws behind it are.", columns, rows)


def _plot_motions(results: Results, walk: bool) -> Block:
    what, table, units = _find_motions(results)
    if what == "channel":
        order = {name: str(k + 1) for k, name in enumerate(dict.fromkeys(table["channel"]))}
        legs = table.assign(leg=[int(order[name]) for name in table["channel"]])
        names = {int(k): f"{name}, {unit}" for (name, k), unit in zip(order.items(), units, strict=False)}
        caption = (
            "What every channel reads more at home from one session to the next: mean and 90 % interval of each step."
        )
        return Figure("channels", caption, partial(draw_legs, legs, walk, names))
    caption = (
        "Motion of every leg from one session to the next: mean and 90 % interval of each step."
        if walk
        else "Every leg of every machine, off the mean of all: mean and 90 % interval."
    )
    return Figure("legs", caption, partial(draw_legs, results.table("legs"), walk))


def draw_legs(legs: pd.DataFrame, walk: bool, names: dict[int, str] | None = None) -> mpl.Figure:
    """Return the motion of legs, or of channels of these names, over the sessions, a panel for each."""
    numbers = list(dict.fromkeys(legs["leg"]))
    ends = legs[legs["leg"] == numbers[0]][["since", "session"]]
    steps = len(ends) - 1 if walk and len(ends) > 1 else len(ends)  # the last row sets the first against the last
    figure = mpl.Figure(figsize=(9.4, 1.6 + 1.6 * ((len(numbers) - 1) // 3 + 1)))
    panels = figure.subplots(
        -(-len(numbers) // 3), min(3, len(numbers)), sharex=True, sharey=names is None, squeeze=False
    )
    for axes, leg in zip(panels.ravel(), numbers, strict=False):
        mine = legs[legs["leg"] == leg].iloc[:steps]
        at, mean = np.arange(len(mine)), mine["mean"].to_numpy(dtype=float)
        bars = np.abs(mine[["q05", "q95"]].to_numpy(dtype=float).T - mean)
        axes.errorbar(at, mean, yerr=bars, fmt="o", markersize=3.5, color=LEG_COLOURS[(int(leg) - 1) % 6])
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"Leg {leg}" if names is None else names[int(leg)])
        axes.set_xticks(at, [str(one) for one in mine["session"]], rotation=45, ha="right")
    for axes in panels[:, 0]:
        axes.set_ylabel(("Step" if walk else "Off the mean") + (", µm" if names is None else ""))
    return figure
