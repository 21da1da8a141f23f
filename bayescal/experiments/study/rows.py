"""Rows of a study's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayescal.experiments.shared.rows import ERROR_ROWS, KNOWLEDGE_ROWS, USE, VARIANT, JointRow, Use
from bayescal.files.rows import TableRow, column

POSE = "name of the pose"
CHANNEL = "name of the channel"
EXTERNAL = "whether an instrument beside the machine reads it"
DATA_SET = "which readings the variant takes in; evidences of different ones do not compare"
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
    n_equations: int = column("readings less coordinates of their poses")
    n_parameters: int = column("unknowns")
    log_evidence: float = column("the estimate that is used", "nat")
    log_evidence_se: float = column("its standard error", "nat")
    log_evidence_importance: float = column("by importance sampling", "nat")
    log_evidence_importance_se: float = column("its standard error", "nat")
    log_evidence_bridge: float = column("by bridge sampling from the chains", "nat")
    log_evidence_bridge_se: float = column("its standard error", "nat")
    log_evidence_by: str = column("which estimate is used")
    log_evidence_check: float | None = column("by the sampler that `cross_check` names, or `backend`", "nat", None)
    log_evidence_check_se: float | None = column("its standard error", "nat", None)
    efficiency: float = column("effective fraction of the importance draws")
    pareto_k: float = column(PARETO_K)
    misfit_chi2: float = column("sum of squares of residuals at the mode, in noise")
    misfit_dof: float = column("their degrees of freedom")
    prior_chi2: float = column("sum of squares of deviations from nominal, in prior standard deviations")
    prior_dof: float = column("how many these are")
    rhat_max: float = column("largest R-hat of the parameters")
    ess_bulk_min: float = column("smallest bulk effective sample size")
    ess_tail_min: float = column("smallest tail effective sample size")
    converged: bool = column("whether nothing speaks against the posterior")
    problems: str = column("what does")
    elpd: float = column("log predictive density of the held-back poses", "nat")
    reduced_chi: float = column("root of chi² per degree of freedom at the mode")
    calibration_position_error_mean_mm: float | None = column("mean over calibration poses", "mm", None)
    calibration_position_error_max_mm: float | None = column("largest of calibration poses", "mm", None)
    calibration_orientation_error_mean_deg: float | None = column("mean over calibration poses", "deg", None)
    calibration_orientation_error_max_deg: float | None = column("largest of calibration poses", "deg", None)
    verification_position_error_mean_mm: float | None = column("mean over held-back poses", "mm", None)
    verification_position_error_max_mm: float | None = column("largest of held-back poses", "mm", None)
    verification_orientation_error_mean_deg: float | None = column("mean over held-back poses", "deg", None)
    verification_orientation_error_max_deg: float | None = column("largest of held-back poses", "deg", None)
    distance_from_nominal_mm: float = column("rms deviation of lengths from nominal", "mm")
    distance_from_nominal_prior_sd: float = column("rms deviation in prior standard deviations")
    linearisation_log_shift: float | None = column("log-evidence of the exact less the explored density", "nat", None)
    linearisation_log_shift_se: float | None = column("its standard error", "nat", None)
    linearisation_efficiency: float | None = column("effective fraction of draws under the exact density", "", None)
    linearisation_pareto_k: float | None = column("Pareto k of the weights to the exact density", "", None)
    n_verification_readings: int | None = column("held-back readings of own sensors that are predicted", "", None)
    coverage_90: float | None = column("fraction of them inside their 90 % intervals", "", None)
    elpd_loo: float = column("log predictive density, one pose left out at a time", "nat")
    elpd_loo_se: float = column("its standard error over poses", "nat")
    elpd_loo_difference: float = column("less that of the best variant of the same readings", "nat")
    elpd_loo_difference_se: float = column("its standard error over poses", "nat")
    stacking_weight: float = column("weight in the best mixture of predictions")
    loo_pareto_k_max: float = column("largest Pareto k of a pose left out")
    n_loo_refitted: int = column("poses left out by sampling again")
    n_loo_bad_k: int = column("poses whose figure is unreliable")


@dataclass(frozen=True, kw_only=True)
class ParameterRow(TableRow, table="parameters"):
    """The posterior of a parameter; of several solutions each has its rows."""

    variant: str = column(VARIANT)
    parameter: str = column("name, with the index of leg or channel")
    unit: str = column("of nominal to q95")
    nominal: float = column("value as designed, or prior median")
    prior_sd: float = column("standard deviation of the prior")
    mean: float = column("posterior mean")
    sd: float = column("posterior standard deviation")
    q05: float = column("5 % quantile")
    q95: float = column("95 % quantile")
    contraction: float = column("1 − (sd / prior_sd)²")
    prior_sensitivity: float = column("power-scaling sensitivity to the prior")
    likelihood_sensitivity: float = column("power-scaling sensitivity to the likelihood")
    verdict: str = column("identifiable, weak, not; noise: none of the machine's; several: solutions differ")
    rhat: float = column("R-hat")
    ess_bulk: float = column("bulk effective sample size")
    ess_tail: float = column("tail effective sample size")
    mode: int | None = column("number of the solution, the most probable first", "", None)
    probability: float | None = column("of the solution", "", None)
    probability_se: float | None = column("its standard error", "", None)


@dataclass(frozen=True, kw_only=True)
class PoseRow(TableRow, table="poses"):
    """A calibration pose: how the best machine fits it; its coordinates follow, a column each."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    elpd_loo: float = column("log predictive density of its readings, left out", "nat")
    pareto_k: float = column(PARETO_K)
    loo_refitted: bool = column("whether it was left out by sampling again")
    n_dof: int = column("readings less coordinates")
    chi2: float = column("sum of squares of its residuals, in noise")
    p_value: float = column("probability that noise makes chi² as large")
    robust_weight: float = column("mean of its precision; 1 without outliers")
    is_outlier: bool = column("whether its residuals contradict the noise")
    others: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ResidualRow(TableRow, table="residuals"):
    """A calibration reading and its residual at the best machine."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    channel: str = column(CHANNEL)
    unit: str = column("of the figures")
    measured: float = column("the reading")
    residual: float = column("measured less fitted")
    noise: float = column("standard deviation by noise and random error")


@dataclass(frozen=True, kw_only=True)
class PredictionRow(TableRow, table="predictions"):
    """A held-back reading and its prediction by the other poses."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    channel: str = column(CHANNEL)
    external: bool = column(EXTERNAL)
    unit: str = column("of the figures")
    measured: float = column("the reading")
    mean: float = column("its prediction")
    sd: float = column("standard deviation of the prediction")
    low: float = column("5 % quantile")
    high: float = column("95 % quantile")
    in_interval_90: bool = column("whether the reading lies between them")


