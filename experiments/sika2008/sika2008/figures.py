"""Figures of simulated self-calibrations, after figures 4 to 7 of Šika et al. (2008)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from bayescal.report.numbers import format_plain
from bayescal.report.style import GREY, INK, MARKERS, PALE, RED
from bayescal.report.symbols import quote, set_parameter

SET_COLOURS: tuple[str, ...] = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
STEP_COLOURS: tuple[str, ...] = ("#E69F00", "#56B4E9", "#CC79A7", "#009E73", "#0072B2")
PAPER, BAYESIAN = "paper", "bayesian"
UNITS = {"mm": (1e3, "µm"), "rad": (180.0 * 3600.0 / np.pi, "arcsec")}
PROCEDURE_LABELS = {PAPER: "as in the paper", BAYESIAN: "Bayesian"}
QUANTITY_LABELS = {
    "lengths": "Lengths, rms (µm)",
    "guide_angles": "Guide angles, rms (arcsec)",
    "tool": "Tool's centre, rms (µm)",
    "tool_in_use": "Tool's centre in use, rms (µm)",
}
PREDICTOR_LABELS = {
    "metres_radians": "C, metres and radians",
    "millimetres_radians": "C, mm and radians",
    "millimetres_degrees": "C, mm and degrees",
    "scaled": "C, noise and tolerances",
    "scaled_alike": "C, zeros as guide angles",
    "tool_predicted": "Tool's error predicted (µm)",
}


@dataclass(frozen=True)
class Band:
    """A published factor and what counts as the same."""

    value: float
    low: float
    high: float


def scale_of_quantity(quantity: str) -> float:
    """Return the factor from mm or rad to the unit that a quantity is shown in, µm or arcsec."""
    return UNITS["rad" if quantity == "guide_angles" else "mm"][0]


def colours_of(names: Sequence[str], palette: Sequence[str] = SET_COLOURS) -> dict[str, str]:
    """Return a colour for each set, or each step."""
    return dict(zip(names, cycle(palette), strict=False))


def draw_parameters(parameters: pd.DataFrame, names: Sequence[str], procedure: str = PAPER) -> Figure:
    """Return how far calibrated parameters lie from the true ones, after figure 4.

    Parameters
    ----------
    parameters : pandas.DataFrame
        Columns ``set``, ``procedure``, ``parameter``, ``unit``, ``tolerance``, ``first_error``, ``rms_error``,
        ``rms_se``; mm and rad.
    names : sequence of str
        Sets, in the order of their colours.
    procedure : str
    """
    rows = parameters[parameters["procedure"] == procedure]
    panels = [unit for unit in UNITS if (rows["unit"] == unit).any()]
    figure = Figure(figsize=(9.2, 3.1 * len(panels)))
    for axes, unit in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels, strict=True):
        _draw_unit(axes, rows[rows["unit"] == unit], names, unit)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


def _draw_unit(axes: Axes, rows: pd.DataFrame, names: Sequence[str], unit: str) -> None:
    scale, shown = UNITS[unit]
    widest = max(names, key=lambda name: int((rows["set"] == name).sum()))
    order = list(dict.fromkeys([*rows.loc[rows["set"] == widest, "parameter"], *rows["parameter"]]))
    place = {name: k for k, name in enumerate(order)}
    tolerances = rows.drop_duplicates("parameter").set_index("parameter")["tolerance"]
    ticks = [place[name] for name in tolerances.index]
    axes.plot(ticks, scale * tolerances, "_", color=GREY, markersize=12, label="tolerance (1 sd)")
    for k, (name, colour) in enumerate(colours_of(names).items()):
        ours = rows[rows["set"] == name]
        at = np.array([place[p] for p in ours["parameter"]]) + 0.22 * (k - 0.5 * (len(names) - 1))
        errors = scale * ours["rms_se"]
        style: dict[str, Any] = {"color": colour, "markersize": 5.0, "linestyle": "none", "marker": "s"}
        axes.errorbar(at, scale * ours["rms_error"], yerr=errors, mfc="none", capsize=1.5, **style)
        axes.plot(at, scale * ours["first_error"].abs(), "o", color=colour, markersize=3.5, label=quote(name))
    axes.set_yscale("log")
    axes.set_xticks(range(len(order)), [set_parameter(name) for name in order], rotation=90)
    axes.set_xlim(-0.7, len(order) - 0.3)
    axes.set_ylabel(f"Deviation ({shown})")
    axes.grid(visible=True, axis="y")


def draw_path(path: pd.DataFrame, names: Sequence[str], procedure: str = PAPER) -> Figure:
    """Return the tool's deviation along a circle, each set on its own scale, after figures 5 to 7.

    Parameters
    ----------
    path : pandas.DataFrame
        Columns ``set``, ``procedure``, ``pose``, ``first_x_mm``, ``first_y_mm``, ``rms_mm``, ``rms_se_mm``.
    names : sequence of str
    procedure : str
    """
    figure = Figure(figsize=(9.2, 3.2))
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        rows = path[(path["set"] == name) & (path["procedure"] == procedure)]
        turn = 360.0 * (rows["pose"] - 1) / len(rows)
        rms, error = 1e3 * rows["rms_mm"], 2e3 * rows["rms_se_mm"]
        axes.fill_between(turn, rms - error, rms + error, color=PALE)
        axes.plot(turn, rms, color=GREY, linewidth=1.2, label="distance, rms over calibrations, ± 2 standard errors")
        axes.plot(turn, 1e3 * rows["first_x_mm"], color=SET_COLOURS[1], label="x, one calibration")
        axes.plot(turn, 1e3 * rows["first_y_mm"], color=SET_COLOURS[0], linestyle="--", label="y, one calibration")
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.set_title(quote(name))
        axes.set_xticks([0, 90, 180, 270, 360])
        axes.set_xlabel("Place on the circle (deg)")
        axes.grid(visible=True)
    figure.axes[0].set_ylabel("Tool's deviation (µm)")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def draw_errors(errors: pd.DataFrame, names: Sequence[str], factors: Mapping[str, Sequence[float]]) -> Figure:
    """Return root mean square errors by set, both procedures, with 2 standard errors.

    Parameters
    ----------
    errors : pandas.DataFrame
        Columns ``set``, ``procedure``, each quantity and its ``_se``; mm and rad.
    names : sequence of str
    factors : mapping of quantity to sequence of float
        Published improvements from set to set, drawn from the first set on; empty without any.
    """
    shown = ("lengths", "guide_angles", "tool")
    figure = Figure(figsize=(9.2, 3.4))
    place = {name: k for k, name in enumerate(names)}
    styles = ((PAPER, "tool", INK, "o"), (BAYESIAN, "tool", SET_COLOURS[1], "s"))
    for axes, quantity in zip(figure.subplots(1, len(shown)), shown, strict=True):
        scale = scale_of_quantity(quantity)
        for k, (procedure, _, colour, marker) in enumerate(styles):
            rows = errors[errors["procedure"] == procedure]
            at = np.array([place[name] for name in rows["set"]]) + 0.08 * (2 * k - 1)
            bars = 2.0 * scale * rows[f"{quantity}_se"]
            label = PROCEDURE_LABELS[procedure]
            axes.errorbar(at, scale * rows[quantity], bars, color=colour, marker=marker, capsize=2.5, label=label)
        if quantity in factors:
            start = scale * errors.loc[errors["procedure"] == PAPER, quantity].iloc[0]
            values = start / np.cumprod([1.0, *factors[quantity]])
            axes.plot(range(len(values)), values, color=RED, linestyle=":", label="published factors")
        axes.set_yscale("log")
        axes.set_xticks(range(len(names)), [quote(name) for name in names])
        axes.set_xlim(-0.4, len(names) - 0.6)
        axes.set_ylabel(QUANTITY_LABELS[quantity])
        axes.grid(visible=True, axis="y")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def draw_machines(
    machines: pd.DataFrame, steps: pd.DataFrame, published: pd.DataFrame, documented: Mapping[str, Mapping[str, float]]
) -> Figure:
    """Return histograms over plausible machines: C of each set, and the improvements from set to set.

    Parameters
    ----------
    machines, steps : pandas.DataFrame
        Rows for each machine and set, and for each machine and step.
    published : pandas.DataFrame
        Columns ``of``, ``quantity`` and ``published``, NaN without one.
    documented : mapping of quantity to mapping of set or step to float
        The documented machine's.
    """
    steps = steps.assign(of=steps["from"] + " to " + steps["to"]) if len(steps) else steps
    panels = [("C, metres and radians", machines.rename(columns={"set": "of"}), "metres_radians", SET_COLOURS)]
    if len(steps):
        panels += [
            ("Factor of improvement of C", steps, "metres_radians", STEP_COLOURS),
            ("Factor of improvement of lengths", steps, "lengths", STEP_COLOURS),
            ("Factor of improvement of the tool's centre", steps, "tool", STEP_COLOURS),
        ]
    figure = Figure(figsize=(9.2, 6.0 if len(panels) > 1 else 3.2))
    grid = figure.subplots(2, 2) if len(panels) > 1 else figure.subplots(1, 1, squeeze=False)
    for axes, (title, table, column, palette) in zip(grid.flat, panels, strict=True):
        values = table[column].replace([np.inf, -np.inf], np.nan).dropna()
        bins = np.geomspace(values.min(), values.max() * (1.0 + 1e-9), 50).tolist()
        for name, colour in colours_of(list(dict.fromkeys(table["of"])), palette).items():
            own = table.loc[table["of"] == name, column].dropna()
            axes.hist(own, bins, histtype="stepfilled", color=colour, alpha=0.4, label=quote(name))
            axes.hist(own, bins, histtype="step", color=colour, linewidth=1.2)
            printed = published.loc[(published["of"] == name) & (published["quantity"] == column), "published"].dropna()
            for value in printed:
                axes.axvline(value, color=colour, linestyle="--", linewidth=1.6)
            if name in documented.get(column, {}):
                axes.plot(documented[column][name], 0.0, "^", color=colour, mec=INK, markersize=9, clip_on=False)
        axes.set(xscale="log", xlabel=title, ylabel="Machines")
        axes.legend()
    return figure


def draw_predictors(machines: pd.DataFrame, names: Sequence[str], predictors: Sequence[str]) -> Figure:
    """Return the tool's error of plausible machines by what is to tell it beforehand, a panel for each."""
    figure = Figure(figsize=(9.2, 3.6))
    panels = figure.subplots(1, len(predictors), sharey=True, squeeze=False)[0]
    for axes, predictor in zip(panels, predictors, strict=True):
        scale = 1e3 if predictor == "tool_predicted" else 1.0
        for k, (name, colour) in enumerate(colours_of(names).items()):
            rows = machines[machines["set"] == name]
            style: dict[str, Any] = {"color": colour, "markersize": 3.0, "alpha": 0.6, "label": quote(name)}
            axes.plot(scale * rows[predictor], 1e3 * rows["tool"], MARKERS[k % len(MARKERS)], **style)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(PREDICTOR_LABELS[predictor])
        axes.grid(visible=True)
    panels[0].set_ylabel("Tool's error found (µm)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), markerscale=2.0)
    return figure


def draw_sweep(steps: pd.DataFrame, bands: Mapping[str, Band], assumed: Sequence[float]) -> Figure:
    """Return by which factor errors fall from set to set, against the noise of the angle sensors.

    Parameters
    ----------
    steps : pandas.DataFrame
        Columns ``angle_noise_arcsec``, ``from``, ``to``, ``procedure``, ``quantity``, ``ratio``, ``standard_error``.
    bands : mapping of step to Band
        Published factors of the tool's error.
    assumed : sequence of float
        Noise of the angle sensors elsewhere in the experiment.
    """
    steps = steps.assign(of=steps["from"] + " to " + steps["to"])
    names = list(dict.fromkeys(steps["of"]))
    figure = Figure(figsize=(4.6 * max(2, len(names)), 3.6))
    for axes, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        if name in bands:
            band = bands[name]
            axes.axhspan(band.low, band.high, color=PALE, alpha=0.6, label="counts as the published factor")
            axes.axhline(band.value, color=RED, linestyle=":", label="published factor")
        _draw_ratios(axes, steps[steps["of"] == name])
        for noise in assumed:
            axes.axvline(noise, color=GREY, linewidth=0.8)
        axes.set(xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
            axis.set_minor_formatter(NullFormatter())
        axes.set_title(quote(name))
        axes.set_xlabel("Noise of the angle sensors (arcsec)")
        axes.grid(visible=True)
    figure.axes[0].set_ylabel("Factor by which errors fall")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def _draw_ratios(axes: Axes, steps: pd.DataFrame) -> None:
    """Draw one step's ratios, a line for each quantity and procedure."""
    for quantity, what, colour in (("tool", "tool's centre", SET_COLOURS[1]), ("lengths", "lengths", SET_COLOURS[0])):
        for procedure, line in ((PAPER, "-"), (BAYESIAN, "--")):
            rows = steps[(steps["procedure"] == procedure) & (steps["quantity"] == quantity)]
            style: dict[str, Any] = {
                "color": colour,
                "linestyle": line,
                "marker": "o",
                "markersize": 3.5,
                "capsize": 2.0,
            }
            label = f"{what}, {PROCEDURE_LABELS[procedure]}"
            axes.errorbar(rows["angle_noise_arcsec"], rows["ratio"], 2.0 * rows["standard_error"], label=label, **style)
