"""Which sensors to take and how many poses: sets of sensors and counts of poses on the page of an audit."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.experiments.audit.page import reading_figures as figures
from bayescal.experiments.audit.page.wording import format_probability
from bayescal.experiments.shared.headline import LIKELY, rate_probability, say_probability
from bayescal.report.blocks import Cell, Column, Figure, Section, Statement, make_section, make_table
from bayescal.report.numbers import (
    format_count,
    format_fixed,
    format_percent,
    format_plain,
    format_significant,
    join_words,
)
from bayescal.report.reading import Row, list_rows
from bayescal.report.symbols import Asked, shown_in

ENOUGH = 1.1  # times the error of the best set, which a smaller one may have
WORTH = 0.02  # of the error, by which one more pose should lower it
MANY = 12
REASONS = {
    "calibration": "readings do not determine where the machine is in the calibration",
    "use": "the machine's own sensors of the set do not determine where it is in use",
}


def find_enough(tables: dict[str, pd.DataFrame]) -> Row:
    """Return the smallest of the best sets, the cheapest where there are prices, that is good enough.

    It meets the requirements with a high probability; where none does, it is the one that most probably does; where
    nothing is required it errs hardly more than the best.
    """
    rows = list_rows(tables["front" if "front" in tables else "best_sets"])
    if "requirements" in tables:
        likely = [row for row in rows if row["probability"] >= LIKELY]
        return likely[0] if likely else max(rows, key=lambda row: (row["probability"], -row["goal"]))
    limit = ENOUGH * min(row["goal"] for row in rows)
    return next(row for row in rows if row["goal"] <= limit)


def find_last_worth(counts: pd.DataFrame) -> int:
    """Return after how many poses each further one lowers the error by too little."""
    worth = counts[counts["gain"] >= WORTH]["n_poses"]
    return int(worth.max()) if len(worth) else 1


def state_sets(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Statement]:
    """Return which sensors are enough, or that none of the sets is any good."""
    if "sensor_sets" not in tables:
        return []
    n_sets = format_count(len(tables["sensor_sets"]))
    if "best_sets" not in tables:
        return [Statement(f"None of {n_sets} sets of sensors determines where the machine is.", "bad", "Sensors")]
    row = find_enough(tables)
    words = f"{_name_sensors(row, summary)}, {_count_sensors(row)} of {len(summary['sensor_choice']['candidates'])}"
    words += f" at a price of {format_plain(row['price'])}" if "price" in row else ""
    if "requirements" not in tables:
        best = min(one["goal"] for one in list_rows(tables["best_sets"]))
        more = format_percent(row["goal"] / best - 1.0)
        return [
            Statement(
                f"Enough of {n_sets} sets of sensors: {words}; {more} more error than the best.", "plain", "Sensors"
            )
        ]
    chance, what = say_probability(row["probability"]), _name_requirements(tables)
    level = rate_probability(row["probability"])
    if row["probability"] >= LIKELY:
        first = "cheapest" if "price" in row else "fewest"
        text = f"The {first} sensors that meet {what} with at least {say_probability(LIKELY)} probability: {words}"
        return [Statement(f"{text}; these do with {chance}.", level, "Sensors")]
    text = f"No set of sensors meets {what} with {say_probability(LIKELY)} probability; the most likely is {words}"
    return [Statement(f"{text}, with {chance}.", level, "Sensors")]


def _name_requirements(tables: dict[str, pd.DataFrame]) -> str:
    n = tables["requirements"]["requirement"].nunique()
    return "the requirement" if n == 1 else f"all {n} requirements"


def _name_sensors(row: Row, summary: dict[str, Any]) -> str:
    names = str(row["sensors"]).split(", ") if row["n_sensors"] else []
    always = [str(one) for one in summary["sensor_choice"]["always"]]
    beside = f" besides {join_words(always)}" if always else ""
    return f"{join_words(names) or 'nothing'}{beside}"


def _count_sensors(row: Row) -> str:
    return f"{int(row['n_sensors'])}"


def state_counts(tables: dict[str, pd.DataFrame], best: str) -> list[Statement]:
    """Return where more poses stop paying."""
    if "pose_counts" not in tables:
        return []
    mine = tables["pose_counts"][tables["pose_counts"]["variant"] == best]
    if mine.empty:
        return []
    enough, most = find_last_worth(mine), int(mine["n_poses"].max())
    if enough >= most:
        gain = format_percent(float(mine["gain"].iloc[-1]))
        return [
            Statement(f"The last of {most} poses still lowers the error by {gain}: measure more.", "plain", "Poses")
        ]
    share = format_percent(WORTH)
    return [Statement(f"From {enough} poses on, one more lowers the error by less than {share}.", "plain", "Poses")]


def show_sets(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Section]:
    """Return the best sets of every number of sensors, and the largest that are no good."""
    if "sensor_sets" not in tables:
        return []
    shown, drawn = [], []
    if "best_sets" in tables:
        shown.append(_tabulate_best(tables["best_sets"], "The best set of every number of sensors", tables, summary))
        drawn.append(_draw_sets("sensor_sets", "number", tables["best_sets"], tables))
        if "front" in tables:
            caption = "The sets that no other one beats at their price or below"
            shown.append(_tabulate_best(tables["front"], caption, tables, summary))
            drawn.append(_draw_sets("front", "price", tables["front"], tables))
        shown.append(_tabulate_parameters(tables))
    if "hopeless_sets" in tables:
        shown.append(_tabulate_hopeless(tables))
    text = (
        "Each set takes in the planned poses. An external sensor serves the calibration alone; in use the "
        "machine's own sensors of the set determine where it is. Error is that of unknown parameters and of the noise "
        "in use together.",
    )
    return [make_section("Which sensors to take", text, shown, drawn)]


def _draw_sets(name: str, against: str, best: pd.DataFrame, tables: dict[str, pd.DataFrame]) -> Figure:
    required = "requirements" in tables
    what = "the largest standard deviation as a share of its limit" if required else "rms over the workspace"
    return Figure(
        name,
        f"Error of every set of sensors against their {against}, {what}.",
        lambda: figures.draw_sets(tables["sensor_sets"], best, required, against),
    )


def _tabulate_best(best: pd.DataFrame, caption: str, tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Any:
    asked = summary["units"]
    names = [str(name).removeprefix("error_") for name in best.columns if str(name).startswith("error_")]
    group = "rms error over the workspace"
    columns = [Column("Sensors"), Column("Which", kind="text")]
    columns += [Column("Price")] if "price" in best else []
    columns += [Column("Sets"), Column("of them no good")] if "n_sets" in best else []
    columns += [Column(n.rpartition("_")[0], shown_in(n.rpartition("_")[2], asked)[1], group=group) for n in names]
    columns += [Column("Requirements", "probability of all")] if "requirements" in tables else []
    rows: list[list[str | Cell]] = []
    for row in list_rows(best):
        factors = [shown_in(n.rpartition("_")[2], asked)[0] for n in names]
        errors = [format_significant(f * row[f"error_{n}"]) for f, n in zip(factors, names, strict=True)]
        chance = [_judge(row["probability"])] if "requirements" in tables else []
        counts = [format_plain(row["price"])] if "price" in best else []
        counts += [format_count(row["n_sets"]), format_count(row["n_hopeless"])] if "n_sets" in best else []
        rows.append([_count_sensors(row), str(row["sensors"]) if row["n_sensors"] else "–", *counts, *errors, *chance])
    always = summary["sensor_choice"]["always"]
    beside = f", besides {join_words([str(one) for one in always])}" if always else ""
    return make_table(f"{caption}{beside}.", columns, rows)


def _judge(probability: float) -> Cell:
    return Cell(format_probability(probability), rate_probability(probability))


def _tabulate_parameters(tables: dict[str, pd.DataFrame]) -> Any:
    """Return what each number of sensors leaves of the parameters' tolerances, a symbol a row."""
    every = tables["best_set_parameters"]
    every = every.assign(symbol=every["parameter"].str.partition("[")[0], share=every["sd"] / every["prior_sd"])
    shares = every.groupby(["symbol", "n_sensors"], sort=False)["share"].max().unstack()
    columns = [Column("Parameter", kind="text")]
    columns += [Column(f"{int(n)}", group="by the number of sensors") for n in shares.columns]
    rows: list[list[str | Cell]] = [
        [str(symbol), *(format_fixed(float(one), 3) for one in values)]
        for symbol, values in zip(shares.index, shares.to_numpy(), strict=True)
    ]
    return make_table(
        "What the best sets leave of tolerances; of several of a symbol the largest share.", columns, rows
    )


