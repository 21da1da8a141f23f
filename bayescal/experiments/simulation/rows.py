"""The table of a simulation, declared once."""

from __future__ import annotations

from dataclasses import dataclass

from bayescal.experiments.shared.rows import PARAMETER, PARAMETER_UNIT
from bayescal.files.rows import TableRow, column


@dataclass(frozen=True, kw_only=True)
class TruthRow(TableRow, table="truth"):
    """A parameter that is off its nominal value."""

    parameter: str = column(PARAMETER, show="name")
    unit: str = column(PARAMETER_UNIT, show="text")
    nominal: float = column("nominal value", show="fixed 6")
    true: float = column("true value", show="fixed 6")


ROWS: tuple[type[TableRow], ...] = (TruthRow,)
"""Tables of a simulation."""
