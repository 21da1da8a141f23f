"""Pages of simulated calibrations: what was found beside what is published."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any

import pandas as pd

from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    Level,
    Page,
    PageSection,
    Statement,
    Table,
    make_section,
    make_table,
)
from bayescal.report.numbers import (
    format_estimate,
    format_fixed,
    format_percent,
    format_significant,
    join_words,
)
from yu2023 import figures

KIND = "Simulated calibrations"
ORIGIN = "Simulated; published figures from Yu, Wu and Wang (2023)"
TAIL = 0.025  # a published figure with less beside it is marked
ANGLES = (
    "Pose errors, measurement noise and the indices that select poses are in the paper's coordinates, position and the "
    "angles α, β, γ about fixed axes; only the workspace is a box of rotation vectors."
)
UNIT = "deg"
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
type PageParts = tuple[str, tuple[Statement, ...], tuple[PageSection, ...]]
"""Headline, verdict and sections of a page."""


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
    text = (ANGLES,)
    caption = (
        "Integrated error over the verification poses, after figure 10. The diamond is where the paper's conclusion "
        "puts the curve of random poses."
    )
    figure = Figure("figure10", caption, lambda: figures.draw_numbers(table))
    section = make_section("Integrated error", text, (_number_table(table),), (figure,))
    return f"{found}; more selected poses {gains}.", verdict, (section,)


def _judge_equality(summary: dict[str, Any]) -> Statement:
    enough, fewest, lead = summary["random_poses_as_good"], summary["fewest_selected"], "Selected or random"
    published = f"as good as {fewest} selected poses; published {figures.RANDOM_AS_GOOD}"
    if enough is None:
        return Statement(f"More than {summary['most_random']} random poses are {published}.", "warning", lead)
    near = abs(enough - figures.RANDOM_AS_GOOD) <= 10
    text = f"{enough} random poses are {published}."
    return Statement(text, "good" if near else "warning", lead, value=enough, limit=figures.RANDOM_AS_GOOD)


def _estimate_gain(table: pd.DataFrame) -> tuple[float, float]:
    """Return by which factor the mean error falls from the fewest selected poses to the most, and its error."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")]
    means, errors = rows["mean"].to_numpy()[[0, -1]], rows["standard_error"].to_numpy()[[0, -1]]
    gain = float(means[0] / means[1])
    return gain, float(gain * ((errors / means) ** 2).sum() ** 0.5)


