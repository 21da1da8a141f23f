"""Rows of a study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import (
    CHANNEL,
    EFFICIENCY,
    ERROR_ROWS,
    ERROR_UNIT,
    KNOWLEDGE_ROWS,
    LEG,
    POSE_NAME,
    POSTERIOR_SD,
    PREDICTED_Q05,
    PREDICTED_Q95,
    Q05,
    Q95,
    STANDARD_ERROR,
    USE,
    VARIANT,
    JointRow,
    Use,
)
from bayescal.files.rows import TableRow, column

EXTERNAL = "whether an instrument beside the machine reads it"
DATA_SET = "readings taken in; evidences of others do not compare"
PARETO_K = "Pareto k of the importance weights"
CLAIM_VERDICTS = ("holds", "does not hold", "not testable")


@dataclass(frozen=True, kw_only=True)
class VariantRow(TableRow, table="variants"):
    """A variant: its evidence, its residuals, its sampler, how it predicts."""

    variant: str = column(VARIANT)
    title: str = column("what pages call it")
    data_set: str = column(DATA_SET)
    has_outliers: bool = column("whether single poses may be outliers")
    n_poses: int = column("calibration poses")
    n_equations: int = column("readings less coordinates")
    n_parameters: int = column("unknowns")
    log_evidence: float = column("the estimate used", "nat")
    log_evidence_se: float = column(STANDARD_ERROR, "nat")
    log_evidence_importance: float = column("by importance sampling", "nat")
    log_evidence_importance_se: float = column(STANDARD_ERROR, "nat")
    log_evidence_bridge: float = column("by bridge sampling", "nat")
    log_evidence_bridge_se: float = column(STANDARD_ERROR, "nat")
    log_evidence_by: str = column("which estimate it is")
    log_evidence_check: float | None = column("by `cross_check`, or `backend`", "nat", None)
    log_evidence_check_se: float | None = column(STANDARD_ERROR, "nat", None)
    efficiency: float = column(EFFICIENCY)
    pareto_k: float = column(PARETO_K)
    misfit_chi2: float = column("sum of (residual / noise)² at the mode")
    misfit_dof: float = column("their degrees of freedom")
    prior_chi2: float = column("sum of (deviation from nominal / prior sd)²")
    prior_dof: float = column("how many these are")
    rhat_max: float = column("largest R-hat of the parameters")
    ess_bulk_min: float = column("smallest bulk effective sample size")
    ess_tail_min: float = column("smallest tail effective sample size")
    converged: bool = column("whether the posterior passes all checks")
    problems: str = column("what does")
    elpd: float = column("log predictive density, held-back poses", "nat")
    reduced_chi: float = column("root of chi² / degrees of freedom, mode")
    calibration_position_error_mean_mm: float | None = column("mean over calibration poses", "mm", None)
    calibration_position_error_max_mm: float | None = column("largest of calibration poses", "mm", None)
    calibration_orientation_error_mean_deg: float | None = column("mean over calibration poses", "deg", None)
    calibration_orientation_error_max_deg: float | None = column("largest of calibration poses", "deg", None)
    verification_position_error_mean_mm: float | None = column("mean over held-back poses", "mm", None)
    verification_position_error_max_mm: float | None = column("largest of held-back poses", "mm", None)
    verification_orientation_error_mean_deg: float | None = column("mean over held-back poses", "deg", None)
    verification_orientation_error_max_deg: float | None = column("largest of held-back poses", "deg", None)
    distance_from_nominal_mm: float = column("rms deviation of lengths", "mm")
    distance_from_nominal_prior_sd: float = column("rms deviation in prior standard deviations")
    linearisation_log_shift: float | None = column("log-evidence, exact less explored density", "nat", None)
    linearisation_log_shift_se: float | None = column(STANDARD_ERROR, "nat", None)
    linearisation_efficiency: float | None = column("effective fraction, exact density", "", None)
    linearisation_pareto_k: float | None = column("Pareto k, exact density", "", None)
    n_verification_readings: int | None = column("held-back readings predicted", "", None)
    coverage_90: float | None = column("coverage of their 90 % intervals", "", None)
    elpd_loo: float = column("leave-one-out log predictive density", "nat")
    elpd_loo_se: float = column("its standard error over poses", "nat")
    elpd_loo_difference: float = column("less that of the best, same readings", "nat")
    elpd_loo_difference_se: float = column("its standard error over poses", "nat")
    stacking_weight: float = column("weight in the predictive mixture")
    loo_pareto_k_max: float = column("largest leave-one-out Pareto k")
    n_loo_refitted: int = column("poses sampled again")
    n_loo_bad_k: int = column("poses whose figure is unreliable")


@dataclass(frozen=True, kw_only=True)
class ParameterRow(TableRow, table="parameters"):
    """The posterior of a parameter; of several solutions each has its rows."""

    variant: str = column(VARIANT)
    parameter: str = column("name with its index")
    unit: str = column("of nominal to q95")
    nominal: float = column("value as designed, or prior median")
    prior_sd: float = column("standard deviation of the prior")
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    q05: float = column(Q05)
    q95: float = column(Q95)
    contraction: float = column("1 − (sd / prior_sd)²")
    prior_sensitivity: float = column("power-scaling sensitivity to the prior")
    likelihood_sensitivity: float = column("power-scaling sensitivity to the likelihood")
    verdict: str = column("identifiable, weak, not; noise: not the machine's; several: solutions differ")
    rhat: float = column("R-hat")
    ess_bulk: float = column("bulk effective sample size")
    ess_tail: float = column("tail effective sample size")
    mode: int | None = column("number, most probable first", "", None)
    probability: float | None = column("of the solution", "", None)
    probability_se: float | None = column(STANDARD_ERROR, "", None)


@dataclass(frozen=True, kw_only=True)
class PoseRow(TableRow, table="poses"):
    """A calibration pose: how the best machine fits it; its coordinates follow, a column each."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    elpd_loo: float = column("log predictive density, left out", "nat")
    pareto_k: float = column(PARETO_K)
    loo_refitted: bool = column("whether it was sampled again")
    n_dof: int = column("readings less coordinates")
    chi2: float = column("sum of (residual / noise)²")
    p_value: float = column("probability of a larger chi²")
    robust_weight: float = column("mean precision; 1: no outlier")
    is_outlier: bool = column("whether its residuals contradict the noise")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ResidualRow(TableRow, table="residuals"):
    """A calibration reading and its residual at the best machine."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    channel: str = column(CHANNEL)
    unit: str = column("of the figures")
    measured: float = column("the reading")
    residual: float = column("measured less fitted")
    noise: float = column("sd by noise and random error")


@dataclass(frozen=True, kw_only=True)
class PredictionRow(TableRow, table="predictions"):
    """A held-back reading and its prediction by the other poses."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    channel: str = column(CHANNEL)
    external: bool = column(EXTERNAL)
    unit: str = column("of the figures")
    measured: float = column("the reading")
    mean: float = column("its prediction")
    sd: float = column("predicted standard deviation")
    low: float = column(Q05)
    high: float = column(Q95)
    in_interval_90: bool = column("whether the reading is inside")


