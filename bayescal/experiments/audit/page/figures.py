"""The figures of an audit's page: what each shows, what is written below it, and why it may be left out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayescal.experiments.audit.page.results import KNOWN_LIMITS, AuditResults
from bayescal.experiments.audit.page.verdict import is_met
from bayescal.experiments.audit.page.wording import (
    format_contraction,
    format_share,
    name_change,
    name_requirement,
    name_unit,
)
from bayescal.experiments.audit.rows import PARAMETER_ERROR, RANDOM_ERROR, AuditCombinationRow, AuditRequirementRow
from bayescal.experiments.shared.headline import LIKELY
from bayescal.experiments.shared.machine_scene import build_scene, read_joint_columns
from bayescal.limits import IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Figure
from bayescal.report.numbers import format_percent, format_plain, join_words
from bayescal.report.scene import Scene
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, PALE, RED
from bayescal.report.symbols import ChosenUnits, quote, set_mathematics, set_parameter, shown_in, split_name

BLUE, ORANGE, YELLOW = "#0072B2", "#D55E00", "#E69F00"
WIDTH = 9.4  # inches
MILLIMETRES = {"um": 1e-3, "mm": 1.0, "m": 1e3}


def _grid(height: float, rows: int = 1, columns: int = 1, width: float = WIDTH) -> tuple[Drawing, list[Axes]]:
    figure = Drawing(figsize=(width, height))
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def _scale_log(axes: Axes, suffix: str = "", most: int | None = None) -> None:
    """Make an ordinate logarithmic, its ticks plain numbers, several in a decade."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(base=10.0, subs=(1.0, 2.0, 5.0), numticks=most))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{format_plain(value)}{suffix}"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def show_machine(audit: AuditResults) -> list[Scene]:
    """Return the machine in space at its planned poses, with what remains unknown of its joints."""
    if "joints" not in audit.tables:
        return []
    frame = pd.DataFrame(
        [
            {"symbol": row.symbol, "leg": row.leg, "sd": row.posterior_sd * MILLIMETRES[row.unit]}
            for row in audit.parameters
            if row.unit in MILLIMETRES
        ]
    )
    scene = build_scene(audit.tables["joints"], spreads=read_joint_columns(frame, "sd"))
    return [] if scene is None else [scene]


# --- contractions as heat maps with numbers --------------------------------------------------------------------------

# orange where nothing is learnt, pale about what is learnt in part, blue where the tolerance is at least halved
COLOURS = LinearSegmentedColormap.from_list(
    "contraction",
    [
        (0.0, "#e08344"),
        (UNIDENTIFIABLE_CONTRACTION, "#f3c39d"),
        (0.5, "#f5f1ea"),
        (IDENTIFIABLE_CONTRACTION, "#b9d6ea"),
        (1.0, "#3f86bd"),
    ],
)
CELL = 0.24  # inches, height of a row
NUMBERED = 26  # columns with legible numbers


def show_contraction(results: AuditResults) -> Figure:
    """Return the contraction of every parameter: a row per symbol, a column per leg; the reduced set outlined."""
    symbols, rows = results.symbols, results.parameters
    legs = sorted({row.leg for row in rows}, key=lambda leg: (leg == 0, leg))  # parameters of the machine last
    values, free = np.full((len(symbols), len(legs)), np.nan), np.zeros((len(symbols), len(legs)), dtype=bool)
    for one in rows:
        place = symbols.index(one.symbol), legs.index(one.leg)
        values[place], free[place] = one.contraction, one.reduced_set
    caption = "Contraction; blue: uncertainty at least halved. Outlined: reduced set."

    def draw() -> Drawing:
        width = min(WIDTH, 1.6 + 0.75 * len(legs))
        figure, (axes,) = _grid(0.75 + CELL * len(values), width=width)
        _draw_heat(axes, values, [set_mathematics(symbol) for symbol in symbols])
        axes.set_xticks(range(len(legs)), [f"{results.member} {leg}" if leg else "machine" for leg in legs])
        for row, column in np.argwhere(free):
            place = (float(column) - 0.46, float(row) - 0.42)
            axes.add_patch(Rectangle(place, 0.92, 0.84, fill=False, edgecolor=INK, linewidth=1.1))
        return figure

    return Figure("contraction", caption, draw)


