"""How accurate a machine is, what its readings do not determine and where to measure next, as blocks of any page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from bayescal.experiments.frame.results import list_rows
from bayescal.report.blocks import Block, Cell, Column, Fold, Level, Section, Statement, Table, make_section, make_table
from bayescal.report.numbers import NOTHING, format_fixed, format_percent, format_significant
from bayescal.report.symbols import Asked, format_place, name_unit, shown_in

if TYPE_CHECKING:
    import pandas as pd

VERDICT_LEVELS: dict[str, Level] = {
    "identifiable": "good",
    "weak": "warning",
    "not": "bad",
    "noise": "plain",
    "several": "warning",
}
"""How good the news of a parameter's verdict is."""
NO_TOOL = (
    "The machine's class states no tool: its coordinates are reported instead. State tool_channels (names and units), "
    "and tool() where the tool is something else than the coordinates."
)
ALIGNED = (
    "It is what remains after a best fit of the base frame, and of the tool frame where the tool turns, over the "
    "workspace. Unaligned figures are larger because they hold, too, how well it is known where these frames lie: a "
    "convention, which no measurement of the machine's motion tells."
)
"""Why accuracy is stated with base and tool aligned, and why it differs otherwise."""
WORTHWHILE = 0.01  # of the mean squared error; what promises less is no advice
SENSORS = {"all": "all", "own": "the machine's own"}


def name_titles(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Return what the variants are called by their names."""
    import pandas as pd  # a third of a second, for those who have tables

    return {str(row["variant"]): str(row["title"]) for row in list_rows(tables.get("variants", pd.DataFrame()))}


def is_aligned(accuracy: pd.DataFrame) -> bool:
    """Whether a table of accuracies says what remains of errors once base and tool are aligned."""
    return "frame" in accuracy and bool((accuracy["frame"] == "aligned").any())


def show_accuracy(tables: Mapping[str, pd.DataFrame], variant: str = "", asked: Asked = None) -> Section | None:
    """Return how accurate each variant's tool is, or its coordinates where no tool is stated.

    All others are folded behind a ``variant`` that is named.
    """
    if "accuracy" not in tables:
        return None
    text = (
        "Standard uncertainty (k = 1) of the tool as located by the machine's own sensors alone: before the "
        "calibration by the tolerances (prior), after it by what is unknown of parameters and systematic errors "
        "together (posterior); the noise of one set of readings comes on top. A dash: its own sensors do not "
        "determine it."
    )
    if is_aligned(tables["accuracy"]):
        text += f" {ALIGNED}"
    first = tables["accuracy"]["variant"] == variant
    every, titles = tables["accuracy"], name_titles(tables)
    blocks: list[Block] = [_tabulate_accuracy(every[first] if first.any() else every, titles, asked)]
    if first.any() and not first.all():
        blocks.append(Fold("The other variants", (_tabulate_accuracy(every[~first], titles, asked),)))
    return Section("How accurate the machine is", (text, *blocks))


def _tabulate_accuracy(accuracy: pd.DataFrame, titles: Mapping[str, str], asked: Asked) -> Table:
    """Return the rows of some variants."""
    group = "rms over the workspace"
    columns = [Column("Variant", kind="text"), Column("Tool", kind="text"), Column("Unit", kind="text")]
    columns += [Column(one, group=group) for one in ("before", "after", "noise of one reading")]
    columns += [Column("largest after"), Column("at", kind="text")]
    aligned = is_aligned(accuracy)
    if aligned:
        columns += [Column(one, group="unaligned") for one in ("rms after", "largest after")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(accuracy):
        factor, unit = shown_in(row["unit"], asked)
        numbers = (format_significant(factor * row[name]) for name in ("before", "after", "noise"))
        worst = format_significant(factor * row["worst"]) if "worst" in row else NOTHING
        at = str(row.get("worst_at", NOTHING))
        base = [format_significant(factor * row[name]) for name in ("unaligned", "worst_unaligned") if aligned]
        rows.append([titles[row["variant"]], str(row["coordinate"]), unit, *numbers, worst, at, *base])
    return make_table("Predicted standard uncertainty.", columns, rows)


def state_ridges(tables: Mapping[str, pd.DataFrame], variant: str) -> list[Statement]:
    """Return the combinations that a variant's readings leave undetermined; nothing where there are none."""
    if "ridges" not in tables:
        return []
    mine = tables["ridges"][tables["ridges"]["variant"] == variant]
    return [
        Statement(f"Contraction of this combination {format_fixed(row['contraction'], 2)}: {row['sentence']}")
        for row in list_rows(mine)
    ]


def _say_gain(gain: float) -> str:
    """Return by what part the error falls where its mean square falls by a part ``gain``."""
    return format_percent(1.0 - math.sqrt(max(0.0, 1.0 - gain)), 1)


def _read_next(tables: Mapping[str, pd.DataFrame], variant: str) -> pd.DataFrame:
    """Return a variant's candidate poses whose gain is known, and the columns of its coordinates; no rows without."""
    import pandas as pd  # a third of a second, for those who have tables

    rows = tables.get("next", pd.DataFrame(columns=["variant", "sensors", "gain"]))
    return rows[(rows["variant"] == variant) & rows["gain"].notna()].dropna(axis=1, how="all")


def state_next(tables: Mapping[str, pd.DataFrame], variant: str, asked: Asked = None) -> list[Statement]:
    """Return where to measure next with each set of sensors, where that promises something."""
    mine, found = _read_next(tables, variant), []
    if mine.empty:
        return []
    for sensors, rows in mine.groupby("sensors", sort=False):
        first = list_rows(rows)[0]
        if first["gain"] < WORTHWHILE:
            continue
        place = [
            f"{name.rpartition('_')[0]} = {format_place(name, value, asked)} {name_unit(name, asked)}"
            for name, value in first.items()
            if name not in ("variant", "sensors", "gain")
        ]
        text = f"Measure next, with {SENSORS[str(sensors)]} sensors, at {', '.join(place)}: best of the candidate poses"
        found.append(Statement(f"{text}, expected to reduce the error by {_say_gain(first['gain'])}.", "plain", "Next"))
    return found


def show_next(tables: Mapping[str, pd.DataFrame], variant: str, asked: Asked = None) -> list[Section]:
    """Return the candidate poses that reduce a variant's error most."""
    mine = _read_next(tables, variant)
    if mine.empty:
        return []
    names = [str(name) for name in mine.columns if name not in ("variant", "sensors", "gain")]
    columns = [Column("Sensors", kind="text")]
    columns += [Column(name.rpartition("_")[0], name_unit(name, asked)) for name in names]
    columns.append(Column("Error falls by"))
    rows: list[list[str | Cell]] = [
        [
            SENSORS[str(row["sensors"])],
            *(format_place(name, row[name], asked) for name in names),
            _say_gain(row["gain"]),
        ]
        for row in list_rows(mine)
    ]
    text = (
        "Random poses of the workspace; the error is the rms standard uncertainty of the tool over the workspace, as "
        "it is expected after one more set of readings there.",
    )
    table = make_table("The best of the candidate poses.", columns, rows)
    return [make_section("What to measure next", text, (table,))]