@dataclass(frozen=True, kw_only=True)
class ToolPredictionRow(PredictionRow, table="tool_predictions"):
    """A held-back reading of an instrument and its prediction by the machine's own sensors alone."""


@dataclass(frozen=True, kw_only=True)
class NotPredictedRow(TableRow, table="not_predicted"):
    """A held-back reading without a prediction."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    channel: str = column(CHANNEL)
    external: bool = column(EXTERNAL)
    reason: str = column("why there is none")


@dataclass(frozen=True, kw_only=True)
class PoseErrorRow(TableRow, table="pose_errors"):
    """The error of a pose that an instrument measured: measured less predicted by the machine's own sensors."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    use: Use = column(USE)
    position_error_mm: float = column("length of the position error", "mm")
    position_bound_95_mm: float = column("predicted 95 % bound", "mm")
    orientation_error_deg: float = column("angle of the orientation error", "deg")
    orientation_bound_95_deg: float = column("predicted 95 % bound", "deg")
    x_error_mm: float = column("error in x", "mm")
    x_low_mm: float = column(PREDICTED_Q05, "mm")
    x_high_mm: float = column(PREDICTED_Q95, "mm")
    y_error_mm: float = column("error in y", "mm")
    y_low_mm: float = column(PREDICTED_Q05, "mm")
    y_high_mm: float = column(PREDICTED_Q95, "mm")
    z_error_mm: float = column("error in z", "mm")
    z_low_mm: float = column(PREDICTED_Q05, "mm")
    z_high_mm: float = column(PREDICTED_Q95, "mm")
    rx_error_deg: float = column("error of the rotation about x", "deg")
    rx_low_deg: float = column(PREDICTED_Q05, "deg")
    rx_high_deg: float = column(PREDICTED_Q95, "deg")
    ry_error_deg: float = column("error of the rotation about y", "deg")
    ry_low_deg: float = column(PREDICTED_Q05, "deg")
    ry_high_deg: float = column(PREDICTED_Q95, "deg")
    rz_error_deg: float = column("error of the rotation about z", "deg")
    rz_low_deg: float = column(PREDICTED_Q05, "deg")
    rz_high_deg: float = column(PREDICTED_Q95, "deg")