def _judge_gain(table: pd.DataFrame, gain: float, error: float) -> Statement:
    """Return whether more selected poses gain something."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")].to_dict("records")
    falls = gain > 1.0 + 2.0 * error
    text = (
        f"From {rows[0]['n_poses']} to {rows[-1]['n_poses']} selected poses the error falls by a factor of "
        f"{format_estimate(gain, error)}; published: little."
    )
    return Statement(text, "warning" if falls else "good", "More poses", value=gain, limit=1.0)


def _describe_powers(summary: dict[str, Any]) -> Statement:
    optimal, random = (summary[f"{m}_unweighted_power"] for m in ("optimal", "random"))
    powers = f"{format_fixed(optimal, 2)} (selected), {format_fixed(random, 2)} (random)"
    text = f"Error ∝ number of poses to the power {powers}."
    return Statement(text, lead="Power", value=optimal, limit=-0.5)


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


def share_cell(share: float) -> Cell:
    """Return how many repeats lie below a published figure, marked where it is in a tail; empty where there is none."""
    if math.isnan(share):
        return Cell("")
    return Cell(format_percent(share, 1), "plain" if TAIL <= share <= 1.0 - TAIL else "warning")


def format_range(low: float, high: float, digits: int = 3) -> str:
    """Return ``low to high``."""
    return f"{format_significant(low, digits)} to {format_significant(high, digits)}"


def show_indices(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageParts:
    """Return the page of table 4."""
    table, best, first = tables["table4"], tables["best"], summary["first_index"]
    leads = _find_leaders(table, "mean")
    is_best = [c for c, i in leads.items() if i == first]
    headline = _write_headline(table, leads, first)
    chances = best[(best["unit"] == UNIT) & (best["index"] == first)]
    single = {str(r["condition"]): float(r["share_best"]) for _, r in chances.iterrows()}
    least, everywhere = min(single, key=lambda name: single[name]), summary["share_first_best_everywhere"]
    machines, noise = summary["spread_over_machines"], summary["spread_over_noise"]
    verdict = [
        _judge_rivals(best, first),
        Statement(
            f"P({first} is best in one draw): least {format_percent(single[least])} ({least}); everywhere "
            f"{format_percent(everywhere)}.",
            "good" if len(is_best) == len(leads) else "warning",
            "Chance",
            value=everywhere,
        ),
        Statement(
            f"Scatter of the integrated error: {format_percent(machines)} over machines, {format_percent(noise)} over "
            "draws of the noise.",
            lead="Chance",
            value=noise,
            limit=machines,
        ),
    ]
    verdict += _judge_magnitudes(summary)
    if summary["failed"]:
        verdict.append(Statement(f"{summary['failed']} calibrations did not converge (excluded).", "warning", "Failed"))
    return headline, tuple(verdict), (_show_table4(tables), _show_best(tables, summary))


def _show_table4(tables: dict[str, pd.DataFrame]) -> PageSection:
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


def _show_best(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageSection:
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
    """Return how the strongest rival of the first index compares."""
    ours = best[(best["unit"] == UNIT) & (best["index"] != first)]
    closest = ours.loc[ours.groupby("condition", sort=False)["ratio"].idxmin()]
    worst = closest.sort_values("ratio").iloc[0]
    beaten = [str(c) for c in closest[closest["high"] < 1.0]["condition"]]
    text = (
        f"{first} is beaten in {join_words(beaten) if beaten else 'no condition'}; closest {worst['index']} in "
        f"{worst['condition']}: error ratio {format_fixed(worst['ratio'], 2)}."
    )
    return Statement(text, "warning" if beaten else "good", "Rivals", value=float(worst["ratio"]), limit=1.0)


def _judge_magnitudes(summary: dict[str, Any]) -> list[Statement]:
    """Say whether the published errors are reached, and what the workspace, which is not printed, makes of them."""
    if "published" not in summary:
        return []
    here, *others = summary["workspaces"]
    ratio, inside, count = here["published_by_found_deg"], summary["published_inside"], summary["published"]
    reached = 0.8 < ratio < 1.25 and inside >= 0.9 * count
    found = Statement(
        f"Published errors / found: {format_significant(ratio)}; {inside} of {count} in the middle 95 %.",
        "good" if reached else "warning",
        "Published errors",
        value=ratio,
        limit=1.0,
    )
    why = [
        Statement(
            f"In a workspace of {format_percent(other['scale'])} (not printed): published errors / found "
            f"{format_significant(other['published_by_found_deg'])}.",
            lead="Workspace",
            value=other["published_by_found_deg"],
            limit=1.0,
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
        verdict = [_judge_published(summary), _judge_reductions(tables["reductions"]), *verdict]
    return headline, tuple(verdict), (_show_table8(tables), _show_weights(tables), _show_one(tables, summary))


def _show_table8(tables: dict[str, pd.DataFrame]) -> PageSection:
    table = tables["table8"]
    plain = table[table["weighting"] == "unweighted"]
    caption = "Table 8's figures over the repeats; published ones dashed, in the colour of their poses."
    figure = Figure("table8", caption, lambda: figures.draw_table8(tables["repeats"], table))
    text = (ANGLES, "Every repeat has its own noise, shared by both sets of poses, and its own random set.")
    title = "Errors at the verification poses, least squares as in the paper (table 8)."
    shown = (_error_table(plain, title), _reduction_table(tables["reductions"]))
    return make_section("Selected poses against random ones", text, shown, (figure,))


def _show_weights(tables: dict[str, pd.DataFrame]) -> PageSection:
    table, ratios = tables["table8"], tables["ratios"]
    weighted = table[table["weighting"] == "weighted"].drop(columns=["published", "share_below"], errors="ignore")
    text = ("Unweighted, as in the paper, a millimetre counts as much as a radian.",)
    title = "Errors at the verification poses, weighted by the noise."
    return make_section("What weights gain", text, (_ratio_table(ratios), _error_table(weighted, title)))


def _show_one(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> PageSection:
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


def _judge_published(summary: dict[str, Any]) -> Statement:
    count, inside, middle = (summary[k] for k in ("published", "published_in_range", "published_in_middle"))
    text = f"Table 8: {inside} of {count} published figures in the range of the repeats, {middle} in the middle 95 %."
    level: Level = "good" if inside == count else "warning"
    return Statement(text, level, "Table 8", value=inside, limit=count)


def _judge_reductions(reductions: pd.DataFrame) -> Statement:
    within = (reductions["published"] >= reductions["low"]) & (reductions["published"] <= reductions["high"])
    n, inside = len(within), int(within.sum())
    text = f"Reductions of errors by selected poses: {inside} of {n} published ones in the middle 95 %."
    return Statement(text, "good" if inside == n else "warning", "Reductions", value=inside, limit=n)


def _judge_parameters(summary: dict[str, Any]) -> Statement:
    rms = summary["parameter_rms_mm"]
    text = f"Table 7: parameter error {format_significant(rms['mean'])} mm rms"
    published = summary.get("published_parameter_rms_mm")
    if published is None:
        return Statement(f"{text}.", lead="Table 7", value=rms["mean"], unit="mm")
    level: Level = "good" if rms["low"] <= published <= rms["high"] else "warning"
    text = f"{text}; published {format_significant(published)} mm."
    return Statement(text, level, "Table 7", value=rms["mean"], limit=published, unit="mm")


def _judge_convergence(summary: dict[str, Any]) -> Statement:
    changes = summary["largest_change_mm"]
    settled = len(changes) >= PUBLISHED_ITERATIONS and (
        changes[PUBLISHED_ITERATIONS - 1] < SETTLED * summary["parameter_rms_mm"]["mean"]
    )
    text = f"Figure 8: {'settled' if settled else 'not settled'} after {PUBLISHED_ITERATIONS} iterations, as published."
    text = text if settled else text.replace("as published", "unlike published")
    return Statement(text, "good" if settled else "warning", "Figure 8", limit=PUBLISHED_ITERATIONS)


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
