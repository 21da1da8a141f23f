"""The tables of a study's results as pandas frames."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.density.least_squares import LeastSquaresFit, identify, list_identified
from bayescal.experiments.shared.estimate import Fit
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.variant_tables import (
    NOISE,
    compute_contraction,
    judge_contraction,
    tabulate_parameters,
)
from bayescal.experiments.study.fit import Task, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.published import read_published
from bayescal.experiments.study.summary import list_nominal
from bayescal.files.csv_tables import format_table
from bayescal.inference.importance import smooth_weights
from bayescal.limits import PARETO_K_LIMIT
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.beam import CIRCLE, PIVOT, compute_beam_shift, compute_circle_shift
from bayescal.numerics.geometry import rotation_vector_from_matrix
from bayescal.numerics.units import MICROMETRE

BENDING, N_BENDINGS = 1.0, 51  # deg
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


def tabulate_tau_scale(inputs: StudyInputs, posteriors: dict[Task, Fit]) -> pd.DataFrame:
    """Return the log-evidence of every variant for other scales of the model error's half-normal prior.

    Only this prior changes: Z(s) / Z(s0) is the mean of Π p(τ; s) / p(τ; s0) over the posterior's draws. Where the
    weights of these have a heavy tail the posterior lies elsewhere, and there is no answer.
    """
    rows = []
    own = inputs.config.leg_error.scale_um
    for task, fit in posteriors.items():
        if not task.with_model_error:
            continue
        tau = fit.draws[..., [name.startswith("tau") for name in fit.names]]
        square = np.sum((tau / MICROMETRE) ** 2, axis=-1).ravel()
        for scale in inputs.config.sensitivity.tau_scale_um:
            log_weights = tau.shape[-1] * np.log(own / scale) + 0.5 * square * (own**-2 - scale**-2)
            gain = float(logsumexp(log_weights) - np.log(len(log_weights)))
            relative = np.exp(log_weights - gain)
            pareto_k = 0.0 if scale == own else smooth_weights(log_weights)[1]
            trusted = pareto_k <= PARETO_K_LIMIT
            rows.append(
                {
                    "variant": task.variant,
                    "tau_scale_um": scale,
                    "log_evidence": fit.importance.log_evidence + gain if trusted else np.nan,
                    "efficiency": 1.0 / np.mean(relative**2),
                    "pareto_k": pareto_k,
                }
            )
    table = pd.DataFrame(rows)
    return table.sort_values(["tau_scale_um", "log_evidence"], ascending=[True, False], ignore_index=True)


def tabulate_all_parameters(inputs: StudyInputs, fits: dict[Task, Fit]) -> pd.DataFrame:
    """Return one row per variant, setting of the model error and parameter."""
    frames = []
    for task, fit in fits.items():
        verdicts = judge_contraction(compute_contraction(fit.sd, fit.prior_sd))
        known = inputs.likelihood(inputs.variant(task.variant), verification=False).layout.names
        own = [v if name in known else NOISE for name, v in zip(fit.names, verdicts, strict=True)]
        nominal = list(list_nominal(inputs, task.variant, fit.names))
        frames.append(tabulate_parameters(task.variant, fit, nominal, own, task.setting))
    return pd.concat(frames, ignore_index=True)


def tabulate_pose_errors(inputs: StudyInputs, fits: dict[Task, Fit]) -> pd.DataFrame:
    """Return one row per variant, setting and pose: errors, predictive intervals and bounds (mm, degrees)."""
    scale = np.array([1.0, 1.0, 1.0, *[np.degrees(1.0)] * 3])
    units = ("mm", "mm", "mm", "deg", "deg", "deg")
    frames = []
    for task, fit in fits.items():
        prediction = read_prediction(fit)
        error, low, high = (part * scale for part in (prediction.error, prediction.low, prediction.high))
        frame = pd.DataFrame(
            {
                "variant": task.variant,
                "model_error": task.setting,
                "pose": inputs.names,
                "use": np.where(inputs.verification, "verification", "calibration"),
                "position_error_mm": prediction.position_error,
                "position_bound_95_mm": prediction.position_bound,
                "orientation_error_deg": np.degrees(prediction.orientation_error),
                "orientation_bound_95_deg": np.degrees(prediction.orientation_bound),
            }
        )
        for k, (component, unit) in enumerate(zip(COMPONENTS, units, strict=True)):
            frame[f"{component}_error_{unit}"] = error[:, k]
            frame[f"{component}_low_{unit}"] = low[:, k]
            frame[f"{component}_high_{unit}"] = high[:, k]
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def identify_variants(inputs: StudyInputs) -> dict[str, LeastSquaresFit]:
    """Return the least-squares identification of every variant by its name (RR-8096 section 7).

    It takes poses as they stand in the base frame; where an instrument measures them in part, or in a frame of its own,
    there is none.
    """
    if not inputs.measured.has_poses:
        return {}
    poses = inputs.poses(verification=False)
    return {v.name: identify(inputs.machine(v), poses, inputs.free(v)) for v in inputs.config.variants}


def tabulate_least_squares(inputs: StudyInputs, fits: dict[str, LeastSquaresFit]) -> pd.DataFrame:
    """Return what least squares found for every variant, beside the published values."""
    rows = []
    for variant in (one for one in inputs.config.variants if one.name in fits):
        machine, fit = inputs.machine(variant), fits[variant.name]
        name = variant.published
        published = {} if name is None else read_published(inputs.folder / name, inputs.mechanism.n_legs)
        for symbol in list_identified(machine, inputs.free(variant)):
            index = machine.layout.index[symbol]
            for leg, k in enumerate(index, start=1):
                offset = fit.theta[k] - machine.layout.nominal[k]
                known = published.get((symbol, leg), np.nan)
                rows.append(
                    {
                        "variant": variant.name,
                        "parameter": symbol,
                        "leg": leg,
                        "unit": machine.layout.units[k],
                        "nominal": machine.layout.nominal[k],
                        "offset": offset,
                        "published_offset": known,
                        "difference": offset - known,
                        "leg_residual_rms_um": 1e3 * fit.residual_rms[leg - 1],
                        "converged": fit.converged,
                    }
                )
    return pd.DataFrame(rows)


def tabulate_flexure(mechanism: Mechanism) -> pd.DataFrame:
    """Return how a flexure's end moves as it bends up to 1 deg: beam, ideal pivot and circle (RR-8096 figure 9)."""
    if mechanism.flexures is None:
        return pd.DataFrame()
    degrees = np.linspace(0.0, BENDING, N_BENDINGS)
    frames = []
    for length in np.unique(mechanism.flexures.lengths):
        along, across = compute_beam_shift(np.radians(degrees), float(length))
        circle = compute_circle_shift(across, CIRCLE * length)
        columns = {
            "flexure_length_mm": length,
            "bending_deg": degrees,
            "across_um": 1e3 * across,
            "along_beam_um": 1e3 * along,
            "along_pivot_um": 1e3 * compute_circle_shift(across, PIVOT * length),
            "along_circle_um": 1e3 * circle,
            "circle_error_nm": 1e6 * (circle - along),
        }
        frames.append(pd.DataFrame(columns))
    return pd.concat(frames, ignore_index=True)


