"""The page of sessions, from their results alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib import figure as mpl

from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.sessions.rows import (
    ROWS,
    ChannelMotionRow,
    DriftModelRow,
    DriftScaleRow,
    ExpansionRow,
    LegMotionRow,
    MotionRow,
    SessionRow,
)
from bayescal.experiments.shared.headline import write_headline
from bayescal.experiments.shared.slips import state_denied
from bayescal.files.rows import check_tables
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import (
    Block,
    Cell,
    Column,
    Figure,
    KeyFigure,
    Level,
    Page,
    PageSection,
    Statement,
    Table,
    make_table,
)
from bayescal.report.numbers import (
    capitalise,
    format_estimate,
    format_fixed,
    format_odds,
    format_percent,
    format_plain,
    name_some,
)
from bayescal.report.row_tables import tabulate_rows
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import name_parameter

CLEAR = 3.0
"""Nats, odds of twenty to one, from which on evidence is called clear."""
MICROMETRES = "µm"
CLEAR_REDUCTION = 0.3
"""Share of the prior's interval that data have to take off for a motion to be a finding: half of the variance."""


def build_page(results: Results) -> Page:
    """Return what the page of sessions says."""
    check_tables(ROWS, results.tables, results.folder or Path())
    summary = results.summary
    walk = summary["drift_model"] == "random_walk"
    what, _ = _read_motions(results)
    expansion, sessions = (row.read(results.table(row.table)) for row in (ExpansionRow, SessionRow))
    models = DriftModelRow.read(results.table("models"))
    sections = [
        PageSection(
            f"Motion of the {what}s", (_plot_motions(results, walk), _tabulate_motions(results, walk)), f"{what}s"
        ),
        PageSection("Drift scales", (_tabulate_scales(results, walk),), "scales"),
    ]
    if expansion:
        sections.append(PageSection("Expansion", (tabulate_rows("Expansion coefficients.", expansion),), "expansion"))
    sections += [
        PageSection("Sessions", (tabulate_rows("Sessions.", sessions),), "sessions"),
        PageSection("Evidence", (tabulate_rows("Evidence by model.", models),), "evidence"),
    ]
    return Page(
        kind="Sessions",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(results),
        verdict=tuple(_list_statements(results, walk)),
        sections=tuple(sections),
        key_figures=tuple(_list_key_figures(results, walk)),
        facts=(
            ("Study", f"{summary['study']}, {summary['variant']}"),
            ("Sessions" if walk else "Machines", str(summary["n_sessions"])),
            ("Poses", str(summary["n_poses"])),
        ),
    )


def _read_motions(results: Results) -> tuple[str, list[MotionRow]]:
    """Return whether legs move or channels, and by how much."""
    legs: list[MotionRow] = [*LegMotionRow.read(results.table("legs"))]
    return ("leg", legs) if legs else ("channel", [*ChannelMotionRow.read(results.table("channels"))])


def state_headline(results: Results) -> str:
    """Return what to do, whether anything moved, and what."""
    summary, scales = results.summary, DriftScaleRow.read(results.table("scales"))
    walk, nats = summary["drift_model"] == "random_walk", summary["log_evidence_drift"]
    differ, differs = ("moved", "moved") if walk else ("differ", "differs")
    if nats < -CLEAR:
        advice = "Keep the calibration" if walk else "One calibration for all machines"
        return write_headline([advice, f"no change (log Bayes factor {format_fixed(nats, 1, sign=True)})"])
    if nats < CLEAR:
        said = f"Inconclusive: log Bayes factor {format_fixed(nats, 1, sign=True)}"
        return write_headline([said, "Measure more poses"])
    advice = "Calibrate again" if walk else "Calibrate each machine"
    moved = [name_parameter(one.parameter_group) for one in scales if one.log_bayes_factor_moved > CLEAR]
    what = f"{name_some(moved)} {differs if len(moved) == 1 else differ}" if moved else "open part"
    return write_headline([advice, f"{what} (odds of {format_odds(nats)})"])


