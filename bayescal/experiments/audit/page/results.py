"""An audit's results as its page reads them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from bayescal.experiments.audit.rows import (
    PREDICTED_SD,
    ROWS,
    AlternativeRow,
    AuditCombinationRow,
    AuditParameterRow,
    AuditRequirementRow,
    AuditScenarioRow,
    AuditVariantRow,
    FreeingStepRow,
)
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.rows import ToolUncertaintyRow
from bayescal.files.rows import TableRow, check_tables
from bayescal.limits import IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION
from bayescal.report.symbols import split_name

KNOWN_LIMITS = (
    math.sqrt(UNIDENTIFIABLE_CONTRACTION / (1.0 - UNIDENTIFIABLE_CONTRACTION)),
    math.sqrt(IDENTIFIABLE_CONTRACTION / (1.0 - IDENTIFIABLE_CONTRACTION)),
)
"""Tolerance over what the noise alone would leave of a combination: below, hardly anything is learnt; above, enough."""
SIMULATED = {
    "simulated_calibrations": "full set free",
    "simulated_calibrations_reduced": "reduced set free, rest nominal",
}
"""What was free in the simulated calibrations of each key."""


@dataclass(frozen=True)
class PlanChange:
    """What another plan determines: nats, contraction of practical ridges by pivot, sd of requirements; NaN if none."""

    name: str
    n_poses: int
    is_feasible: bool
    is_beyond_range: bool
    nats: float
    n_identifiable: int
    ridges: dict[str, float]
    requirements: dict[str, float]


@dataclass(frozen=True, eq=False)
class AuditResults:
    """What an audit left: its summary, and the tables that are there and not empty."""

    summary: Summary
    tables: dict[str, pd.DataFrame]

    @classmethod
    def of(cls, results: Results) -> AuditResults:
        """Return the view of an audit's results; InputError where a table is not as it is declared."""
        check_tables(ROWS, results.tables, results.folder or Path())
        return cls(results.summary, {name: table for name, table in results.tables.items() if not table.empty})

    @property
    def best(self) -> str:
        """The variant that the details are of."""
        return str(self.summary.get("best", ""))

    @property
    def is_measured(self) -> bool:
        """Whether the poses are those of a study's data, no plan."""
        return "n_verification_poses" in self.summary["plan"]

    @property
    def member(self) -> str:
        """What one of many is called."""
        return str(self.summary.get("member", "leg"))

    @property
    def n_poses(self) -> int:
        """How many poses are planned or measured."""
        return int(self.summary["plan"]["n_poses"])

    @cached_property
    def variants(self) -> list[AuditVariantRow]:
        """In the design's order."""
        return self._read(AuditVariantRow)

    @property
    def together(self) -> float:
        """Probability that all requirements are met; NaN where it is not known."""
        return next((row.probability for row in self.variants if row.variant == self.best), math.nan)

    def of_best(self, name: str) -> pd.DataFrame:
        """Return the rows and columns of a table that the best variant has; none where there is no such table."""
        if name not in self.tables:
            return pd.DataFrame()
        table = self.tables[name]
        return table[table["variant"] == self.best].dropna(axis=1, how="all")

    def _read[R: TableRow](self, row: type[R], best: bool = False) -> list[R]:
        """Return the rows of a table, of the best variant alone where wanted; none where there is no such table."""
        if row.table not in self.tables:
            return []
        table = self.tables[row.table]
        return row.read(table[table["variant"] == self.best] if best else table)

    @cached_property
    def accuracy(self) -> list[ToolUncertaintyRow]:
        """Of the best variant's tool, a coordinate each."""
        return self._read(ToolUncertaintyRow, best=True)

    @cached_property
    def parameters(self) -> list[AuditParameterRow]:
        """Of the best variant, in the order of the layout."""
        return self._read(AuditParameterRow, best=True)

    @cached_property
    def requirements(self) -> list[AuditRequirementRow]:
        """Of the best variant, in the design's order."""
        return self._read(AuditRequirementRow, best=True)

    @cached_property
    def steps(self) -> list[FreeingStepRow]:
        """Of the search for the reduced set, in their order."""
        return self._read(FreeingStepRow)

    @property
    def n_identifiable(self) -> int:
        """How many parameters are determined."""
        return sum(row.verdict == "identifiable" for row in self.parameters)

    @cached_property
    def symbols(self) -> list[str]:
        """Symbols in the order of the layout."""
        return list(dict.fromkeys(row.symbol for row in self.parameters))

    @cached_property
    def ridges(self) -> list[AuditCombinationRow]:
        """The structural and practical directions in the audit's order."""
        return self._read(AuditCombinationRow)

    @cached_property
    def groups(self) -> list[list[AuditCombinationRow]]:
        """Ridges of one kind that are named after the same symbol, one per leg, in the order of the first of each."""
        found: dict[tuple[str, str], list[AuditCombinationRow]] = {}
        for ridge in self.ridges:
            found.setdefault((ridge.kind, split_name(ridge.pivot)[0]), []).append(ridge)
        return list(found.values())

    @cached_property
    def changes(self) -> list[PlanChange]:
        """In the audit's order."""
        ridges: dict[str, dict[str, float]] = {}
        for one in self._read(AuditScenarioRow):
            ridges.setdefault(one.scenario, {})[one.ridge] = one.contraction
        return [
            PlanChange(
                row.alternative,
                row.n_poses,
                row.is_feasible,
                row.is_beyond_range,
                row.nats,
                row.n_identifiable,
                ridges.get(row.alternative, {}),
                {name.removeprefix(PREDICTED_SD): sd for name, sd in row.others.items()},
            )
            for row in self._read(AlternativeRow)
        ]