def show_changes(results: AuditResults) -> Figure:
    """Return what other plans determine of each weak combination: a row per plan, a column per combination."""
    ridges = [ridge for ridge in results.ridges if ridge.kind == "practical"]
    order = {symbol: k for k, symbol in enumerate(results.symbols)}
    ridges.sort(key=lambda ridge: (order[split_name(ridge.pivot)[0]], split_name(ridge.pivot)[1]))
    pivots = [ridge.pivot for ridge in ridges]
    plan = {ridge.pivot: ridge.contraction for ridge in ridges}
    table = pd.DataFrame(
        [plan, *({p: c.ridges.get(p, np.nan) for p in pivots} for c in results.changes)], columns=pivots
    )
    if len(pivots) > NUMBERED:  # the least of each symbol where these are too many to be read
        table = table.T.groupby([split_name(p)[0] for p in pivots], sort=False).min().T
    caption = "Contraction of weak combinations by plan; blue: determined."
    if not ridges or not results.changes:
        reason = "no weak combination" if not ridges else "no other plan"
        return Figure("changes", caption, None, reason)
    labels = ["as it is" if results.is_measured else "as planned", *map(name_change, results.changes)]

    def draw() -> Drawing:
        width = min(WIDTH, 2.8 + 0.75 * len(table.columns))
        figure, (axes,) = _grid(0.85 + CELL * len(labels), width=width)
        _draw_heat(axes, table.to_numpy(dtype=float), [quote(name) for name in labels])
        names = [set_parameter(name) for name in table.columns]
        axes.set_xticks(range(len(names)), names, rotation=90 * (len(names) > NUMBERED))
        axes.axhline(0.5, color=INK, linewidth=1.0)
        return figure

    return Figure("changes", caption, draw)


def _draw_heat(axes: Axes, values: Array, names: list[str]) -> None:
    """Draw contractions, shape (rows, columns), NaN where there is none, with the names of the rows."""
    rows, columns = values.shape
    axes.imshow(np.ma.masked_invalid(values), cmap=COLOURS, vmin=0.0, vmax=1.0, aspect="auto")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=1.5)
    axes.tick_params(which="minor", length=0)
    size = 8.0 if columns <= NUMBERED // 2 else 6.6
    for i, j in np.ndindex(rows, columns):
        if np.isfinite(values[i, j]) and columns <= NUMBERED:
            text = format_contraction(float(values[i, j]))
            axes.text(j, i, text, ha="center", va="center", fontsize=size, color=INK)
    axes.xaxis.tick_top()
    axes.set_yticks(range(rows), names)


# --- spectra ---------------------------------------------------------------------------------------------------------

FLOOR = 1e-3  # of what rounding or the thresholds are, below which values are drawn at the floor


def show_spectrum(results: AuditResults) -> Figure:
    """Return the spectra that decide: over a wide workspace against rounding, of the plan against the tolerances."""
    caption = "Left: noise-free Jacobian, per tolerance. Right: planned measurements."
    return Figure("spectrum", caption, partial(_draw_spectrum, results.tables["spectrum"]))


