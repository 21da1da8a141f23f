"""Tables of an audit, each declared once: `parameters.csv` and the others, in the units of the design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import (
    COMBINATION_TEXT,
    N_POSES,
    P_ALL_MET,
    PARAMETER,
    PARAMETER_UNIT,
    POSE_NAME,
    PRIOR_SD,
    REQUIREMENT,
    VARIANT,
    CandidatePoseRow,
    JointRow,
    ToolUncertaintyRow,
    UnmodelledBiasRow,
)
from bayescal.files.rows import TableRow, column
from bayescal.report.symbols import split_name

PARAMETER_ERROR, RANDOM_ERROR, ERROR, NOISE = "parameter_error_", "random_error_", "error_", "noise_"
"""Starts of the columns whose names end with a coordinate of the tool and its unit, such as `x_mm`."""
PREDICTED_SD = "sd_"
"""Before the name of a requirement in columns of the alternatives."""
AXES = ("x", "y", "x_unit", "y_unit", "formula")
"""What is said of a combination's plot."""


@dataclass(frozen=True, kw_only=True)
class AuditVariantRow(TableRow, table="variants"):
    """A variant of an audit: what it measures and what this determines."""

    variant: str = column(VARIANT)
    title: str = column("title of the variant")
    data_set: str = column("readings that are taken in")
    n_equations: int = column("readings less coordinates")
    n_parameters: int = column("free parameters")
    n_poses: int = column("planned poses")
    n_identifiable: int = column("identifiable parameters")
    error_ratio: float = column("rms tool error by parameters, posterior / prior")
    sd_over_limit: float = column("largest predicted sd / limit, or NaN")
    probability: float = column("probability to meet all requirements, or NaN")


@dataclass(frozen=True, kw_only=True)
class AuditParameterRow(TableRow, table="parameters"):
    """A parameter of a variant, prior and predicted posterior."""

    variant: str = column(VARIANT)
    parameter: str = column(PARAMETER)
    unit: str = column(PARAMETER_UNIT)
    nominal: float = column("nominal value")
    prior_sd: float = column(PRIOR_SD)
    posterior_sd: float = column("predicted posterior standard deviation")
    contraction: float = column("1 - posterior / prior variance")
    nats: float = column("information gain", "nat")
    verdict: Literal["identifiable", "weak", "not"] = column("practical identifiability")
    reduced_set: bool = column("whether it is in the reduced set")
    reduced_claimed_sd: float = column("sd claimed by the reduced set alone, or NaN")
    reduced_true_error: float = column("rms error of the reduced set alone")
    reduced_coverage_90: float = column("coverage of its 90 % intervals")
    reason: str = column("reason of the verdict")

    @property
    def symbol(self) -> str:
        """Name without the leg."""
        return split_name(self.parameter)[0]

    @property
    def leg(self) -> int:
        """Number of the leg; zero for parameters of the whole machine."""
        return split_name(self.parameter)[1]

    @property
    def sd_ratio(self) -> float:
        """Posterior over prior standard deviation."""
        return self.posterior_sd / self.prior_sd


@dataclass(frozen=True, kw_only=True)
class AuditRequirementRow(TableRow, table="requirements"):
    """A requirement on the tool of a variant; NaN where the machine's own sensors do not locate the tool."""

    variant: str = column(VARIANT)
    requirement: str = column(REQUIREMENT)
    unit: str = column("unit of limit and sds")
    limit: float = column("largest error allowed")
    prior_sd: float = column("sd of the tool error before calibration")
    predicted_sd: float = column("predicted sd of the tool error afterwards")
    parameter_sd: float = column("part by unknown parameters")
    reduced_sd: float = column("the same, reduced set alone")
    rms_sd: float = column("predicted sd, workspace rms")
    max_sd: float = column("largest predicted sd in the workspace")
    prior_probability: float = column("probability to meet the limit before calibration")
    probability: float = column("probability to meet the limit afterwards")
    reduced_probability: float = column("the same, reduced set alone")
    p_all_poses: float = column("probability that no pose exceeds the limit")
    max_sd_pose: str = column("pose of the largest predicted sd")


@dataclass(frozen=True, kw_only=True)
class DirectionRow(TableRow, table="directions"):
    """A parameter's component of a direction of the parameter space."""

    direction: int = column("number of the direction")
    kind: Literal["structural", "practical", "informed"] = column("identifiability of the direction")
    contraction: float = column("contraction along the direction")
    nats: float = column("information gain along the direction", "nat")
    parameter: str = column(PARAMETER)
    unit: str = column("unit of the component")
    loading: float = column("component in prior sds")
    share: float = column("squared component in prior sds")


