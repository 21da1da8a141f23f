"""Rows of the tables that studies and audits share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.files.rows import TableRow, column

SYSTEMATIC_TOTAL = "systematic_total"
"""All functions of a model error together, as its tables call them."""
CHANGE_UNIT = "unit of the change; absent: µm"
CHANNEL = "name of the channel"
COMBINATION_TEXT = "what changes together, with its effect on readings"
CRITERION = "criterion that is maximised"
EFFICIENCY = "effective fraction of importance draws"
ERROR_UNIT = "um at the tool, or noise"
INTERVAL_REDUCTION = "1 - posterior / prior width of the 90 % interval"
LEG = "number of the leg"
N_POSES = "number of poses"
PARAMETER = "name of the parameter"
PARAMETER_UNIT = "unit of the parameter"
POSE_NAME = "name of the pose"
POSTERIOR_SD = "posterior standard deviation"
PREDICTED_Q05 = "predicted 5 % quantile"
PREDICTED_Q95 = "predicted 95 % quantile"
PRIOR_SD = "prior standard deviation"
P_ALL_MET = "probability to meet all requirements"
P_MOVED = "probability of a change beyond the limit"
Q05 = "5 % quantile"
Q95 = "95 % quantile"
REQUIREMENT = "name of the requirement"
SD_OVER_REPEATS = "its sd over repeats"
SELECTION = "label of the selection"
STANDARD_ERROR = "its standard error"
VARIANT = "name of the variant"
"""What columns of several tables mean."""
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
    coordinate: str = column("coordinate of tool or machine", show="text", title="Tool")
    unit: str = column("of the standard uncertainties", show="unit")
    prior_sd: float = column("before calibration, workspace rms", show="amount", title="before", group=RMS)
    posterior_sd: float = column("after calibration, workspace rms", show="amount", title="after", group=RMS)
    noise: float = column("by noise of one set, workspace rms", show="amount", title="noise", group=RMS)
    max_sd: float = column("after calibration, workspace maximum", show="amount", title="largest after")
    max_sd_pose: str = column("where that is", show="text", title="at")
    frame: Literal["aligned", "base"] = column("aligned: frames fitted; base: base frame")
    unaligned_sd: float = column("posterior_sd without alignment", show="amount", title="rms after", group="unaligned")
    max_unaligned_sd: float = column(
        "max_sd without alignment", show="amount", title="largest after", group="unaligned"
    )


@dataclass(frozen=True, kw_only=True)
class CombinationRow(TableRow, table="ridges"):
    """A combination of parameters that the measurements determine too little."""

    variant: str = column(VARIANT)
    parameter: str = column("largest part of the combination")
    contraction: float = column("contraction of the combination")
    text: str = column(COMBINATION_TEXT)


@dataclass(frozen=True, kw_only=True)
class CandidatePoseRow(TableRow, table="next"):
    """A candidate pose to be measured next; its coordinates follow, a column each."""

    variant: str = column(VARIANT)
    sensors: Literal["own", "all"] = column("own sensors alone, or all")
    variance_reduction: float = column("tool error variance removed by one set")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class JointRow(TableRow, table="joints"):
    """A joint of the nominal machine at a pose, base frame."""

    pose: str = column("name of the pose, or home")
    leg: int = column(LEG)
    joint: Literal["base", "platform", "from", "to"] = column("joint, or end of a guide")
    x_mm: float = column("base frame", "mm")
    y_mm: float = column("base frame", "mm")
    z_mm: float = column("base frame", "mm")


# --- the model error -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ModelErrorRow(TableRow, table="model_error"):
    """The size of a term of the model error: root mean square over calibration rows and own channels."""

    variant: str = column(VARIANT)
    term: Term = column("term of [model_error], or systematic_total")
    unit: str = column("um at the tool, or multiples of noise")
    median: float = column("of the posterior")
    q05: float = column(Q05)
    q95: float = column(Q95)
    tail: float = column("sd of the amplitude / its 90 % interval's; large: heavy tail")


@dataclass(frozen=True, kw_only=True)
class ModelErrorMemberRow(TableRow, table="model_error_members"):
    """The size of a term of the model error in one channel."""

    variant: str = column(VARIANT)
    member: str = column(CHANNEL)
    term: Term = column("term of [model_error]")
    unit: str = column(ERROR_UNIT)
    rms: float = column("posterior mean, calibration rows")


@dataclass(frozen=True, kw_only=True)
class ModelErrorPoseRow(TableRow, table="model_error_poses"):
    """All systematic terms of the model error together, of a channel at a pose."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    use: Use = column(USE)
    member: str = column(CHANNEL)
    unit: str = column(ERROR_UNIT)
    mean: float = column("posterior mean")
    low: float = column(Q05)
    high: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class ModelErrorAloneRow(TableRow, table="model_error_alone"):
    """How well one term of the model error alone explains the readings."""

    variant: str = column(VARIANT)
    term: str = column("the only term; none: no systematic error")
    log_bayes_factor: float = column("against all terms together", "nat")
    unit: str = column(ERROR_UNIT)
    median: float = column("size of the term alone")
    q05: float = column(Q05)
    q95: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class UnmodelledBiasRow(TableRow, table="model_error_bias"):
    """By how much errors that leave no trace in the readings bias a parameter."""

    variant: str = column(VARIANT)
    parameter: str = column(PARAMETER)
    unit: str = column("of bias and standard deviation")
    bias_rms: float = column("rms bias by errors of that size")
    sd: float = column(POSTERIOR_SD)


# --- errors that are functions ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ErrorFunctionRow(TableRow, table="functions"):
    """A systematic error of a sensor, of [error_terms]."""

    variant: str = column(VARIANT)
    sensor: str = column(CHANNEL)
    input: str = column("what the error depends on")
    unit: str = column("of its sizes")
    kernel: str = column("covariance function")
    probability_present: float = column("posterior probability of the error")
    scale_stated: float = column("prior median of its scale")
    scale: float = column("posterior median of its scale, if present")
    log_scale_sd_ratio: float = column("posterior / prior sd of log scale")
    rms: float = column("mean rms over calibration rows")
    rms_low: float = column(Q05)
    rms_high: float = column(Q95)


@dataclass(frozen=True, kw_only=True)
class ErrorCurveRow(TableRow, table="function_curves"):
    """A point of a systematic error's course over a single input."""

    variant: str = column(VARIANT)
    sensor: str = column(CHANNEL)
    input: str = column("what the error depends on")
    unit: str = column("of the error")
    reading: float = column("value of the input")
    mean: float = column("posterior mean")
    low: float = column(Q05)
    high: float = column(Q95)


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
