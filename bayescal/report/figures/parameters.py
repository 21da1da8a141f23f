"""Where the parameters moved: posterior intervals, and the joints seen from above (RR-8096 figure 18)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from bayescal.report.figures.style import GREY, INK, PALE, VariantStyle, assign_styles, set_symbol, split_variant
from bayescal.report.numbers import MICROMETRES, PER_MILLE
from bayescal.report.results import MODEL_ERROR, is_model_error

PRIOR_90 = 1.645  # prior standard deviations to the 5 and 95 % points of a normal prior
HARDPOINTS = (("a_x", "a_y", "Base joints a"), ("b_x", "b_y", "Platform joints b"))


def draw_parameters(parameters: pd.DataFrame, published: pd.DataFrame, variants: Sequence[str]) -> Figure:
    """Return the 90 % posterior intervals of all geometry, as offsets from nominal, a panel per symbol.

    Parameters
    ----------
    parameters : DataFrame
        Posterior summaries with columns variant, symbol, leg, unit, nominal, mean, q05, q95, prior_sd.
    published : DataFrame
        Columns variant, parameter, leg and published_offset; NaN where nothing was published.
    variants : sequence of str
        From left to right at each leg.
    """
    rows = parameters[~parameters["symbol"].map(is_model_error)]
    symbols = list(dict.fromkeys(rows["symbol"]))
    n_rows = math.ceil(len(symbols) / 2)
    figure = Figure(figsize=(9.4, 0.7 + 1.95 * n_rows))
    grid = figure.subplots(n_rows, 2, squeeze=False).ravel()
    styles = assign_styles(variants)
    for axes, symbol in zip(grid, symbols, strict=False):
        chosen = rows[rows["symbol"] == symbol]
        factor, unit = scale_of(symbol, str(chosen["unit"].iloc[0]))
        _draw_prior(axes, chosen, factor)
        _draw_intervals(axes, chosen, styles, factor)
        _draw_published(axes, published[published["parameter"] == symbol], chosen, styles, factor)
        axes.axhline(0, color=INK, linewidth=0.8)
        axes.set_ylabel(f"{set_symbol(symbol, 'Δ')} ({unit})")
        _label_legs(axes, chosen)
    for axes in grid[len(symbols) :]:
        axes.set_axis_off()
    figure.legend(handles=_legend(styles, published), loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


def draw_model_error(parameters: pd.DataFrame, variants: Sequence[str], prior_scale_um: float | None) -> Figure:
    """Return the 90 % posterior intervals of the model error τ of each leg, µm."""
    rows = parameters[parameters["symbol"] == MODEL_ERROR].assign(nominal=0.0)
    figure = Figure(figsize=(9.4, 2.6))
    axes = figure.subplots()
    styles = assign_styles(variants)
    _draw_intervals(axes, rows, styles, MICROMETRES)
    handles = _variant_handles(styles)
    if prior_scale_um is not None:
        axes.axhline(prior_scale_um, color=GREY, linestyle="--", linewidth=1.0)
        handles.append(
            Line2D([], [], color=GREY, linestyle="--", linewidth=1.0, label="scale of the half-normal prior")
        )
    axes.set_ylim(bottom=0)
    axes.set_ylabel("Model error τ (µm)")
    _label_legs(axes, rows)
    figure.legend(handles=handles, loc="outside upper left", ncols=4, borderaxespad=0.2)
    return figure


def scale_of(symbol: str, unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which a parameter's offsets are shown."""
    if is_model_error(symbol):
        return MICROMETRES, "µm"
    return (PER_MILLE, "10⁻³") if unit == "1" else (1.0, unit)


def _shift(k: int, n: int) -> float:
    return 0.72 * ((k + 0.5) / n - 0.5)


def _draw_prior(axes: Axes, rows: pd.DataFrame, factor: float) -> None:
    """Shade the prior's 90 %; where it is far wider than the posteriors it fills the panel."""
    for leg, width in (factor * PRIOR_90 * rows.groupby("leg")["prior_sd"].max()).items():
        centre = float(np.asarray(leg))
        axes.fill_between([centre - 0.45, centre + 0.45], -width, width, color=PALE, alpha=0.55, linewidth=0)


def _draw_intervals(axes: Axes, rows: pd.DataFrame, styles: dict[str, VariantStyle], factor: float) -> None:
    for k, (name, style) in enumerate(styles.items()):
        chosen = rows[rows["variant"] == name]
        leg = chosen["leg"].to_numpy() + _shift(k, len(styles))
        mean, low, high = (factor * (chosen[c] - chosen["nominal"]).to_numpy() for c in ("mean", "q05", "q95"))
        axes.vlines(leg, low, high, color=style.colour, linewidth=1.6)
        axes.plot(leg, mean, linestyle="none", marker=style.marker, markersize=3.8, color=style.colour)


def _draw_published(
    axes: Axes, published: pd.DataFrame, rows: pd.DataFrame, styles: dict[str, VariantStyle], factor: float
) -> None:
    single = set(rows["leg"]) == {0}
    for k, name in enumerate(styles):
        chosen = published[published["variant"] == name]
        leg = (0.0 if single else chosen["leg"].to_numpy()) + np.full(len(chosen), _shift(k, len(styles)))
        offset = factor * chosen["published_offset"].to_numpy()
        axes.plot(leg, offset, linestyle="none", marker="x", markersize=4.5, color=INK, markeredgewidth=0.9)


