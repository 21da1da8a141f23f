"""What was measured against what is predicted: errors of poses, held-back readings, poses that others contradict."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial
from textwrap import fill as fill_lines
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayescal.experiments.shared.rows import USES
from bayescal.experiments.shared.soundness import span_shares
from bayescal.experiments.study.page.results import (
    POSITION,
    VARIANT,
    ErrorScale,
    StudyResults,
    get_number,
)
from bayescal.experiments.study.page.soundness import COVERAGE, is_too_narrow
from bayescal.experiments.study.page.styles import Styles, assign_styles
from bayescal.experiments.study.rows import PoseRow
from bayescal.report.blocks import Block, Cell, Column, Figure, Fold, PageSection, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    NO_VALUE,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    name_some,
)
from bayescal.report.style import GREY, INK, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import describe_deformation, quote

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array

SHADES = {"calibration": 0.85, "verification": 0.35}
WIDTH = 0.38
CROWDED = 4  # variants beyond which labels and numbers are slanted
MARGINS = {"left": 0.065, "right": 0.995, "bottom": 0.11, "top": 0.89, "wspace": 0.16}
LABEL, LINE = 24, 0.15  # letters in a line of a variant's label, and its height, inches
CROWDED_MARGINS = MARGINS | {"bottom": 0.34, "top": 0.93}
SLANTED: dict[str, Any] = {"rotation": 25, "ha": "right", "rotation_mode": "anchor", "fontsize": 7}
NINETY = 1.645
RANGE = 0.95  # of the binomial distribution, where a coverage is as expected
MOST_NAMED = 25  # poses with a name below the axis, legible on a telephone too
BARS = "full bar: largest error, line: mean"
BOUNDS = "Position error / 95 % bound. Open: verification; many red: overconfident."
HELD_BACK = "Each predicted without its pose."
WEIGHTS = "A pose of weight near 0 is an outlier."


# --- errors of measured poses ----------------------------------------------------------------------------------------


def show_errors(study: StudyResults) -> PageSection | None:
    """Return errors of poses, and how often bounds and intervals hold them; None where no poses were measured."""
    if not study.has("pose_errors"):
        return None
    title = "Coverage by variant"
    table = study.table("pose_errors")
    seen = [name for name in study.ranking if name in set(table["variant"])]
    blocks: list[Block] = [*_illustrate_errors(study)]
    if seen:  # by the instrument, of variants that are ranked
        blocks.append(Figure("bounds", BOUNDS, partial(_draw_bounds, table, seen, assign_styles(study))))
    blocks.append(Fold(title, (_tabulate_coverage(study),)))
    return PageSection("Pose errors", tuple(blocks), anchor="errors", short="Errors")


def _tabulate_coverage(study: StudyResults) -> Table:
    """Return how often intervals and bounds hold the measurements, for every variant whose poses were seen."""
    uses = USES if study.n_verification else USES[:1]
    kinds = ("90 % coverage", *(f"95 % bound, {scale.what}" for scale in study.error_scales))
    columns = [VARIANT, *(Column(use, "%", kind) for kind in kinds for use in uses)]
    rows = []
    for name, fit in study.fits.items():
        frame = study.table("pose_errors", name)
        if frame.empty:
            continue
        cells: list[str | Cell] = [study.label(name)]
        for use in uses:
            share, n = get_number(fit[use] or {}, "interval_90_coverage"), study.count_seen(name, use)
            cells.append(Cell(format_percent(share).rstrip(" %"), "warning" if is_too_narrow(share, n) else "plain"))
        for scale in study.error_scales:
            for use in uses:
                poses = frame[(frame["use"] == use) & frame[scale.column].notna()]
                inside = poses[scale.column] <= poses[scale.bound]
                cells.append(format_percent(float(inside.mean()) if len(poses) else None).rstrip(" %"))
        rows.append(cells)
    note = "Marked: two standard errors below 90 %."
    caption = "Coverage of predictive intervals; nominal 90 %, 95 %."
    return make_table(caption, columns, rows, [Statement(note)])


def _illustrate_errors(study: StudyResults) -> list[Figure]:
    """Return the bars of every deformation, on common axes; of a single model all deformations together."""
    seen = set(study.table("pose_errors")["variant"])
    styles = {name: style for name, style in assign_styles(study).items() if name in seen}
    bars = partial(draw_error_bars, study.table("pose_errors"), study.error_scales, styles)
    if len(study.models) == 1:
        caption = f"{BARS[0].upper()}{BARS[1:]}{study.cite('figures', 'errors_all')}."
        return [Figure("errors_all", caption, partial(bars, list(styles)))]
    shown = []
    for k, deformation in enumerate(study.deformations, start=1):
        name = f"errors_{deformation if re.fullmatch(r'\w+', deformation, re.ASCII) else k}"
        words = describe_deformation(deformation)
        title = f"{words[0].upper()}{words[1:]}"
        caption = f"{title}{study.cite('figures', name)}: {BARS}; common axes."
        variants = [one for one in study.find(deformation=deformation) if one in seen]
        shown += [Figure(name, caption, partial(bars, variants, title))] if variants else []
    return shown


def draw_error_bars(
    predictions: pd.DataFrame, scales: Sequence[ErrorScale], styles: Styles, variants: Sequence[str], title: str = ""
) -> Drawing:
    """Return bars of some variants, from left to right: as high as the largest error, a line at the mean.

    All such figures of a study take the same axes, from ``predictions`` of all its variants.
    """
    crowded = len(variants) > CROWDED
    models, deformations = ({getattr(styles[name], what) for name in variants} for what in ("model", "deformation"))
    by_model = len(models) > 1 and len(deformations) == 1
    said = [styles[name].model if by_model and styles[name].deformation else styles[name].label for name in variants]
    labels = [fill_lines(one, LABEL, break_long_words=False) for one in said]
    more = 0.0 if crowded else LINE * max(label.count("\n") for label in labels)
    height = (3.6 if crowded else 2.2) + more
    figure = Drawing(figsize=(9.4, height))
    figure.set_layout_engine("none")  # fixed margins take half the time
    margins = CROWDED_MARGINS if crowded else MARGINS
    margins = margins | {"bottom": (margins["bottom"] * (height - more) + more) / height}
    uses = [use for use in SHADES if (predictions["use"] == use).any()]
    panels = figure.subplots(1, len(scales), gridspec_kw=margins, squeeze=False)[0]
    for axes, scale in zip(panels, scales, strict=True):
        errors = scale.factor * predictions.groupby(["variant", "use"])[scale.column].agg(["mean", "max"])
        for use, side in zip(uses, (-1, 1) if len(uses) > 1 else (0,), strict=True):
            places = [(name, use) for name in variants]
            mean, largest = (errors[what].reindex(places).to_numpy(float) for what in ("mean", "max"))
            _draw_bars(axes, side, mean, largest, [styles[name].colour for name in variants], SHADES[use], crowded)
        axes.set_ylim(0, (1.35 if crowded else 1.3) * float(errors["max"].max()) or 1.0)
        axes.set_xlim(-0.6, max(len(variants), 3) - 0.4)
        axes.set_xticks(range(len(variants)), labels, **(SLANTED if crowded else {}))
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(scale.label)
        axes.grid(axis="y")
    colours = {styles[name].colour for name in variants}
    colour = colours.pop() if len(colours) == 1 else GREY
    panels[0].set_title(title)
    panels[-1].legend(
        handles=[Patch(color=colour, alpha=SHADES[use], linewidth=0, label=f"{use} poses") for use in uses],
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=2,
        borderaxespad=0.0,
    )
    return figure


def _draw_bars(
    axes: Axes, side: int, mean: Array, largest: Array, colours: Sequence[str], shade: float, upright: bool
) -> None:
    """Draw bars (V,) left (-1) or right (1) of places 0, 1, … or on them (0).

    Their numbers reach away from their neighbours, or up.
    """
    centre = np.arange(len(mean)) + 0.5 * side * WIDTH
    axes.bar(centre, largest, width=0.94 * WIDTH, color=colours, alpha=shade, linewidth=0)
    axes.hlines(mean, centre - 0.47 * WIDTH, centre + 0.47 * WIDTH, color=INK, linewidth=1.6)
    align, between = {-1: "right", 0: "center", 1: "left"}[side], "/" if upright else "/\n"  # in degrees they are long
    for k, both in enumerate(zip(mean, largest, strict=True)):
        text = between.join(format_significant(float(one), 2) for one in both)
        looks: dict[str, Any]
        if upright:
            looks = {"xytext": (0, 2), "ha": "center", "fontsize": 6, "rotation": 90}
        else:
            looks = {"xytext": (3 * side, 2), "ha": align, "fontsize": 7}
        axes.annotate(text, (centre[k] if upright else k, largest[k]), textcoords="offset points", **looks)


def _draw_bounds(predictions: pd.DataFrame, variants: Sequence[str], styles: Styles) -> Drawing:
    """Return every pose's position error in units of its 95 % bound: a row per variant."""
    figure = Drawing(figsize=(9.4, 0.8 + 0.265 * len(variants)))
    axes = figure.subplots()
    ratio = predictions[POSITION.column] / predictions[POSITION.bound]
    frame = predictions.assign(ratio=ratio.clip(lower=1e-6))
    frame = frame[frame["variant"].isin(list(variants)) & frame["ratio"].notna()]
    for k, name in enumerate(variants):
        _draw_strip(axes, frame[frame["variant"] == name], k, styles[name].colour)
    axes.axvline(1.0, color=INK, linewidth=0.9)
    axes.set_xlabel("Error / 95 % bound")
    axes.grid(axis="x")
    axes.tick_params(axis="y", length=0)
    axes.set_xscale("log")
    axes.set_xlim(max(0.002, 0.7 * frame["ratio"].min()), 1.25 * max(1.0, frame["ratio"].max()))
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(range(len(variants)), [styles[name].label for name in variants])
    axes.set_ylim(len(variants) - 0.5, -0.5)
    return figure