@dataclass(frozen=True, kw_only=True)
class ToolPredictionRow(PredictionRow, table="tool_predictions"):
    """A held-back reading of an instrument and its prediction by the machine's own sensors alone."""


@dataclass(frozen=True, kw_only=True)
class NotPredictedRow(TableRow, table="not_predicted"):
    """A held-back reading without a prediction."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    channel: str = column(CHANNEL)
    external: bool = column(EXTERNAL)
    reason: str = column("why there is none")


@dataclass(frozen=True, kw_only=True)
class PoseErrorRow(TableRow, table="pose_errors"):
    """The error of a pose that an instrument measured: measured less predicted by the machine's own sensors."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    use: Use = column(USE)
    position_error_mm: float = column("length of the position error", "mm")
    position_bound_95_mm: float = column("its predicted 95 % bound", "mm")
    orientation_error_deg: float = column("angle of the orientation error", "deg")
    orientation_bound_95_deg: float = column("its predicted 95 % bound", "deg")
    x_error_mm: float = column("error in x", "mm")
    x_low_mm: float = column("5 % quantile of its prediction", "mm")
    x_high_mm: float = column("95 % quantile of its prediction", "mm")
    y_error_mm: float = column("error in y", "mm")
    y_low_mm: float = column("5 % quantile of its prediction", "mm")
    y_high_mm: float = column("95 % quantile of its prediction", "mm")
    z_error_mm: float = column("error in z", "mm")
    z_low_mm: float = column("5 % quantile of its prediction", "mm")
    z_high_mm: float = column("95 % quantile of its prediction", "mm")
    rx_error_deg: float = column("error of the rotation about x", "deg")
    rx_low_deg: float = column("5 % quantile of its prediction", "deg")
    rx_high_deg: float = column("95 % quantile of its prediction", "deg")
    ry_error_deg: float = column("error of the rotation about y", "deg")
    ry_low_deg: float = column("5 % quantile of its prediction", "deg")
    ry_high_deg: float = column("95 % quantile of its prediction", "deg")
    rz_error_deg: float = column("error of the rotation about z", "deg")
    rz_low_deg: float = column("5 % quantile of its prediction", "deg")
    rz_high_deg: float = column("95 % quantile of its prediction", "deg")


