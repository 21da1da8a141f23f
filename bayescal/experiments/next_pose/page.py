"""The page: which pose to measure next or whether to stop, what it will bring, and the history; from results alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pandas as pd
from matplotlib import figure as mpl
from matplotlib.axes import Axes

from bayescal.experiments.next_pose.rows import (
    OVER_LIMIT,
    ROWS,
    ComparedVariantRow,
    NextPoseRow,
    RequirementForecastRow,
)
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.headline import say_data_first, say_probability, write_headline
from bayescal.experiments.shared.slips import state_slip
from bayescal.files.rows import check_tables
from bayescal.limits import PARETO_K_LIMIT
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
    make_table,
)
from bayescal.report.numbers import capitalise, format_fixed, format_percent, format_significant
from bayescal.report.row_tables import tabulate_rows
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, RED


def build_page(results: Results) -> Page:
    """Return what the page says."""
    check_tables(ROWS, results.tables, results.folder or Path())
    summary = results.summary
    sections = [PageSection("Next poses", (_show_poses(results),), "next")]
    if summary["requirements"] is not None:
        sections.insert(0, PageSection("History", (_plot_history(results),), "history"))
        sections.append(PageSection("Requirements", (_tabulate_requirements(results),), "requirements"))
    if len(results.table("variants")) > 1:
        sections.append(
            PageSection("Variants", (tabulate_rows("Evidence (Laplace).", _rank_variants(results)),), "variants")
        )
    return Page(
        kind="Next pose",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(summary),
        verdict=tuple(_state_all(results)),
        sections=tuple(sections),
        key_figures=tuple(_list_key_figures(results)),
        facts=(
            ("Study", summary["study"]),
            ("Variant", summary["variant"]),
            ("Poses measured", str(summary["n_poses"])),
            ("Candidates", str(summary["n_candidates"])),
        ),
        unreliable=summary["decision"] != "stop" or "suspected_data_error" in summary,
    )


# --- in words ----------------------------------------------------------------------------------------------------


def state_headline(summary: Summary) -> str:
    """Return whether to stop, and how probable what is wanted is."""
    n, wanted = summary["n_poses"], format_percent(summary["stated_probability"])
    if "suspected_data_error" in summary:
        return write_headline([say_data_first(summary["suspected_data_error"]["text"])])
    stop, infeasible = summary["decision"] == "stop", summary["decision"] == "infeasible"
    order = "Stop" if stop else f"Measure one more pose, candidate {summary['next_candidate']}"
    if infeasible:
        order = "Stop: more poses will not meet the requirements"
    if summary["goal"] == "variants":
        probability, what = summary["variant_probability"], f"{summary['variant']} is the right variant"
    else:
        probability, what = summary["requirements"]["probability"], "the requirements hold"
    said = f"After {_count(n)} the probability that {what} is {say_probability(probability, 1)}; target {wanted}"
    return write_headline([order, said])


def _list_key_figures(results: Results) -> list[KeyFigure]:
    """Return decision, probability now and after the next pose, poses, and the largest error against its limit."""
    summary, required = results.summary, results.summary["requirements"]
    levels: dict[str, Level] = {"stop": "good", "infeasible": "bad"}
    decision, level = summary["decision"], levels.get(summary["decision"], "warning")
    found = [KeyFigure("Decision", decision, "", level), KeyFigure("Poses measured", str(summary["n_poses"]))]
    if required is not None:
        row = _find_tightest(results)
        error = f"{format_significant(row.error, 3)} → {format_significant(row.error_after_next, 3)}"
        name = f"{_name(row.requirement)} error, limit {format_significant(row.limit)}"
        found.append(KeyFigure(name, error, row.unit, "good" if row.error <= row.limit else "bad"))
        now, then = (say_probability(required[key], 1) for key in ("probability", "probability_after_next"))
        enough = required["probability"] >= summary["stated_probability"]
        found.append(KeyFigure("Probability now", now, "", "good" if enough else "warning"))
        found.append(KeyFigure("After the next pose", then))
    else:
        sure = summary["variant_probability"]
        level = "good" if sure >= summary["stated_probability"] else "warning"
        found.append(KeyFigure("Probability of the best variant", say_probability(sure, 1), summary["variant"], level))
    k = summary["pareto_k"]
    found.append(KeyFigure("Pareto k", format_fixed(k, 2), "", "good" if k <= PARETO_K_LIMIT else "warning"))
    return found


def _count(n: int) -> str:
    return "one pose" if n == 1 else f"{n} poses"


def _state_all(results: Results) -> list[Statement]:
    summary = results.summary
    said = state_slip(summary)
    if summary["decision"] != "infeasible":
        lead = "Next best pose" if summary["decision"] == "stop" else "Next pose"
        said.append(Statement(summary["next_pose"], "plain", lead))
    if summary["requirements"] is not None:
        said += [*_state_gain(results), _state_needed(summary), _state_best(summary)]
    if len(results.table("variants")) > 1:
        first, second, *_ = _rank_variants(results)
        text = f"P = {say_probability(first.probability, 1)} for {first.variant}; next {second.variant}."
        said.append(Statement(text, "plain", "Variants", value=first.probability))
    return [*said, _state_soundness(summary)]


def _rank_variants(results: Results) -> list[ComparedVariantRow]:
    """Return the variants, the most probable first."""
    return sorted(ComparedVariantRow.read(results.table("variants")), key=lambda row: -row.probability)


def _find_tightest(results: Results) -> RequirementForecastRow:
    """Return the requirement that is least kept."""
    rows = RequirementForecastRow.read(results.table("requirements"))
    return max(rows, key=lambda row: row.error / row.limit)


def _state_gain(results: Results) -> list[Statement]:
    """Return the tightest requirement's error now and after the next pose, and by how much the mean error falls."""
    summary, row = results.summary, _find_tightest(results)
    now, then = format_significant(row.error, 4), format_significant(row.error_after_next, 4)
    wanted, limit = format_percent(summary["stated_probability"]), format_significant(row.limit)
    text = f"Maximum {_name(row.requirement)} error ({wanted}): {now} {row.unit}, next {then}; limit "
    text += f"{limit}."
    gain = 100.0 * (1.0 - summary["mean_error_after_next"] / summary["mean_error"])
    fall = f"Mean geometry error: −{format_fixed(gain, 1)} %."
    lead = "Expected gain"
    return [
        Statement(text, "plain", lead, value=row.error, limit=row.limit, unit=row.unit),
        Statement(fall, "plain", lead, value=gain, unit="%"),
    ]


