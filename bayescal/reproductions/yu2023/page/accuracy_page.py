"""Page of selected poses against random ones: tables 6 to 8, figures 8 and 9, and what weights gain."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    Level,
    Section,
    Statement,
    Table,
    make_section,
    make_table,
)
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.reproductions.yu2023.page import figures
from bayescal.reproductions.yu2023.page.blocks import ANGLES, PageParts, format_range, share_cell

ERRORS = {
    "position_max_mm": "largest position error",
    "position_mean_mm": "mean position error",
    "attitude_max_deg": "largest attitude error",
    "attitude_mean_deg": "mean attitude error",
}
SETTLED = 1e-2  # of the error that stays: a correction below it changes nothing
PUBLISHED_ITERATIONS = 3
RATIO_NAMES = {
    "position_mean_mm": "Position, mean",
    "attitude_mean_deg": "Attitude, mean",
    "parameter_rms_mm": "Parameters, rms",
}


def show_accuracy(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageParts:
    """Return the page of table 8."""
    ratios = tables["ratios"]
    ours = ratios[(ratios["poses"] == "optimal") & (ratios["weighting"] == "bayesian")].set_index("figure")
    attitude, position = (_estimate(ours.loc[[name]]) for name in ("attitude_mean_deg", "position_mean_mm"))
    headline = (
        f"Weigh by the noise and the prior: the same measurements then give a mean attitude error {attitude} times "
        f"smaller and a mean position error {position} times smaller than the paper's least squares."
    )
    verdict = [_judge_parameters(summary), _judge_convergence(summary)]
    if "published" in summary:
        verdict = [_judge_published(tables["table8"], summary), _judge_reductions(tables["reductions"]), *verdict]
    return headline, tuple(verdict), (_show_errors(tables), _show_weights(tables), _show_one(tables, summary))


def _show_errors(tables: dict[str, pd.DataFrame]) -> Section:
    table = tables["table8"]
    plain = table[table["weighting"] == "unweighted"]
    caption = "Table 8's figures over the repeats; published ones dashed, in the colour of their poses."
    figure = Figure("table8", caption, lambda: figures.draw_table8(tables["repeats"], table))
    text = (ANGLES, "Every repeat has its own noise, shared by both sets of poses, and its own random set.")
    title = "Errors at the verification poses, least squares as in the paper (table 8)."
    shown = (_error_table(plain, title), _reduction_table(tables["reductions"]))
    return make_section("Selected poses against random ones", text, shown, (figure,))


def _show_weights(tables: dict[str, pd.DataFrame]) -> Section:
    table, ratios = tables["table8"], tables["ratios"]
    weighted = table[table["weighting"] == "weighted"].drop(columns=["published", "share_below"], errors="ignore")
    text = (
        "The paper counts a millimetre as much as a radian, so that the angles, whose noise in radians is far smaller "
        "than that of the positions in mm, are nearly ignored. Divided by their noise both count for what they tell.",
    )
    title = "Errors at the verification poses, weighted by the noise."
    return make_section("What weights gain", text, (_ratio_table(ratios), _error_table(weighted, title)))


def _show_one(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    steps = (
        "After figure 8: errors of the first hardpoint's parameters over the iterations, first repeat; the published "
        "calibration ended at the diamonds, table 7 less table 6."
    )
    poses = "After figure 9: errors at the verification poses, first repeat; lines are table 8's published figures."
    found = (
        Figure("figure8", steps, lambda: figures.draw_convergence(tables["convergence"], tables["parameters"])),
        Figure("figure9", poses, lambda: figures.draw_verification(tables["verification"], tables["table8"])),
    )
    return make_section("One calibration", (), (_parameter_table(tables["parameters"]),), found, wide=True)


def _estimate(row: pd.DataFrame) -> str:
    return format_estimate(float(row["ratio"].iloc[0]), float(row["standard_error"].iloc[0]))


def _judge_published(table: pd.DataFrame, summary: dict[str, Any]) -> Statement:
    rows = table.dropna(subset=["published"])
    outside = rows[(rows["published"] < rows["low"]) | (rows["published"] > rows["high"])]
    count, inside, middle = (summary[k] for k in ("published", "published_in_range", "published_in_middle"))
    text = (
        f"Table 8: {inside} of {count} published figures lie in the range of the repeats, {middle} in the middle 95 %"
    )
    level: Level = "good" if inside == count else "warning"
    if outside.empty:
        return Statement(f"{text}.", level)
    names = [
        f"{r['poses']} poses' {ERRORS[str(r['figure'])]} ({format_percent(r['share_below'])} of the repeats below it)"
        for _, r in outside.iterrows()
    ]
    share = format_percent(summary["share_with_as_many_outside"])
    return Statement(
        f"{text}; outside are the {join_words(names)}. That is what one repeat may do: {share} of the repeats have as "
        f"many of their own {count} outside.",
        level,
    )


def _judge_reductions(reductions: pd.DataFrame) -> Statement:
    words = [
        f"{ERRORS[str(r['figure'])]} {format_percent(r['published'])} published, {format_percent(r['median'])} found "
        f"({format_percent(r['low'])} to {format_percent(r['high'])})"
        for _, r in reductions.iterrows()
    ]
    inside = ((reductions["published"] >= reductions["low"]) & (reductions["published"] <= reductions["high"])).all()
    return Statement(
        f"By how much selected poses reduce errors, median and middle 95 % of the repeats: {'; '.join(words)}. The "
        "paper's text gives the reductions of its largest errors as those of the means.",
        "good" if inside else "warning",
    )


def _judge_parameters(summary: dict[str, Any]) -> Statement:
    rms = summary["parameter_rms_mm"]
    text = (
        f"Table 7: parameters are identified to {format_significant(rms['mean'])} mm rms, "
        f"{format_range(rms['low'], rms['high'])} in the middle 95 % of the repeats"
    )
    published = summary.get("published_parameter_rms_mm")
    if published is None:
        return Statement(f"{text}.")
    inside = rms["low"] <= published <= rms["high"]
    scaled = format_fixed(summary["published_parameter_rms_sd"], 2)
    return Statement(
        f"{text}; published {format_significant(published)}, in sd over the repeats {scaled} rms.",
        "good" if inside else "warning",
    )


def _judge_convergence(summary: dict[str, Any]) -> Statement:
    changes = summary["largest_change_mm"]
    said = [format_plain(change, 1) for change in changes]
    settled = len(changes) >= PUBLISHED_ITERATIONS and (
        changes[PUBLISHED_ITERATIONS - 1] < SETTLED * summary["parameter_rms_mm"]["mean"]
    )
    return Statement(
        f"Figure 8: published, settled after three iterations; {'confirmed' if settled else 'not confirmed'}: the "
        f"largest corrections are {', '.join(said)} mm, and after {summary['iterations']} at the latest no repeat "
        "changes by more than a millionth of a millimetre.",
        "good" if settled else "warning",
    )


def _error_table(table: pd.DataFrame, caption: str) -> Table:
    printed = "published" in table
    columns = [Column("Poses", kind="text"), Column("Error", kind="text"), Column("", kind="text")]
    columns += [Column("Published")] if printed else []
    columns += [Column(title) for title in ("Mean", "Median", "Middle 95 %")]
    columns += [Column("Repeats below published")] if printed else []
    rows: list[list[str | Cell]] = []
    for _, r in table.iterrows():
        title, unit = figures.FIGURE_TITLES[str(r["figure"])].rstrip(")").split(" (")
        row: list[str | Cell] = [str(r["poses"]), title, unit]
        row += [format_significant(1e3 * r["published"])] if printed else []
        row += [format_significant(1e3 * r["mean"]), format_significant(1e3 * r["median"])]
        row.append(format_range(1e3 * r["low"], 1e3 * r["high"]))
        row += [share_cell(r["share_below"])] if printed else []
        rows.append(row)
    return make_table(caption, columns, rows)


def _reduction_table(reductions: pd.DataFrame) -> Table:
    printed = "published" in reductions
    columns = [Column("Error", kind="text"), *([Column("Published")] if printed else [])]
    columns += [Column("Median"), Column("Middle 95 %")]
    rows: list[list[str | Cell]] = []
    for _, r in reductions.iterrows():
        row: list[str | Cell] = [ERRORS[str(r["figure"])].capitalize()]
        row += [format_percent(r["published"], 1)] if printed else []
        row += [format_percent(r["median"]), f"{format_percent(r['low'])} to {format_percent(r['high'])}"]
        rows.append(row)
    return make_table("By how much selected poses reduce the errors of random ones, repeat by repeat.", columns, rows)


def _ratio_table(ratios: pd.DataFrame) -> Table:
    columns = [Column(t, kind="text") for t in ("Poses", "Least squares", "Error")]
    columns += [Column("Times smaller"), Column("Single repeats, middle 95 %"), Column("Repeats where smaller")]
    names = {"weighted": "weighted", "bayesian": "weighted, with prior"}
    rows = [
        [
            str(r["poses"]),
            names[str(r["weighting"])],
            RATIO_NAMES[str(r["figure"])],
            format_estimate(r["ratio"], r["standard_error"]),
            f"{format_fixed(r['low'], 2)} to {format_fixed(r['high'], 2)}",
            format_percent(r["share_better"]),
        ]
        for _, r in ratios.iterrows()
    ]
    caption = "Errors without weights by errors with them, on the same data; ± is the standard error over the repeats."
    return make_table(caption, columns, rows)


def _parameter_table(parameters: pd.DataFrame) -> Table:
    """Return tables 6 and 7 with what was found: hardpoints down, parameters across."""
    lines = [
        ("preset_mm", "preset (table 6)"),
        ("published_mm", "published (table 7)"),
        ("identified_mm", "found, first repeat"),
        ("sd_over_repeats_mm", "sd over repeats"),
    ]
    lines = [pair for pair in lines if pair[0] in parameters]
    symbol, leg = parameters["parameter"].str.rstrip("]").str.split("[", expand=True).to_numpy().T
    table = parameters.assign(symbol=symbol, leg=leg)
    columns = [Column("Hardpoint", kind="text"), Column("mm", kind="text")]
    columns += [Column(name, symbolic=True) for name in dict.fromkeys(symbol)]
    rows: list[list[str | Cell]] = []
    for name, ours in table.groupby("leg", sort=False):
        for k, (column, title) in enumerate(lines):
            head = Cell(str(name), span=len(lines) if k == 0 else 0)
            rows.append([head, title, *(format_fixed(value, 3) for value in ours[column])])
    return make_table("Parameter errors (tables 6 and 7); the printed table 7 has no l.", columns, rows)