def _draw_spectrum(spectrum: pd.DataFrame) -> Drawing:
    figure, (left, right) = _grid(3.3, columns=2)
    counts, number = spectrum["is_in_rank"].to_numpy(dtype=bool), spectrum["number"].to_numpy()
    values, planned = (spectrum[key].to_numpy(dtype=float) for key in ("wide_workspace", "planned"))
    rounding, rank, (low, high) = float(spectrum["noise_floor"].iloc[0]), int(counts.sum()), KNOWN_LIMITS

    def draw_groups(axes: Axes, shown: Array, groups: Sequence[tuple[np.ndarray, str, str, str]]) -> None:
        for chosen, colour, marker, label in groups:
            if chosen.any():
                axes.plot(number[chosen], shown[chosen], marker, markersize=3.5, color=colour, label=label)

    shown = np.maximum(values, FLOOR * rounding if rounding > 0.0 else np.finfo(float).tiny)
    draw_groups(left, shown, ((counts, BLUE, "o", "seen"), (~counts, RED, "s", "never seen")))
    left.axhline(rounding, color=GREY, linestyle="--", linewidth=1.0, label="noise floor")
    if 0 < rank < len(counts):
        left.axvline(rank + 0.5, color=INK, linewidth=0.6, linestyle=":")
    left.set_ylabel("Singular value")
    left.set_title(f"Structural rank {rank} of {len(counts)}")
    groups = (
        (planned >= high, BLUE, "o", "determined"),
        ((planned >= low) & (planned < high), ORANGE, "^", "in part"),
        (planned < low, RED, "s", "weak or never"),
    )
    draw_groups(right, np.maximum(planned, FLOOR * low), groups)
    for value, contraction in ((high, IDENTIFIABLE_CONTRACTION), (low, UNIDENTIFIABLE_CONTRACTION)):
        right.axhline(value, color=GREY, linestyle="--", linewidth=1.0)
        right.text(1, value * 1.12, f"contraction {format_plain(contraction)}", fontsize=8, color="#555555")
    right.set_ylabel("Prior sd / data sd")
    right.set_title("Planned measurements")
    for axes in (left, right):
        axes.legend(loc="best")
        axes.set_yscale("log")
        axes.set_xlabel("Number")
        axes.xaxis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
        axes.grid(axis="y")
    return figure


# --- requirements ----------------------------------------------------------------------------------------------------


def show_requirements(results: AuditResults) -> Figure:
    """Return the predicted errors against their limits."""
    caption = f"Largest sd / limit. Tick: parameters alone. Blue: met (P ≥ {format_percent(LIKELY)})."
    if not results.requirements:
        return Figure("requirements", caption, None, "no requirement given")
    kept = np.array([is_met(results, r) for r in results.requirements])
    return Figure("requirements", caption, partial(_draw_requirements, results.requirements, kept))


def _draw_requirements(requirements: Sequence[AuditRequirementRow], kept: np.ndarray) -> Drawing:
    figure, (axes,) = _grid(1.0 + 0.42 * len(requirements))
    rows = np.arange(len(requirements))
    before, after, geometry = (
        100.0 * np.array([getattr(r, key) / r.limit for r in requirements])
        for key in ("prior_sd", "predicted_sd", "parameter_sd")
    )
    axes.hlines(rows, np.minimum(after, before), np.maximum(after, before), color=PALE, linewidth=5.0, zorder=1)
    shape: dict[str, Any] = {"linestyle": "none", "markersize": 6.5}
    axes.plot(before, rows, marker="o", markerfacecolor="white", color=GREY, label="before", **shape)
    axes.plot(geometry, rows, marker="|", color=INK, label="parameters alone", **shape)
    for colour, label, chosen in ((BLUE, "after, met", kept), (RED, "after, not met", ~kept)):
        if chosen.any():
            axes.plot(after[chosen], rows[chosen], marker="o", color=colour, label=label, **shape)
    for row, value in zip(rows, after, strict=True):
        axes.annotate(
            format_share(value / 100.0), (value, row), (0, 6), textcoords="offset points", ha="center", fontsize=8
        )
    axes.set_xscale("log")
    positive = np.concatenate([before, after, geometry, [100.0]])
    positive = positive[positive > 0.0]
    axes.set_xlim(positive.min() / 2.0, positive.max() * 2.0)
    axes.axvline(100.0, color=INK, linewidth=1.2, label="the limit")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{format_plain(value, separator=',')} %"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_yticks(rows, [quote(name_requirement(r.requirement)) for r in requirements])
    axes.set_ylim(len(requirements) - 0.5, -0.6)
    axes.set_xlabel("Predicted sd / limit (%)")
    axes.grid(axis="x")
    figure.legend(loc="outside upper left", ncols=5, borderaxespad=0.2, fontsize=8)
    return figure


