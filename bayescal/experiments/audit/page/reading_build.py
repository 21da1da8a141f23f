"""The page of an audit of a machine of one function: what is met, what is not told, what to measure."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.experiments.audit.page import reading_figures as figures
from bayescal.experiments.audit.page.reading_verdict import choose_best, state_headline, state_verdict
from bayescal.experiments.audit.page.sensor_sets import show_counts, show_sets
from bayescal.experiments.shared.knowledge_page import VERDICT_LEVELS, show_accuracy, show_next, show_ridges
from bayescal.files.plain_text import add_article
from bayescal.report.blocks import Cell, Column, Figure, Page, Section, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, format_percent, format_significant
from bayescal.report.reading import list_rows
from bayescal.report.units import Asked, format_place, name_unit, shown_in

KIND = "Audit of a calibration"


def build_page(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Page:
    """Return the page of an experiment's tables."""
    best, asked = choose_best(tables), summary["units"]
    accuracy = show_accuracy(tables, asked)
    sections = [
        _show_variants(tables),
        *_show_requirements(tables, summary),
        *([] if accuracy is None else [accuracy]),
        _show_parameters(tables, best, summary),
        *show_ridges(tables, best),
        *show_sets(tables, summary),
        *show_next(tables, best, asked),
        *_show_selected(tables, best, asked),
        *show_counts(tables, best, asked),
        _show_method(),
    ]
    return Page(
        KIND,
        summary["experiment"],
        summary["title"],
        f"Computed before anything is measured: {summary['n_poses']} poses, {summary['poses']}",
        state_headline(tables, summary),
        tuple(state_verdict(tables, summary)),
        tuple(sections),
        (("Machine", str(summary["machine"])), ("Details of", _titles(tables)[best])),
    )


