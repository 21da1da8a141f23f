"""The page of a look-up table, from its results alone: what moves, what corrects it, how sure, what to measure next."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import figure as mpl

from bayescal.experiments.frame.results import Results, list_rows
from bayescal.experiments.shared.headline import say_data_first, write_headline
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.slips import state_slip
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    Page,
    Section,
    Statement,
    Table,
    make_section,
    make_table,
)
from bayescal.report.numbers import format_estimate, format_percent, format_plain, format_significant, join_words
from bayescal.report.style import GREY, LEG_COLOURS
from bayescal.report.symbols import quote

SHOWN = {"mm": (1.0 / MICROMETRE, "µm"), "rad": (1.0 / ARCSECOND, "arcsec")}
MARKS = {"deg": "°", "c": " °C"}
CURVES = 3
SMALL = 0.1  # of the table's own error, which its few terms may miss without anybody's noticing
FEW_ROWS = 60
LITTLE = 0.05  # of the table's error; a plan that promises less is no advice


def build_page(results: Results) -> Page:
    """Return the page of a look-up table."""
    tables, summary = results.tables, results.summary
    return Page(
        "Look-up table",
        summary["experiment"],
        summary["title"],
        name_origin(summary["origin"]),
        state_headline(summary),
        tuple(_state(tables, summary)),
        tuple(show(tables, summary) for show in (_show_offsets, _show_corrections, _show_terms, _show_plan)),
        (
            ("Machine", str(summary["machine"])),
            ("Study", f"{summary['study']}, variant {summary['variant']}"),
            ("Zero at", _name_place(summary["reference"])),
        ),
    )


# --- words -------------------------------------------------------------------------------------------------------


def state_headline(summary: dict[str, Any]) -> str:
    """Return whether to use the table, how well it tells where the platform is, and how far that moves without it."""
    spans = []
    for name, (low, high) in summary["axes"].items():
        words, unit = _split(name)
        spans.append(f"{format_plain(low)} to {format_plain(high)}{unit} of {words}")
    moves, known = [_largest(summary, key) for key in ("largest_offset", "largest_half_width_90")]
    worth = any(one["largest_offset"] > one["largest_half_width_90"] for one in summary["coordinates"].values())
    if "slip" in summary:
        return write_headline([say_data_first(summary["slip"]["text"])])
    sound = summary["converged"]
    advice = "Correct by the table" if worth and sound else "Do not correct by the table yet"
    return (
        f"{advice}: from {join_words(spans)} it gives the platform's place to ±{known} (90 %); uncorrected it moves by "
        f"up to {moves}."
    )


def _largest(summary: dict[str, Any], key: str) -> str:
    """Return the largest amount of each unit among the coordinates."""
    found: dict[str, float] = {}
    for one in summary["coordinates"].values():
        found[one["unit"]] = max(found.get(one["unit"], 0.0), one[key])
    return join_words([_amount(value, unit) for unit, value in found.items()])


def _amount(value: float, unit: str) -> str:
    factor, name = SHOWN.get(unit, (1.0, unit))
    return f"{format_significant(factor * value, 2)} {name}"


def _split(column: str) -> tuple[str, str]:
    """Return the words and the unit of a column: ``elevation_deg`` is elevation in °."""
    stem, _, unit = column.rpartition("_")
    return (stem.replace("_", " "), MARKS.get(unit, f" {unit}")) if stem else (column, "")


def _name_place(place: dict[str, float]) -> str:
    parts = [(*_split(name), value) for name, value in place.items()]
    return ", ".join(f"{words} {format_plain(value)}{unit}" for words, unit, value in parts)


def _state(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    found = state_slip(summary)
    if not summary["converged"]:
        text = f"The posterior did not converge ({'; '.join(summary['problems'])}); the table was made by force."
        found.append(Statement(text, "bad", "Convergence"))
    now, prior, unit = summary["sd_by_data"], summary["sd_by_tolerances"], _unit(summary)
    text = f"A correction is known to {_amount(now, unit)} (sd, rms over the table); the tolerances alone left "
    found.append(Statement(f"{text}{_amount(prior, unit)}.", "good" if now < 0.5 * prior else "warning", "Error"))
    return [*found, _state_terms(summary), _state_elsewhere(summary), _state_plan(tables, summary)]


def _unit(summary: dict[str, Any]) -> str:
    return str(next(iter(summary["actuators"].values()))["unit"])


def _state_terms(summary: dict[str, Any]) -> Statement:
    misfit = max(one["polynomial_misfit"] for one in summary["actuators"].values())
    sd = max(one["largest_sd"] for one in summary["actuators"].values())
    words = f"The few terms below miss the table by at most {_amount(misfit, _unit(summary))}"
    if misfit <= SMALL * sd:
        return Statement(f"{words}: they may stand in for it.", "good", "Formula")
    text = f"{words}; a correction's own sd is at most {_amount(sd, _unit(summary))}."
    return Statement(text, "plain" if misfit <= sd else "warning", "Formula")


def _state_elsewhere(summary: dict[str, Any]) -> Statement:
    other = max(one["elsewhere"] for one in summary["actuators"].values())
    text = (
        f"The table is that of one commanded pose; at other poses of the workspace corrections differ from it by up to "
        f"{_amount(other, _unit(summary))}."
    )
    sd = max(one["largest_sd"] for one in summary["actuators"].values())
    return Statement(text, "plain" if other <= 2.0 * sd else "warning", "Elsewhere")


def _state_plan(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Statement:
    plan, unit = tables["plan"], _unit(summary)
    before, after = summary["sd_before_plan"], summary["sd_after_plan"]
    beside = "more measurements" if summary["plan_beside_data"] else "measurements from nothing"
    if after > (1.0 - LITTLE) * before:
        text = f"{len(plan)} {beside} would hardly help: {_amount(before, unit)} become {_amount(after, unit)}."
        return Statement(text, "plain", "Measure next")
    first = _name_place({name: float(plan[name].iloc[0]) for name in summary["axes"]})
    text = (
        f"{len(plan)} {beside}, the first at {first}, would bring the error from {_amount(before, unit)} to "
        f"{_amount(after, unit)} (sd, rms); as many at random to {_amount(summary['sd_after_random'], unit)}."
    )
    return Statement(text, "plain", "Measure next")


# --- sections ----------------------------------------------------------------------------------------------------


def _show_offsets(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    text = (
        "Where the platform goes if the actuators stay where they are: what a telescope would see without the table.",
    )
    figure = Figure(
        "offsets",
        "Offsets of the pose with their 90 % intervals; zero is the reference.",
        partial(draw_offsets, tables["offsets"], list(summary["axes"])),
    )
    return make_section("What moves", text, (), (figure,))


def draw_offsets(offsets: pd.DataFrame, axes: list[str]) -> mpl.Figure:
    """Return every coordinate's offset over the first axis, a curve for some values of the second."""
    names = list(dict.fromkeys(offsets["coordinate"]))
    n_rows = -(-len(names) // 3)
    figure = mpl.Figure(figsize=(9.4, 0.6 + 2.2 * n_rows))
    grid = figure.subplots(n_rows, min(3, len(names)), sharex=True, squeeze=False).ravel()
    for axis, name in zip(grid, names, strict=False):
        mine = offsets[offsets["coordinate"] == name]
        factor, unit = SHOWN.get(mine["unit"].iloc[0], (1.0, mine["unit"].iloc[0]))
        for k, (label, rows) in enumerate(_list_curves(mine, axes)):
            at = rows[axes[0]].to_numpy(dtype=float)
            low, mean, high = (factor * rows[key].to_numpy(dtype=float) for key in ("q05", "mean", "q95"))
            colour = LEG_COLOURS[(0, 2, 5)[k]]
            axis.fill_between(at, low, high, color=colour, alpha=0.3, linewidth=0.0)
            axis.plot(at, mean, color=colour, linewidth=1.2, label=quote(label))
        axis.axhline(0.0, color=GREY, linewidth=0.6)
        axis.set_title(quote(f"{name} [{unit}]"))
        axis.grid(axis="y")
    words, unit = _split(axes[0])
    figure.supxlabel(quote(f"{words} [{unit.strip()}]"), fontsize=9.0)
    if len(axes) > 1:
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=CURVES)
    return figure


