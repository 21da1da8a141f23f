"""An audit's results as its page reads them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from bayescal.experiments.frame.results import Results
from bayescal.limits import DEAD, INFORMED
from bayescal.report.symbols import split_name

KNOWN_LIMITS = (math.sqrt(DEAD / (1.0 - DEAD)), math.sqrt(INFORMED / (1.0 - INFORMED)))
"""Tolerance over what the noise alone would leave of a combination: below, hardly anything is learnt; above, enough."""
SIMULATED = {
    "simulated_calibrations": "everything free within its tolerance",
    "simulated_calibrations_reduced": "the reduced set free, the rest off by its tolerances and taken for nominal",
}
"""What was free in the simulated calibrations of each key."""


@dataclass(frozen=True)
class Ridge:
    """A direction that the measurements determine not at all or too little."""

    number: int  # among the audit's directions, from 1
    kind: str  # ``structural`` or ``practical``
    contraction: float
    pivot: str  # the parameter it is named after
    sentence: str
    effect: str
    share: float  # of a limit, that 1.96 sd of what remains unknown takes; NaN without requirements
    limit: str  # of which requirement
    position: float  # what a round step does to a pose of the workspace, the design's units
    rotation: float
    posterior_contraction: float  # from draws; NaN without
    plot: dict[str, str]  # what the axes of its plot are; empty where there is none


@dataclass(frozen=True)
class Requirement:
    """How a requirement is met, the design's units, NaN of what is not known; see the audit's results."""

    name: str
    unit: str
    limit: float
    prior_sd: float
    predicted_sd: float
    geometry_sd: float
    prior_probability: float
    probability: float
    reduced_sd: float
    reduced_probability: float


@dataclass(frozen=True)
class Change:
    """What another plan determines: nats, contraction of practical ridges by pivot, sd of requirements; NaN if none."""

    name: str
    n_poses: int
    possible: bool
    beyond_range: bool
    nats: float
    n_identifiable: int
    ridges: dict[str, float]
    requirements: dict[str, float]


@dataclass(frozen=True, eq=False)
class AuditResults:
    """What an audit left: its summary, and the tables that are there and not empty."""

    summary: dict[str, Any]
    tables: dict[str, pd.DataFrame]

    @classmethod
    def of(cls, results: Results) -> AuditResults:
        """Return the view of an audit's results."""
        return cls(results.summary, {name: table for name, table in results.tables.items() if not table.empty})

    @property
    def best(self) -> str:
        """The variant that the details are of."""
        return str(self.summary.get("best", ""))

    @property
    def is_measured(self) -> bool:
        """Whether the poses are those of a study's data, no plan."""
        return "n_held_back" in self.summary["plan"]

    @property
    def member(self) -> str:
        """What one of many is called."""
        return str(self.summary.get("member", "leg"))

    @property
    def n_poses(self) -> int:
        """How many poses are planned or measured."""
        return int(self.summary["plan"]["n_poses"])

    @property
    def together(self) -> float:
        """Probability that all requirements are met; NaN where it is not known."""
        return _number(self.summary.get("variants", {}).get(self.best, {}).get("probability"))

    def of_best(self, name: str) -> pd.DataFrame:
        """Return the rows and columns of a table that the best variant has; none where there is no such table."""
        if name not in self.tables:
            return pd.DataFrame()
        table = self.tables[name]
        return table[table["variant"] == self.best].dropna(axis=1, how="all")

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row per parameter by name, with ``symbol`` and ``leg``, zero for the machine's own."""
        rows = []
        for name, values in self.summary["parameters"].items():
            symbol, leg = split_name(name)
            rows.append({"name": name, "symbol": symbol, "leg": leg, **values})
        return pd.DataFrame(rows).set_index("name")

    @property
    def n_identifiable(self) -> int:
        """How many parameters are determined."""
        return int((self.parameters["verdict"] == "identifiable").sum())

    @cached_property
    def symbols(self) -> list[str]:
        """Symbols in the order of the layout."""
        return list(dict.fromkeys(self.parameters["symbol"]))

    @cached_property
    def ridges(self) -> list[Ridge]:
        """The structural and practical directions in the audit's order."""
        return [
            Ridge(
                number,
                one["kind"],
                float(one["contraction"]),
                one["pivot"],
                one["sentence"],
                one["effect_on_pose"],
                _number(one.get("share_of_limit")),
                one.get("limit") or "",
                float(one["changes_workspace_position"]),
                float(one["changes_workspace_rotation"]),
                _number(one.get("posterior_contraction")),
                one.get("plot") or {},
            )
            for number, one in enumerate(self.summary["directions"], start=1)
            if one["kind"] != "informed"
        ]

    @cached_property
    def groups(self) -> list[list[Ridge]]:
        """Ridges of one kind that are named after the same symbol, one per leg, in the order of the first of each."""
        found: dict[tuple[str, str], list[Ridge]] = {}
        for ridge in self.ridges:
            found.setdefault((ridge.kind, split_name(ridge.pivot)[0]), []).append(ridge)
        return list(found.values())

    @cached_property
    def requirements(self) -> list[Requirement]:
        """In the design's order."""
        numbers = [name for name in Requirement.__dataclass_fields__ if name not in ("name", "unit")]
        return [
            Requirement(name, values["unit"], **{key: _number(values[key]) for key in numbers})
            for name, values in self.summary["requirements"].items()
        ]

    @cached_property
    def changes(self) -> list[Change]:
        """In the audit's order."""
        return [
            Change(
                one["name"],
                one["n_poses"],
                one["possible"],
                one["beyond_actuator_range"],
                _number(one.get("total_nats")),
                int(one.get("n_identifiable") or 0),
                *({name: _number(value) for name, value in one[key].items()} for key in ("ridges", "requirements")),
            )
            for one in self.summary["what_if"]
        ]


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
