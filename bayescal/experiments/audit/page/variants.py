"""Variants of an audit side by side, and the poses that are chosen for the best one."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from bayescal.experiments.audit.page.wording import format_probability, format_share
from bayescal.report.blocks import Cell, Column, Section, Statement, make_section, make_table
from bayescal.report.numbers import NOTHING, format_percent, format_significant, join_words
from bayescal.report.reading import list_rows
from bayescal.report.symbols import Asked, format_amount, format_place, name_unit, shown_in


def show_variants(tables: dict[str, pd.DataFrame], best: str) -> list[Section]:
    """Return how sets of sensors compare; nothing of a single one."""
    if "variants" not in tables or len(tables["variants"]) < 2:
        return []
    columns = [Column("Sensors", kind="text"), Column("Readings", kind="text"), Column("Free"), Column("Equations")]
    columns += [Column("Identifiable"), Column("Error left"), Column("Of the tightest limit")]
    columns += [Column("Requirements", "probability of all"), Column("", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(tables["variants"]):
        share, probability = (float(row.get(name) or math.nan) for name in ("share_of_limit", "probability"))
        chosen = Cell("shown below", "good", badge=True) if row["variant"] == best else Cell("")
        numbers = [str(row[name]) for name in ("n_parameters", "n_equations", "n_identifiable")]
        rows.append(
            [
                str(row["title"]),
                str(row["data"]),
                *numbers,
                format_percent(row["left"], 1) if math.isfinite(row["left"]) else NOTHING,
                format_share(share),
                format_probability(probability),
                chosen,
            ]
        )
    text = (
        "Equations are readings less coordinates of the poses. Identifiable: uncertainty at least halved. Error left: "
        "what unknown parameters do to where the machine is, rms, after the calibration against before.",
    )
    return [make_section("Which sensors", text, (make_table("Sets of sensors.", columns, rows),))]


def state_equations(tables: dict[str, pd.DataFrame]) -> list[Statement]:
    """Warn of variants whose readings are fewer than what they are to determine."""
    return [
        Statement(
            f"“{row['title']}”: {row['n_equations']} equations for {row['n_parameters']} unknowns; what the readings "
            "do not determine rests on the tolerances.",
            "warning",
            "Data",
        )
        for row in list_rows(tables["variants"])
        if row["n_equations"] < row["n_parameters"]
    ]


def state_selected(tables: dict[str, pd.DataFrame], summary: dict[str, Any], best: str) -> list[Statement]:
    """Return what the chosen poses determine, beside the planned ones."""
    if "selected" not in tables:
        return []
    mine = list_rows(tables["selected"][tables["selected"]["variant"] == best])
    planned = {row["coordinate"]: row for row in list_rows(tables["accuracy"]) if row["variant"] == best}
    if not mine:
        return []
    words = [
        f"{name} to {format_amount(mine[-1][f'after_{name}_{row["unit"]}'], row['unit'], 2, summary['units'])} "
        f"({format_amount(row['after'], row['unit'], 2, summary['units'])})"
        for name, row in planned.items()
    ]
    return [
        Statement(
            f"{len(mine)} poses chosen out of {summary['candidates']} determine {join_words(words)}; in brackets what "
            f"the {summary['plan']['n_poses']} planned ones do.",
            "plain",
            "Poses",
        )
    ]


def show_selected(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Section]:
    """Return the poses that are chosen, the first first."""
    if "selected" not in tables:
        return []
    mine = tables["selected"][tables["selected"]["variant"] == best].dropna(axis=1, how="all")
    names = [str(name) for name in mine.columns if name not in ("variant", "step")]
    columns = [Column("Pose"), *(_make_column(name, asked) for name in names)]
    rows: list[list[str | Cell]] = [
        [
            str(row["step"]),
            *(_format(n, row[n], asked) for n in names),
        ]
        for row in list_rows(mine)
    ]
    text = (
        "In the order in which each lowers the mean squared error over the workspace most, given all before it. Beside "
        "each, what is then left of the error by unknown parameters.",
    )
    return [make_section("Poses to measure", text, (make_table("The poses chosen.", columns, rows),))] if rows else []


def _make_column(name: str, asked: Asked) -> Column:
    stem = name.rpartition("_")[0]
    if stem.startswith("after_"):
        return Column(stem.removeprefix("after_"), name_unit(name, asked), group="rms then left")
    return Column(stem, name_unit(name, asked))


def _format(name: str, value: float, asked: Asked) -> str:
    if not name.startswith("after_"):
        return format_place(name, value, asked)
    return format_significant(shown_in(name.rpartition("_")[2], asked)[0] * value)
