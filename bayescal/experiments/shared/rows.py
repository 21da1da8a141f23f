"""Rows of the tables that studies and audits share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.files.rows import TableRow, column

SYSTEMATIC_TOTAL = "systematic_total"
"""All functions of a model error together, as its tables call them."""
VARIANT = "name of the variant"
RMS = "rms over the workspace"
USE = "calibration or verification"
USES = ("calibration", "verification")
"""What poses are for: to calibrate by, or held back."""

type Use = Literal["calibration", "verification"]
type Term = Literal["random", "linear", "positioning", "smooth", "drift", "systematic_total"]


@dataclass(frozen=True, kw_only=True)
class ToolUncertaintyRow(TableRow, table="accuracy"):
    """The standard uncertainty of a coordinate of the tool over the workspace, located by the machine's own sensors."""

    variant: str = column(VARIANT, show="text")
    coordinate: str = column("coordinate of the tool, or of the machine without one", show="text", title="Tool")
    unit: str = column("of the standard uncertainties", show="unit")
    prior_sd: float = column(
        "before calibration, by the tolerances, rms over the workspace", show="amount", title="before", group=RMS
    )
    posterior_sd: float = column("after calibration, rms over the workspace", show="amount", title="after", group=RMS)
    noise: float = column(
        "by the noise of one set of readings, rms over the workspace", show="amount", title="noise", group=RMS
    )
    max_sd: float = column("after calibration, the largest of the workspace", show="amount", title="largest after")
    max_sd_pose: str = column("where that is", show="text", title="at")
    frame: Literal["aligned", "base"] = column("aligned: base and tool frames fitted; base: stated in the base frame")
    unaligned_sd: float = column("posterior_sd without alignment", show="amount", title="rms after", group="unaligned")
    max_unaligned_sd: float = column(
        "max_sd without alignment", show="amount", title="largest after", group="unaligned"
    )


@dataclass(frozen=True, kw_only=True)
class CombinationRow(TableRow, table="ridges"):
    """A combination of parameters that the measurements determine too little."""

    variant: str = column(VARIANT)
    parameter: str = column("the largest part of the combination")
    contraction: float = column("1 − (posterior sd / prior sd)² of the combination")
    text: str = column("what changes together, and what that does to the readings")


@dataclass(frozen=True, kw_only=True)
class CandidatePoseRow(TableRow, table="next"):
    """A candidate pose to be measured next; its coordinates follow, a column each."""

    variant: str = column(VARIANT)
    sensors: Literal["own", "all"] = column("whether the machine's own sensors are read there, or all")
    variance_reduction: float = column("part of the tool's mean squared error that one set of readings removes")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class JointRow(TableRow, table="joints"):
    """A joint of the nominal machine at a pose, base frame."""

    pose: str = column("name of the pose; home: all actuators at their initial positions")
    leg: int = column("number of the leg, from 1")
    joint: Literal["base", "platform", "from", "to"] = column("which joint, or which end of a guide")
    x_mm: float = column("base frame", "mm")
    y_mm: float = column("base frame", "mm")
    z_mm: float = column("base frame", "mm")


# --- the model error -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ModelErrorRow(TableRow, table="model_error"):
    """The size of a term of the model error: root mean square over calibration rows and own channels."""

    variant: str = column(VARIANT)
    term: Term = column("term of [model_error]; systematic_total: all but random")
    unit: str = column("um at the tool, or noise: multiples of the channels' noise")
    median: float = column("of the posterior")
    q05: float = column("5 % quantile")
    q95: float = column("95 % quantile")
    tail: float = column("standard deviation of the amplitude over that of its 90 % interval; large: a heavy tail")


@dataclass(frozen=True, kw_only=True)
class ModelErrorMemberRow(TableRow, table="model_error_members"):
    """The size of a term of the model error in one channel."""

    variant: str = column(VARIANT)
    member: str = column("name of the channel")
    term: Term = column("term of [model_error]")
    unit: str = column("um at the tool, or noise")
    rms: float = column("of the posterior mean over the calibration rows")


@dataclass(frozen=True, kw_only=True)
class ModelErrorPoseRow(TableRow, table="model_error_poses"):
    """All systematic terms of the model error together, of a channel at a pose."""

    variant: str = column(VARIANT)
    pose: str = column("name of the pose")
    use: Use = column(USE)
    member: str = column("name of the channel")
    unit: str = column("um at the tool, or noise")
    mean: float = column("posterior mean")
    low: float = column("5 % quantile")
    high: float = column("95 % quantile")


@dataclass(frozen=True, kw_only=True)
class ModelErrorAloneRow(TableRow, table="model_error_alone"):
    """How well one term of the model error alone explains the readings."""

    variant: str = column(VARIANT)
    term: str = column("the only term; none: no systematic error at all")
    log_bayes_factor: float = column("against all terms together", "nat")
    unit: str = column("um at the tool, or noise")
    median: float = column("size of the term alone")
    q05: float = column("5 % quantile")
    q95: float = column("95 % quantile")


@dataclass(frozen=True, kw_only=True)
class UnmodelledBiasRow(TableRow, table="model_error_bias"):
    """By how much errors that leave no trace in the readings bias a parameter."""

    variant: str = column(VARIANT)
    parameter: str = column("name of the parameter")
    unit: str = column("of bias and standard deviation")
    bias_rms: float = column("root mean square bias by errors of the stated size")
    sd: float = column("posterior standard deviation")


# --- errors that are functions ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ErrorFunctionRow(TableRow, table="functions"):
    """A systematic error of a sensor, of [error_terms]."""

    variant: str = column(VARIANT)
    sensor: str = column("name of the channel")
    input: str = column("what the error depends on")
    unit: str = column("of its sizes")
    kernel: str = column("covariance function")
    probability_present: float = column("posterior probability that there is such an error")
    scale_stated: float = column("prior median of its scale")
    scale: float = column("posterior median of its scale, where it is there")
    log_scale_sd_ratio: float = column("posterior over prior sd of the scale's logarithm")
    rms: float = column("mean of its root mean square over the calibration rows")
    rms_low: float = column("5 % quantile")
    rms_high: float = column("95 % quantile")


@dataclass(frozen=True, kw_only=True)
class ErrorCurveRow(TableRow, table="function_curves"):
    """A point of a systematic error's course over a single input."""

    variant: str = column(VARIANT)
    sensor: str = column("name of the channel")
    input: str = column("what the error depends on")
    unit: str = column("of the error")
    reading: float = column("value of the input")
    mean: float = column("posterior mean")
    low: float = column("5 % quantile")
    high: float = column("95 % quantile")


ERROR_ROWS = (
    ModelErrorRow,
    ModelErrorMemberRow,
    ModelErrorPoseRow,
    ModelErrorAloneRow,
    UnmodelledBiasRow,
    ErrorFunctionRow,
    ErrorCurveRow,
)
KNOWLEDGE_ROWS = (ToolUncertaintyRow, CombinationRow, CandidatePoseRow)
