"""Published tables beside what least squares find: how far they lie apart, and what is odd in print."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.experiments.shared.study_schema import name_variant
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import (
    find_variants,
    label_model,
    label_variant,
    list_deformations,
    list_models,
    split_variant,
)
from bayescal.report.blocks import Column, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_significant, format_span
from bayescal.report.symbols import describe_deformation, write_symbol

LENGTH = "mm"
ODD = 0.25  # of the other models' values, below which a published row looks misprinted
MISPRINT = 10.0


@dataclass(frozen=True)
class Published:
    """Comparison of a least-squares identification with published values.

    Attributes
    ----------
    rms_mm : float
        Root mean square of the differences over all lengths, NaN without any.
    n_lengths : int
    n_inside, n_known : int
        Published values inside the posterior's 90 % interval, and how many there are.
    """

    rms_mm: float
    n_lengths: int
    n_inside: int
    n_known: int


def has_published(results: StudyResults, variant: str | None = None) -> bool:
    """Whether any value was published, for one variant or at all."""
    rows = results.table("least_squares")
    rows = rows if variant is None else rows[rows["variant"] == variant]
    return bool(rows["published_offset"].notna().any())


def compare_published(results: StudyResults, variant: str) -> Published:
    """Compare one variant's least squares and posterior (model error free) with the published values."""
    rows = results.table("least_squares")[results.table("least_squares")["variant"] == variant]
    lengths = rows[(rows["unit"] == LENGTH) & rows["difference"].notna()]["difference"]
    known = rows[rows["published_offset"].notna()]
    free = [row for row in results.rows("parameters", variant) if row["model_error"] == "free"]
    parameters = {str(row["parameter"]): row for row in free}
    inside = n = 0
    for row in known.itertuples():
        one = parameters.get(f"{row.parameter}[{row.leg}]") or parameters.get(str(row.parameter))
        if one is not None:
            n += 1
            inside += one["q05"] <= one["nominal"] + row.published_offset <= one["q95"]
    return Published(measure_rms(lengths), len(lengths), int(inside), n)


def measure_rms(values: pd.Series) -> float:
    """Return the root mean square of the values that are there, NaN without any."""
    known = values.dropna().to_numpy(dtype=float)
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")


def name_table(results: StudyResults, variant: str) -> str:
    """Return which published table belongs to a variant, ``table 5(a)``; empty where the config names none."""
    for entry in results.config.get("variants", []):
        if entry.get("name", name_variant(entry.get("model"), entry.get("deformation"))) == variant:
            name = re.split(r"[/\\]", str(entry.get("published") or ""))[-1].removesuffix(".csv")
            return re.sub(r"^table_?(\d+)_?([a-z])$", r"table \1(\2)", name)
    return ""


def tabulate_published(results: StudyResults) -> Table | None:
    """Return the rms difference between least squares and the published tables: a row per model."""
    if not has_published(results):
        return None
    frame = results.table("least_squares")[results.table("least_squares")["difference"].notna()]
    columns, keys = [Column("Model", kind="text")], []
    for deformation in list_deformations(results):
        names = find_variants(results, deformation=deformation)
        rows = frame[frame["variant"].isin(names)]
        for unit, symbols in _list_columns(rows):
            scale, text = results.scale_of(symbols[0], unit)
            group = _title_group(results, names, deformation)
            title = ", ".join(dict.fromkeys(s.partition("_")[0] for s in symbols)) if unit == LENGTH else symbols[0]
            columns.append(Column(title, text, group, symbolic=unit != LENGTH))
            keys.append((deformation, symbols, scale))
    cells: list[list[str]] = []
    for model in list_models(results):
        row = [label_model(results, model)]
        for deformation, symbols, scale in keys:
            names = find_variants(results, model, deformation)
            chosen = frame[frame["variant"].isin(names) & frame["parameter"].isin(symbols)]
            row.append(format_significant(scale * measure_rms(chosen["difference"]), 2) if len(chosen) else NOTHING)
        cells.append(row)
    caption = "Least squares on these data against the published tables: rms difference over the legs."
    return make_table(caption, columns, cells, list_remarks(results))


def _title_group(results: StudyResults, names: list[str], deformation: str) -> str:
    """Return ``Table 5, without deformation`` where all tables of a deformation bear one number."""
    words = describe_deformation(deformation).removeprefix("with the ")
    numbers = {name_table(results, name).partition("(")[0] for name in names}
    title = f"{numbers.pop()}, {words}" if len(numbers) == 1 and "" not in numbers else words
    return title[0].upper() + title[1:]


def _list_columns(rows: pd.DataFrame) -> list[tuple[str, list[str]]]:
    """Return all lengths together, and every other symbol by itself, with their units."""
    lengths = list(dict.fromkeys(rows[rows["unit"] == LENGTH]["parameter"]))
    others = rows[rows["unit"] != LENGTH].drop_duplicates("parameter")
    found = [(LENGTH, lengths)] if lengths else []
    return found + [(str(unit), [str(s)]) for s, unit in zip(others["parameter"], others["unit"], strict=True)]


def list_remarks(results: StudyResults) -> list[Statement]:
    """Return published rows that are far smaller than those of all other models, as misprints would be."""
    frame = results.table("least_squares")[results.table("least_squares")["published_offset"].notna()]
    grouped = frame.groupby(["variant", "parameter"])["published_offset"]
    sizes = {(str(name), str(symbol)): measure_rms(values) for (name, symbol), values in grouped}
    remarks = []
    for (name, symbol), size in sizes.items():
        same = find_variants(results, deformation=split_variant(results, name)[1])
        others = [sizes[other, symbol] for other in same if other != name and (other, symbol) in sizes]
        if len(others) > 1 and 0 < size < ODD * min(others):
            rows = frame[(frame["variant"] == name) & (frame["parameter"] == symbol)]
            remarks.append(_remark(results, name, symbol, [size / x for x in others], rows))
    return remarks


def _remark(results: StudyResults, name: str, symbol: str, shares: list[float], rows: pd.DataFrame) -> Statement:
    factor, unit = results.scale_of(symbol, str(rows["unit"].iloc[0]))
    unit = f"·{unit}" if unit.startswith("10") else f" {unit}"
    printed = factor * measure_rms(rows["difference"])
    times_ten = factor * measure_rms(rows["offset"] - MISPRINT * rows["published_offset"])
    table = name_table(results, name) or "the published table"
    text = (
        f"The {write_symbol(symbol)} of {table}, {label_variant(results, name)}, is printed at "
        f"{format_span(shares, 2)} of the other models' size (rms)"
    )
    if times_ten < 0.5 * printed:
        text += (
            f"; ten times the printed values lie {format_significant(times_ten, 2)}{unit} rms from least squares, the "
            f"printed ones {format_significant(printed, 2)}{unit}: they may have been printed in another unit"
        )
    return Statement(f"{text}.", "warning")
