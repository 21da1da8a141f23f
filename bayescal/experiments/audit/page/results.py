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
from bayescal.experiments.frame.results import NUMBER, SUMMARY_FILE, Results, check_keys
from bayescal.experiments.shared.joints import COLUMNS as JOINT_COLUMNS
from bayescal.limits import DEAD, INFORMED
from bayescal.report.symbols import split_name

# --- what the files must hold ----------------------------------------------------------------------------------------

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
KNOWN_LIMITS = (math.sqrt(DEAD / (1.0 - DEAD)), math.sqrt(INFORMED / (1.0 - INFORMED)))
"""Tolerance over what the noise alone would leave of a combination: below, hardly anything is learnt; above, enough."""

DEVIATIONS = ("prior_sd", "predicted_sd", "geometry_sd", "reduced_sd")
REQUIREMENT_NUMBERS = ("limit", *DEVIATIONS, "prior_probability", "probability", "reduced_probability")
ANY_NUMBER = (*NUMBER, type(None))
"""A number that is not known where the machine's own sensors do not determine it."""
SIMULATED = {
    "simulated_calibrations": "everything free within its tolerance",
    "simulated_calibrations_reduced": "the reduced set free, the rest off by its tolerances and taken for nominal",
}
"""What was free in the simulated calibrations of each key."""


@dataclass(frozen=True)
class _Each:
    """What every entry of a list or an object has to be."""

    entry: Any


def _numbers(*names: str) -> dict[str, Any]:
    return dict.fromkeys(names, NUMBER)


def _texts(*names: str) -> dict[str, Any]:
    return dict.fromkeys(names, str)


# the kind of a value, words to choose from, or the keys of an object, optional ones with a question mark
SUMMARY: dict[str, Any] = {
    **_texts("name", "title", "machine"),
    **_texts("model?", "deformation?"),
    **dict.fromkeys(("n_parameters", "structural_rank", "n_structural", "n_practical", "n_informed"), int),
    **dict.fromkeys(("recommended_free", "could_also_be_freed", "directions"), list),
    "structural_rank_is_clear": bool,
    "total_nats": NUMBER,
    "units": _texts("length", "angle"),
    "plan": {"n_poses": int, "sensors": list, "poses": str, "n_held_back?": int},
    "far_readings?": {"channels": list, **_numbers("reading_mm", "moved_mm")},
    "parameters": _Each(
        {
            **_texts("unit", "why"),
            **_numbers("nominal", "prior_sd", "posterior_sd", "contraction", "nats"),
            "verdict": ("identifiable", "weak", "not"),
            "in_reduced_set": bool,
        }
    ),
    "requirements": _Each(
        {"unit": str, **_numbers(*REQUIREMENT_NUMBERS)} | dict.fromkeys(DEVIATIONS, ANY_NUMBER),
    ),
    "selection": _Each({"symbol": str, **_numbers("nats", "contraction"), "taken": bool}),
    "what_if": _Each(
        {
            "name": str,
            "n_poses": int,
            **dict.fromkeys(("possible", "beyond_actuator_range"), bool),
            **dict.fromkeys(("ridges", "requirements"), dict),
        }
    ),
    "reduced_set?": {"free": list, **_numbers("coverage_90", "rms_z")},
    "posterior?": {
        "origin": str,
        "n_draws": int,
        "converged": bool,
        "parameters": _Each(_numbers("mean", "sd")),
    },
}
DIRECTION = {
    "kind": ("structural", "practical", "informed"),
    **_numbers("contraction", "nats"),
    "shares": dict,
    "sentence": str,
}
RIDGE = {
    "pivot": str,
    "effect_on_pose": ("harmless", "noticeable", "harmful", "unknown"),
    **_numbers("changes_workspace_position", "changes_workspace_rotation"),
    "plot?": _texts("x", "y", "x_unit", "y_unit", "formula"),
}
CALIBRATIONS = {
    **dict.fromkeys(("n", "n_converged"), int),
    **_numbers("coverage_90", "rms_z"),
    "symbols": _Each(
        {"unit": str, **_numbers("claimed_sd", "predicted_sd", "simulated_sd", "ratio", "ratio_se", "coverage_90")}
    ),
    "requirements": _Each(
        {
            **dict.fromkeys(("kept", "n", "expected_low", "expected_high"), int),
            "claimed_probability": NUMBER,
            "agrees": bool,
        }
    ),
}