def tabulate_ring(inputs: StudyInputs) -> pd.DataFrame:
    """Return the measured deflection of every joint at every pose, µm, with its standard deviation."""
    if inputs.deflection is None:
        return pd.DataFrame()
    sd = np.sqrt(np.diagonal(inputs.deflection.covariance, axis1=-2, axis2=-1))
    n_poses, n_legs = inputs.displacement.shape
    return pd.DataFrame(
        {
            "pose": np.repeat(inputs.names, n_legs),
            "use": np.repeat(np.where(inputs.verification, "verification", "calibration"), n_legs),
            "leg": np.tile(np.arange(1, n_legs + 1), n_poses),
            "actuator_displacement_mm": inputs.displacement.ravel(),
            "deflection_um": 1e3 * inputs.deflection.displacement.ravel(),
            "deflection_sd_um": 1e3 * sd.ravel(),
        }
    )


def tabulate_deformation(inputs: StudyInputs) -> pd.DataFrame:
    """Return κ and K from the targets with posterior standard deviations, in 1e-3."""
    if inputs.measured_matrix is None or inputs.measured_kappa is None:
        return pd.DataFrame()
    n = inputs.mechanism.n_legs
    rows = [
        {"quantity": "kappa", "leg": i + 1, "actuator": i + 1, "mean_1e-3": 1e3 * k, "sd_1e-3": 1e3 * s}
        for i, (k, s) in enumerate(zip(inputs.measured_kappa.kappa, inputs.measured_kappa.sd, strict=True))
    ]
    rows += [
        {
            "quantity": "K",
            "leg": i + 1,
            "actuator": j + 1,
            "mean_1e-3": 1e3 * inputs.measured_matrix.matrix[i, j],
            "sd_1e-3": 1e3 * inputs.measured_matrix.sd[i, j],
        }
        for i in range(n)
        for j in range(n)
    ]
    return pd.DataFrame(rows)


def format_poses(inputs: StudyInputs) -> str:
    """Return the extracted poses as CSV text: position (mm), rotation vector (degrees) and covariance (µm, µrad)."""
    poses = inputs.measured.poses
    pairs = [(i, j) for i in range(6) for j in range(i, 6)]
    rotation = np.degrees(rotation_vector_from_matrix(poses.rotation))
    scale = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])  # mm and rad to µm and µrad
    covariance = poses.covariance * np.outer(scale, scale)
    columns = ["pose", "use", "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    columns += [f"cov_{COMPONENTS[i]}_{COMPONENTS[j]}" for i, j in pairs]
    rows = [
        (
            name,
            "verification" if held else "calibration",
            *(f"{x:.7f}" for x in poses.position[k]),
            *(f"{x:.8f}" for x in rotation[k]),
            *(f"{covariance[k, i, j]:.6g}" for i, j in pairs),
        )
        for k, (name, held) in enumerate(zip(poses.names, inputs.verification, strict=True))
    ]
    comments = [
        name_origin(inputs.config.origin.model_dump()),
        "Pose of the platform frame in the base frame; position in mm, rotation vector in degrees.",
        "cov: covariance of position (µm) and of the rotation vector (µrad) about the base axes.",
    ]
    return format_table(comments, columns, rows)
