"""An audit's results as its page needs them, checked as far as it leans on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayescal.errors import InputError
from bayescal.experiments.audit.page.checks import REQUIREMENT_NUMBERS, check_summary
from bayescal.experiments.frame.results import SUMMARY_FILE, Results
from bayescal.experiments.shared.joints import COLUMNS as JOINT_COLUMNS
from bayescal.limits import DEAD, INFORMED
from bayescal.report.symbols import split_name

TABLES = "tables"  # where they stand in the results directory
TABLE_COLUMNS = {
    "spectrum": ("number", "wide_workspace", "planned", "rounding", "counts"),
    "sweeps": ("sweep", "value", "beyond_actuator_range", "symbol", "contraction_least", "contraction_most"),
    "sweep_requirements": ("sweep", "value", "requirement", "unit", "predicted_sd", "limit"),
    "profiles": ("parameter", "unit", "value", "deviance_data", "deviance_total"),
    "profile_paths": ("parameter", "value", "other", "other_unit", "other_value"),
    "ridge_draws": ("direction", "source", "x", "y"),
    "ridge_curves": ("direction", "source", "x", "y"),
    "joints": JOINT_COLUMNS,
}
TEXT_COLUMNS = ("pose", "joint", "sweep", "symbol", "requirement", "unit", "parameter", "other", "other_unit", "source")
REQUIRED = ("spectrum",)
TOLD_LIMITS = (math.sqrt(DEAD / (1.0 - DEAD)), math.sqrt(INFORMED / (1.0 - INFORMED)))
"""Tolerance over what the noise alone would leave of a combination: below, hardly anything is learnt; above, enough."""


@dataclass(frozen=True)
class Ridge:
    """A direction of which the measurements tell nothing or too little.

    Attributes
    ----------
    number : int
        Among the audit's directions, from 1.
    kind : str
        ``structural`` or ``practical``.
    contraction : float
    pivot : str
        The parameter it is named after.
    sentence : str
    effect : str
        One of `EFFECTS`.
    share : float
        Of a limit, that 1.96 sd of what remains unknown takes; NaN without requirements.
    limit : str
        Of which requirement.
    position, rotation : float
        What a round step does to a pose of the workspace, the design's units.
    posterior_contraction : float
        From draws; NaN without.
    plot : dict
        What the axes of its plot are; empty where there is none.
    explanation : str
        Of its curve, in words.
    """

    number: int
    kind: str
    contraction: float
    pivot: str
    sentence: str
    effect: str
    share: float
    limit: str
    position: float
    rotation: float
    posterior_contraction: float
    plot: dict[str, str]
    explanation: str = ""


@dataclass(frozen=True)
class RidgeGroup:
    """Ridges of one kind that are named after the same symbol, one per leg."""

    kind: str
    symbol: str
    ridges: tuple[Ridge, ...]


@dataclass(frozen=True)
class Requirement:
    """How a requirement stands, the design's units; see the audit's results."""

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
    """What another plan would tell.

    Attributes
    ----------
    name : str
    n_poses : int
    possible, beyond_range : bool
    nats : float
        NaN where the plan is impossible.
    n_identifiable : int
    ridges : dict of str to float
        Contraction of each practical ridge by its pivot, NaN where the plan is impossible.
    requirements : dict of str to float
        Predicted standard deviations.
    """

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
    """What an audit left, as the report needs it.

    Attributes
    ----------
    summary : dict
    tables : dict of str to DataFrame
        Those that are there and not empty.
    """

    summary: dict[str, Any]
    tables: dict[str, pd.DataFrame]

    @property
    def best(self) -> str:
        """The variant that the details are of."""
        return str(self.summary.get("best", ""))

    @property
    def is_of_legs(self) -> bool:
        """Whether instruments see the platform of a mechanism on legs."""
        return "model" in self.summary

    @property
    def member(self) -> str:
        """What one of many is called."""
        return str(self.summary.get("member", "leg"))

    @property
    def together(self) -> float:
        """Probability that all requirements are kept; NaN where it is not known."""
        return _number(self.summary.get("variants", {}).get(self.best, {}).get("probability"))

    @classmethod
    def of(cls, results: Results) -> AuditResults:
        """Return the view of an audit's results, checked.

        Raises
        ------
        InputError
            Naming the file where something is missing or not what an audit writes. Tables other than the spectrum may
            be missing.
        """
        folder = results.folder or Path()
        check_summary(results.summary, folder / SUMMARY_FILE)
        tables = {name: results.table(name) for name in TABLE_COLUMNS}
        there = {name: table for name, table in tables.items() if name in REQUIRED or not table.empty}
        for name, table in there.items():
            _check_table(table, folder / TABLES / f"{name}.csv")
        others = {name: table for name, table in results.tables.items() if name not in TABLE_COLUMNS}
        return cls(results.summary, {**others, **there})

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row per parameter by name, with ``symbol`` and ``leg``, zero for the machine's own."""
        rows = []
        for name, values in self.summary["parameters"].items():
            symbol, leg = split_name(name)
            rows.append({"name": name, "symbol": symbol, "leg": leg, **values})
        return pd.DataFrame(rows).set_index("name")

    @cached_property
    def symbols(self) -> list[str]:
        """Symbols in the order of the layout."""
        return list(dict.fromkeys(self.parameters["symbol"]))

    @cached_property
    def ridges(self) -> list[Ridge]:
        """The structural and practical directions in the audit's order."""
        numbered = enumerate(self.summary["directions"], start=1)
        return [_make_ridge(k, content) for k, content in numbered if content["kind"] != "informed"]

    @cached_property
    def groups(self) -> list[RidgeGroup]:
        """Ridges of the same kind on all legs together, in the order of the first of each."""
        found: dict[tuple[str, str], list[Ridge]] = {}
        for ridge in self.ridges:
            found.setdefault((ridge.kind, split_name(ridge.pivot)[0]), []).append(ridge)
        return [RidgeGroup(kind, symbol, tuple(ridges)) for (kind, symbol), ridges in found.items()]

    @cached_property
    def requirements(self) -> list[Requirement]:
        """In the design's order."""
        items = self.summary["requirements"].items()
        return [
            Requirement(name, values["unit"], **{key: _number(values[key]) for key in REQUIREMENT_NUMBERS})
            for name, values in items
        ]

    @cached_property
    def changes(self) -> list[Change]:
        """In the audit's order."""
        return [_make_change(content) for content in self.summary["what_if"]]

    @property
    def n_poses(self) -> int:
        """How many poses are planned or measured."""
        return int(self.summary["plan"]["n_poses"])

    @property
    def is_measured(self) -> bool:
        """Whether the poses are those of a study's data, no plan."""
        return not self.summary["plan"]["sensors"]

    @property
    def n_identifiable(self) -> int:
        """How many parameters are determined."""
        return int((self.parameters["verdict"] == "identifiable").sum())

    def count_hidden(self) -> tuple[int, int]:
        """Return how many independent combinations are learnt in part, and how many hardly or never."""
        planned = self.tables["spectrum"]["planned"].to_numpy(dtype=float)
        low, high = TOLD_LIMITS
        return int(np.sum((planned >= low) & (planned < high))), int(np.sum(planned < low))