def _draw_strip(axes: Axes, rows: pd.DataFrame, k: int, colour: str) -> None:
    """Draw one variant's poses; their order in the survey spreads them over the row's height."""
    ratio = rows["ratio"].to_numpy()
    height = k + 0.56 * ((np.arange(len(rows)) + 0.5) / max(len(rows), 1) - 0.5)
    held = (rows["use"] == "verification").to_numpy()
    for chosen, fill in ((~held, colour), (held, "white")):
        axes.plot(
            ratio[chosen], height[chosen], "o", markersize=3.2, color=fill, markeredgecolor=colour, markeredgewidth=0.8
        )
    beyond = int((ratio > 1).sum())
    expected = 0.05 * len(rows)
    bound = format_significant(MICROMETRES * float(rows[POSITION.bound].median()), 2)
    axes.annotate(
        f"{beyond} of {len(rows)} beyond,\nbound {bound} µm",
        (1.02, k),
        xycoords=("axes fraction", "data"),
        va="center",
        fontsize=7.5,
        color=INK if beyond <= expected + 2 * math.sqrt(0.95 * expected) else RED,
    )
    axes.axhline(k + 0.5, color=GREY, linewidth=0.3, alpha=0.4)


# --- held-back readings ----------------------------------------------------------------------------------------------