@dataclass(frozen=True, kw_only=True)
class BeforeAfterRow(TableRow, table="before_after"):
    """The position error of a measured pose before and after calibration."""

    variant: str = column(VARIANT)
    pose: str = column(POSE_NAME)
    use: Use = column(USE)
    before_mm: float = column("of the nominal machine", "mm")
    after_mm: float = column("of the calibrated machine", "mm")


@dataclass(frozen=True, kw_only=True)
class RequirementResultRow(TableRow, table="requirements"):
    """A requirement and the probability with which the variant keeps it at every pose of the workspace."""

    variant: str = column(VARIANT)
    requirement: str = column("coordinate of the tool, or all")
    unit: str = column("of limit and error")
    limit: float = column("largest allowed error")
    limit_inner: float = column("the same in mm or rad")
    error: float = column("95 % bound of the largest error")
    probability: float = column("no pose exceeds the limit")


@dataclass(frozen=True, kw_only=True)
class PriorWidthRow(TableRow, table="sensitivity"):
    """The evidence of a variant with all priors wider or narrower."""

    variant: str = column(VARIANT)
    factor: float = column("on all prior sds")
    log_evidence: float = column("with that prior", "nat")
    log_evidence_se: float = column(STANDARD_ERROR, "nat")
    efficiency: float = column(EFFICIENCY)
    pareto_k: float = column(PARETO_K)


@dataclass(frozen=True, kw_only=True)
class RandomScaleRow(TableRow, table="tau_scale"):
    """The evidence of a variant with another prior scale of the random model error τ."""

    variant: str = column(VARIANT)
    unit: str = column(ERROR_UNIT)
    prior_scale: float = column("scale of the half-normal prior")
    scale: float = column("scale tried here")
    log_evidence: float = column("with that prior; empty: weights too uneven", "nat")
    efficiency: float = column("effective fraction of draws")
    pareto_k: float = column(PARETO_K)


@dataclass(frozen=True, kw_only=True)
class ReferenceRow(TableRow, table="reference_values"):
    """A quantity of [reference_values] and its posterior."""

    variant: str = column(VARIANT)
    reference: str = column("title of the reference")
    source: str = column("where its values come from")
    quantity: str = column("parameter or function of parameters")
    unit: str = column("of the figures")
    mean: float = column("posterior mean")
    sd: float = column(POSTERIOR_SD)
    value: float = column("reference value")
    value_sd: float = column("its standard deviation, or empty")