def list_variants(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Return what the terminal says of each set of sensors, a line each of at most 80 letters."""
    width = min(34, max(7, *(len(str(name)) for name in tables["variants"]["variant"])))
    lines = [f"{'variant':{width}}  free  equations  identifiable  error left  margin"]
    for row in list_rows(tables["variants"]):
        lines.append(
            f"{row['variant']:{width}}  {row['n_parameters']:4d}  {row['n_equations']:9d}  "
            f"{row['n_identifiable']:12d}  {format_percent(row['left'], 1):>10}  {format_percent(row['margin']):>6}"
        )
    return lines


def _titles(tables: dict[str, pd.DataFrame]) -> dict[str, str]:
    return {str(row["variant"]): str(row["title"]) for row in list_rows(tables["variants"])}


def _show_variants(tables: dict[str, pd.DataFrame]) -> Section:
    columns = [Column("Sensors", kind="text"), Column("Readings", kind="text"), Column("Free"), Column("Equations")]
    columns += [Column("Identifiable"), Column("Error left"), Column("Margin")]
    rows: list[list[str | Cell]] = [
        [
            str(row["title"]),
            str(row["data"]),
            str(row["n_parameters"]),
            str(row["n_equations"]),
            str(row["n_identifiable"]),
            format_percent(row["left"], 1),
            format_percent(row["margin"]),
        ]
        for row in list_rows(tables["variants"])
    ]
    text = (
        "Equations are readings less coordinates of the poses. Identifiable parameters become known at least twice as "
        "well. Error left: what unknown parameters do to where the machine stands, after against before. Margin: to "
        "the limit that is closest; below zero it is not met.",
    )
    return make_section("Which sensors", text, (make_table("Sets of sensors.", columns, rows),))


def _show_requirements(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Section]:
    if "requirements" not in tables:
        return []
    titles, group = _titles(tables), "rms over the workspace"
    columns = [Column("Sensors", kind="text"), Column("Coordinate", kind="text"), Column("Unit", kind="text")]
    columns += [Column("Limit"), Column("before", group=group), Column("after", group=group)]
    columns += [Column("of it noise", group=group), Column("at the worst pose")]
    columns += [Column("before", group="kept with probability"), Column("after", group="kept with probability")]
    columns += [Column("everywhere", group="kept with probability"), Column("Margin"), Column("Met", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(tables["requirements"]):
        factor, unit = shown_in(row["unit"], summary["units"])
        numbers = [format_significant(factor * row[name]) for name in ("limit", "before", "error", "noise", "worst")]
        chances = [format_percent(row[f"probability{part}"]) for part in ("_before", "", "_everywhere")]
        met = Cell("yes", "good") if row["met"] else Cell("no", "bad")
        margin = format_percent(row["margin"])
        rows.append([titles[row["variant"]], str(row["coordinate"]), unit, *numbers, *chances, margin, met])
    text = (
        "Errors of where the machine stands, by its own sensors alone: by what is unknown of the parameters and by the "
        "noise of one set of readings together. At the worst pose: the largest standard deviation anywhere. The limit "
        "is kept where a machine's rms over the workspace is within it; everywhere, where none of its poses exceeds "
        "it: shares of machines drawn from what is unknown of them.",
    )
    figure = Figure(
        "requirements",
        "Errors over their limits, before and after: rms over the workspace, and at the worst pose.",
        lambda: figures.draw_requirements(tables["requirements"], titles),
    )
    return [make_section("What is required", text, (make_table("Requirements.", columns, rows),), (figure,), wide=True)]


def _show_parameters(tables: dict[str, pd.DataFrame], best: str, summary: dict[str, Any]) -> Section:
    mine = tables["parameters"][tables["parameters"]["variant"] == best]
    columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("beforehand")]
    columns += [Column("Deviation after"), Column("Contraction"), Column("Told", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(mine):
        factor, unit = shown_in(row["unit"], summary["units"])
        rows.append(
            [
                str(row["parameter"]),
                unit,
                format_estimate(factor * row["expected"], factor * row["prior_sd"]),
                format_significant(factor * row["sd"]),
                format_fixed(row["contraction"], 2),
                Cell(str(row["verdict"]), VERDICT_LEVELS[str(row["verdict"])]),
            ]
        )
    text = (
        f"A number in brackets is that of {add_article(summary['member'])}. Contraction is the part of the prior's "
        "variance that the readings would remove: 0.75 halves the tolerance.",
    )
    caption = f"Parameters with “{_titles(tables)[best]}”."
    figure = Figure(
        "contraction",
        "Contraction of every parameter with each set of sensors; at the line a tolerance is halved.",
        lambda: figures.draw_contraction(tables["parameters"], _titles(tables)),
    )
    return make_section("Parameters", text, (make_table(caption, columns, rows),), (figure,))


def _show_selected(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Section]:
    if "selected" not in tables:
        return []
    mine = tables["selected"][tables["selected"]["variant"] == best].dropna(axis=1, how="all")
    names = [str(name) for name in mine.columns if name not in ("variant", "step")]
    columns = [Column("Pose"), *(_make_column(name, asked) for name in names)]
    rows: list[list[str | Cell]] = [
        [
            str(row["step"]),
            *(_format(n, row[n], asked) for n in names),
        ]
        for row in list_rows(mine)
    ]
    text = (
        "In the order in which each lowers the mean squared error over the workspace most, given all before it. Beside "
        "each, what is then left of the error by unknown parameters.",
    )
    return [make_section("Poses to measure", text, (make_table("The poses chosen.", columns, rows),))] if rows else []


def _make_column(name: str, asked: Asked) -> Column:
    stem = name.rpartition("_")[0]
    if stem.startswith("after_"):
        return Column(stem.removeprefix("after_"), name_unit(name, asked), group="rms then left")
    return Column(stem, name_unit(name, asked))


def _format(name: str, value: float, asked: Asked) -> str:
    if not name.startswith("after_"):
        return format_place(name, value, asked)
    return format_significant(shown_in(name.rpartition("_")[2], asked)[0] * value)


def _show_method() -> Section:
    text = (
        "Everything is to first order about the machine as expected, with noise and tolerances as stated. The poses of "
        "the readings are not known and are eliminated. Uniform priors count by their standard deviation. What a "
        "machine errs by that its function does not have is not in these numbers.",
    )
    return make_section("Method", text)