def state_held_back(study: StudyResults) -> list[Statement]:
    """Say how many held-back readings of the machine's own sensors lie in their 90 % intervals."""
    mine = study.table("predictions", study.chosen)
    mine = mine[~mine["external"].astype(bool)] if len(mine) else mine
    others = [*_state_lost(study), *_state_tool(study)]
    if mine.empty:
        return others
    share, n = float(mine["in_interval_90"].mean()), len(mine)
    text = f"{int(mine['in_interval_90'].sum())} of {n} verification readings"
    return [_judge_coverage(text, "Prediction", share, int(mine["pose"].nunique())), *others]


def _judge_coverage(text: str, lead: str, share: float, n_poses: int) -> Statement:
    """Return whether so many readings in their 90 % intervals are as expected, a pose counted as one trial."""
    low, high = span_shares(COVERAGE, n_poses, RANGE)
    text = f"{text} lie in their 90 % intervals ({format_percent(share)})"
    if low <= share <= high:
        return Statement(f"{text}, as expected.", "good", lead, value=share, limit=COVERAGE)
    tendency = "narrow" if share < COVERAGE else "wide"
    return Statement(f"{text}: intervals too {tendency}.", "warning", lead, value=share, limit=COVERAGE)


def _state_lost(study: StudyResults) -> list[Statement]:
    """Return how many held-back readings have no prediction."""
    lost, known = study.table("not_predicted", study.chosen), study.table("predictions", study.chosen)
    if lost.empty:
        return []
    names = [f"{quote(channel)} of {pose}" for pose, channel in zip(lost["pose"], lost["channel"], strict=True)]
    text = f"{len(lost)} of {len(lost) + len(known)} verification readings unpredictable: {name_some(names)}."
    return [Statement(text, "warning", "Prediction", value=float(len(lost)))]


