"""Tables of a sweep, each declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.files.rows import TableRow, column

type Extent = Literal["everywhere", "nowhere", "up to", "from", "in places"]
"""Where along an axis a requirement is met."""


@dataclass(frozen=True, kw_only=True)
class SweepMemberRow(TableRow, table="members"):
    """A member, with a column per axis and a column per figure."""

    others: Mapping[str, float | str] = field(default_factory=dict)
    state: Literal["done", "not converged", "failed"] = column("state of the member")
    reason: str = column("why it failed, or empty")


@dataclass(frozen=True, kw_only=True)
class SweepAnswerRow(TableRow, table="answers"):
    """Where along an axis a figure meets its requirement, with the other axes at some setting."""

    figure: str = column("key of the figure")
    axis: str = column("name of the axis")
    setting: str = column("values of the other axes, or empty")
    extent: Literal["everywhere", "nowhere", "up to", "from", "in places"] = column("where the requirement is met")
    bound: float = column("interpolated bound on the axis, or NaN")
    met_at: float = column("neighbouring value that meets it, or NaN")
    failed_at: float = column("neighbouring value that does not, or NaN")


ROWS: tuple[type[TableRow], ...] = (SweepMemberRow, SweepAnswerRow)
"""Tables of a sweep."""
