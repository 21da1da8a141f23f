"""The model error τ of each leg, and whether the measurements call for it."""

from __future__ import annotations

import pandas as pd

from bayescal.experiments.study.page.checks import measure_gain
from bayescal.experiments.study.page.illustrations import illustrate_model_error
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import VARIANT, group_variants, label_variant, name_variants
from bayescal.report.blocks import Block, Column, Fold, Section, Statement, Table, make_table
from bayescal.report.numbers import (
    MICROMETRES,
    NOTHING,
    count_decimals,
    format_fixed,
    format_significant,
    format_span,
)
from bayescal.report.symbols import MODEL_ERROR

TEXT = (
    "τ is the standard deviation of the model error along a leg, beyond the noise of {} and actuators. Where it is "
    "near zero the model suffices; where it is large the posterior widens all intervals instead of attributing "
    "the residuals to the geometry."
)


def show_model_error(study: StudyResults) -> Section | None:
    """Return the model error of each leg; None where no variant was computed without any."""
    if "zero" not in study.settings:
        return None
    table, statements = tabulate_model_error(study)
    text = TEXT.format("targets" if study.instrument is None else "the instrument")
    blocks: list[Block] = [text, *statements, illustrate_model_error(study)]
    if table is not None:
        blocks.append(Fold("τ of every leg, variant by variant", (table,)))
    return Section("Model error", tuple(blocks), anchor="model-error")


def tabulate_model_error(results: StudyResults) -> tuple[Table | None, list[Statement]]:
    """Return τ of each leg with its 90 % interval and what it adds to the evidence, and a sentence per group."""
    frame = results.parameters
    rows_free = frame[(frame["model_error"] == "free") & (frame["symbol"] == MODEL_ERROR)]
    if rows_free.empty:
        return None, []
    legs = sorted(set(rows_free["leg"]))
    columns = [VARIANT, *(Column(f"leg {leg}" if leg else "all legs", "µm", "τ, mean [5 %, 95 %]") for leg in legs)]
    columns.append(Column("Benefit of τ", "nat"))
    rows = []
    for name in results.ranking:
        values = MICROMETRES * rows_free[rows_free["variant"] == name].set_index("leg")[["mean", "q05", "q95"]]
        cells = [_format_interval(values, leg) if leg in values.index else NOTHING for leg in legs]
        rows.append([label_variant(results, name), *cells, format_fixed(measure_gain(results, name), 1, sign=True)])
    note = "Benefit of τ: log-evidence with model error less that without; negative where the model suffices."
    groups = group_variants(results, results.ranking)
    return (
        make_table("Model error of each leg.", columns, rows, [Statement(note)]),
        [_state_group(results, rows_free, group) for group in groups],
    )


def _format_interval(values: pd.DataFrame, leg: int) -> str:
    """Return ``mean [low, high]`` with the decimals that the narrowest interval of the table asks for."""
    places = min(3, count_decimals(float((values["q95"] - values["q05"]).min())))
    row = values.loc[[leg], ["mean", "q05", "q95"]].to_numpy(dtype=float)[0]
    mean, low, high = (format_fixed(x, places) for x in row)
    return f"{mean} [{low}, {high}]"


def _state_group(results: StudyResults, rows: pd.DataFrame, names: list[str]) -> Statement:
    """Say how large τ is in variants that are alike, and whether the measurements call for it."""
    values = MICROMETRES * rows[rows["variant"].isin(names)]["mean"]
    span = " to ".join(dict.fromkeys(format_significant(float(x), 2) for x in (values.min(), values.max())))
    gains = [measure_gain(results, name) for name in names]
    call = "needed" if min(gains) > 0 else "not needed" if max(gains) <= 0 else "needed in some"
    level = "higher" if min(gains) > 0 else "lower" if max(gains) <= 0 else "higher or lower"
    worth = format_span([abs(x) for x in gains])
    return Statement(
        f"{name_variants(results, names)}: τ is {span} µm; it is {call} (log-evidence {worth} nat {level} "
        f"than with {_name_nothing(results, names)})."
    )


def _name_nothing(results: StudyResults, names: list[str]) -> str:
    """Return what variants without any model error have none of."""
    structured = any("structured_error" in results.fit(name, "free") for name in names)
    return "neither τ nor a structured error" if structured else "τ = 0"