def _make_ridge(number: int, content: Mapping[str, Any]) -> Ridge:
    return Ridge(
        number,
        content["kind"],
        float(content["contraction"]),
        content["pivot"],
        content["sentence"],
        content["effect_on_pose"],
        _number(content.get("share_of_limit")),
        content.get("limit") or "",
        float(content["changes_workspace_position"]),
        float(content["changes_workspace_rotation"]),
        _number(content.get("posterior_contraction")),
        content.get("plot") or {},
        _text(content.get("explanation")),
    )


def _make_change(content: Mapping[str, Any]) -> Change:
    return Change(
        content["name"],
        content["n_poses"],
        content["possible"],
        content["beyond_actuator_range"],
        _number(content.get("total_nats")),
        int(content.get("n_identifiable") or 0),
        {name: _number(value) for name, value in content["ridges"].items()},
        {name: _number(value) for name, value in content["requirements"].items()},
    )


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _check_table(table: pd.DataFrame, path: Path) -> None:
    columns = TABLE_COLUMNS[path.stem]
    if table.empty:
        raise InputError(f"{path}: found no rows, expected an audit's table")
    missing = [column for column in columns if column not in table.columns]
    if missing:
        raise InputError(f"{path}: found no column {missing[0]!r}, expected {', '.join(columns)}")
    for column in (c for c in columns if c not in TEXT_COLUMNS):
        if not (pd.api.types.is_numeric_dtype(table[column]) or pd.api.types.is_bool_dtype(table[column])):
            raise InputError(f"{path}: column {column!r}: found text, expected numbers")