def _state_tool(study: StudyResults) -> list[Statement]:
    """Return how many readings of the tool by an instrument lie where the machine's own readings predict them."""
    mine = study.table("tool_predictions", study.chosen)
    if mine.empty:
        return []
    share, n_poses = float(mine["in_interval_90"].mean()), int(mine["pose"].nunique())
    text = f"{int(mine['in_interval_90'].sum())} of {len(mine)} held-back tool readings"
    return [_judge_coverage(text, "Coverage", share, n_poses)]


def show_held_back(study: StudyResults) -> PageSection | None:
    """Return how held-back readings compare with their predictions; None without any."""
    if not study.has("predictions"):
        return None
    table = study.table("predictions")
    table = table.assign(kind=table["channel"].str.partition("[")[0])
    kinds = list(dict.fromkeys(str(kind) for kind in table["kind"]))
    columns = [VARIANT, *(Column(kind, group="in their 90 % intervals") for kind in kinds)]
    rows: list[list[str | Cell]] = []
    for name in study.names:
        mine = table[table["variant"] == name]
        counts = [mine[mine["kind"] == kind]["in_interval_90"] for kind in kinds]
        cells = [f"{int(one.sum())} of {len(one)}" if len(one) else NO_VALUE for one in counts]
        rows.append([study.label(name), *cells])
    notes = [*_state_lost(study), *_state_tool(study)]
    blocks: list[Block] = [HELD_BACK, make_table("Coverage.", columns, rows, notes)]
    mine = study.table("predictions", study.chosen)
    if len(mine):
        caption = f"Held-back readings, {study.label(study.chosen)}."
        blocks.append(Figure("predictions", caption, partial(_draw_predictions, mine)))
    return PageSection("Held-back readings", tuple(blocks), anchor="held-back")