@dataclass(frozen=True, kw_only=True)
class FreeingStepRow(TableRow, table="selection"):
    """A step of the search for the reduced set."""

    symbol: str = column("symbol considered")
    nats: float = column("information gain per parameter, given those included", "nat")
    contraction: float = column("smallest contraction with this symbol")
    is_included: bool = column("whether it is in the reduced set")


@dataclass(frozen=True, kw_only=True)
class SpectrumRow(TableRow, table="spectrum"):
    """A singular value of the identification Jacobian, by descending size."""

    number: int = column("number of the value")
    wide_workspace: float = column("the same over a wide workspace")
    planned: float = column("singular value, noise sds per prior sd")
    noise_floor: float = column("rounding level of the wide workspace's values")
    is_in_rank: bool = column("whether it counts for the structural rank")


@dataclass(frozen=True, kw_only=True)
class AuditScenarioRow(TableRow, table="scenarios"):
    """A weak combination under a changed plan."""

    scenario: str = column("name of the scenario")
    ridge: str = column("parameter it is named after")
    contraction: float = column("contraction under the scenario")


@dataclass(frozen=True, kw_only=True)
class AuditCombinationRow(TableRow, table="combinations"):
    """A combination of parameters that the measurements determine not at all, or too little."""

    number: int = column("number of the direction")
    kind: Literal["structural", "practical"] = column("structural: by no such measurement; practical: weak")
    contraction: float = column("contraction along it")
    pivot: str = column("parameter it is named after")
    sentence: str = column(COMBINATION_TEXT)
    effect: Literal["harmful", "noticeable", "unknown", "harmless"] = column("on the pose / requirements")
    sd_over_limit: float = column("1.96 sd along it / limit, or empty")
    limit: str = column("requirement, or empty")
    position: float = column("largest position change by the stated step; unit of lengths")
    rotation: float = column("largest rotation by the stated step; unit of angles")
    posterior_contraction: float = column("contraction of draws along it, or empty")
    plot_x: str = column("parameter on the x axis, or empty")
    plot_y: str = column("parameter on the y axis")
    plot_x_unit: str = column("unit of the x axis")
    plot_y_unit: str = column("unit of the y axis")
    plot_formula: str = column("slope of the combination in the plot")


@dataclass(frozen=True, kw_only=True)
class AlternativeRow(TableRow, table="alternatives"):
    """A changed plan; the predicted sd of each requirement follows, a column ``sd_`` each."""

    alternative: str = column("name of the scenario")
    n_poses: int = column(N_POSES)
    is_feasible: bool = column("whether its poses are reachable")
    is_beyond_range: bool = column("whether actuators leave their range")
    nats: float = column("information gain", "nat")
    n_identifiable: int = column("number of identifiable parameters")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PlanSweepRow(TableRow, table="sweeps"):
    """A symbol at a point of a sweep of the plan."""

    sweep: str = column("noise, poses or workspace")
    value: float = column("factor, or number of poses")
    is_beyond_range: bool = column("whether actuators leave their range")
    symbol: str = column("symbol of the parameters")
    contraction_min: float = column("smallest contraction of the symbol")
    contraction_max: float = column("largest contraction of the symbol")


@dataclass(frozen=True, kw_only=True)
class SweptRequirementRow(TableRow, table="sweep_requirements"):
    """A requirement at a point of a sweep of the plan."""

    sweep: str = column("noise, poses or workspace")
    value: float = column("factor, or number of poses")
    requirement: str = column(REQUIREMENT)
    unit: str = column("unit of sd and limit")
    predicted_sd: float = column("predicted sd of the tool error")
    limit: float = column("largest error allowed")


@dataclass(frozen=True, kw_only=True)
class SystematicSizeRow(TableRow, table="error_sizes"):
    """A symbol or a requirement with systematic errors of some size."""

    size_factor: float = column("factor on expected systematic errors")
    size: float = column("size of systematic errors, rms")
    size_unit: str = column("unit of the size")
    quantity: Literal["parameter", "requirement"] = column("kind of the row")
    name: str = column("symbol, or name of the requirement")
    unit: str = column("unit of the sd")
    sd: float = column("predicted posterior sd of parameters (rms) or tool error")
    probability: float = column("probability to meet the requirement, or NaN")


@dataclass(frozen=True, kw_only=True)
class ProfileRow(TableRow, table="profiles"):
    """A point of a profile likelihood."""

    parameter: str = column(PARAMETER)
    unit: str = column(PARAMETER_UNIT)
    value: float = column("value of the parameter")
    deviance_data: float = column("deviance of the data")
    deviance_total: float = column("deviance of data and priors")


