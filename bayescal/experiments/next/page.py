"""The page: which pose to measure next or whether to stop, what it will bring, and the course; from results alone."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import figure as mpl
from matplotlib.axes import Axes

from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.headline import say_data_first, say_probability, write_headline
from bayescal.experiments.shared.slips import state_slip
from bayescal.report.blocks import Cell, Column, Definitions, Figure, Level, Page, Section, Statement, Table, make_table
from bayescal.report.numbers import format_fixed, format_percent, format_significant
from bayescal.report.style import GREY, INK, LEG_COLOURS, MARKERS, RED

METHOD = (
    (
        "What is known?",
        "The posterior of the calibration poses: its mode by Newton's steps, and draws of Laplace's approximation "
        "there, weighed by the density itself. Each draw is one possible true machine.",
    ),
    (
        "When do the requirements hold?",
        "The calibrated machine, the posterior mean, predicts the poses of the workspace from what its own sensors "
        "read; the true machine errs from that by its geometry, by the noise of these sensors and by its model errors. "
        "The requirements hold where no pose of the workspace exceeds a limit. The probability is the share of draws "
        "of which this is so.",
    ),
    (
        "Which pose is next?",
        "For the requirements: the candidate after which the predicted poses of the workspace have the smallest mean "
        "variance in units of the limits (I-optimal). To distinguish variants: the candidate where their predictions "
        "differ most, against what is not known of them and the noise (Box and Hill 1967).",
    ),
    (
        "What is expected of it?",
        "That it is measured as well as the poses so far, by all sensors and instruments that these had. The "
        "uncertainty of the geometry shrinks accordingly; what is known of noise and model errors stays as it is, "
        "though more poses will constrain them, too.",
    ),
)


def build_page(results: Results) -> Page:
    """Return what the page says."""
    summary = results.summary
    sections = [Section("Next poses", (_show_poses(results),), "next")]
    if summary["requirements"] is not None:
        sections.append(Section("Requirements", (_tabulate_requirements(results),), "requirements"))
        sections.append(Section("Course", (_plot_course(results),), "course"))
    if len(results.table("variants")) > 1:
        sections.append(Section("Variants", (_tabulate_variants(results),), "variants"))
    return Page(
        kind="Next pose",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(summary),
        verdict=tuple(_state_all(results)),
        sections=(*sections, Section("How it was found", (Definitions(METHOD),), "method")),
        facts=(
            ("Study", summary["study"]),
            ("Variant", summary["variant"]),
            ("Poses measured", str(summary["n_poses"])),
            ("Poses to choose from", str(summary["n_candidates"])),
        ),
        doubtful=summary["decision"] != "stop" or "slip" in summary,
    )


# --- in words ----------------------------------------------------------------------------------------------------


def state_headline(summary: dict[str, Any]) -> str:
    """Return whether to stop, in one sentence."""
    n, wanted = summary["n_poses"], format_percent(summary["stated_probability"])
    if "slip" in summary:
        return write_headline([say_data_first(summary["slip"]["text"])])
    stop = summary["decision"] == "stop"
    order = "Stop" if stop else f"Measure one more pose, candidate {summary['next_candidate']}"
    if summary["aim"] == "variants":
        sure = f"{summary['variant']} is right with {say_probability(summary['variant_probability'], 1)}"
        return write_headline([f"{order}: after {_count(n)} {sure}, {wanted} wanted"])
    standing = summary["requirements"]
    if summary["decision"] == "hopeless":
        at_best, at_length = standing["at_best"], _find_at_length(summary)
        best = f"with the geometry known exactly they hold with {say_probability(at_best, 1)}"
        if at_length < at_best:
            best = f"with all candidates measured over and over they hold with {say_probability(at_length, 1)}"
        return write_headline([f"Stop: the requirements will not be met by measuring; {best}"])
    held = say_probability(standing["probability"], 1)
    return write_headline([f"{order}: after {_count(n)} the requirements hold with {held}, {wanted} wanted"])


def _find_at_length(summary: dict[str, Any]) -> float:
    """Return with what probability requirements hold after endless measuring; one in results of earlier versions."""
    return float(summary["requirements"].get("at_length", 1.0))


def _count(n: int) -> str:
    return "one pose" if n == 1 else f"{n} poses"


def _state_all(results: Results) -> list[Statement]:
    summary = results.summary
    said = state_slip(summary)
    if summary["decision"] != "hopeless":
        lead = "If one went on" if summary["decision"] == "stop" else "Next pose"
        said.append(Statement(summary["next_pose"], "plain", lead))
    if summary["requirements"] is not None:
        said += [_state_gain(results), _state_needed(summary), _state_best(summary)]
    if len(results.table("variants")) > 1:
        table = results.table("variants").sort_values("probability", ascending=False)
        each = [
            f"{row['variant']} {say_probability(float(row['probability']), 1)}" for _, row in table.head(3).iterrows()
        ]
        said.append(Statement(f"{'; '.join(each)}, if one of them is right.", "plain", "Variants"))
    return [*said, _state_soundness(summary)]


def _state_gain(results: Results) -> Statement:
    summary, table = results.summary, results.table("requirements")
    tightest = table.iloc[int(np.argmax(table["error"] / table["limit"]))]
    wanted, unit = format_percent(summary["stated_probability"]), tightest["unit"]
    gain = 1.0 - summary["mean_error_after_next"] / summary["mean_error"]
    now, then = (format_significant(float(tightest[key]), 4) for key in ("error", "error_after_next"))
    text = (
        f"The tightest requirement is that on {_name(tightest['requirement'])}: with a probability of {wanted} no pose "
        f"errs by more than {now} {unit} there, and by {then} {unit} after the next pose; allowed are "
        f"{format_significant(float(tightest['limit']))} {unit}. The mean error that the geometry causes falls by "
        f"{format_percent(gain, 1)}; all requirements then hold with "
        f"{say_probability(summary['requirements']['after_next'], 1)}."
    )
    return Statement(text, "plain", "What it brings")


def _state_needed(summary: dict[str, Any]) -> Statement:
    standing, wanted = summary["requirements"], format_percent(summary["stated_probability"])
    needed, lead = standing["poses_needed"], "How many more"
    if summary["decision"] == "stop":
        return Statement(f"The wanted {wanted} are reached.", "good", lead)
    about = f"about {_count(needed)}" if needed is not None else f"more than {_count(summary['ahead'])}"
    if standing["goal"] == summary["stated_probability"]:
        return Statement(f"{about.capitalize()} to the wanted {wanted}, if chosen as below.", "plain", lead)
    text = (
        f"Whether the wanted {wanted} can be reached depends on noise and model errors, which more poses will "
        f"constrain: with {say_probability(standing['at_best'], 1)} they are small enough. After {about}, if chosen as "
        "below, the geometry will hardly matter any more."
    )
    return Statement(text, "warning", lead)


def _state_best(summary: dict[str, Any]) -> Statement:
    best, wanted = summary["requirements"]["at_best"], summary["stated_probability"]
    text = f"With the geometry known exactly the requirements would hold with {say_probability(best, 1)}"
    at_length = _find_at_length(summary)
    if at_length < min(best, wanted):
        text = (
            f"{text}, but the candidates do not tell it: with all of them measured over and over they would hold with "
            f"{say_probability(at_length, 1)}. What helps is another channel or instrument, other candidates, or a "
            "closer tolerance of the parameters that the study's page calls poorly determined."
        )
        return Statement(text, "bad" if summary["decision"] == "hopeless" else "warning", "What can be reached")
    if best >= wanted:
        return Statement(f"{text}: measuring is what helps.", "good", "What can be reached")
    level: Level = "bad" if summary["decision"] == "hopeless" else "warning"
    return Statement(f"{text}: {summary['stays']}.", level, "What can be reached")


def _state_soundness(summary: dict[str, Any]) -> Statement:
    k = format_fixed(summary["pareto_k"], 2)
    if summary["found"] == "sampled":
        text = f"Draws are those of ensembles, since weights have a heavy tail (k {k}); `bayescal run` is more exact."
        return Statement(text, "warning", "Numerical checks")
    anew = "" if summary["found"] == "updated" else ", the posterior sampled again"
    text = (
        f"{format_percent(summary['efficiency'])} of the draws count, the tail of their weights is light (k {k}){anew}."
    )
    return Statement(text, "good", "Numerical checks")


def _name(requirement: str) -> str:
    return requirement.replace("_", " about ") if requirement.startswith("rotation_") else requirement


# --- tables and figures ------------------------------------------------------------------------------------------


def _show_poses(results: Results) -> Table:
    table, shown = results.table("next_poses"), results.summary["shown"]
    columns = [
        Column("Order"),
        Column("Candidate"),
        *(Column(one["heading"], one["unit"], one["group"]) for one in shown),
    ]
    rows = [
        [
            str(int(row["order"])),
            str(int(row["candidate"])),
            *(format_fixed(float(row[one["column"]]), one["decimals"]) for one in shown),
        ]
        for _, row in table.iterrows()
    ]
    caption = (
        "The poses to measure, in their order; the first alone is final, since its readings may change the others."
    )
    if len(table) == 1:
        caption = "The pose at which the predictions of the variants differ most."
    return make_table(caption, columns, rows, style="wide")


def _tabulate_requirements(results: Results) -> Table:
    summary, table = results.summary, results.table("requirements")
    wanted = format_percent(summary["stated_probability"])
    columns = [
        Column("Requirement", kind="name"),
        Column("Unit", kind="text"),
        Column("Limit"),
        Column("now", "", f"Error that no pose exceeds with {wanted}"),
        Column("after the next pose", "", f"Error that no pose exceeds with {wanted}"),
        Column("geometry known", "", f"Error that no pose exceeds with {wanted}"),
        Column("now", "", "Holds with"),
        Column("after the next pose", "", "Holds with"),
    ]
    rows: list[list[str | Cell]] = []
    for _, row in table.iterrows():
        kept = float(row["error"]) <= float(row["limit"])
        errors = [format_significant(float(row[key])) for key in ("error_after_next", "error_at_best")]
        rows.append(
            [
                _name(str(row["requirement"])),
                str(row["unit"]),
                format_significant(float(row["limit"])),
                Cell(format_significant(float(row["error"])), "good" if kept else "bad", badge=True),
                *errors,
                *(format_percent(float(row[key]), 1) for key in ("probability", "probability_after_next")),
            ]
        )
    caption = f"Largest errors over {summary['n_workspace']} poses of the workspace, by {summary['n_draws']} draws."
    return make_table(caption, columns, rows)


def _tabulate_variants(results: Results) -> Table:
    table = results.table("variants").sort_values("probability", ascending=False)
    columns = [Column("Variant", kind="name"), Column("Log-evidence", "nats"), Column("Probability")]
    rows = [
        [
            str(row["variant"]),
            format_fixed(float(row["log_evidence"]), 1),
            say_probability(float(row["probability"]), 1),
        ]
        for _, row in table.iterrows()
    ]
    caption = "Evidence by Laplace's approximation; `bayescal run` computes it more exactly."
    return make_table(caption, columns, rows)


def _plot_course(results: Results) -> Figure:
    wanted = format_percent(results.summary["stated_probability"])
    caption = (
        "Left: how probable it was after the first poses that all requirements hold, and how probable it is expected "
        "to be after further ones (open marks, dashed); the grey line is where one stops. Right: the error that no "
        f"pose exceeds with {wanted}, in shares of each limit; below the grey line a requirement holds. Crosses are "
        "rough: the approximation of so few poses has draws with heavy-tailed weights."
    )
    course, stated = results.table("course"), results.summary["stated_probability"]
    return Figure("course", caption, partial(draw_course, course, stated))


def draw_course(course: pd.DataFrame, stated: float) -> mpl.Figure:
    """Return the probability, and the errors in shares of the limits, against the number of poses."""
    figure = mpl.Figure(figsize=(9.4, 3.4))
    left, right = figure.subplots(1, 2)
    _draw_line(left, course, "probability", INK, "o", "all requirements")
    left.axhline(stated, color=GREY, linewidth=0.8)
    left.set(ylabel="Probability that the requirements hold", ylim=(-0.02, 1.02))
    names = [name for name in course.columns if name.endswith("_of_limit")]
    for k, name in enumerate(names):
        colour = LEG_COLOURS[k % len(LEG_COLOURS)]
        _draw_line(right, course, name, colour, MARKERS[k % len(MARKERS)], _name(name.removesuffix("_of_limit")))
    right.axhline(1.0, color=GREY, linewidth=0.8)
    right.set(ylabel="Error, share of the limit", ylim=(0.0, None))
    right.legend(ncols=2)
    for axes in (left, right):
        axes.set_xlabel("Poses")
        axes.grid(visible=True)
    return figure


def _draw_line(axes: Axes, course: pd.DataFrame, column: str, colour: str, marker: str, label: str) -> None:
    measured, expected = (course[course["what"] == what] for what in ("measured", "expected"))
    axes.plot(measured["poses"], measured[column], color=colour, marker=marker, markersize=3.5, label=label)
    joined = pd.concat([measured.tail(1), expected])
    axes.plot(joined["poses"], joined[column], color=colour, linestyle="--", linewidth=0.9)
    axes.plot(expected["poses"], expected[column], color=colour, marker=marker, markersize=3.5, linestyle="", mfc="w")
    rough = measured[measured["rough"]]
    axes.plot(rough["poses"], rough[column], color=RED, marker="x", markersize=6, linestyle="")