def _draw_predictions(predictions: pd.DataFrame) -> Drawing:
    """Return how far held-back readings lie from what is predicted, in its standard deviations, by channel."""
    channels = list(dict.fromkeys(str(name) for name in predictions["channel"]))
    figure = Drawing(figsize=(8.2, 1.2 + 0.36 * len(channels)))
    axes = figure.subplots()
    axes.axvspan(-NINETY, NINETY, color=PALE, alpha=0.5, linewidth=0.0)
    for row, channel in enumerate(reversed(channels)):
        mine = predictions[predictions["channel"] == channel]
        z = ((mine["measured"] - mine["mean"]) / mine["sd"]).to_numpy()
        spread = row + 0.28 * np.linspace(-1.0, 1.0, len(z)) if len(z) > 1 else np.array([float(row)])
        inside = mine["in_interval_90"].to_numpy(dtype=bool)
        axes.plot(z[inside], spread[inside], "o", color=LEG_COLOURS[0], markersize=3.5)
        axes.plot(z[~inside], spread[~inside], "D", color=RED, markersize=4.0)
    axes.set_yticks(range(len(channels)), [quote(name) for name in reversed(channels)])
    axes.set_xlabel("(Measured − predicted) / sd; grey: 90 %")
    axes.grid(axis="x")
    return figure


# --- poses that the others contradict --------------------------------------------------------------------------------


def list_contradicting(study: StudyResults) -> list[PoseRow]:
    """Return the best variant's poses that the others contradict, those that count least first."""
    rows = [row for row in study.rows(PoseRow, study.best_name) if row.is_outlier]
    return sorted(rows, key=lambda row: row.robust_weight)


def state_outliers(study: StudyResults) -> list[Statement]:
    """Say which poses the others contradict, or that none does where some were expected to be outliers."""
    rows, lead = list_contradicting(study), "Outliers"
    if rows:
        text = f"Possible outliers: {len(rows)} pose{'s' if len(rows) > 1 else ''}."
        action = f"Check the readings of {name_some([row.pose for row in rows])}."
        return [Statement(text, "warning", lead, value=float(len(rows)), limit=0.0, action=action)]
    if not study.fit(study.best_name).get("has_outliers"):
        return []
    least = min(study.rows(PoseRow, study.best_name), key=lambda row: row.robust_weight)
    text = f"No outlier; smallest weight {format_fixed(least.robust_weight, 2)} ({least.pose})."
    return [Statement(text, "good", lead, value=least.robust_weight)]


def show_outliers(study: StudyResults) -> PageSection:
    """Return the residuals of the poses, and those that the others contradict."""
    caption = f"Residuals of {study.label(study.best_name)} / noise."
    blocks: list[Block] = [Figure("poses", caption, partial(_draw_poses, study.table("poses", study.best_name)))]
    columns = [Column("Pose", kind="text"), Column("Equations"), Column("Residual / noise"), Column("Weight")]
    cells: list[list[str | Cell]] = []
    for row in list_contradicting(study):
        size = format_significant(math.sqrt(row.chi2 / max(1, row.n_dof)), 2)
        cells.append([row.pose, str(row.n_dof), size, format_fixed(row.robust_weight, 2)])
    blocks += [WEIGHTS] if study.fit(study.best_name).get("has_outliers") else []
    blocks.append(make_table("Contradicted poses.", columns, cells) if cells else "No contradicted pose.")
    return PageSection("Poses", tuple(blocks), anchor="outliers")


def _draw_poses(poses: pd.DataFrame) -> Drawing:
    """Return the residuals of the best machine at each pose, in units of their noise."""
    figure = Drawing(figsize=(9.4, 2.9))
    axes = figure.subplots()
    size = np.sqrt(poses["chi2"] / np.maximum(poses["n_dof"], 1))
    contradicting = poses["is_outlier"].to_numpy(dtype=bool)
    place = np.arange(len(poses))
    axes.bar(place[~contradicting], size[~contradicting], color=LEG_COLOURS[0], width=0.7)
    axes.bar(place[contradicting], size[contradicting], color=RED, width=0.7)
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    step = -(-len(poses) // MOST_NAMED)
    axes.set_xticks(place[::step], [quote(str(name)) for name in poses["pose"]][::step], rotation=60)
    axes.tick_params(axis="x", labelsize=7.5)
    axes.set_ylabel("Residual / noise")
    axes.set_xlabel("Pose; red: contradicted")
    axes.grid(axis="y")
    return figure
