"""The page of a check, from its results alone."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd
from matplotlib import figure as mpl

from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.headline import write_headline
from bayescal.limits import FEWEST_SETS
from bayescal.report.blocks import (
    Absent,
    Block,
    Cell,
    Column,
    Definitions,
    Figure,
    Level,
    Page,
    Section,
    Statement,
    Table,
    make_table,
)
from bayescal.report.numbers import format_fixed, format_percent, join_words
from bayescal.report.style import GREY, LEG_COLOURS, PALE, RED
from bayescal.report.symbols import name_parameter

NAMES = {
    "noise": "the noise is not as stated",
    "model error": "the model misses something",
    "unit": "a unit or a sign has slipped",
    "legs": "legs or channels are exchanged",
    "poses": "poses are read in another way",
    "channel": "a channel is wrong",
    "frame": "poses are given in another frame",
    "drift": "readings drift",
    "tolerance": "a tolerance is too tight",
    "rows": "rows do not belong together",
    "mode": "a mode is missed",
    "derivative": "a derivative is wrong",
    "prior": "a tolerance is too tight",
    "search": "the posterior is not found",
    "calibration": "intervals do not hold what they promise",
}
METHOD = (
    (
        "Are priors, model and sampling consistent?",
        "Machines are drawn from the priors, measured to the study's own plan with its stated noise, and fitted as "
        "the study fits; the rank of each true parameter among the draws of its posterior is then uniform "
        "(simulation-based calibration).",
    ),
    (
        "Also near the machine that was measured?",
        "Machines are drawn from the posterior of the measured data, and measured and simulated data are fitted "
        "together; the ranks are uniform again (posterior simulation-based calibration).",
    ),
    (
        "Do the data fit the config?",
        "Simulations of a model know nothing of data that are not of it. Units, signs, order, frames, "
        "noise, single rows and channels, tolerances and drifts are tried as if they were so and compared by one "
        "log-density, derivatives compared with differences, searches started elsewhere, and residuals of the poses "
        "and how far the machine lies from nominal set against noise and tolerances.",
    ),
)


def build_page(results: Results) -> Page:
    """Return what the page of a check says."""
    summary, findings = results.summary, results.table("findings")
    several = len(summary["variants"]) > 1
    rows = [{str(key): str(value) for key, value in row.items()} for row in findings.fillna("").to_dict("records")]
    rows.sort(key=lambda row: ("bad", "warning", "good").index(row["level"]))
    return Page(
        kind="Check",
        name=summary["name"],
        title=summary["title"],
        origin=summary["data_origin"],
        headline=state_headline(results),
        verdict=tuple(_state(row, several) for row in rows),
        sections=(
            *(_show_variant(results, name) for name in summary["variants"]),
            Section("How it was checked", (Definitions(METHOD),), "method"),
        ),
        facts=(("Study", summary["study"]), ("Simulated data sets", f"{summary['data_sets']} twice")),
    )


def state_headline(results: Results) -> str:
    """Return whether to rely on the study, which variants pass, and what is wrong with the others."""
    words, sound = [], True
    for name, one in results.summary["variants"].items():
        faults = [NAMES[fault] for fault in dict.fromkeys(one["faults"])]
        passes = one["passed"] and not faults
        sound &= passes
        words.append(f"{name} passes" if passes else f"{name}: {join_words(faults)}")
    few = min((_count_sets(results, name) or FEWEST_SETS for name in results.summary["variants"]), default=FEWEST_SETS)
    advice = "The study's config can be relied on"
    if few < FEWEST_SETS:
        advice = "Nothing was found against the study's config"
        words.append(f"{few} simulated data sets are too few to judge its intervals, which takes {FEWEST_SETS}")
    advice = advice if sound else "Mend the study's config before relying on it"
    return write_headline([f"{advice}: {'; '.join(words)}"])


def _count_sets(results: Results, name: str) -> int:
    """Return in how many data sets of a variant there are ranks, of the fewer of both sorts; zero without any."""
    ranks = results.table("ranks")
    mine = ranks[ranks["variant"] == name] if len(ranks) else ranks
    return 0 if mine.empty else int(mine["data_set"].str.partition(" ")[0].value_counts().min())


def _state(row: dict[str, str], several: bool) -> Statement:
    level: Level = "bad" if row["level"] == "bad" else "warning" if row["level"] == "warning" else "good"
    text = row["text"]
    said = f"{text[0].upper()}{text[1:]}" if text[0].isascii() else text  # χ² keeps its letter
    return Statement(said, level, f"{row['check']} ({row['variant']})" if several else row["check"])


def _show_variant(results: Results, name: str) -> Section:
    parameters, anchor = results.table("parameters"), f"variant-{list(results.summary['variants']).index(name) + 1}"
    mine = parameters[parameters["variant"] == name] if len(parameters) else parameters
    if mine.empty:
        return Section(name, (Absent("Nothing was simulated: the faults above come first."),), anchor)
    judged = _count_sets(results, name) >= FEWEST_SETS
    blocks: list[Block] = [_plot(results, name, anchor, judged), _tabulate(mine, judged)]
    return Section(name, tuple(blocks), anchor)


def _tabulate(parameters: pd.DataFrame, judged: bool) -> Table:
    columns = [
        Column("Parameter", kind="text"),
        *(
            Column(*one, group)
            for group in ("Simulated from the priors", "Simulated from the posterior")
            for one in (("ranks", ""), ("covers", "of 90 %"), ("off by", "sd, rms"))
        ),
    ]
    rows: list[list[str | Cell]] = []
    for name, group in parameters.groupby("parameter", sort=False):
        row: list[str | Cell] = [name_parameter(str(name))]
        for _, one in group.iterrows():
            good = bool(one["uniform"])
            badge = Cell("uniform" if good else "not uniform", "good" if good else "bad", badge=True)
            row.append(badge if judged else Cell("too few"))
            row += [format_percent(float(one["coverage_90"])), format_fixed(float(one["rms_z"]), 2)]
        rows.append(row)
    return make_table("Ranks, coverage and recovery of every parameter.", columns, rows)


def _plot(results: Results, name: str, anchor: str, judged: bool) -> Figure:
    caption = (
        "Distribution functions of the ranks, less that of uniform ranks, a line per parameter; uniform ones stay "
        "within the grey band, all at once with a probability of 99 %. "
    )
    caption += "Red lines do not." if judged else f"Fewer than {FEWEST_SETS} data sets say little by that."
    ranks, bands = results.table("ranks"), results.table("bands")
    mine, band = ranks[ranks["variant"] == name], bands[bands["variant"] == name]
    return Figure(f"ranks-{anchor}", caption, partial(draw_ranks, mine.dropna(axis=1, how="all"), band))


def draw_ranks(ranks: pd.DataFrame, bands: pd.DataFrame) -> mpl.Figure:
    """Return the distribution functions of ranks, less that of uniform ones, beside their band."""
    figure = mpl.Figure(figsize=(9.4, 3.2))
    whence = list(dict.fromkeys(bands["simulated_from"]))
    for axes, one in zip(figure.subplots(1, len(whence), sharey=True, squeeze=False)[0], whence, strict=True):
        band, mine = bands[bands["simulated_from"] == one], ranks[ranks["data_set"].str.startswith(f"{one} ")]
        at, low, high = (band[key].to_numpy(dtype=float) for key in ("at", "low", "high"))
        axes.fill_between(at, low - at, high - at, color=PALE, linewidth=0.0)
        for name in mine.columns.drop(["variant", "data_set"]):
            values = np.sort(mine[name].to_numpy(dtype=float))
            share = np.searchsorted(values, at, side="right") / len(values)
            inside = bool(np.all((share >= low - 1e-12) & (share <= high + 1e-12)))
            axes.plot(
                at, share - at, color=LEG_COLOURS[4] if inside else RED, linewidth=0.7, alpha=0.6 if inside else 1.0
            )
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        axes.set_title(f"Simulated from the {one}{'s' if one == 'prior' else ''}")
        axes.set_xlabel("Rank of the truth")
    figure.axes[0].set_ylabel("Share of ranks below, less uniform")
    return figure
