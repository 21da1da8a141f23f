"""Tables of sensor placement: the Pareto front and the mixtures of kinds."""

from __future__ import annotations

import pandas as pd

from bayescal.experiments.sensor_placement.page.figures import write_sensors
from bayescal.report.blocks import Cell, Column, Table, make_table
from bayescal.report.numbers import NOTHING, format_count, format_percent, format_plain, format_significant

STEP = 0.02
"""Steps of the front that gain less are left out of the page's table."""


def list_sensors(text: str) -> str:
    """Return the sensors of a set, comma by comma."""
    return write_sensors(text.replace(" ", ", ")) or NOTHING


def _thin(front: pd.DataFrame) -> pd.DataFrame:
    """Return the front without steps that gain next to nothing; its first and last sets stay."""
    kept, level = [], float("inf")
    for place, error in front["rms_um"].items():
        if error <= (1.0 - STEP) * level or place == front.index[-1]:
            kept.append(place)
            level = float(error)
    return front.loc[kept]


def tabulate_front(front: pd.DataFrame, enough: str, within: float) -> Table:
    """Return the front, its small steps left out; ``enough`` are the sensors of the cheapest set near the best."""
    shown = _thin(front)
    columns = [
        Column("Price"),
        Column("Sensors"),
        Column("rms", "µm", "error of the tool's centre"),
        Column("largest", "µm", "error of the tool's centre"),
        Column("calibration", "µm", "of it, rms"),
        Column("noise", "µm", "of it, rms"),
        Column("left to tolerances"),
        Column("Pattern", kind="text"),
        Column("One such set", kind="text"),
        Column("sets", group="of this pattern"),
        Column("as good", group="of this pattern"),
    ]
    rows: list[list[str | Cell]] = [
        [
            format_plain(row["price"]),
            str(row["n_sensors"]),
            Cell(format_significant(row["rms_um"]), "good" if row["sensors"] == enough else "plain"),
            format_significant(row["largest_um"]),
            format_significant(row["calibration_um"]),
            format_significant(row["noise_um"]),
            format_percent(row["left_to_tolerances"]),
            write_sensors(row["pattern"]),
            list_sensors(row["sensors"]),
            str(row["n_of_pattern"]),
            str(row["n_alike"]),
        ]
        for _, row in shown.iterrows()
    ]
    n_more = len(front) - len(shown)
    caption = (
        f"Pareto front of accuracy against price; green: the cheapest within {format_percent(within)} of the best."
    )
    if n_more:
        caption += f" {n_more} steps that gain less than {format_percent(STEP)} are left out; front.csv has them."
    return make_table(caption, columns, rows)


def tabulate_kinds(kinds: pd.DataFrame) -> Table:
    """Return mixtures of kinds."""
    columns = [
        Column("Sensors"),
        Column("Mixture", kind="text"),
        Column("Price"),
        Column("all", group="sets"),
        Column("feasible", group="sets"),
        Column("best", "µm", "rms error"),
        Column("worst feasible", "µm", "rms error"),
        Column("Pattern of the best", kind="text"),
    ]
    rows = [
        [
            str(row["n_sensors"]),
            write_sensors(row["kinds"]) or NOTHING,
            format_plain(row["price"]),
            format_count(row["n_sets"]),
            format_count(row["n_feasible"]),
            format_significant(row["best_um"]),
            format_significant(row["worst_um"]),
            write_sensors(row["best_pattern"]) or NOTHING,
        ]
        for _, row in kinds.iterrows()
    ]
    return make_table("Mixtures of kinds.", columns, rows)