def _label_legs(axes: Axes, rows: pd.DataFrame) -> None:
    legs = sorted(set(rows["leg"]))
    axes.set_xticks(legs, [f"leg {leg}" if leg else "machine" for leg in legs])
    axes.set_xlim(min(legs) - 0.5, max(legs) + 0.5)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")


def _variant_handles(styles: dict[str, VariantStyle]) -> list[Line2D | Patch]:
    return [
        Line2D([], [], color=style.colour, marker=style.marker, markersize=4, linewidth=1.6, label=style.label)
        for style in styles.values()
    ]


def _legend(styles: dict[str, VariantStyle], published: pd.DataFrame) -> list[Line2D | Patch]:
    handles = [*_variant_handles(styles), Patch(color=PALE, alpha=0.55, label="prior, central 90 %")]
    if published["published_offset"].notna().any():
        handles.append(Line2D([], [], color=INK, marker="x", markersize=4.5, linestyle="none", label="published"))
    return handles


# --- the joints from above -------------------------------------------------------------------------------------------


def has_hardpoints(parameters: pd.DataFrame) -> bool:
    """Whether the joints' coordinates in the plane are among the parameters, leg by leg."""
    there = set(parameters[parameters["leg"] > 0]["symbol"])
    return all(x in there and y in there for x, y, _ in HARDPOINTS)


def find_magnification(parameters: pd.DataFrame) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that shows the largest move as a third of the radius."""
    wide = pd.concat([_pivot(parameters, x, y) for x, y, _ in HARDPOINTS])
    radius = float(np.median(np.hypot(wide["x"].to_numpy(), wide["y"].to_numpy())))
    largest = float(np.hypot(wide["dx"], wide["dy"]).max())
    if not (radius > 0 and largest > 0):
        return 1.0
    wanted = 0.35 * radius / largest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted)


def draw_hardpoints(parameters: pd.DataFrame, variants: Sequence[str]) -> Figure:
    """Return the top view of the joints: nominal places and magnified moves to the posterior means, a row per model."""
    models: dict[str, list[str]] = {}
    for name in variants:
        models.setdefault(split_variant(name)[0], []).append(name)
    figure = Figure(figsize=(9.4, 0.5 + 4.3 * len(models)))
    grid = figure.subplots(len(models), 2, squeeze=False)
    styles, factor = assign_styles(variants), find_magnification(parameters)
    for row, names in zip(grid, models.values(), strict=True):
        for axes, (x, y, title) in zip(row, HARDPOINTS, strict=True):
            chosen = parameters[parameters["variant"].isin(names)]
            _draw_joints(axes, _pivot(chosen, x, y), {name: styles[name] for name in names}, factor)
            axes.set_title(f"{title}, moves magnified {factor:g} times")
        row[0].legend(handles=_variant_handles({name: styles[name] for name in names}), loc="center")
    return figure


def _pivot(parameters: pd.DataFrame, x: str, y: str) -> pd.DataFrame:
    """Return one row per variant and leg: nominal place, move and standard deviations, mm."""
    index = ["variant", "leg"]
    one, other = (parameters[parameters["symbol"] == s].set_index(index)[["nominal", "mean", "sd"]] for s in (x, y))
    both = one.add_suffix("_x").join(other.add_suffix("_y"), how="inner").reset_index()
    return pd.DataFrame(
        {
            "variant": both["variant"],
            "leg": both["leg"],
            "x": both["nominal_x"],
            "y": both["nominal_y"],
            "dx": both["mean_x"] - both["nominal_x"],
            "dy": both["mean_y"] - both["nominal_y"],
            "sx": both["sd_x"],
            "sy": both["sd_y"],
        }
    )


def _draw_joints(axes: Axes, rows: pd.DataFrame, styles: dict[str, VariantStyle], factor: float) -> None:
    nominal = rows.drop_duplicates("leg").sort_values("leg")
    outline = nominal.iloc[np.argsort(np.arctan2(nominal["y"], nominal["x"]))]
    axes.fill(outline["x"], outline["y"], facecolor="none", edgecolor=PALE, linewidth=1.0)
    axes.plot(
        nominal["x"], nominal["y"], linestyle="none", marker="o", markersize=5, color="white", markeredgecolor=INK
    )
    for name, style in styles.items():
        one = rows[rows["variant"] == name]
        x, y = one["x"] + factor * one["dx"], one["y"] + factor * one["dy"]
        axes.plot(np.stack([one["x"], x]), np.stack([one["y"], y]), color=style.colour, linewidth=0.7, alpha=0.7)
        axes.errorbar(
            x,
            y,
            xerr=factor * one["sx"],
            yerr=factor * one["sy"],
            linestyle="none",
            marker=style.marker,
            markersize=4.5,
            color=style.colour,
            elinewidth=0.9,
        )
    extent = np.hypot(rows["x"] + factor * rows["dx"], rows["y"] + factor * rows["dy"]).max()
    reach = 1.12 * max(extent, float(np.hypot(nominal["x"], nominal["y"]).max()))
    for leg, x, y in zip(nominal["leg"], nominal["x"], nominal["y"], strict=True):
        distance = math.hypot(x, y) or 1.0
        axes.text(reach * x / distance, reach * y / distance, str(leg), ha="center", va="center", fontweight="bold")
    axes.set_aspect("equal")
    axes.set_xlim(-1.1 * reach, 1.1 * reach)
    axes.set_ylim(-1.1 * reach, 1.1 * reach)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.grid()
