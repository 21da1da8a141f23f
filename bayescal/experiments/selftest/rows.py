"""Tables of a self-test, each declared once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import PARAMETER, VARIANT
from bayescal.files.rows import TableRow, column


@dataclass(frozen=True, kw_only=True)
class SelftestCheckRow(TableRow, table="checks"):
    """What one check of a variant found."""

    variant: str = column(VARIANT)
    subject: str = column("what was checked")
    fault: str = column("kind of the fault, or empty")
    level: Literal["good", "warning", "bad"] = column("status of the finding")
    value: float = column("its figure, or empty")
    limit: float = column("what it is compared with, or empty")
    text: str = column("the finding")
    action: str = column("what to do, or empty")


@dataclass(frozen=True, kw_only=True)
class RecoveryRow(TableRow, table="parameters"):
    """How well a parameter is recovered from simulated data."""

    variant: str = column(VARIANT)
    simulated_from: Literal["prior", "posterior"] = column("distribution of the true parameters")
    parameter: str = column(PARAMETER)
    is_uniform: bool = column("whether the ranks of the truth are uniform")
    coverage_90: float = column("coverage of 90 % intervals")
    rms_z: float = column("error of estimates / posterior sd, rms")


@dataclass(frozen=True, kw_only=True)
class RankRow(TableRow, table="ranks"):
    """A simulated data set, with a column per parameter: the rank of the truth among draws, 0 to 1."""

    variant: str = column(VARIANT)
    data_set: str = column("distribution of the truth, data set")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RankBandRow(TableRow, table="bands"):
    """Limits of the distribution function of uniform ranks at a point."""

    variant: str = column(VARIANT)
    simulated_from: Literal["prior", "posterior"] = column("distribution of the true parameters")
    rank: float = column("rank, 0 to 1")
    low: float = column("lower limit of that fraction")
    high: float = column("upper limit of that fraction")


@dataclass(frozen=True, kw_only=True)
class DataSetTimeRow(TableRow, table="timings"):
    """The time of a simulated data set."""

    variant: str = column(VARIANT)
    data_set: str = column("distribution of the truth, data set")
    wall_seconds: float = column("wall time", "s")


ROWS: tuple[type[TableRow], ...] = (SelftestCheckRow, RecoveryRow, RankRow, RankBandRow, DataSetTimeRow)
"""Tables of a self-test."""