def _state_needed(summary: Summary) -> Statement:
    standing, wanted = summary["requirements"], summary["stated_probability"]
    needed, lead, value = standing["n_poses_needed"], "Poses needed", standing["probability"]
    if summary["decision"] == "stop":
        return Statement(f"The target of {format_percent(wanted)} is reached.", "good", lead, value=value, limit=wanted)
    n = float(needed if needed is not None else summary["horizon"])
    about = f"about {_count(needed)}" if needed is not None else f"more than {_count(summary['horizon'])}"
    if standing["target_probability"] == wanted:
        return Statement(f"{capitalise(about)} to the target of {format_percent(wanted)}.", "plain", lead, value=n)
    text = f"After {about} noise and model error decide."
    return Statement(text, "warning", lead, value=n)


def _state_best(summary: Summary) -> Statement:
    best, wanted = summary["requirements"]["probability_parameters_known"], summary["stated_probability"]
    repeated, lead = summary["requirements"]["probability_all_candidates"], "Reachable"
    level: Level = "bad" if summary["decision"] == "infeasible" else "warning"
    if repeated < min(best, wanted):
        text = f"Unlimited measurements: P = {say_probability(repeated, 1)}."
        action = "Add a channel, candidates or closer tolerances."
        return Statement(text, level, lead, value=repeated, limit=wanted, action=action)
    text = f"All parameters known: P = {say_probability(best, 1)}."
    if best >= wanted:
        return Statement(text, "good", lead, value=best, limit=wanted)
    action = f"{capitalise(summary['remaining_error'])}."
    return Statement(text, level, lead, value=best, limit=wanted, action=action)


def _state_soundness(summary: Summary) -> Statement:
    k, lead = summary["pareto_k"], "Numerical checks"
    if summary["method"] == "sampled":
        text = f"Pareto k {format_fixed(k, 2)}: MCMC draws used."
        return Statement(text, "warning", lead, value=k, limit=PARETO_K_LIMIT)
    text = f"ESS fraction {format_percent(summary['efficiency'])}, Pareto k {format_fixed(k, 2)}."
    return Statement(text, "good", lead, value=k, limit=PARETO_K_LIMIT)