# --- sweeps ----------------------------------------------------------------------------------------------------------

SWEEPS = {
    "noise": "Sensor noise / planned noise",
    "poses": "Number of poses",
    "workspace": "Displacements / planned",
}
LINE_COLOURS = (BLUE, ORANGE, "#009E73", "#CC79A7", YELLOW, "#56B4E9", "#555555")
LINES = ("-", "--", ":")


def show_sweeps(results: AuditResults) -> Figure:
    """Return how tolerances and predicted errors go with noise, number of poses and displacements."""
    sweeps = results.tables.get("sweeps")
    caption = f"Posterior sd / prior sd, least-known {results.member}; below: sd / limit. Open: beyond range."
    if sweeps is None or not set(sweeps["sweep"]) & set(SWEEPS):
        return Figure("sweeps", caption, None, "nothing was swept")
    required = results.tables.get("sweep_requirements")
    return Figure("sweeps", caption, partial(_draw_sweeps, sweeps, required, float(results.n_poses)))


def _draw_sweeps(sweeps: pd.DataFrame, requirements: pd.DataFrame | None, n_poses: float) -> Drawing:
    """Return a column per sweep: what is left of the tolerances, and below it the predicted errors, if any."""
    kinds = [name for name in SWEEPS if name in set(sweeps["sweep"])]
    rows = 1 if requirements is None else 2
    figure = Drawing(figsize=(WIDTH, 0.5 + 2.9 * rows))
    grid = figure.subplots(rows, len(kinds), squeeze=False, sharex="col", sharey="row")
    for column, kind in enumerate(kinds):
        mine = sweeps[sweeps["sweep"] == kind]
        _draw_left(grid[0, column], mine)
        if requirements is not None:
            _draw_required(grid[1, column], requirements[requirements["sweep"] == kind])
        for axes in grid[:, column]:
            axes.set_xscale("log")
            axes.axvline(n_poses if kind == "poses" else 1.0, color=GREY, linewidth=0.8)
            axes.grid()
        _label_values(grid[-1, column], sorted(set(mine["value"])))
        grid[-1, column].set_xlabel(SWEEPS[kind])
    labels = ("Posterior sd / prior sd", "Predicted sd / limit (%)")
    for label, row in zip(labels, grid, strict=False):
        row[0].set_ylabel(label)
        place: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.02, 0.5)}
        row[-1].legend(*row[-1].get_legend_handles_labels(), handlelength=2.2, labelspacing=0.25, **place)
    return figure