def _list_key_figures(results: Results, walk: bool) -> list[KeyFigure]:
    """Return evidence of motion, the largest motion, sessions, poses, and the quality of the draws."""
    summary, (what, moved) = results.summary, _read_motions(results)
    nats = summary["log_evidence_drift"]
    level: Level = "warning" if nats > CLEAR else "good" if nats < -CLEAR else "plain"
    found = [
        KeyFigure("Log Bayes factor", format_fixed(nats, 1, sign=True), "nat", level),
        KeyFigure("Sessions" if walk else "Machines", str(summary["n_sessions"])),
        KeyFigure("Poses", str(summary["n_poses"])),
    ]
    if known := [one for one in moved if one.interval_reduction >= CLEAR_REDUCTION]:
        largest = max(known, key=lambda one: abs(one.mean))
        value, unit = format_estimate(largest.mean, largest.sd, sign=True), largest.unit or MICROMETRES
        level = "warning" if largest.p_exceeds_limit > 0.5 else "plain"
        found.append(KeyFigure(f"Largest motion: {what} {largest.moved}", value, unit, level))
    k = _find_worst_k(results)
    found.append(KeyFigure("Largest Pareto k", format_fixed(k, 2), "", "good" if k <= PARETO_K_LIMIT else "bad"))
    return found


def _find_worst_k(results: Results) -> float:
    models = results.table("models")
    return float(max(models["pareto_k"].max(), models["exact_pareto_k"].max()))


def _list_statements(results: Results, walk: bool) -> list[Statement]:
    summary, found = results.summary, state_denied(results.summary)
    nats, error = summary["log_evidence_drift"], summary["log_evidence_drift_se"]
    text = f"Log Bayes factor of motion: {format_estimate(nats, max(error, 0.01), sign=True)}."
    level: Level = "warning" if nats > CLEAR else "plain"
    found.append(Statement(text, level, "Evidence", value=nats, limit=CLEAR, unit="nat"))
    what, moved = _read_motions(results)
    last = [one for one in moved if (one.since, one.session) == (moved[-1].since, moved[-1].session)] if walk else moved
    known = [one for one in last if one.interval_reduction >= CLEAR_REDUCTION]
    if known:
        largest = max(known, key=lambda one: abs(one.mean))
        where = f"from {largest.since} to {largest.session}" if walk else f"of {largest.session}"
        unit = largest.unit or MICROMETRES
        text = f"{capitalise(what)} {largest.moved} {where}: {format_estimate(largest.mean, largest.sd, sign=True)} "
        text += f"{unit}; P(beyond {_name_shift(summary, unit)}) = {format_percent(largest.p_exceeds_limit, 1)}."
        found.append(Statement(text, "plain", "Largest motion", value=largest.mean, unit=unit))
    few = [one.moved for one in last if one not in known]
    if few:
        text = f"Not determined: {what}{'s' * (len(few) > 1)} {name_some(few)}."
        found.append(Statement(text, "plain" if known else "warning", "Motion", value=len(few), limit=0.0))
    for one in ExpansionRow.read(results.table("expansion")):
        expected, estimate = (format_estimate(*both) for both in ((one.prior_mean, one.prior_sd), (one.mean, one.sd)))
        text = f"Expansion of {one.body}: {estimate} ppm/K (prior {expected})."
        if one.sd > (1.0 - CLEAR_REDUCTION) * one.prior_sd:
            text = f"Expansion of {one.body}: not determined (prior {expected} ppm/K)."
        found.append(Statement(text, "plain", "Temperature", value=one.mean, limit=one.prior_mean, unit="ppm/K"))
    k, models = _find_worst_k(results), results.table("models")
    text = f"Importance sampling: ESS at least {format_percent(float(models['exact_efficiency'].min()))}, "
    text += f"Pareto k at most {format_fixed(k, 2)}."
    good = k <= PARETO_K_LIMIT
    action = "" if good else "Use more draws."
    level = "good" if good else "bad"
    found.append(Statement(text, level, "Computation", value=k, limit=PARETO_K_LIMIT, action=action))
    return found


# --- tables ------------------------------------------------------------------------------------------------------


