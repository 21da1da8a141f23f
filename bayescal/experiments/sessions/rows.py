"""Tables of sessions, each declared once."""

from __future__ import annotations

from dataclasses import dataclass

from bayescal.experiments.shared.rows import (
    CHANGE_UNIT,
    CHANNEL,
    INTERVAL_REDUCTION,
    LEG,
    P_MOVED,
    PARAMETER,
    POSTERIOR_SD,
    PRIOR_SD,
    Q05,
    Q95,
)
from bayescal.files.rows import TableRow, column


@dataclass(frozen=True, kw_only=True)
class SessionRow(TableRow, table="sessions"):
    """A session, or a machine of a population."""

    session: str = column("label of the session", show="name")
    time_days: float = column("time of the session, or NaN", "d", show="plain", title="Time")
    n_poses: int = column("poses measured", show="count", title="Poses")
    temperature_celsius: float = column("temperature, or NaN", "°C", show="fixed 1", title="Temperature")


@dataclass(frozen=True, kw_only=True)
class DriftScaleRow(TableRow, table="scales"):
    """A prior scale of the drift."""

    parameter_group: str = column("parameter or symbol with this scale")
    unit: str | None = column("unit of the scale; absent: µm", default=None)
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)
    log_bayes_factor_moved: float = column("log Bayes factor of motion, others free", "nat")


@dataclass(frozen=True, kw_only=True)
class SessionShiftRow(TableRow, table="shifts"):
    """A parameter's change between two sessions."""

    since: str = column("earlier session, or mean")
    session: str = column("later session, or machine")
    parameter: str = column(PARAMETER)
    unit: str | None = column(CHANGE_UNIT, default=None)
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)
    p_exceeds_limit: float = column(P_MOVED)
    interval_reduction: float = column(INTERVAL_REDUCTION)


@dataclass(frozen=True, kw_only=True)
class LegMotionRow(TableRow, table="legs"):
    """A leg's motion between two sessions, as a change of its length at home."""

    since: str = column("earlier session, or mean")
    session: str = column("later session, or machine")
    leg: int = column(LEG)
    unit: str | None = column(CHANGE_UNIT, default=None)
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)
    p_exceeds_limit: float = column(P_MOVED)
    interval_reduction: float = column(INTERVAL_REDUCTION)

    @property
    def moved(self) -> str:
        """Number of the leg."""
        return str(self.leg)


@dataclass(frozen=True, kw_only=True)
class ChannelMotionRow(TableRow, table="channels"):
    """A channel's change between two sessions at home."""

    since: str = column("earlier session, or mean")
    session: str = column("later session, or machine")
    channel: str = column(CHANNEL)
    unit: str | None = column(CHANGE_UNIT, default=None)
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)
    p_exceeds_limit: float = column(P_MOVED)
    interval_reduction: float = column(INTERVAL_REDUCTION)

    @property
    def moved(self) -> str:
        """Name of the channel."""
        return self.channel


@dataclass(frozen=True, kw_only=True)
class SessionParameterRow(TableRow, table="parameters"):
    """A parameter in a session."""

    session: str = column("label of the session")
    parameter: str = column(PARAMETER)
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    prior_sd: float = column(PRIOR_SD)


@dataclass(frozen=True, kw_only=True)
class ExpansionRow(TableRow, table="expansion"):
    """A body's coefficient of thermal expansion."""

    body: str = column("name of the body", show="text")
    prior_mean: float = column("prior mean", "ppm/K", show="± prior_sd", title="prior")
    prior_sd: float = column(PRIOR_SD, "ppm/K")
    mean: float = column("posterior mean", "ppm/K", show="± sd", title="posterior")
    sd: float = column(POSTERIOR_SD, "ppm/K")
    q05: float = column(Q05, "ppm/K")
    q95: float = column(Q95, "ppm/K")


@dataclass(frozen=True, kw_only=True)
class SessionErrorRow(TableRow, table="model_error"):
    """A size of model errors, common to all sessions."""

    error: str = column("name of the size")
    unit: str = column("unit of the size")
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class DriftModelRow(TableRow, table="models"):
    """A model of what may move, and the checks of its evidence."""

    model: str = column("drift, none, or the part held still", show="name")
    log_evidence: float = column("log-evidence", "nat", show="± se", title="Log-evidence")
    se: float = column("standard error of the log-evidence", "nat")
    efficiency: float = column("effective fraction, scales", show="percent", title="efficiency", group="Scales")
    pareto_k: float = column("Pareto k, scales", show="fixed 2", title="k", group="Scales")
    exact_efficiency: float = column(
        "effective fraction, exact density",
        show="percent",
        title="efficiency",
        group="Exact density",
    )
    exact_pareto_k: float = column("Pareto k, exact density", show="fixed 2", title="k", group="Exact density")


type MotionRow = LegMotionRow | ChannelMotionRow
"""What moved between two sessions."""

ROWS: tuple[type[TableRow], ...] = (
    *(SessionRow, DriftScaleRow, SessionShiftRow, LegMotionRow, ChannelMotionRow),
    *(SessionParameterRow, ExpansionRow, SessionErrorRow, DriftModelRow),
)
"""Tables of sessions."""