@dataclass(frozen=True, kw_only=True)
class BeforeAfterRow(TableRow, table="before_after"):
    """The position error of a measured pose before and after calibration."""

    variant: str = column(VARIANT)
    pose: str = column(POSE)
    use: Use = column(USE)
    before_mm: float = column("of the nominal machine", "mm")
    after_mm: float = column("of the calibrated machine", "mm")


@dataclass(frozen=True, kw_only=True)
class RequirementResultRow(TableRow, table="requirements"):
    """A requirement and the probability with which the variant keeps it at every pose of the workspace."""

    variant: str = column(VARIANT)
    requirement: str = column("coordinate of the tool; all: all together")
    unit: str = column("of limit and error")
    limit: float = column("largest allowed error")
    limit_inner: float = column("the same in mm or rad")
    error: float = column("largest error of the workspace, kept with 95 % probability")
    probability: float = column("that no pose exceeds the limit")


@dataclass(frozen=True, kw_only=True)
class PriorWidthRow(TableRow, table="sensitivity"):
    """The evidence of a variant with all priors wider or narrower."""

    variant: str = column(VARIANT)
    factor: float = column("on the standard deviations of all priors")
    log_evidence: float = column("with that prior", "nat")
    log_evidence_se: float = column("its standard error", "nat")
    efficiency: float = column("effective fraction of the importance draws")
    pareto_k: float = column(PARETO_K)


@dataclass(frozen=True, kw_only=True)
class RandomScaleRow(TableRow, table="tau_scale"):
    """The evidence of a variant with another prior scale of the random model error τ."""

    variant: str = column(VARIANT)
    unit: str = column("of the scales: um at the tool, or noise")
    prior_scale: float = column("scale of the half-normal prior of the study")
    scale: float = column("scale tried here")
    log_evidence: float = column("with that prior; empty where the weights are too uneven", "nat")
    efficiency: float = column("effective fraction of the posterior draws")
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
    sd: float = column("posterior standard deviation")
    value: float = column("reference value")
    value_sd: float = column("its standard deviation; empty where none is stated")


@dataclass(frozen=True, kw_only=True)
class CommandErrorRow(TableRow, table="errors"):
    """By how much a commanded channel errs; its correlations with the others follow where they are known."""

    variant: str = column(VARIANT)
    channel: str = column(CHANNEL)
    unit: str = column("of noise and model error")
    noise: float = column("rms standard deviation by noise")
    model_error: float = column("rms standard deviation by model error")
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

    pose: str = column(POSE)
    use: Use = column(USE)
    leg: int = column("number of the leg, from 1")
    actuator_displacement_mm: float = column("from the initial position", "mm")
    deflection_um: float = column("along the normal of the ring", "um")
    deflection_sd_um: float = column("its standard deviation", "um")


@dataclass(frozen=True, kw_only=True)
class DeformationRow(TableRow, table="deformation"):
    """An entry of the deformation per displacement: κ of a leg, or K of a leg and an actuator."""

    quantity: Literal["kappa", "K"] = column("which one")
    leg: int = column("number of the leg, from 1")
    actuator: int = column("number of the actuator, from 1")
    mean_permille: float = column("posterior mean", "1e-3")
    sd_permille: float = column("posterior standard deviation", "1e-3")


# --- what a publication says -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ClaimRow(TableRow, table="claims"):
    """A published claim and whether it holds."""

    claim: str = column("name of the claim")
    section: str = column("section of the publication; own: a finding that it does not state")
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
    leg: int = column("number of the leg, from 1; 0: of the machine")
    unit: str = column("of nominal to difference")
    nominal: float = column("value as designed")
    offset: float = column("least squares less nominal")
    published_offset: float = column("published less nominal; empty where none is printed")
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