def _name_shift(summary: Summary, unit: str) -> str:
    """Return the motion from which on one counts, in a unit."""
    limit = summary["motion_limit_um"] if unit == "µm" else summary.get("motion_limit_arcsec", 0.0)
    return f"{format_plain(limit)} {unit}"


def _tabulate_motions(results: Results, walk: bool) -> Table:
    what, motions = _read_motions(results)
    by_leg, summary = what == "leg", results.summary
    unit = MICROMETRES if by_leg else ""
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
    for one in motions:
        interval = f"{format_fixed(one.q05, 1)} to {format_fixed(one.q95, 1)}"
        sure = Cell(format_percent(one.p_exceeds_limit, 1), "warning" if one.p_exceeds_limit > 0.5 else "plain")
        sure = sure if one.interval_reduction >= CLEAR_REDUCTION else Cell("not determined")
        moved = format_estimate(one.mean, one.sd, sign=True)
        own = [] if by_leg else [one.unit or MICROMETRES]
        rows.append([one.since, one.session, one.moved, moved, interval, *own, sure])
    if by_leg:
        caption = "Leg length changes ± sd."
        return make_table(caption, columns, rows)
    limits = " and ".join(
        _name_shift(summary, one) for one in dict.fromkeys(one.unit or MICROMETRES for one in motions)
    )
    caption = f"Reading changes at home ± sd; limit {limits}."
    return make_table(caption, columns, rows)


def _tabulate_scales(results: Results, walk: bool) -> Table:
    scales = DriftScaleRow.read(results.table("scales"))
    unit = "" if any(one.unit for one in scales) else "µm per √month" if walk else MICROMETRES
    columns = [Column("Moves", kind="name"), Column("scale", unit), Column("90 % interval", unit)]
    columns.append(Column("Log Bayes factor", "nat"))
    rows: list[list[str | Cell]] = []
    for one in scales:
        interval = f"{format_fixed(one.q05, 1)} to {format_fixed(one.q95, 1)}"
        nats = one.log_bayes_factor_moved
        factor = Cell(format_fixed(nats, 1, sign=True), "warning" if nats > CLEAR else "plain")
        own = f" {one.unit}{' per √month' * walk}" if one.unit else ""
        rows.append([one.parameter_group, f"{format_estimate(one.mean, one.sd)}{own}", interval, factor])
    caption = "Motion scales, log Bayes factor of each."
    return make_table(caption, columns, rows)


def _plot_motions(results: Results, walk: bool) -> Block:
    what, motions = _read_motions(results)
    if what == "channel":
        caption = "Reading changes by session, 90 % interval."
        return Figure("channels", caption, partial(draw_motions, motions, walk, False))
    caption = "Leg length changes by session, 90 % interval." if walk else "Leg lengths less the mean, 90 % interval."
    return Figure("legs", caption, partial(draw_motions, motions, walk, True))


def draw_motions(motions: Sequence[MotionRow], walk: bool, by_leg: bool) -> mpl.Figure:
    """Return the motion of legs, or of channels, over the sessions, a panel for each."""
    names = list(dict.fromkeys(one.moved for one in motions))
    figure = mpl.Figure(figsize=(9.4, 1.6 + 1.6 * ((len(names) - 1) // 3 + 1)))
    panels = figure.subplots(-(-len(names) // 3), min(3, len(names)), sharex=True, sharey=by_leg, squeeze=False)
    for k, (axes, name) in enumerate(zip(panels.ravel(), names, strict=False)):
        mine = [one for one in motions if one.moved == name]
        mine = mine[:-1] if walk and len(mine) > 1 else mine  # the last row sets the first against the last
        mean, low, high = np.array([(one.mean, one.q05, one.q95) for one in mine]).T
        bars = np.abs([low - mean, high - mean])
        axes.errorbar(np.arange(len(mine)), mean, yerr=bars, fmt="o", markersize=3.5, color=LEG_COLOURS[k % 6])
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"Leg {name}" if by_leg else f"{name}, {mine[0].unit}")
        axes.set_xticks(np.arange(len(mine)), [one.session for one in mine], rotation=45, ha="right")
    for axes in panels[:, 0]:
        axes.set_ylabel(("Step" if walk else "Off the mean") + (", µm" if by_leg else ""))
    return figure
