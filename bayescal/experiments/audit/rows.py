"""Tables of an audit, each declared once: `parameters.csv` and the others, in the units of the design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import CandidatePoseRow, JointRow, ToolUncertaintyRow, UnmodelledBiasRow
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

    variant: str = column("name of the variant")
    title: str = column("title of the variant")
    data_set: str = column("readings that are taken in")
    n_equations: int = column("readings less coordinates of the poses")
    n_parameters: int = column("free parameters")
    n_poses: int = column("planned poses")
    n_identifiable: int = column("parameters whose verdict is identifiable")
    error_ratio: float = column("rms tool error by unknown parameters, posterior over prior")
    sd_over_limit: float = column("largest predicted sd over its limit; NaN without requirements")
    probability: float = column("probability that all requirements are met; NaN without any")


@dataclass(frozen=True, kw_only=True)
class AuditParameterRow(TableRow, table="parameters"):
    """A parameter of a variant, prior and predicted posterior."""

    variant: str = column("name of the variant")
    parameter: str = column("name of the parameter")
    unit: str = column("unit of the parameter")
    nominal: float = column("nominal value")
    prior_sd: float = column("prior standard deviation, the tolerance")
    posterior_sd: float = column("predicted posterior standard deviation")
    contraction: float = column("1 - posterior variance / prior variance")
    nats: float = column("information gain", "nat")
    verdict: Literal["identifiable", "weak", "not"] = column("practical identifiability")
    reduced_set: bool = column("whether it is in the reduced set")
    reduced_claimed_sd: float = column("sd claimed by a fit of the reduced set alone; NaN outside of it")
    reduced_true_error: float = column("rms error of a fit of the reduced set alone")
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

    variant: str = column("name of the variant")
    requirement: str = column("name of the requirement")
    unit: str = column("unit of limit and standard deviations")
    limit: float = column("largest error allowed")
    prior_sd: float = column("sd of the tool error before the calibration")
    predicted_sd: float = column("predicted sd of the tool error after the calibration")
    parameter_sd: float = column("part of it caused by unknown parameters")
    reduced_sd: float = column("the same with the reduced set calibrated alone")
    rms_sd: float = column("rms over the workspace of the predicted sd")
    max_sd: float = column("largest predicted sd in the workspace")
    prior_probability: float = column("probability to meet the limit before the calibration")
    probability: float = column("probability to meet the limit after the calibration")
    reduced_probability: float = column("the same with the reduced set calibrated alone")
    p_all_poses: float = column("probability that no pose of the workspace exceeds the limit")
    max_sd_pose: str = column("pose of the largest predicted sd")


@dataclass(frozen=True, kw_only=True)
class DirectionRow(TableRow, table="directions"):
    """A parameter's component of a direction of the parameter space."""

    direction: int = column("number of the direction")
    kind: Literal["structural", "practical", "informed"] = column("identifiability of the direction")
    contraction: float = column("1 - posterior variance / prior variance along the direction")
    nats: float = column("information gain along the direction", "nat")
    parameter: str = column("name of the parameter")
    unit: str = column("unit of the component")
    loading: float = column("component of one prior sd along the direction")
    share: float = column("squared component of the unit vector in prior sds")


@dataclass(frozen=True, kw_only=True)
class FreeingStepRow(TableRow, table="selection"):
    """A step of the search for the reduced set."""

    symbol: str = column("symbol considered")
    nats: float = column("information gain per parameter, given the symbols included", "nat")
    contraction: float = column("smallest contraction of all included, with this symbol")
    is_included: bool = column("whether the symbol is in the reduced set")


@dataclass(frozen=True, kw_only=True)
class SpectrumRow(TableRow, table="spectrum"):
    """A singular value of the identification Jacobian, by descending size."""

    number: int = column("number of the value")
    wide_workspace: float = column("singular value over a wide workspace, per prior sd")
    planned: float = column("singular value at the planned poses, in sds of noise per prior sd")
    noise_floor: float = column("level to which rounding moves the values of the wide workspace")
    is_in_rank: bool = column("whether the value counts for the structural rank")


@dataclass(frozen=True, kw_only=True)
class AuditScenarioRow(TableRow, table="scenarios"):
    """A weak combination under a changed plan."""

    scenario: str = column("name of the scenario")
    ridge: str = column("parameter that the combination is named after")
    contraction: float = column("contraction under the scenario")


@dataclass(frozen=True, kw_only=True)
class AuditCombinationRow(TableRow, table="combinations"):
    """A combination of parameters that the measurements determine not at all, or too little."""

    number: int = column("number of the direction, from 1")
    kind: Literal["structural", "practical"] = column("structural: by no measurement of this kind; practical: weak")
    contraction: float = column("1 - posterior variance / prior variance along it")
    pivot: str = column("parameter that it is named after")
    sentence: str = column("what changes together, and what that does to the readings")
    effect: Literal["harmful", "noticeable", "unknown", "harmless"] = column("on the pose, against the requirements")
    sd_over_limit: float = column("1.96 sd along it over the limit of a requirement; empty without")
    limit: str = column("of which requirement; empty without")
    position: float = column("largest position change of a pose by the step of the sentence; unit of lengths")
    rotation: float = column("largest rotation of a pose by the step of the sentence; unit of angles")
    posterior_contraction: float = column("contraction of the posterior's draws along it; empty without")
    plot_x: str = column("parameter on the x axis of its plot; empty without one")
    plot_y: str = column("parameter on the y axis")
    plot_x_unit: str = column("unit of the x axis")
    plot_y_unit: str = column("unit of the y axis")
    plot_formula: str = column("slope of the combination in the plot")