def check_summary(summary: dict[str, Any], path: Path) -> None:
    """Raise InputError where an audit's summary lacks something or holds something else."""
    _check(summary, SUMMARY | dict.fromkeys((f"{name}?" for name in SIMULATED), CALIBRATIONS), path, "")
    known = summary["parameters"]
    if not known:
        raise InputError(f"{path}: parameters: found none, expected some")
    for k, content in enumerate(summary["directions"], start=1):
        _check(content, DIRECTION, path, where := f"directions {k}")
        if content["kind"] != "informed":
            _check(content, RIDGE, path, where)
            _check(content["pivot"], tuple(known), path, f"{where}.pivot")
    for name, content in summary["requirements"].items():
        if content["limit"] <= 0.0:
            raise InputError(f"{path}: requirements.{name}.limit: found {content['limit']}, expected a positive number")
    for k, change in enumerate(summary["what_if"], start=1):
        if change["possible"]:
            required = {k: ANY_NUMBER if k in change["requirements"] else NUMBER for k in summary["requirements"]}
            wanted = {"total_nats": NUMBER, "n_identifiable": int, "ridges": _Each(NUMBER), "requirements": required}
            _check(change, wanted, path, f"what_if {k}")
    for where, names in (
        ("recommended_free", summary["recommended_free"] + summary["could_also_be_freed"]),
        ("reduced_set.free", (summary.get("reduced_set") or {"free": ()})["free"]),
        ("posterior.parameters", (summary.get("posterior") or {"parameters": ()})["parameters"]),
    ):
        for name in names:
            if name not in known:
                raise InputError(f"{path}: {where}: found {name!r}, expected parameters")


def _check(content: Any, wanted: Any, path: Path, where: str) -> None:
    """Raise InputError where content read from JSON is not what is wanted of it."""
    if isinstance(wanted, _Each):
        numbered = isinstance(content, list)
        entries = enumerate(content, start=1) if numbered else _open(content, path, where).items()
        for key, entry in entries:
            _check(entry, wanted.entry, path, f"{where} {key}" if numbered else f"{where}.{key}")
    elif isinstance(wanted, Mapping):
        fields = _open(content, path, where)
        for key, one in wanted.items():
            name = key.removesuffix("?")
            if name == key or fields.get(name) is not None:
                _check(fields.get(name), one, path, f"{where}.{name}".removeprefix("."))
    elif isinstance(wanted, tuple) and isinstance(wanted[0], str):
        if content not in wanted:
            shown = ", ".join(wanted[:6]) + (", ..." if len(wanted) > 6 else "")
            raise InputError(f"{path}: {where}: found {content!r}, expected one of {shown}")
    else:
        check_keys({where: content}, {where: wanted}, path, "")


def _open(content: Any, path: Path, where: str) -> dict[str, Any]:
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        raise InputError(f"{path}: {where}: found {found}, expected an object")
    return content


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


# --- what the page reads ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ridge:
    """A direction that the measurements determine not at all or too little.

    Attributes
    ----------
    number : int
        Among the audit's directions, from 1.
    kind : str
        ``structural`` or ``practical``.
    contraction : float
    pivot : str
        The parameter it is named after.
    sentence, effect : str
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


@dataclass(frozen=True)
class Requirement:
    """How a requirement is met, the design's units; see the audit's results."""

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
    """What an audit left, as the report needs it.

    Attributes
    ----------
    summary : dict
    tables : dict of str to DataFrame
        Those that are there and not empty.
    """

    summary: dict[str, Any]
    tables: dict[str, pd.DataFrame]

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
        items = self.summary["requirements"].items()
        return [
            Requirement(name, values["unit"], **{key: _number(values[key]) for key in REQUIREMENT_NUMBERS})
            for name, values in items
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

    def count_hidden(self) -> tuple[int, int]:
        """Return how many independent combinations are learnt in part, and how many hardly or never."""
        planned = self.tables["spectrum"]["planned"].to_numpy(dtype=float)
        low, high = KNOWN_LIMITS
        return int(np.sum((planned >= low) & (planned < high))), int(np.sum(planned < low))


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