def _style_line(k: int) -> dict[str, Any]:
    n = len(LINE_COLOURS)
    return {"color": LINE_COLOURS[k % n], "linestyle": LINES[k // n % 3]}


def _draw_left(axes: Axes, rows: pd.DataFrame) -> None:
    for k, (symbol, one) in enumerate(rows.groupby("symbol", sort=False)):
        line, style = one.sort_values("value"), _style_line(k)
        left = 100.0 * np.sqrt(np.maximum(1.0 - line["contraction_min"].to_numpy(dtype=float), 1e-16))
        axes.plot(line["value"], left, linewidth=1.2, label=set_mathematics(str(symbol)), **style)
        beyond = line["is_beyond_range"].to_numpy(dtype=bool)
        for chosen, face in ((beyond, "white"), (~beyond, style["color"])):
            x, y = line["value"].to_numpy()[chosen], left[chosen]
            axes.plot(x, y, linestyle="none", marker="o", markersize=3.2, color=style["color"], markerfacecolor=face)
    for contraction in (IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION):
        axes.axhline(100.0 * np.sqrt(1.0 - contraction), color=RED, linewidth=0.8, linestyle="--")
    _scale_log(axes, " %", 9)


def _draw_required(axes: Axes, rows: pd.DataFrame) -> None:
    for k, (name, one) in enumerate(rows.groupby("requirement", sort=False)):
        line = one.sort_values("value")
        share = 100.0 * line["predicted_sd"] / line["limit"]
        style = {**_style_line(k), "linestyle": LINES[k % 2]}  # x and y often lie upon each other
        label = quote(name_requirement(str(name)))
        axes.plot(line["value"], share, marker="o", markersize=3.2, linewidth=1.2, label=label, **style)
    axes.axhline(100.0, color=RED, linewidth=0.8, linestyle="--")
    _scale_log(axes, " %", 9)


def _label_values(axes: Axes, values: list[float]) -> None:
    """Label the values swept, as many as there is room for."""
    kept: list[float] = []
    room = (np.log(values[-1]) - np.log(values[0])) / 6.0 if len(values) > 1 else 0.0
    for value in values:
        if not kept or np.log(value / kept[-1]) >= room * 0.999:
            kept.append(value)
    axes.set_xticks(kept, [format_plain(value) for value in kept])
    axes.minorticks_off()


# --- profile likelihoods ---------------------------------------------------------------------------------------------

COLUMNS = 4
NINETY_FIVE = 3.841  # deviance of one parameter
HIGHEST = 12.0


def show_profiles(results: AuditResults) -> Figure:
    """Return the deviance of each profiled parameter, all others fitted again."""
    profiles = results.tables.get("profiles")
    caption = "Profile likelihoods. Below the dotted line: not bounded by data."
    if profiles is None:
        return Figure("profiles", caption, None, "no profiles requested")
    return Figure("profiles", caption, partial(_draw_profiles, profiles))


def _draw_profiles(profiles: pd.DataFrame) -> Drawing:
    figure, panels = _make_panels(profiles["parameter"].nunique(), 1.9)
    styles: tuple[dict[str, Any], ...] = (
        {"color": BLUE, "linewidth": 1.5},
        {"color": YELLOW, "linewidth": 1.2, "linestyle": "--"},
        {"color": RED, "linewidth": 0.8, "linestyle": ":"},
    )
    for axes, (name, one) in zip(panels, profiles.groupby("parameter", sort=False), strict=True):
        line = one.sort_values("value")
        offset = line["value"] - one["value"].iloc[int(one["deviance_total"].argmin())]
        for column, style in zip(("deviance_data", "deviance_total"), styles, strict=False):
            axes.plot(offset, line[column], **style)
        axes.axhline(NINETY_FIVE, **styles[2])
        axes.set_ylim(-0.4, HIGHEST)
        axes.set_title(set_parameter(str(name)))
        axes.set_xlabel(_label("from expected", str(one["unit"].iloc[0])))
        axes.locator_params(axis="x", nbins=4)
        axes.grid()
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("Deviance")
    labels = ("measurements alone", "with tolerances", "95 %")
    handles = [Line2D([], [], label=label, **style) for label, style in zip(labels, styles, strict=True)]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, borderaxespad=0.2)
    return figure


def _label(text: str, unit: str) -> str:
    named = name_unit(unit)
    return f"{text} ({quote(named)})" if named else text


def _make_panels(n: int, height: float) -> tuple[Drawing, list[Axes]]:
    rows = -(-n // COLUMNS)
    figure, panels = _grid(0.4 + height * rows, rows, COLUMNS)
    for axes in panels[n:]:
        axes.set_visible(False)
    return figure, panels[:n]


def span_profile(one: pd.DataFrame, column: str = "deviance_data") -> tuple[float, float]:
    """Return the least and largest value of a parameter within the 95 % of its profile; infinite where it is open."""
    rows = one.sort_values("value")
    value, deviance = rows["value"].to_numpy(dtype=float), rows[column].to_numpy(dtype=float)
    best = int(np.argmin(deviance))
    low, high = _cross(value[best::-1], deviance[best::-1]), _cross(value[best:], deviance[best:])
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def _cross(value: Array, deviance: Array) -> float | None:
    """Return where the deviance first exceeds the 95 % on the way outwards, between the points linearly."""
    above = np.flatnonzero(deviance > NINETY_FIVE)
    if not len(above) or above[0] == 0:
        return float(value[0]) if len(above) else None
    k = int(above[0])
    share = (NINETY_FIVE - deviance[k - 1]) / (deviance[k] - deviance[k - 1])
    return float(value[k - 1] + share * (value[k] - value[k - 1]))


# --- ridges as draws show them ---------------------------------------------------------------------------------------

PANELS = 12  # of ridges in the first figure
SHOWN_DRAWS = 1200
DOTS: dict[str, Any] = {"linestyle": "none", "marker": "."}
SOURCES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "prior": ("prior", "prior (grey)", {"color": "#b5b5b5", "alpha": 0.8, **DOTS}),
    "forecast": (
        "expected posterior, first order",
        "expected posterior (blue)",
        {"color": BLUE, "alpha": 0.5, **DOTS},
    ),
    "posterior": ("posterior", "posterior (blue)", {"color": BLUE, "alpha": 0.5, **DOTS}),
    "profile": (
        "profile path",
        "profile path (dashed)",
        {"color": INK, "linewidth": 1.0, "linestyle": "--"},
    ),
    "tangent": (
        "information direction",
        "information direction (dotted)",
        {"color": RED, "linewidth": 1.0, "linestyle": ":"},
    ),
}
"""By source of what is drawn of a ridge: its name in the key, in the caption, and how it looks."""


def show_ridges(results: AuditResults) -> list[Figure]:
    """Return the ridges that have a plot: the first of each kind, and all others where there are some."""
    empty = pd.DataFrame(columns=["direction", "source", "x", "y"])
    draws, curves = (results.tables.get(name, empty) for name in ("ridge_draws", "ridge_curves"))
    there, sources = {*draws["direction"], *curves["direction"]}, {*draws["source"], *curves["source"]}
    plotted = [ridge for ridge in results.ridges if ridge.plot_x and ridge.number in there]
    leading = [next((ridge for ridge in group if ridge in plotted), None) for group in results.groups]
    first = [ridge for ridge in leading if ridge is not None][:PANELS]
    others = [ridge for ridge in plotted if ridge not in first]
    left_out = results.summary.get("no_posterior_reason")
    shown = join_words([words for source, (_, words, _) in SOURCES.items() if source in sources])
    caption = f"Draws along undetermined combinations: {shown}."
    if "posterior" in sources:
        caption += " Posterior as wide as prior: unidentifiable."
    else:
        reason = f": {left_out}" if isinstance(left_out, str) else ""
        caption += f" No posterior draws{reason}."
    if not first:
        reason = left_out if isinstance(left_out, str) else "no posterior draws"
        return [Figure("ridges", caption, None, reason)]
    found = [Figure("ridges", caption, partial(_draw_ridges, first, draws, curves))]
    if others:
        same = "Other ridges."
        found.append(Figure("ridges_others", same, partial(_draw_ridges, others, draws, curves)))
    return found


def _draw_ridges(ridges: Sequence[AuditCombinationRow], draws: pd.DataFrame, curves: pd.DataFrame) -> Drawing:
    """Return a panel per ridge; of draws that there are also without their moves along the other ridges, these."""
    figure, panels = _make_panels(len(ridges), 2.35)
    for axes, ridge in zip(panels, ridges, strict=True):
        cloud, own = (table[table["direction"] == ridge.number] for table in (draws, curves))
        for source in ("prior", "forecast", "posterior"):
            points = cloud[cloud["source"] == source]
            points = points.iloc[:: max(1, len(points) // SHOWN_DRAWS)]
            x, y = (points[f"{axis}_held" if f"{axis}_held" in points else axis] for axis in "xy")
            if len(points):
                axes.plot(x, y, markersize=2.4, **SOURCES[source][2])
        limits = axes.get_xlim(), axes.get_ylim()
        for source in ("profile", "tangent"):
            line = own[own["source"] == source]
            if len(line):
                axes.plot(line["x"], line["y"], **SOURCES[source][2])
        if len(cloud):
            axes.set(xlim=limits[0], ylim=limits[1])
        axes.set_xlabel(_label(set_parameter(ridge.plot_x), ridge.plot_x_unit))
        axes.set_ylabel(_label(set_parameter(ridge.plot_y), ridge.plot_y_unit))
        axes.locator_params(nbins=4)
        axes.grid()
    there = {*draws["source"], *curves["source"]}
    keys = [
        Line2D([], [], markersize=8, label=name, **(style | {"alpha": None}))
        for source, (name, _, style) in SOURCES.items()
        if source in there
    ]
    figure.legend(handles=keys, loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


# --- what to measure with --------------------------------------------------------------------------------------------

BEST = LEG_COLOURS[4]
SHOWN = 1e3  # times the best error, above which sets are left out of the picture


def draw_sets(sets: pd.DataFrame, best: pd.DataFrame, required: bool, against: str) -> Drawing:
    """Return the error of every set of sensors against their number or cost, the best of each joined."""
    figure, (axes,) = _grid(4.0, width=8.4)
    good = sets[(sets["goal"] < SHOWN * best["goal"].min()) & ~sets["sensors"].isin(best["sensors"])]
    by_number = against == "number"
    column, shift = (
        ("n_sensors", 0.3 * (((0.618034 * np.arange(len(good))) % 1.0) - 0.5)) if by_number else ("cost", 0.0)
    )
    axes.plot(good[column] + shift, good["goal"], ".", color=PALE, markersize=5.0, label="another set")
    axes.plot(best[column], best["goal"], "-o", color=BEST, markersize=5.0, label=f"best of each {against}")
    if required:
        axes.axhline(1.0, color=RED, linewidth=0.9, label="sd = limit")
    _finish_log(axes, by_number)
    axes.set_ylabel("Largest sd / limit" if required else "Error")
    axes.set_xlabel("Number of sensors" if by_number else "Cost")
    return figure


def draw_counts(counts: pd.DataFrame, enough: int, asked: ChosenUnits) -> Drawing:
    """Return the error of each coordinate against the number of poses, chosen and at random."""
    names = [str(one).removeprefix(PARAMETER_ERROR) for one in counts.columns if str(one).startswith(PARAMETER_ERROR)]
    units = list(dict.fromkeys(name.rpartition("_")[2] for name in names))
    figure, panels = _grid(3.8, columns=len(units), width=8.4)
    number = counts["n_poses"]
    for axes, unit in zip(panels, units, strict=True):
        factor, shown = shown_in(unit, asked)
        for k, name in enumerate(one for one in names if one.rpartition("_")[2] == unit):
            colour, marker = LEG_COLOURS[(k + 4) % 6], MARKERS[k % len(MARKERS)]
            label = quote(name.rpartition("_")[0])
            axes.plot(
                number, factor * counts[f"{PARAMETER_ERROR}{name}"], "-", marker=marker, color=colour, label=label
            )
            axes.plot(number, factor * counts[f"{RANDOM_ERROR}{name}"], ":", color=colour)
        axes.plot([], [], ":", color=GREY, label="at random")
        if flat := enough < number.max():
            axes.axvline(enough, color=INK, linewidth=0.8, linestyle="--")
        _finish_log(axes, integers=True)
        axes.set_xlabel(f"Number of poses{'; dashed: enough' if flat else ''}")
        axes.set_ylabel(f"rms over the workspace ({shown})" if shown else "rms over the workspace")
    return figure


def _finish_log(axes: Axes, integers: bool) -> None:
    _scale_log(axes)
    axes.xaxis.set_major_locator(MaxNLocator(integer=integers))
    axes.grid(axis="y")
    axes.legend(loc="upper right")