@dataclass(frozen=True, kw_only=True)
class CommandErrorRow(TableRow, table="errors"):
    """By how much a commanded channel errs; its correlations with the others follow where they are known."""

    variant: str = column(VARIANT)
    channel: str = column(CHANNEL)
    unit: str = column("of noise and model error")
    noise: float = column("rms sd by noise")
    model_error: float = column("rms sd by model error")
    others: Mapping[str, float] = field(default_factory=dict)


# --- machines on legs ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class FlexureRow(TableRow, table="flexure"):
    """How the end of a flexure moves as it bends: beam, ideal pivot and circle (RR-8096 figure 9)."""

    flexure_length_mm: float = column("length of the flexure", "mm")
    bending_deg: float = column("angle of bending", "deg")
    across_um: float = column("motion across the flexure", "um")
    along_beam_um: float = column("motion along it, of the beam", "um")
    along_pivot_um: float = column("the same of an ideal pivot", "um")
    along_circle_um: float = column("the same of a circle", "um")
    circle_error_nm: float = column("circle less beam", "nm")


@dataclass(frozen=True, kw_only=True)
class JointDeflectionRow(TableRow, table="joint_deflection"):
    """The measured deflection of a joint of the ring at a pose."""

    pose: str = column(POSE_NAME)
    use: Use = column(USE)
    leg: int = column(LEG)
    actuator_displacement_mm: float = column("from the initial position", "mm")
    deflection_um: float = column("along the normal of the ring", "um")
    deflection_sd_um: float = column("its standard deviation", "um")


@dataclass(frozen=True, kw_only=True)
class DeformationRow(TableRow, table="deformation"):
    """An entry of the deformation per displacement: κ of a leg, or K of a leg and an actuator."""

    quantity: Literal["kappa", "K"] = column("which one")
    leg: int = column(LEG)
    actuator: int = column("number of the actuator")
    mean_permille: float = column("posterior mean", "1e-3")
    sd_permille: float = column(POSTERIOR_SD, "1e-3")


# --- what a publication says -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ClaimRow(TableRow, table="claims"):
    """A published claim and whether it holds."""

    claim: str = column("name of the claim")
    section: str = column("section of the publication; own: not stated there")
    statement: str = column("what is claimed")
    expected: str = column("the figure that is claimed")
    found: str = column("the figure that was found")
    value: float = column("the same as a number")
    unit: str = column("of the value")
    verdict: Literal["holds", "does not hold", "not testable"] = column("whether it holds")
    reason: str = column("why")


@dataclass(frozen=True, kw_only=True)
class PublishedParameterRow(TableRow, table="least_squares"):
    """A parameter by least squares beside its published value."""

    variant: str = column(VARIANT)
    parameter: str = column("symbol")
    leg: int = column("number of the leg; 0: the machine")
    unit: str = column("of nominal to difference")
    nominal: float = column("value as designed")
    offset: float = column("least squares less nominal")
    published_offset: float = column("published less nominal, or empty")
    difference: float = column("offset less published offset")
    leg_residual_rms_um: float = column("residuals of the leg", "um")
    converged: bool = column("whether least squares did")


REQUIRED = (ParameterRow, PoseRow)
ROWS = (
    VariantRow,
    *REQUIRED,
    ResidualRow,
    PredictionRow,
    ToolPredictionRow,
    NotPredictedRow,
    PoseErrorRow,
    BeforeAfterRow,
    RequirementResultRow,
    PriorWidthRow,
    RandomScaleRow,
    ReferenceRow,
    CommandErrorRow,
    JointRow,
    FlexureRow,
    JointDeflectionRow,
    DeformationRow,
    ClaimRow,
    PublishedParameterRow,
    *KNOWLEDGE_ROWS,
    *ERROR_ROWS,
)
"""Of all tables of a study."""
