"""What an experiment says, as a table: the findings of its page, one row each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from bayescal.files.rows import TableRow, column
from bayescal.report.blocks import Level, Statement

if TYPE_CHECKING:
    import pandas as pd

type Status = Literal["good", "note", "warning", "bad"]

STATUSES: dict[Level, Status] = {"good": "good", "plain": "note", "warning": "warning", "bad": "bad"}


@dataclass(frozen=True, kw_only=True)
class FindingRow(TableRow, table="findings"):
    """A finding: what the page, the terminal and Python show, in their order."""

    subject: str = column("what it is about")
    status: Status = column("good, note, warning, or bad: do not rely on the results")
    value: float = column("its figure, or empty")
    limit: float = column("what it is compared with, or empty")
    unit: str = column("of both")
    text: str = column("the finding in words")
    action: str = column("what to do, or empty")

    def __str__(self) -> str:
        """Return the finding as a line."""
        return " ".join(one for one in (f"{self.subject}:" if self.subject else "", self.text, self.action) if one)


def tabulate_findings(found: Iterable[Statement]) -> pd.DataFrame:
    """Return findings as a table, in their order."""
    return FindingRow.collect(
        FindingRow(
            subject=one.lead,
            status=STATUSES[one.level],
            value=one.value,
            limit=one.limit,
            unit=one.unit,
            text=one.text,
            action=one.action,
        )
        for one in found
    )
