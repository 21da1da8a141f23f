"""The page of a look-up table, from its results alone: what moves, what corrects it, how sure, what to measure next."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import figure as mpl

from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.headline import say_data_first, write_headline
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.slips import state_slip
from bayescal.experiments.table.rows import ROWS, CorrectionRow, PlanRow, PolynomialTermRow
from bayescal.files.rows import check_tables
from bayescal.numerics.units import ARCSECOND, MICROMETRE
from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    KeyFigure,
    Level,
    Page,
    PageSection,
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
NEGLIGIBLE_ERROR_FRACTION = 0.1  # of the table's own error, which its few terms may miss without anybody's noticing
FEW_ROWS = 60
LITTLE = 0.05  # of the table's error; a plan that promises less is no advice


def build_page(results: Results) -> Page:
    """Return the page of a look-up table."""
    check_tables(ROWS, results.tables, results.folder or Path())
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
        key_figures=tuple(_list_key_figures(tables, summary)),
    )


# --- words -------------------------------------------------------------------------------------------------------


def state_headline(summary: Summary) -> str:
    """Return whether to use the table, how large its uncertainty and the uncorrected offsets are, and what is next."""
    moves, known = [_largest(summary, key) for key in ("max_offset", "max_half_width_90")]
    worth = any(one["max_offset"] > one["max_half_width_90"] for one in summary["coordinates"].values())
    if "suspected_data_error" in summary:
        return write_headline([say_data_first(summary["suspected_data_error"]["text"])])
    advice = "Correct by the table" if worth and summary["converged"] else "Do not use the table yet"
    return write_headline([advice, f"Offsets up to {moves}, known to ±{known} (90 %)"])


def _list_key_figures(tables: Mapping[str, pd.DataFrame], summary: Summary) -> list[KeyFigure]:
    """Return offsets, sd of the corrections before and after, and what the plan would bring."""
    unit, now, prior = _unit(summary), summary["posterior_sd"], summary["prior_sd"]
    factor, name = SHOWN.get(unit, (1.0, unit))
    before, after, planned = (format_significant(factor * x, 2) for x in (prior, now, summary["sd_after_plan"]))
    worth = any(one["max_offset"] > one["max_half_width_90"] for one in summary["coordinates"].values())
    return [
        KeyFigure("Largest offset", _largest(summary, "max_offset"), "", "warning" if worth else "good"),
        KeyFigure("Known to (90 %)", f"±{_largest(summary, 'max_half_width_90')}"),
        KeyFigure("Correction sd", f"{before} → {after}", name, "good" if now < 0.5 * prior else "warning"),
        KeyFigure(f"sd after {len(tables['plan'])} more measurements", planned, name),
        KeyFigure("Sampler", "converged" if summary["converged"] else "not converged", "", _rate(summary["converged"])),
    ]


def _rate(converged: bool) -> Level:
    return "good" if converged else "bad"


def _largest(summary: Summary, key: str) -> str:
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


def _state(tables: dict[str, pd.DataFrame], summary: Summary) -> list[Statement]:
    found = state_slip(summary)
    if not summary["converged"]:
        problems = [str(one) for one in summary["problems"]]
        text = f"Not converged: {(problems[0] if problems else 'see the study')}."
        found.append(Statement(text, "bad", "Convergence", value=len(problems), limit=0.0))
    now, prior, unit = summary["posterior_sd"], summary["prior_sd"], _unit(summary)
    text = f"Correction sd {_amount(now, unit)} (rms); prior {_amount(prior, unit)}."
    level: Level = "good" if now < 0.5 * prior else "warning"
    found.append(_state_amount(text, level, "Error", unit, now, prior))
    return [*found, _state_terms(summary), _state_elsewhere(summary), _state_plan(tables, summary)]


def _state_amount(text: str, level: Level, lead: str, unit: str, value: float, limit: float) -> Statement:
    """Return a finding of an amount in an inner unit and its limit, in the unit that they are shown in."""
    factor, name = SHOWN.get(unit, (1.0, unit))
    return Statement(text, level, lead, value=factor * value, limit=factor * limit, unit=name)


def _unit(summary: Summary) -> str:
    return str(next(iter(summary["actuators"].values()))["unit"])


def _state_terms(summary: Summary) -> Statement:
    misfit = max(one["polynomial_misfit"] for one in summary["actuators"].values())
    sd = max(one["max_sd"] for one in summary["actuators"].values())
    unit = _unit(summary)
    text = f"Polynomial error ≤ {_amount(misfit, unit)}; correction sd ≤ {_amount(sd, unit)}."
    level: Level = "good" if misfit <= NEGLIGIBLE_ERROR_FRACTION * sd else "plain" if misfit <= sd else "warning"
    return _state_amount(text, level, "Formula", unit, misfit, sd)


def _state_elsewhere(summary: Summary) -> Statement:
    other, unit = max(one["max_difference_elsewhere"] for one in summary["actuators"].values()), _unit(summary)
    sd = max(one["max_sd"] for one in summary["actuators"].values())
    text = f"Elsewhere in the workspace corrections differ by up to {_amount(other, unit)}."
    return _state_amount(text, "plain" if other <= 2.0 * sd else "warning", "Elsewhere", unit, other, 2.0 * sd)


def _state_plan(tables: dict[str, pd.DataFrame], summary: Summary) -> Statement:
    plan, unit = tables["plan"], _unit(summary)
    before, after = summary["sd_before_plan"], summary["sd_after_plan"]
    what = "more measurements" if summary["plan_include_existing_data"] else "measurements"
    only = " only" if after > (1.0 - LITTLE) * before else ""
    text = f"{len(plan)} {what}: correction sd {_amount(before, unit)} to {_amount(after, unit)}{only}."
    return _state_amount(text, "plain", "Next", unit, after, before)


# --- sections ----------------------------------------------------------------------------------------------------


def _show_offsets(tables: dict[str, pd.DataFrame], summary: Summary) -> PageSection:
    figure = Figure(
        "offsets",
        "Pose offsets from the reference, 90 % intervals.",
        partial(draw_offsets, tables["offsets"], list(summary["axes"])),
    )
    return make_section("Pose offsets", (), (), (figure,))


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


def _show_corrections(tables: dict[str, pd.DataFrame], summary: Summary) -> PageSection:
    text = ("Files: lookup.csv, corrections.csv, correction_covariance.csv.",)
    return make_section("Actuator corrections", text, (_tabulate(tables["corrections"], list(summary["axes"])),))


def _tabulate(corrections: pd.DataFrame, axes: list[str]) -> Table:
    names = list(dict.fromkeys(corrections["actuator"]))
    factor, unit = SHOWN.get(corrections["unit"].iloc[0], (1.0, str(corrections["unit"].iloc[0])))
    columns = [Column(_split(name)[0], _split(name)[1].strip()) for name in axes]
    columns += [Column(name, unit, symbolic=False) for name in names]
    rows: list[list[str | Cell]] = []
    for _, mine in corrections.groupby(axes, sort=False):
        cells = [format_estimate(factor * row.mean, factor * row.sd) for row in CorrectionRow.read(mine)]
        rows.append([*(format_plain(float(value)) for value in mine[axes].iloc[0]), *cells])
    caption = "Corrections, mean ± sd"
    caption += f"; the first {FEW_ROWS} places of {len(rows)}." if len(rows) > FEW_ROWS else "."
    return make_table(caption, columns, rows[:FEW_ROWS])


def _show_terms(tables: dict[str, pd.DataFrame], summary: Summary) -> PageSection:
    table = tables["polynomial"]
    names = list(dict.fromkeys(table["actuator"]))
    factor, unit = SHOWN.get(_unit(summary), (1.0, _unit(summary)))
    columns = [Column("Term", kind="text"), *(Column(name, unit) for name in names)]
    rows: list[list[str | Cell]] = []
    for term, mine in table.groupby("term", sort=False):
        cells = [format_estimate(factor * row.coefficient, factor * row.sd) for row in PolynomialTermRow.read(mine)]
        rows.append([str(term), *cells])
    misfit = [format_significant(factor * summary["actuators"][name]["polynomial_misfit"], 2) for name in names]
    rows.append(["largest deviation", *misfit])
    text = ("Polynomial; covariances in polynomial.json.",)
    return make_section("Polynomial fit", text, (make_table("Coefficients, mean ± sd.", columns, rows),))


def _show_plan(tables: dict[str, pd.DataFrame], summary: Summary) -> PageSection:
    planned, unit = PlanRow.read(tables["plan"]), _unit(summary)
    factor, shown = SHOWN.get(unit, (1.0, unit))
    axes = list(summary["axes"])
    places = list(planned[0].others)
    columns = [Column(""), *(Column(_split(name)[0], _split(name)[1].strip()) for name in places)]
    columns += [Column("resulting error", shown), Column("largest", shown), Column("random poses", shown)]
    rows: list[list[str | Cell]] = []
    for row in planned:
        errors = [format_significant(factor * sd, 3) for sd in (row.sd, row.max_sd, row.random_sd)]
        at = [format_plain(x) if name in axes else format_significant(x, 4) for name, x in row.others.items()]
        rows.append([str(row.order), *at, *errors])
    drop = format_percent(1.0 - summary["sd_after_plan"] / summary["sd_before_plan"])
    text = (f"Greedy I-optimal choice; correction sd −{drop}.",)
    return make_section("Next measurements", text, (make_table("Measurements.", columns, rows),))
