"""The joints seen from above and where the identification moved them (RR-8096 figure 18)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayescal.experiments.study.page.styles import Styles, VariantStyle
from bayescal.report.numbers import format_plain, format_significant
from bayescal.report.style import GREY, INK, PALE

HARDPOINTS = (("a_x", "a_y", "a"), ("b_x", "b_y", "b"))
DEFORMATION_MARKERS = {"none": "o", "linear": "x", "matrix": "^"}
OTHER_MARKERS = ("s", "D", "v", "P")
SMALL_COLUMNS = 3
ONE_DIRECTION = math.radians(8.0)  # between points whose names would overlap
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")  # ten times faster than mathematical text


def has_joints(parameters: pd.DataFrame) -> bool:
    """Whether the joints' coordinates in the plane are among the parameters, leg by leg."""
    there = set(parameters[parameters["leg"] > 0]["symbol"])
    return all(x in there and y in there for x, y, _ in HARDPOINTS)


def locate_joints(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return one row per variant, point (a or b) and leg: nominal place x, y, move dx, dy, and sd sx, sy, all mm.

    Parameters
    ----------
    parameters : DataFrame
        Posterior summaries with columns variant, symbol, leg, nominal, mean and sd; a in the base frame, b in the
        platform frame.
    """
    index = ["variant", "leg"]
    frames = []
    for x, y, point in HARDPOINTS:
        one, other = (parameters[parameters["symbol"] == s].set_index(index)[["nominal", "mean", "sd"]] for s in (x, y))
        both = one.add_suffix("_x").join(other.add_suffix("_y"), how="inner").reset_index()
        frames.append(
            pd.DataFrame(
                {
                    "variant": both["variant"],
                    "point": point,
                    "leg": both["leg"],
                    "x": both["nominal_x"],
                    "y": both["nominal_y"],
                    "dx": both["mean_x"] - both["nominal_x"],
                    "dy": both["mean_y"] - both["nominal_y"],
                    "sx": both["sd_x"],
                    "sy": both["sd_y"],
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def measure_moves(joints: pd.DataFrame) -> dict[str, float]:
    """Return the rms distance (mm) of each variant's joints from nominal, over all points a and b."""
    square = joints["dx"] ** 2 + joints["dy"] ** 2
    return {str(name): math.sqrt(mean) for name, mean in square.groupby(joints["variant"]).mean().items()}


def find_magnification(joints: pd.DataFrame) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that shows the largest move as a third of the radius."""
    radius = float(np.median(np.hypot(joints["x"].to_numpy(), joints["y"].to_numpy())))
    largest = float(np.hypot(joints["dx"], joints["dy"]).max())
    if not (radius > 0 and largest > 0):
        return 1.0
    wanted = 0.35 * radius / largest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted)


def draw_joints(joints: pd.DataFrame, models: Mapping[str, Sequence[str]], styles: Styles) -> Figure:
    """Return the top view of the joints: the first model large, base and platform apart, the others small.

    Parameters
    ----------
    joints : DataFrame
        From `locate_joints`.
    models : mapping of str to sequence of str
        Variants of each model by its name; the first is shown large.
    styles : mapping
    """
    (first, names), *others = models.items()
    n_rows = math.ceil(len(others) / SMALL_COLUMNS)
    figure = Figure(figsize=(9.4, 4.9 + 2.9 * n_rows))
    grid = figure.add_gridspec(1 + n_rows, 6, height_ratios=[4.9, *[2.9] * n_rows])
    factor, marks, moves = find_magnification(joints), _assign_markers(styles), measure_moves(joints)
    rows = joints[joints["variant"].isin(list(names))]
    for k, (point, where) in enumerate((("a", "base"), ("b", "platform"))):
        axes = figure.add_subplot(grid[0, 3 * k : 3 * k + 3])
        _draw_plan(axes, rows[rows["point"] == point], names, styles, marks, factor, True)
        axes.set_title(f"{first}: points {point} of the {where}, moves magnified {format_plain(factor)} times")
        axes.set_xlabel("x (mm)")
        axes.set_ylabel("y (mm)")
        of_point = measure_moves(rows[rows["point"] == point])
        axes.legend(handles=_legend(names, styles, marks, of_point), loc="center", title="rms distance from nominal")
    for k, (model, names) in enumerate(others):
        axes = figure.add_subplot(grid[1 + k // SMALL_COLUMNS, 2 * (k % SMALL_COLUMNS) : 2 * (k % SMALL_COLUMNS) + 2])
        _draw_plan(axes, joints[joints["variant"].isin(list(names))], names, styles, marks, factor, False)
        axes.set_title(f"{model}: a and b")
        axes.legend(handles=_legend(names, styles, marks, moves, with_name=False), loc="center", handletextpad=0.2)
    return figure


def _assign_markers(styles: Styles) -> dict[str, str]:
    others = cycle(OTHER_MARKERS)
    found = {s.deformation: DEFORMATION_MARKERS.get(s.deformation) or next(others) for s in styles.values()}
    return {name: s.marker if s.has_own_name else found[s.deformation] for name, s in styles.items()}


def _mark(style: VariantStyle, marker: str) -> dict[str, Any]:
    """Return how a point is drawn: a circle open, the others in full colour."""
    fill = "none" if marker == "o" else style.colour
    return {
        "color": style.colour,
        "marker": marker,
        "markerfacecolor": fill,
        "markeredgewidth": 1.4,
        "linestyle": "none",
    }


def _legend(
    names: Sequence[str],
    styles: Styles,
    marks: Mapping[str, str],
    moves: Mapping[str, float],
    with_name: bool = True,
) -> list[Line2D]:
    handles = []
    for name in (name for name in names if name in moves):
        style = styles[name]
        word = f"{style.label}: " if style.has_own_name else f"{style.deformation}: " if with_name else ""
        label = f"{word}{format_significant(moves[name], 2)} mm"
        handles.append(Line2D([], [], markersize=6, label=label, **_mark(style, marks[name])))
    return handles


def _draw_plan(
    axes: Axes,
    rows: pd.DataFrame,
    names: Sequence[str],
    styles: Styles,
    marks: Mapping[str, str],
    factor: float,
    large: bool,
) -> None:
    x, y = rows["x"] + factor * rows["dx"], rows["y"] + factor * rows["dy"]
    reach = 1.08 * float(max(np.hypot(x, y).max(), np.hypot(rows["x"], rows["y"]).max()))
    for point, of_point in rows.groupby("point"):
        _draw_nominal(axes, of_point.drop_duplicates("leg"), str(point), reach if large else 0.0)
    for name in names:
        one = rows[rows["variant"] == name]
        colour = styles[name].colour
        ends = one["x"] + factor * one["dx"], one["y"] + factor * one["dy"]
        axes.plot(np.stack([one["x"], ends[0]]), np.stack([one["y"], ends[1]]), color=colour, linewidth=0.9, alpha=0.8)
        if large:
            wide, high = factor * one["sx"], factor * one["sy"]
            axes.hlines(ends[1], ends[0] - wide, ends[0] + wide, color=colour, linewidth=0.8, alpha=0.7)
            axes.vlines(ends[0], ends[1] - high, ends[1] + high, color=colour, linewidth=0.8, alpha=0.7)
        axes.plot(*ends, markersize=7 if large else 4.5, **_mark(styles[name], marks[name]))
    axes.set_aspect("equal")
    limit = 1.08 * reach if large else reach
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-limit, limit)
    if large:
        axes.grid()
    else:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_visible(False)


def _draw_nominal(axes: Axes, nominal: pd.DataFrame, point: str, reach: float) -> None:
    """Draw the nominal points, joined in order around the centre; at a reach, if any, stand their names."""
    outline = nominal.iloc[np.argsort(np.arctan2(nominal["y"], nominal["x"]))]
    line = "-" if point == "a" else "--"
    axes.fill(outline["x"], outline["y"], facecolor="none", edgecolor=PALE if reach else GREY, linewidth=0.8, ls=line)
    axes.plot(nominal["x"], nominal["y"], linestyle="none", marker=".", markersize=5, color=INK)
    if not reach:
        return
    for legs, azimuth in _group_by_azimuth(outline):
        words = ", ".join(f"{point}{str(leg).translate(SUBSCRIPTS)}" for leg in sorted(legs))
        x, y = reach * math.cos(azimuth), reach * math.sin(azimuth)
        side = "left" if x > 0 else "right"  # several names are wide and go outwards, off the marks
        axes.text(
            x, y, words, ha=side if len(legs) > 1 and abs(x) > 0.5 * reach else "center", va="center", fontsize=10
        )


def _group_by_azimuth(outline: pd.DataFrame) -> list[tuple[list[int], float]]:
    """Return legs in order of azimuth, those in one direction together, each group with its azimuth in radians."""
    groups: list[tuple[list[int], list[float]]] = []
    for leg, azimuth in zip(outline["leg"], np.arctan2(outline["y"], outline["x"]), strict=True):
        if groups and azimuth - groups[-1][1][-1] < ONE_DIRECTION:
            groups[-1][0].append(int(leg))
            groups[-1][1].append(float(azimuth))
        else:
            groups.append(([int(leg)], [float(azimuth)]))
    return [(legs, float(np.mean(azimuths))) for legs, azimuths in groups]