@dataclass(frozen=True, kw_only=True)
class AlternativeRow(TableRow, table="alternatives"):
    """A changed plan; the predicted sd of each requirement follows, a column ``sd_`` each."""

    alternative: str = column("name of the scenario")
    n_poses: int = column("number of poses")
    is_feasible: bool = column("whether the machine reaches its poses")
    is_beyond_range: bool = column("whether actuators would leave their range")
    nats: float = column("information gain", "nat")
    n_identifiable: int = column("number of identifiable parameters")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PlanSweepRow(TableRow, table="sweeps"):
    """A symbol at a point of a sweep of the plan."""

    sweep: str = column("what varies: noise, poses or workspace")
    value: float = column("factor on the plan's, or number of poses")
    is_beyond_range: bool = column("whether actuators would leave their range")
    symbol: str = column("symbol of the parameters")
    contraction_min: float = column("smallest contraction of the symbol")
    contraction_max: float = column("largest contraction of the symbol")


@dataclass(frozen=True, kw_only=True)
class SweptRequirementRow(TableRow, table="sweep_requirements"):
    """A requirement at a point of a sweep of the plan."""

    sweep: str = column("what varies: noise, poses or workspace")
    value: float = column("factor on the plan's, or number of poses")
    requirement: str = column("name of the requirement")
    unit: str = column("unit of sd and limit")
    predicted_sd: float = column("predicted sd of the tool error")
    limit: float = column("largest error allowed")


@dataclass(frozen=True, kw_only=True)
class SystematicSizeRow(TableRow, table="error_sizes"):
    """A symbol or a requirement with systematic errors of some size."""

    size_factor: float = column("factor on the expected size of systematic errors")
    size: float = column("size of systematic errors, rms")
    size_unit: str = column("unit of the size")
    quantity: Literal["parameter", "requirement"] = column("kind of the row")
    name: str = column("symbol of the parameters, or name of the requirement")
    unit: str = column("unit of the sd")
    sd: float = column("predicted posterior sd of the parameters (rms), or of the tool error")
    probability: float = column("probability to meet the requirement; NaN of parameters")


@dataclass(frozen=True, kw_only=True)
class ProfileRow(TableRow, table="profiles"):
    """A point of a profile likelihood."""

    parameter: str = column("name of the parameter")
    unit: str = column("unit of the parameter")
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
    x_held: float | None = column("first parameter without moves along the other ridges", default=None)
    y_held: float | None = column("second parameter without moves along the other ridges", default=None)


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

    pose: str = column("name of the pose")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SelectedPoseRow(TableRow, table="selected"):
    """A pose that was selected, with columns of its coordinates and of the rms tool error by unknown parameters."""

    variant: str = column("name of the variant")
    step: int = column("place in the order of selection")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class PoseCountRow(TableRow, table="pose_counts"):
    """A number of poses, with columns of the rms tool error by unknown parameters, of selected and of random poses."""

    variant: str = column("name of the variant")
    n_poses: int = column("number of poses")
    others: Mapping[str, float] = field(default_factory=dict)
    error: float = column("rms position error by unknown parameters, selected poses", "mm")
    error_reduction: float = column("part by which the last pose reduces the error")


@dataclass(frozen=True, kw_only=True)
class InfeasibleSetRow(TableRow, table="infeasible_sets"):
    """A set of sensors that does not determine where the machine is."""

    n_sensors: int = column("number of sensors")
    sensors: str = column("names of the sensors")
    cost: float | None = column("sum of the stated costs", default=None)
    n_readings: int = column("readings of a pose")
    reason: Literal["", "calibration", "use"] = column("where poses are not determined; empty if feasible")


@dataclass(frozen=True, kw_only=True)
class SensorSetRow(InfeasibleSetRow, table="sensor_sets"):
    """A set of sensors, with columns of the rms tool error, its parts by unknown parameters and by noise."""

    n_equations: int = column("readings less coordinates of the poses")
    goal: float = column("largest sd over its limit, or rms position error without requirements; NaN if infeasible")
    probability: float | None = column("probability that all requirements are met", default=None)
    sd_ratio: float = column("posterior over prior sd of the parameters, rms")
    n_sets: int | None = column("sets of as many sensors that were judged", default=None)
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
    parameter: str = column("name of the parameter")
    unit: str = column("unit of the parameter")
    prior_sd: float = column("prior standard deviation")
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
