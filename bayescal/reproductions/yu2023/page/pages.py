"""Pages of simulated calibrations: what was found beside what is published."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.report.blocks import Cell, Column, Figure, Page, Statement, Table, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, format_percent, format_significant
from bayescal.reproductions.yu2023.page import figures
from bayescal.reproductions.yu2023.page.accuracy_page import show_accuracy
from bayescal.reproductions.yu2023.page.blocks import ANGLES, PageParts, format_range
from bayescal.reproductions.yu2023.page.index_page import show_indices

KIND = "Simulated calibrations"
ORIGIN = "Simulated; published figures from Yu, Wu and Wang (2023)"


def build_page(of: str, name: str, title: str, tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Page:
    """Return the page of an experiment of one of the three kinds, ``observability``, ``accuracy`` and ``numbers``."""
    build = {"observability": show_indices, "accuracy": show_accuracy, "numbers": show_numbers}[of]
    headline, verdict, sections = build(tables, summary)
    return Page(KIND, name, title, ORIGIN, headline, verdict, sections)


def show_numbers(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageParts:
    """Return the page of figure 10."""
    table, enough = tables["figure10"], summary["random_poses_as_good"]
    fewest, most = summary["fewest_selected"], summary["most_random"]
    found = (
        f"Select {fewest} poses or measure {enough} random ones: they do as well"
        if enough is not None
        else f"Select the poses: {most} random ones still err {format_significant(summary['most_random_ratio'])} times "
        f"as much as {fewest} selected ones"
    )
    gain, error = _estimate_gain(table)
    gains = "gain accuracy, where none is published" if gain > 1.0 + 2.0 * error else "gain nothing, as published"
    verdict = (_judge_equality(summary), _judge_gain(table, gain, error), _describe_powers(summary))
    text = (
        ANGLES,
        "The published figure is a graph without numbers and the numbers of poses are not printed; beside it stand its "
        "two conclusions. Every repeat has its own noise, shared by both sets of poses, and its own random set.",
    )
    caption = (
        "Integrated error over the verification poses, after figure 10. The diamond is where the paper's conclusion "
        "puts the curve of random poses."
    )
    figure = Figure("figure10", caption, lambda: figures.draw_numbers(table))
    section = make_section("Integrated error", text, (_number_table(table),), (figure,))
    return f"{found}; more selected poses {gains}.", verdict, (section,)


def _judge_equality(summary: dict[str, Any]) -> Statement:
    enough, fewest = summary["random_poses_as_good"], summary["fewest_selected"]
    published = f"Published: {fewest} selected poses do about as well as {figures.RANDOM_AS_GOOD} random ones. "
    if enough is None:
        return Statement(f"{published}Not reached: {summary['most_random']} random ones do worse.", "warning")
    ratio = format_fixed(summary["random_ratio"], 2)
    near = abs(enough - figures.RANDOM_AS_GOOD) <= 10
    return Statement(
        f"{published}{'Confirmed' if near else 'Not reached'}: the mean error of {enough} random ones is {ratio} times "
        f"that of {fewest} selected ones.",
        "good" if near else "warning",
    )


def _estimate_gain(table: pd.DataFrame) -> tuple[float, float]:
    """Return by which factor the mean error falls from the fewest selected poses to the most, and its error."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")]
    means, errors = rows["mean"].to_numpy()[[0, -1]], rows["standard_error"].to_numpy()[[0, -1]]
    gain = float(means[0] / means[1])
    return gain, float(gain * ((errors / means) ** 2).sum() ** 0.5)


def _judge_gain(table: pd.DataFrame, gain: float, error: float) -> Statement:
    """Say whether more selected poses gain something, and how easily one calibration each hides it."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")].to_dict("records")
    first, last = rows[0], rows[-1]
    no_better = [f"{format_percent(r['share_no_better'])} at {r['n_poses']}" for r in rows[1:] if r["n_poses"] <= 50]
    hidden = (
        f" The chance of one calibration each can hide it at first, hardly later: one with more poses does no better "
        f"than one with {first['n_poses']} in {', '.join(no_better)}."
        if no_better
        else ""
    )
    falls = gain > 1.0 + 2.0 * error
    return Statement(
        f"Published: more selected poses change the error little. {'Not confirmed' if falls else 'Confirmed'}: from "
        f"{first['n_poses']} to {last['n_poses']} the mean error falls by a factor of {format_estimate(gain, error)}."
        f"{hidden}",
        "warning" if falls else "good",
    )


def _describe_powers(summary: dict[str, Any]) -> Statement:
    optimal, random = (format_fixed(summary[f"{m}_unweighted_power"], 2) for m in ("optimal", "random"))
    return Statement(
        f"The mean error falls as the number of poses to the power {optimal} (selected) and {random} (random); "
        f"{format_fixed(-0.5, 2)} is what more measurements of the same kind give."
    )


def _number_table(table: pd.DataFrame) -> Table:
    """Return a row for each number of poses: mean with standard error, and the middle 95 %."""
    groups = [(p, w) for w in ("unweighted", "weighted") for p in ("optimal", "random")]
    columns = [Column("Poses")]
    for poses, weighting in groups:
        heading = f"{poses.capitalize()}, {figures.LABELS[weighting]}"
        columns += [Column("Mean", "1e-3", heading), Column("Middle 95 %", "1e-3", heading)]
    found = table.set_index(["n_poses", "poses", "weighting"]).to_dict("index")
    rows: list[list[str | Cell]] = []
    for n in dict.fromkeys(table["n_poses"]):
        row: list[str | Cell] = [str(n)]
        for group in groups:
            one = found[(n, *group)]
            row.append(format_estimate(1e3 * one["mean"], 1e3 * one["standard_error"]))
            row.append(format_range(1e3 * one["low"], 1e3 * one["high"]))
        rows.append(row)
    return make_table("Integrated error, mm and deg (figure 10); ± is the standard error.", columns, rows)