def _list_curves(rows: pd.DataFrame, axes: list[str]) -> list[tuple[str, pd.DataFrame]]:
    """Return the rows of the smallest, the middle and the largest value of the second axis with their labels."""
    if len(axes) == 1:
        return [("", rows)]
    values = sorted(set(rows[axes[1]]))
    chosen = dict.fromkeys(values[k] for k in np.linspace(0, len(values) - 1, min(CURVES, len(values))).astype(int))
    return [(_name_place({axes[1]: float(value)}), rows[rows[axes[1]] == value]) for value in chosen]


def _show_corrections(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    text = (
        "What to add to the actuators so that the platform stays where it was commanded to; lookup.csv has it as a "
        "controller takes it, corrections.csv with intervals, correction_covariance.csv with covariances.",
    )
    return make_section("What corrects it", text, (_tabulate(tables["corrections"], list(summary["axes"])),))


def _tabulate(corrections: pd.DataFrame, axes: list[str]) -> Table:
    names = list(dict.fromkeys(corrections["actuator"]))
    factor, unit = SHOWN.get(corrections["unit"].iloc[0], (1.0, str(corrections["unit"].iloc[0])))
    columns = [Column(_split(name)[0], _split(name)[1].strip()) for name in axes]
    columns += [Column(name, unit, symbolic=False) for name in names]
    rows: list[list[str | Cell]] = []
    for _, mine in corrections.groupby(axes, sort=False):
        cells = [format_estimate(factor * row["mean"], factor * row["sd"]) for row in list_rows(mine)]
        rows.append([*(format_plain(float(value)) for value in mine[axes].iloc[0]), *cells])
    caption = "Corrections, mean ± standard deviation"
    caption += f"; the first {FEW_ROWS} places of {len(rows)}." if len(rows) > FEW_ROWS else "."
    return make_table(caption, columns, rows[:FEW_ROWS])


def _show_terms(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    table = tables["polynomial"]
    names = list(dict.fromkeys(table["actuator"]))
    factor, unit = SHOWN.get(_unit(summary), (1.0, _unit(summary)))
    columns = [Column("Term", kind="text"), *(Column(name, unit) for name in names)]
    rows: list[list[str | Cell]] = []
    for term, mine in table.groupby("term", sort=False):
        cells = [format_estimate(factor * row["coefficient"], factor * row["sd"]) for row in list_rows(mine)]
        rows.append([str(term), *cells])
    misfit = [format_significant(factor * summary["actuators"][name]["polynomial_misfit"], 2) for name in names]
    rows.append(["misses the table by at most", *misfit])
    text = (
        "The same in a few terms, each zero at the reference, fitted to every draw of the posterior; polynomial.json "
        "has them with the covariance of all coefficients.",
    )
    return make_section("In a few terms", text, (make_table("Coefficients, mean ± sd.", columns, rows),))


def _show_plan(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    plan, unit = tables["plan"], _unit(summary)
    factor, shown = SHOWN.get(unit, (1.0, unit))
    axes = list(summary["axes"])
    places = [name for name in plan.columns if not name.startswith(("order", "sd_", "largest_"))]
    columns = [Column(""), *(Column(_split(name)[0], _split(name)[1].strip()) for name in places)]
    columns += [Column("error then", shown), Column("the largest", shown), Column("at random", shown)]
    rows: list[list[str | Cell]] = []
    for row in list_rows(plan):
        errors = [
            format_significant(factor * row[key], 3) for key in ("sd_after", "largest_sd_after", "sd_after_random")
        ]
        at = [format_plain(row[name]) if name in axes else format_significant(row[name], 4) for name in places]
        rows.append([str(row["order"]), *at, *errors])
    drop = format_percent(1.0 - summary["sd_after_plan"] / summary["sd_before_plan"])
    text = (
        f"Poses and places chosen one by one out of random poses at every place of the table, each the one that lowers "
        f"the table's mean squared error most (I-optimal); all together lower the error by {drop}: the standard "
        f"deviation of a correction, rms over places and actuators, {_amount(summary['sd_before_plan'], unit)} "
        "beforehand.",
    )
    return make_section("Where to measure next", text, (make_table("Measurements, the best first.", columns, rows),))