@dataclass(frozen=True, kw_only=True)
class ProfilePathRow(TableRow, table="profile_paths"):
    """Another parameter at a point of a profile likelihood."""

    parameter: str = column("name of the profiled parameter")
    value: float = column("value of the profiled parameter")
    other: str = column("name of the other parameter")
    other_unit: str = column("unit of the other parameter")
    other_value: float = column("value of the other parameter")


@dataclass(frozen=True, kw_only=True)
class RidgeDrawRow(TableRow, table="ridge_draws"):
    """A draw in the plane of two parameters of a ridge."""

    direction: int = column("number of the direction")
    source: Literal["prior", "posterior", "forecast"] = column("distribution of the draw")
    x: float = column("first parameter")
    y: float = column("second parameter")
    x_held: float | None = column("first parameter without the other ridges", default=None)
    y_held: float | None = column("second parameter without the other ridges", default=None)


@dataclass(frozen=True, kw_only=True)
class RidgeCurveRow(TableRow, table="ridge_curves"):
    """A point of a curve in the plane of two parameters of a ridge."""

    direction: int = column("number of the direction")
    source: Literal["tangent", "profile"] = column("curve of the point")
    x: float = column("first parameter")
    y: float = column("second parameter")


@dataclass(frozen=True, kw_only=True)
class PlannedPoseRow(TableRow, table="poses"):
    """A planned pose, with a column per coordinate."""

    pose: str = column(POSE_NAME)
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SelectedPoseRow(TableRow, table="selected"):
    """A pose that was selected, with columns of its coordinates and of the rms tool error by unknown parameters."""

    variant: str = column(VARIANT)
    step: int = column("place in the order of selection")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PoseCountRow(TableRow, table="pose_counts"):
    """A number of poses, with columns of the rms tool error by unknown parameters, of selected and of random poses."""

    variant: str = column(VARIANT)
    n_poses: int = column(N_POSES)
    others: Mapping[str, float] = field(default_factory=dict)
    error: float = column("rms position error by parameters, selected poses", "mm")
    error_reduction: float = column("error reduction by the last pose")


@dataclass(frozen=True, kw_only=True)
class InfeasibleSetRow(TableRow, table="infeasible_sets"):
    """A set of sensors that does not determine where the machine is."""

    n_sensors: int = column("number of sensors")
    sensors: str = column("names of the sensors")
    cost: float | None = column("sum of the stated costs", default=None)
    n_readings: int = column("readings of a pose")
    reason: Literal["", "calibration", "use"] = column("undetermined poses; empty: feasible")


@dataclass(frozen=True, kw_only=True)
class SensorSetRow(InfeasibleSetRow, table="sensor_sets"):
    """A set of sensors, with columns of the rms tool error, its parts by unknown parameters and by noise."""

    n_equations: int = column("readings less coordinates")
    goal: float = column("largest sd / limit, without requirements rms position error; NaN: infeasible")
    probability: float | None = column(P_ALL_MET, default=None)
    sd_ratio: float = column("parameters' posterior / prior sd, rms")
    n_sets: int | None = column("sets of that size judged", default=None)
    n_infeasible: int | None = column("infeasible ones of them", default=None)
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BestSetRow(SensorSetRow, table="best_sets"):
    """The best set of a number of sensors."""


@dataclass(frozen=True, kw_only=True)
class FrontSetRow(SensorSetRow, table="front"):
    """A set of sensors that no other one of the same or a lower cost beats."""


@dataclass(frozen=True, kw_only=True)
class BestSetParameterRow(TableRow, table="best_set_parameters"):
    """A parameter with the best set of a number of sensors."""

    n_sensors: int = column("number of sensors")
    parameter: str = column(PARAMETER)
    unit: str = column(PARAMETER_UNIT)
    prior_sd: float = column(PRIOR_SD)
    sd: float = column("predicted posterior standard deviation")


ROWS: tuple[type[TableRow], ...] = (
    *(AuditVariantRow, AuditParameterRow, AuditRequirementRow, DirectionRow, FreeingStepRow, SpectrumRow),
    *(
        AuditCombinationRow,
        AlternativeRow,
        AuditScenarioRow,
        PlanSweepRow,
        SweptRequirementRow,
        SystematicSizeRow,
        ProfileRow,
        ProfilePathRow,
    ),
    *(RidgeDrawRow, RidgeCurveRow, PlannedPoseRow, SelectedPoseRow, PoseCountRow, InfeasibleSetRow),
    *(SensorSetRow, BestSetRow, FrontSetRow, BestSetParameterRow),
    *(ToolUncertaintyRow, CandidatePoseRow, JointRow, UnmodelledBiasRow),
)
"""Tables of an audit."""
