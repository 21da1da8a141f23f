"""Profile likelihoods and ridges: what the measurements leave open, drawn with the machine itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayescal.experiments.audit.page.results import Ridge
from bayescal.experiments.audit.page.wording import name_unit
from bayescal.numerics.geometry import Array
from bayescal.report.style import INK, RED
from bayescal.report.symbols import quote, set_parameter

BLUE = "#0072B2"
ORANGE = "#E69F00"
GREY = "#b5b5b5"
COLUMNS = 4
NINETY_FIVE = 3.841  # deviance of one parameter
HIGHEST = 12.0
SHOWN_DRAWS = 1200
CURVES: dict[str, dict[str, Any]] = {
    "analytic": {"color": RED, "linewidth": 1.2},
    "profile": {"color": INK, "linewidth": 1.0, "linestyle": "--"},
    "tangent": {"color": RED, "linewidth": 1.0, "linestyle": ":"},
}


def draw_profiles(profiles: pd.DataFrame, centres: Mapping[str, float]) -> Figure:
    """Return the deviance of each profiled parameter, all others fitted again.

    Parameters
    ----------
    profiles : DataFrame
        The audit's table.
    centres : mapping of str to float
        Expected values.
    """
    names = list(dict.fromkeys(profiles["parameter"]))
    figure, panels = _make_panels(len(names), 1.9)
    for axes, name in zip(panels, names, strict=True):
        one = profiles[profiles["parameter"] == name].sort_values("value")
        offset = one["value"] - centres[name]
        axes.plot(offset, one["deviance_data"], color=BLUE, linewidth=1.5)
        axes.plot(offset, one["deviance_total"], color=ORANGE, linewidth=1.2, linestyle="--")
        axes.axhline(NINETY_FIVE, color=RED, linewidth=0.8, linestyle=":")
        axes.set_ylim(-0.4, HIGHEST)
        axes.set_title(set_parameter(name))
        axes.set_xlabel(_label("from expected", str(one["unit"].iloc[0])))
        axes.locator_params(axis="x", nbins=4)
        axes.grid()
    for axes in panels[::COLUMNS]:
        axes.set_ylabel("Deviance")
    handles = [
        Line2D([], [], color=BLUE, linewidth=1.5, label="measurements alone"),
        Line2D([], [], color=ORANGE, linewidth=1.2, linestyle="--", label="with the tolerances"),
        Line2D([], [], color=RED, linewidth=0.8, linestyle=":", label="95 %"),
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, borderaxespad=0.2)
    return figure


def _label(text: str, unit: str) -> str:
    named = name_unit(unit)
    return f"{text} ({quote(named)})" if named else text


def _make_panels(n: int, height: float) -> tuple[Figure, list[Axes]]:
    rows = -(-n // COLUMNS)
    figure = Figure(figsize=(9.4, 0.4 + height * rows))
    panels = list(figure.subplots(rows, COLUMNS, squeeze=False).ravel())
    for axes in panels[n:]:
        axes.set_visible(False)
    return figure, panels[:n]


def draw_ridge_plots(ridges: Sequence[Ridge], draws: pd.DataFrame, curves: pd.DataFrame) -> Figure:
    """Return a panel per ridge: draws of prior and posterior, and the ridge as computed.

    Parameters
    ----------
    ridges : sequence of Ridge
        Each with a plot.
    draws, curves : DataFrame
        The audit's tables; of draws that also stand without their moves along the other ridges, these.
    """
    figure, panels = _make_panels(len(ridges), 2.35)
    for axes, ridge in zip(panels, ridges, strict=True):
        cloud = draws[draws["direction"] == ridge.number]
        for source, colour, alpha in (("prior", GREY, 0.8), ("forecast", BLUE, 0.5), ("posterior", BLUE, 0.5)):
            points = _thin(cloud[cloud["source"] == source])
            x, y = (points[f"{axis}_held" if f"{axis}_held" in points else axis] for axis in "xy")
            if len(points):
                axes.plot(x, y, linestyle="none", marker=".", markersize=2.4, color=colour, alpha=alpha)
        limits = axes.get_xlim(), axes.get_ylim()
        own = curves[curves["direction"] == ridge.number]
        for source, style in CURVES.items():
            line = own[own["source"] == source]
            if len(line):
                axes.plot(line["x"], line["y"], **style)
        if len(cloud):
            axes.set_xlim(limits[0])
            axes.set_ylim(limits[1])
        axes.set_xlabel(_label(set_parameter(ridge.plot["x"]), ridge.plot["x_unit"]))
        axes.set_ylabel(_label(set_parameter(ridge.plot["y"]), ridge.plot["y_unit"]))
        axes.locator_params(nbins=4)
        axes.grid()
    figure.legend(handles=_list_keys(draws, curves), loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


def _thin(points: pd.DataFrame) -> pd.DataFrame:
    return points.iloc[:: max(1, len(points) // SHOWN_DRAWS)]


def _list_keys(draws: pd.DataFrame, curves: pd.DataFrame) -> list[Line2D]:
    dots: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 8}
    keys = {
        "prior": Line2D([], [], color=GREY, label="prior", **dots),
        "forecast": Line2D([], [], color=BLUE, label="expected posterior, first order", **dots),
        "posterior": Line2D([], [], color=BLUE, label="posterior", **dots),
        "analytic": Line2D([], [], label="analytic curve", **CURVES["analytic"]),
        "profile": Line2D([], [], label="profile path", **CURVES["profile"]),
        "tangent": Line2D([], [], label="direction of the information", **CURVES["tangent"]),
    }
    there = {*draws["source"], *curves["source"]}
    return [key for source, key in keys.items() if source in there]


def span_profile(one: pd.DataFrame, column: str = "deviance_data") -> tuple[float, float]:
    """Return the least and largest value of a parameter within the 95 % of its profile; infinite where it is open.

    Parameters
    ----------
    one : DataFrame
        The profile of one parameter.
    column : str
    """
    rows = one.sort_values("value")
    value, deviance = rows["value"].to_numpy(dtype=float), rows[column].to_numpy(dtype=float)
    best = int(np.argmin(deviance))
    low = _cross(value[best::-1], deviance[best::-1])
    high = _cross(value[best:], deviance[best:])
    return (-np.inf if low is None else low), (np.inf if high is None else high)


def _cross(value: Array, deviance: Array) -> float | None:
    """Return where the deviance first exceeds the 95 % on the way outwards, between the points linearly."""
    above = np.flatnonzero(deviance > NINETY_FIVE)
    if not len(above) or above[0] == 0:
        return float(value[0]) if len(above) else None
    k = int(above[0])
    share = (NINETY_FIVE - deviance[k - 1]) / (deviance[k] - deviance[k - 1])
    return float(value[k - 1] + share * (value[k] - value[k - 1]))
