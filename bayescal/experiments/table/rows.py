"""Tables of a look-up table, each declared once; lengths in mm, angles in rad, places in the units of their columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayescal.experiments.shared.rows import POSTERIOR_SD, Q05, Q95
from bayescal.files.rows import TableRow, column


@dataclass(frozen=True, kw_only=True)
class LookupRow(TableRow, table="lookup"):
    """A place of the table: a column per axis, and a column per actuator with its correction."""

    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class CorrectionRow(TableRow, table="corrections"):
    """An actuator's correction at a place, with a column per axis."""

    others: Mapping[str, float] = field(default_factory=dict)
    actuator: str = column("name of the actuator")
    unit: str = column("unit of the correction")
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class OffsetRow(TableRow, table="offsets"):
    """A coordinate's uncorrected offset at a place, with a column per axis."""

    others: Mapping[str, float] = field(default_factory=dict)
    coordinate: str = column("name of the coordinate")
    unit: str = column("unit of the offset")
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class CorrectionCovarianceRow(TableRow, table="correction_covariance"):
    """The covariance of two actuators' corrections at a place, with a column per axis."""

    others: Mapping[str, float] = field(default_factory=dict)
    first: str = column("name of the first actuator")
    second: str = column("name of the second actuator")
    covariance: float = column("posterior covariance")


@dataclass(frozen=True, kw_only=True)
class OffsetCovarianceRow(TableRow, table="offset_covariance"):
    """The covariance of two coordinates' offsets at a place, with a column per axis."""

    others: Mapping[str, float] = field(default_factory=dict)
    first: str = column("name of the first coordinate")
    second: str = column("name of the second coordinate")
    covariance: float = column("posterior covariance")


@dataclass(frozen=True, kw_only=True)
class PolynomialTermRow(TableRow, table="polynomial"):
    """A term of the polynomial fit of an actuator's correction."""

    term: str = column("formula of the term, zero at the reference")
    actuator: str = column("name of the actuator")
    unit: str = column("unit of the coefficient")
    coefficient: float = column("posterior mean of the coefficient")
    sd: float = column("posterior sd of the coefficient")


@dataclass(frozen=True, kw_only=True)
class PlanRow(TableRow, table="plan"):
    """A measurement to make, with columns of its place and coordinates; errors are those of a correction after it."""

    order: int = column("place in the order of measurement")
    others: Mapping[str, float] = field(default_factory=dict)
    sd: float = column("rms sd over places and actuators")
    max_sd: float = column("largest sd over places and actuators")
    random_sd: float = column("rms sd after as many random measurements")


ROWS: tuple[type[TableRow], ...] = (
    *(LookupRow, CorrectionRow, OffsetRow, CorrectionCovarianceRow, OffsetCovarianceRow, PolynomialTermRow, PlanRow),
)
"""Tables of a look-up table."""