def _tabulate_hopeless(tables: dict[str, pd.DataFrame]) -> Any:
    lines = list_rows(tables["hopeless_sets"].sort_values("n_sensors", ascending=False, kind="stable"))
    columns = [Column("Sensors", kind="text"), Column("Why not", kind="text")]
    rows: list[list[str | Cell]] = [
        [str(row["sensors"]) if row["n_sensors"] else "none", REASONS[str(row["reason"])]] for row in lines[:MANY]
    ]
    more = f", the first {MANY} of {len(lines)}" if len(lines) > MANY else ""
    return make_table(f"The largest sets that are no good, nor is any part of them{more}.", columns, rows)


def show_counts(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Section]:
    """Return what every number of poses leaves of the error."""
    if "pose_counts" not in tables:
        return []
    mine = tables["pose_counts"][tables["pose_counts"]["variant"] == best].dropna(axis=1, how="all")
    if mine.empty:
        return []
    names = [str(name).removeprefix("after_") for name in mine.columns if str(name).startswith("after_")]
    columns = [Column("Poses")]
    for group in ("chosen, rms then left", "at random"):
        columns += [Column(n.rpartition("_")[0], shown_in(n.rpartition("_")[2], asked)[1], group=group) for n in names]
    columns += [Column("the last lowers the error by")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(mine):
        values = [
            (shown_in(n.rpartition("_")[2], asked)[0] * row[f"{part}_{n}"])
            for part in ("after", "random")
            for n in names
        ]
        rows.append([str(row["n_poses"]), *map(format_significant, values), format_percent(row["gain"], 1)])
    figure = Figure(
        "pose_counts",
        "Error over the workspace by unknown parameters, by the number of poses: chosen, and as many at random.",
        lambda: figures.draw_counts(mine, find_last_worth(mine), asked),
    )
    text = ("The best set of poses found of every number; where the curve is flat more of them do not pay.",)
    return [make_section("How many poses", text, (make_table("By the number of poses.", columns, rows),), (figure,))]
