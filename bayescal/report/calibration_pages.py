"""Pages of simulated calibrations: what was found beside what is published."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.report import calibration_figures as figures
from bayescal.report.blocks import Cell, Column, Statement, Table, make_table
from bayescal.report.experiment_page import ExperimentPage, PageFigure, PageSection
from bayescal.report.numbers import format_estimate, format_fixed, format_percent, format_significant, join_words

KIND = "Simulated calibrations"
ORIGIN = "Simulated; published figures from Yu, Wu and Wang (2023)"
TAIL = 0.025  # a published figure with less beside it is marked
ANGLES = (
    "Pose errors and measurement noise are in the paper's coordinates, position and the angles α, β, γ about fixed "
    "axes; the index for selection and the workspace are in rotation vectors, which differ little at 10 deg."
)


def build_page(
    of: str, name: str, title: str, tables: dict[str, pd.DataFrame], summary: dict[str, Any]
) -> ExperimentPage:
    """Return the page of an experiment of one of the three kinds, ``observability``, ``accuracy`` and ``numbers``."""
    build = {"observability": _show_indices, "accuracy": _show_accuracy, "numbers": _show_numbers}[of]
    headline, verdict, sections = build(tables, summary)
    return ExperimentPage(KIND, name, title, ORIGIN, headline, verdict, sections)


type Parts = tuple[str, tuple[Statement, ...], tuple[PageSection, ...]]


# --- selected against random, weighted against not ---------------------------------------------------------------


def _show_accuracy(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Parts:
    table, ratios = tables["table8"], tables["ratios"]
    ours = ratios[(ratios["poses"] == "optimal") & (ratios["weighting"] == "bayesian")].set_index("figure")
    attitude, position = (ours.loc[[name]] for name in ("attitude_mean_deg", "position_mean_mm"))
    headline = (
        f"Weighted by the noise and the prior, the same measurements give a mean attitude error {_estimate(attitude)} "
        f"times smaller and a mean position error {_estimate(position)} times smaller than the paper's least squares."
    )
    verdict = [_judge_published(table)] if "published" in table else []
    verdict.append(_judge_parameters(summary))
    changes = [f"{change:.1g}" for change in summary["largest_change_mm"]]
    verdict.append(
        Statement(
            f"The corrections of an iteration fall as {', '.join(changes)} mm; they have settled after "
            f"{summary['iterations']} at the latest."
        )
    )
    sections = (
        PageSection(
            "Selected poses against random ones",
            (ANGLES, "Every repeat has its own noise, shared by both sets of poses, and its own random set."),
            (_table8(table),),
            (
                PageFigure(
                    "table8",
                    "Table 8's figures over the repeats; published ones dashed.",
                    lambda: figures.draw_table8(tables["repeats"], table),
                ),
            ),
        ),
        PageSection("What weights gain", (), (_ratio_table(ratios),)),
        PageSection(
            "One calibration",
            (),
            (_parameter_table(tables["parameters"]),),
            (
                PageFigure(
                    "figure8",
                    "Parameter errors of the first hardpoint over the iterations; first repeat.",
                    lambda: figures.draw_convergence(tables["convergence"]),
                ),
                PageFigure(
                    "figure9",
                    "Errors at the verification poses; first repeat.",
                    lambda: figures.draw_verification(tables["verification"]),
                ),
            ),
        ),
    )
    return headline, tuple(verdict), sections


def _estimate(row: pd.DataFrame) -> str:
    return format_estimate(float(row["ratio"].iloc[0]), float(row["standard_error"].iloc[0]))


def _judge_published(table: pd.DataFrame) -> Statement:
    rows = table.dropna(subset=["published"])
    outside = rows[(rows["published"] < rows["low"]) | (rows["published"] > rows["high"])]
    if outside.empty:
        return Statement(f"All {len(rows)} published figures lie within the middle 95 % of the repeats.", "good")
    names = [
        f"{r['poses']} poses, {str(r['figure']).replace('_', ' ')} (below it {format_percent(r['share_below'])})"
        for _, r in outside.iterrows()
    ]
    return Statement(
        f"{len(rows) - len(outside)} of {len(rows)} published figures lie within the middle 95 % of the repeats; "
        f"outside: {join_words(names)}.",
        "warning",
    )


def _judge_parameters(summary: dict[str, Any]) -> Statement:
    rms = summary["parameter_rms_mm"]
    text = (
        f"Parameters are identified to {format_significant(rms['mean'])} mm rms, "
        f"{format_significant(rms['low'])} to {format_significant(rms['high'])} in the middle 95 % of the repeats"
    )
    published = summary.get("published_parameter_rms_mm")
    if published is None:
        return Statement(f"{text}.")
    inside = rms["low"] <= published <= rms["high"]
    return Statement(f"{text}; published {format_significant(published)}.", "good" if inside else "warning")


def _table8(table: pd.DataFrame) -> Table:
    rows: list[list[str | Cell]]
    columns = [Column("Poses", kind="text"), Column("Least squares", kind="text"), Column("Figure", kind="text")]
    columns += [Column(title, "µm or mdeg") for title in ("Published", "Mean", "2.5 %", "50 %", "97.5 %")]
    columns.append(Column("Below published"))
    rows = [
        [
            str(r["poses"]),
            str(r["weighting"]),
            figures.FIGURE_TITLES[str(r["figure"])].partition(" (")[0],
            *(format_significant(1e3 * r.get(k, float("nan"))) for k in ("published", "mean", "low", "median", "high")),
            _share(r.get("share_below", float("nan"))),
        ]
        for _, r in table.iterrows()
    ]
    return make_table("Errors of the calibrated machine at the verification poses (table 8).", columns, rows)


def _share(share: float) -> Cell:
    inside = TAIL <= share <= 1.0 - TAIL
    text = "" if share != share else f"{100 * share:.1f} %"  # NaN where nothing is published
    return Cell(text, "plain" if inside or not text else "warning")


def _ratio_table(ratios: pd.DataFrame) -> Table:
    names = {
        "position_mean_mm": "Position, mean",
        "attitude_mean_deg": "Attitude, mean",
        "parameter_rms_mm": "Parameters",
    }
    columns = [Column(t, kind="text") for t in ("Poses", "Least squares", "Error")]
    columns += [Column("Times smaller"), Column("Single repeats, middle 95 %"), Column("Repeats where smaller")]
    rows = [
        [
            str(r["poses"]),
            str(r["weighting"]),
            names[str(r["figure"])],
            format_estimate(r["ratio"], r["standard_error"]),
            f"{format_fixed(r['low'], 2)} to {format_fixed(r['high'], 2)}",
            format_percent(r["share_better"]),
        ]
        for _, r in ratios.iterrows()
    ]
    return make_table("Errors without weights by errors with them, on the same data.", columns, rows)


def _parameter_table(parameters: pd.DataFrame) -> Table:
    shown = [("preset_mm", "Preset"), ("published_mm", "Published"), ("identified_mm", "Found")]
    shown = [pair for pair in shown if pair[0] in parameters]
    columns = [Column("Parameter", kind="symbol"), *(Column(title, "mm") for _, title in shown)]
    columns.append(Column("sd over repeats", "mm"))
    rows = [
        [
            str(r["parameter"]),
            *(format_fixed(r[column], 3) for column, _ in shown),
            format_fixed(r["sd_over_repeats_mm"], 3),
        ]
        for _, r in parameters.iterrows()
    ]
    return make_table("Parameter errors (tables 6 and 7), found in the first repeat.", columns, rows)


# --- observability indices ---------------------------------------------------------------------------------------


def _show_indices(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Parts:
    best = tables["best"]
    rivals = best[(best["unit"] == "deg") & (best["index"] != summary["first_index"])]
    better = rivals[rivals["ratio"] + 2.0 * rivals["standard_error"] < 1.0]
    level = rivals[(rivals["ratio"] - 1.0).abs() <= 2.0 * rivals["standard_error"]]
    first = summary["first_index"]
    headline = (
        f"{first} is the best index in all conditions at once in "
        f"{format_percent(summary['share_first_best_everywhere'])} of the draws of noise and selections."
    )
    verdict = [
        Statement(f"Better than {first} by more than two standard errors: {_name_pairs(better)}.", "warning")
        if len(better)
        else Statement(f"No index is better than {first} by more than two standard errors in any condition.", "good"),
        Statement(f"Not to be told from {first} within two standard errors: {_name_pairs(level)}."),
        Statement(
            f"Over parameter sets with one draw of noise the integrated error varies by "
            f"{format_percent(summary['spread_over_machines'])}, over draws of the noise by "
            f"{format_percent(summary['spread_over_noise'])}: the published means are those of one draw."
        ),
    ]
    if "published_by_found_deg" in summary:
        ratio = summary["published_by_found_deg"]
        verdict.append(
            Statement(
                f"Published errors are {format_significant(ratio)} times those found with attitude in degrees "
                f"(scatter {format_percent(summary['published_by_found_deg_scatter'])}), "
                f"{format_significant(summary['published_by_found_rad'])} times those in radians "
                f"(scatter {format_percent(summary['published_by_found_rad_scatter'])}).",
                "plain" if 0.8 < ratio < 1.25 else "warning",
            )
        )
    if summary["failed"]:
        verdict.append(Statement(f"{summary['failed']} calibrations did not converge and are left out.", "warning"))
    sections = (
        PageSection(
            "Mean integrated error",
            (ANGLES,),
            (_table4(tables["table4"]),),
            (
                PageFigure(
                    "figure5",
                    "One draw of the noise, as in the paper; first selections.",
                    lambda: figures.draw_indices(tables["parameter_sets"]),
                ),
                PageFigure(
                    "figure5_noise",
                    "Over draws of the noise, each with its own machine, and selections.",
                    lambda: figures.draw_indices_noise(tables["noise_draws"]),
                ),
            ),
            wide=True,
        ),
        PageSection(
            "Which index is best",
            ("Machines and noise are the same for all indices; standard errors are those over selections.",),
            (_best_table(best),),
            (
                PageFigure(
                    "best",
                    "Mean integrated error against the first index, with two standard errors.",
                    lambda: figures.draw_best(best),
                ),
            ),
        ),
    )
    return headline, tuple(verdict), sections


def _name_pairs(rows: pd.DataFrame) -> str:
    names = [f"{r['index']} in {r['condition']} (ratio {r['ratio']:.2f})" for _, r in rows.iterrows()]
    return join_words(names) or "none"


def _table4(table: pd.DataFrame) -> Table:
    rows: list[list[str | Cell]]
    columns = [Column("Condition", kind="text"), Column("Index", kind="text"), Column("Published")]
    columns += [Column("One draw", "mm, deg"), Column("One draw", "mm, rad"), Column("Mean over draws", "mm, deg")]
    columns += [Column(t, "mm, deg") for t in ("2.5 %", "97.5 %")] + [Column("Below published")]
    rows = [
        [
            str(r["condition"]),
            str(r["index"]),
            format_significant(r.get("published", float("nan"))),
            format_significant(r["as_printed_deg"]),
            format_significant(r["as_printed_rad"]),
            format_estimate(r["mean"], r["standard_error"]),
            format_significant(r["low"]),
            format_significant(r["high"]),
            _share(r.get("share_below", float("nan"))),
        ]
        for _, r in table.iterrows()
    ]
    return make_table("Table 4 with the spread over draws of the noise.", columns, rows)


def _best_table(best: pd.DataFrame) -> Table:
    columns = [Column(t, kind="text") for t in ("Attitude in", "Condition", "Index")]
    columns += [Column("Draws where best"), Column("Error by that of the first")]
    rows = [
        [
            str(r["unit"]),
            str(r["condition"]),
            str(r["index"]),
            format_percent(r["share_best"]),
            format_estimate(r["ratio"], r["standard_error"]) if r["standard_error"] else format_fixed(r["ratio"], 2),
        ]
        for _, r in best.iterrows()
    ]
    return make_table("How often an index is best, and by how much.", columns, rows)


# --- number of poses ---------------------------------------------------------------------------------------------


def _show_numbers(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Parts:
    table, enough = tables["figure10"], summary["random_poses_as_good"]
    fewest, most = summary["fewest_selected"], summary["most_random"]
    reached = (
        f"{enough} random poses are as good as {fewest} selected ones"
        if enough is not None
        else f"{most} random poses still err {format_significant(summary['most_random_ratio'])} times as much as "
        f"{fewest} selected ones"
    )
    powers = [f"{m} {format_fixed(summary[f'{m}_unweighted_power'], 2)}" for m in ("optimal", "random")]
    verdict = (
        Statement("Published: 20 selected poses do as well as about 50 random ones; more selected ones gain nothing."),
        Statement(f"The error falls as a power of the number of poses: {join_words(powers)}."),
        _judge_gain(table),
    )
    section = PageSection(
        "Integrated error",
        (ANGLES,),
        (_number_table(table),),
        (PageFigure("figure10", "Integrated error over the verification poses.", lambda: figures.draw_numbers(table)),),
    )
    return f"{reached}.", verdict, (section,)


def _judge_gain(table: pd.DataFrame) -> Statement:
    """Say whether more selected poses gain something."""
    rows = table[(table["poses"] == "optimal") & (table["weighting"] == "unweighted")]
    first, last = (rows.iloc[[k]].to_dict("records")[0] for k in (0, -1))
    gain = first["mean"] / last["mean"]
    error = (
        gain * ((first["standard_error"] / first["mean"]) ** 2 + (last["standard_error"] / last["mean"]) ** 2) ** 0.5
    )
    return Statement(
        f"From {first['n_poses']} to {last['n_poses']} selected poses the mean error falls by a factor of "
        f"{format_estimate(gain, error)}; a single calibration has a spread of {format_significant(first['low'])} to "
        f"{format_significant(first['high'])} at {first['n_poses']}, in which such a trend is easily lost.",
        "plain" if gain < 1.0 + 2.0 * error else "warning",
    )


def _number_table(table: pd.DataFrame) -> Table:
    columns = [Column("Poses", kind="text"), Column("Least squares", kind="text"), Column("Number")]
    columns += [Column(title, "1e-3") for title in ("Mean", "2.5 %", "97.5 %")]
    rows = [
        [
            str(r["poses"]),
            str(r["weighting"]),
            str(r["n_poses"]),
            format_estimate(1e3 * r["mean"], 1e3 * r["standard_error"]),
            format_significant(1e3 * r["low"]),
            format_significant(1e3 * r["high"]),
        ]
        for _, r in table.iterrows()
    ]
    return make_table("Integrated error, mm and deg (figure 10).", columns, rows)
