"""What errors that leave no trace hide of each parameter: as a table, and on the pages of studies and audits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from bayescal.experiments.shared.rows import UnmodelledBiasRow
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Block, Column, Fold, Statement, make_table
from bayescal.report.numbers import format_fixed, format_significant
from bayescal.report.symbols import split_name

if TYPE_CHECKING:
    import pandas as pd

FEW: Final = 12  # parameters that are shown one by one
ALLOWED: Final = "Bias from model errors ({size}, rms) that imitate parameters; posterior sds include it."
BESIDE: Final = (
    "Bias from model errors ({size}, rms) that imitate parameters; posterior sds exclude it: state floor_um."
)


def tabulate_hidden(variant: str, names: Sequence[str], units: Sequence[str], hidden: Array, sd: Array) -> pd.DataFrame:
    """Return by how much unseen errors put n parameters off (n,), and their standard deviations (n,), a row each."""
    return UnmodelledBiasRow.tabulate(variant=variant, parameter=names, unit=units, bias_rms=hidden, sd=sd)


def show_hidden(
    rows: pd.DataFrame, size: str, allowed: bool, shown_in: Callable[[str], tuple[float, str]]
) -> list[Block]:
    """Return what unseen errors hide of the parameters of one variant, symbol by symbol; each by itself folded.

    ``size``: of the errors, in words; ``allowed``: whether posterior sds have them in; ``shown_in``: factor and name of
    the unit that values of another one are shown in.
    """
    if rows.empty:
        return []
    said = Statement((ALLOWED if allowed else BESIDE).format(size=size))
    records = UnmodelledBiasRow.read(rows)
    every = [_list_cells(row.parameter, [row], shown_in) for row in records]
    if len(every) <= FEW:
        return [said, make_table("Bias from unmodelled errors.", _list_columns("Parameter"), every)]
    by_symbol = dict[str, list[UnmodelledBiasRow]]()
    for row in records:
        by_symbol.setdefault(split_name(row.parameter)[0], []).append(row)
    cells = [_list_cells(symbol, some, shown_in) for symbol, some in by_symbol.items()]
    return [
        said,
        make_table("Bias from unmodelled errors, rms.", _list_columns("Symbol"), cells),
        Fold("Of each parameter", (make_table("Bias from unmodelled errors.", _list_columns("Parameter"), every),)),
    ]


def _list_columns(first: str) -> list[Column]:
    return [Column(first, kind="text"), *map(Column, ("Bias, rms", "Posterior sd", "Bias / sd"))]


def _list_cells(
    name: str, rows: Sequence[UnmodelledBiasRow], shown_in: Callable[[str], tuple[float, str]]
) -> list[str]:
    factor, unit = shown_in(rows[0].unit)
    hidden, sd = (
        math.sqrt(sum(one**2 for one in values) / len(rows))
        for values in ([row.bias_rms for row in rows], [row.sd for row in rows])
    )
    share = format_fixed(hidden / sd, 2) if sd > 0.0 else ""
    amounts = (f"{format_significant(factor * value, 2)} {unit}".rstrip() for value in (hidden, sd))
    return [name, *amounts, share]