def _name(requirement: str) -> str:
    return requirement.replace("_", " about ") if requirement.startswith("rotation_") else requirement


# --- tables and figures ------------------------------------------------------------------------------------------


def _show_poses(results: Results) -> Table:
    poses, shown = NextPoseRow.read(results.table("next_poses")), results.summary["columns"]
    columns = [
        Column("Order"),
        Column("Candidate"),
        *([Column("Touches", kind="text")] if poses[0].touching else []),
        *(Column(one["heading"], one["unit"], one["group"]) for one in shown),
    ]
    rows = [
        [
            str(row.order),
            str(row.candidate),
            *([row.touching] if row.touching else []),
            *(format_fixed(row.others[one["column"]], one["decimals"]) for one in shown),
        ]
        for row in poses
    ]
    caption = "Poses; only the first is final."
    if len(poses) == 1:
        caption = "Largest predicted difference."
    return make_table(caption, columns, rows, style="wide")


def _tabulate_requirements(results: Results) -> Table:
    summary = results.summary
    wanted = format_percent(summary["stated_probability"])
    columns = [
        Column("Requirement", kind="name"),
        Column("Unit", kind="text"),
        Column("Limit"),
        Column("now", "", f"Error ({wanted})"),
        Column("next", "", f"Error ({wanted})"),
        Column("parameters known", "", f"Error ({wanted})"),
        Column("now", "", "Probability to meet it"),
        Column("next", "", "Probability to meet it"),
    ]
    rows: list[list[str | Cell]] = []
    for row in RequirementForecastRow.read(results.table("requirements")):
        errors = (row.error_after_next, row.error_parameters_known)
        rows.append(
            [
                _name(row.requirement),
                row.unit,
                format_significant(row.limit),
                Cell(format_significant(row.error), "good" if row.error <= row.limit else "bad", badge=True),
                *map(format_significant, errors),
                *(format_percent(one, 1) for one in (row.probability, row.probability_after_next)),
            ]
        )
    caption = f"Largest errors over {summary['n_workspace']} workspace poses, {summary['n_draws']} draws."
    return make_table(caption, columns, rows)


def _plot_history(results: Results) -> Figure:
    wanted = format_percent(results.summary["stated_probability"])
    caption = (
        f"Left: P(all requirements); dashed: expected. Right: error ({wanted}) / limit. Crosses: "
        f"Pareto k > {PARETO_K_LIMIT}."
    )
    history, stated = results.table("history"), results.summary["stated_probability"]
    return Figure("course", caption, partial(draw_history, history, stated))


def draw_history(history: pd.DataFrame, stated: float) -> mpl.Figure:
    """Return the probability, and the errors in shares of the limits, against the number of poses."""
    figure = mpl.Figure(figsize=(9.4, 3.4))
    left, right = figure.subplots(1, 2)
    _draw_line(left, history, "probability", INK, "o", "all requirements")
    left.axhline(stated, color=GREY, linewidth=0.8)
    left.set(ylabel="P(all requirements met)", ylim=(-0.02, 1.02))
    names = [name for name in history.columns if name.endswith(OVER_LIMIT)]
    for k, name in enumerate(names):
        colour = LEG_COLOURS[k % len(LEG_COLOURS)]
        _draw_line(right, history, name, colour, MARKERS[k % len(MARKERS)], _name(name.removesuffix(OVER_LIMIT)))
    right.axhline(1.0, color=GREY, linewidth=0.8)
    right.set(ylabel="Error / limit", ylim=(0.0, None))
    right.legend(ncols=2)
    for axes in (left, right):
        axes.set_xlabel("Poses")
        axes.grid(visible=True)
    return figure


def _draw_line(axes: Axes, history: pd.DataFrame, column: str, colour: str, marker: str, label: str) -> None:
    measured, planned = (history[history["measured_or_planned"] == one] for one in ("measured", "planned"))
    axes.plot(measured["n_poses"], measured[column], color=colour, marker=marker, markersize=3.5, label=label)
    joined = pd.concat([measured.tail(1), planned])
    axes.plot(joined["n_poses"], joined[column], color=colour, linestyle="--", linewidth=0.9)
    axes.plot(planned["n_poses"], planned[column], color=colour, marker=marker, markersize=3.5, linestyle="", mfc="w")
    approximate = measured[measured["approximate"]]
    axes.plot(approximate["n_poses"], approximate[column], color=RED, marker="x", markersize=6, linestyle="")
