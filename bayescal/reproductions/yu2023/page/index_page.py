"""Page of the observability indices: table 4 and figure 5 beside what is published, and how much of it is chance."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import pandas as pd

from bayescal.report.blocks import Cell, Column, Figure, Section, Statement, Table, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, format_percent, format_significant, join_words
from bayescal.reproductions.yu2023.page import figures
from bayescal.reproductions.yu2023.page.blocks import ANGLES, PageParts, format_range, share_cell

UNIT = "deg"


def show_indices(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageParts:
    """Return the page of table 4."""
    table, best, first = tables["table4"], tables["best"], summary["first_index"]
    leads = _find_leaders(table, "mean")
    is_best = [c for c, i in leads.items() if i == first]
    headline = _write_headline(table, leads, first)
    chances = best[(best["unit"] == UNIT) & (best["index"] == first)]
    single = [f"{format_percent(r['share_best'])} in {r['condition']}" for _, r in chances.iterrows()]
    verdict = [
        _judge_rivals(best, first),
        Statement(
            f"The chance that one draw of the noise and one selection name {first} best: {join_words(single)}; in all "
            f"conditions at once {format_percent(summary['share_first_best_everywhere'])}.",
            "good" if len(is_best) == len(leads) else "warning",
        ),
        Statement(
            "A table from one draw of the noise is chance to a large part: over parameter sets with the same noise "
            f"the integrated error varies by {format_percent(summary['spread_over_machines'])}, over draws of the "
            f"noise by {format_percent(summary['spread_over_noise'])}. Parameter sets average the former only."
        ),
    ]
    verdict += _judge_magnitudes(summary)
    if summary["failed"]:
        verdict.append(Statement(f"{summary['failed']} calibrations did not converge and are left out.", "warning"))
    return headline, tuple(verdict), (_show_errors(tables), _show_best(tables, summary))


def _show_errors(tables: dict[str, pd.DataFrame]) -> Section:
    table = tables["table4"]
    one = (
        "After figure 5: 100 parameter sets, all with one draw of the noise, as in the paper; first selections. The "
        "published histograms have no printed numbers; their means are table 4's."
    )
    many = "The same over draws of the noise, each with its own machine, and over all selections."
    return make_section(
        "Mean integrated error",
        (ANGLES,),
        (_table4(table),),
        (
            Figure("figure5", one, lambda: figures.draw_indices(tables["parameter_sets"], table)),
            Figure("figure5_noise", many, lambda: figures.draw_indices_noise(tables["noise_draws"], table)),
        ),
        wide=True,
    )


def _show_best(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    best = tables["best"]
    text = (
        "Machines and noise are the same for all indices. Intervals are Student's 95 % over the selections, which "
        "start from different random sets.",
    )
    shown = [_best_table(best)]
    if len(summary["workspaces"]) > 1 and "published_by_found_deg" in summary["workspaces"][0]:
        shown.append(_workspace_table(summary["workspaces"]))
    caption = "Mean integrated error over noise draws and selections, by that of the first index."
    figure = Figure("best", caption, lambda: figures.draw_best(best, tables["table4"]))
    return make_section("Which index is best", text, tuple(shown), (figure,), wide=True)


def _find_leaders(table: pd.DataFrame, column: str) -> dict[str, str]:
    """Return the index with the least error in each condition."""
    groups = table.groupby("condition", sort=False)
    return {str(c): str(rows["index"].iloc[int(rows[column].argmin())]) for c, rows in groups}


def _name_leaders(leads: dict[str, str]) -> str:
    where: dict[str, list[str]] = {}
    for condition, index in leads.items():
        where.setdefault(index, []).append(condition)
    if len(where) == 1:
        return f"{next(iter(where))} in all {len(leads)} conditions"
    return join_words([f"{index} in {join_words(conditions)}" for index, conditions in where.items()])


def _write_headline(table: pd.DataFrame, leads: dict[str, str], first: str) -> str:
    found = f"Choose poses by {_name_leaders(leads)}: the mean error is the least there"
    if "published" not in table:
        return f"{found}."
    printed = _find_leaders(table, "published")
    same = "as published" if printed == leads else f"published is {_name_leaders(printed)}"
    return f"{found}; {same}."


def _judge_rivals(best: pd.DataFrame, first: str) -> Statement:
    """Say how the strongest rival of the first index compares, with its interval."""
    ours = best[(best["unit"] == UNIT) & (best["index"] != first)]
    closest = ours.loc[ours.groupby("condition", sort=False)["ratio"].idxmin()]
    words = [
        f"{r['index']} in {r['condition']} {format_fixed(r['ratio'], 2)} ({format_fixed(r['low'], 2)} to "
        f"{format_fixed(r['high'], 2)})"
        for _, r in closest.iterrows()
    ]
    beaten = closest[closest["high"] < 1.0]
    says = (
        f"so {first} is beaten in {join_words([str(c) for c in beaten['condition']])}"
        if len(beaten)
        else f"so {first} is beaten nowhere"
    )
    return Statement(
        f"Mean errors of the closest rival by those of {first}, 95 % intervals over selections: {join_words(words)}; "
        f"{says}.",
        "warning" if len(beaten) else "good",
    )


def _judge_magnitudes(summary: dict[str, Any]) -> list[Statement]:
    """Say whether the published errors are reached, and what the workspace, which is not printed, makes of them."""
    if "published" not in summary:
        return []
    here, *others = summary["workspaces"]
    ratio, inside, count = here["published_by_found_deg"], summary["published_inside"], summary["published"]
    reached = 0.8 < ratio < 1.25 and inside >= 0.9 * count
    found = Statement(
        f"{'Reached' if reached else 'Not reached'}: published errors are {format_significant(ratio)} times those "
        f"found with attitude in degrees ({format_significant(here['published_by_found_rad'])} times in radians), and "
        f"{inside} of {count} lie in the middle 95 % of the draws. They scatter about this factor by "
        f"{format_percent(here['published_by_found_deg_scatter'])}, single draws of the noise about their mean by "
        f"{format_percent(summary['spread_over_noise'])}.",
        "good" if reached else "warning",
    )
    why = [
        Statement(
            "The paper does not print the workspace of this machine. In one of "
            f"{format_percent(other['scale'])} the width and tilt, published errors are "
            f"{format_significant(other['published_by_found_deg'])} times those found in degrees (scatter "
            f"{format_percent(other['published_by_found_deg_scatter'])}), and {summary['first_index']} is best "
            f"everywhere in {format_percent(other['share_first_best_everywhere'])} of the draws."
        )
        for other in others
    ]
    return [found, *why]


def _table4(table: pd.DataFrame) -> Table:
    rows: list[list[str | Cell]]
    columns = [Column("Condition", kind="text"), Column("Index", kind="text"), Column("Published")]
    columns += [Column("mm, deg", "", "One draw"), Column("mm, rad", "", "One draw")]
    columns += [Column(t, "mm, deg", "Over draws of the noise") for t in ("Mean", "Middle 95 %")]
    columns += [Column("Published by mean"), Column("Draws below published")]
    rows = [
        [
            str(r["condition"]),
            str(r["index"]),
            format_significant(r.get("published", float("nan"))),
            format_significant(r["as_printed_deg"]),
            format_significant(r["as_printed_rad"]),
            format_estimate(r["mean"], r["standard_error"]),
            format_range(r["low"], r["high"]),
            format_fixed(r.get("published", float("nan")) / r["mean"], 2),
            share_cell(r.get("share_below", float("nan"))),
        ]
        for _, r in table.iterrows()
    ]
    return make_table("Table 4 with its spread; ± is the standard error over selections.", columns, rows)


def _best_table(best: pd.DataFrame) -> Table:
    columns = [Column(t, kind="text") for t in ("Condition", "Index")]
    for unit in ("deg", "rad"):
        group = f"Attitude in {unit}"
        columns += [Column("Draws where best", "", group), Column("Mean error by that of the first", "", group)]
    degrees, radians = (best[best["unit"] == unit].to_dict("records") for unit in ("deg", "rad"))
    rows: list[list[str | Cell]] = []
    for pair in zip(degrees, radians, strict=True):
        row: list[str | Cell] = [str(pair[0]["condition"]), str(pair[0]["index"])]
        for one in pair:
            row += [format_percent(one["share_best"]), _ratio_cell(one)]
        rows.append(row)
    return make_table("How often an index is best, and by how much; 95 % intervals.", columns, rows)


def _ratio_cell(one: dict[Hashable, Any]) -> Cell:
    if one["low"] == one["high"]:
        return Cell(format_fixed(one["ratio"], 2))
    text = f"{format_fixed(one['ratio'], 2)} ({format_fixed(one['low'], 2)} to {format_fixed(one['high'], 2)})"
    return Cell(text, "warning" if one["high"] < 1.0 else "plain")


def _workspace_table(workspaces: list[dict[str, float]]) -> Table:
    columns = [Column("Size of the workspace")]
    for unit in ("deg", "rad"):
        group = f"Attitude in {unit}"
        columns += [Column("Published by found", "", group), Column("Scatter", "", group)]
    columns.append(Column("First index best everywhere", "share of draws"))
    rows = [
        [
            format_percent(one["scale"]),
            *(
                text
                for unit in ("deg", "rad")
                for text in (
                    format_fixed(one[f"published_by_found_{unit}"], 2),
                    format_percent(one[f"published_by_found_{unit}_scatter"]),
                )
            ),
            format_percent(one["share_first_best_everywhere"]),
        ]
        for one in workspaces
    ]
    return make_table("Published mean errors by those found in workspaces of other sizes.", columns, rows)
