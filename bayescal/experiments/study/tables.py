"""What a study of an instrument's poses found, as tables and as numbers of its summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.config.classes import label_class
from bayescal.density.errors import TAU
from bayescal.density.least_squares import LeastSquaresFit, identify, list_identified
from bayescal.density.legs import POSES
from bayescal.density.prediction import Prediction, compute_elpd, compute_joint_elpd, measure_length, summarise_misfit
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.estimate import Arrays, Fit
from bayescal.experiments.shared.joints import tabulate_joints
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.readings.knowledge import plain
from bayescal.experiments.shared.stacking import compare_variants, find_tied, tabulate_comparison
from bayescal.experiments.shared.study_inputs import Described, Task
from bayescal.experiments.shared.trees import SAVED_DRAWS, spread
from bayescal.experiments.shared.variant_tables import (
    FREE,
    NOISE,
    ZERO,
    compute_contraction,
    describe_fit,
    judge_contraction,
    tabulate_left_out,
    tabulate_parameters,
)
from bayescal.experiments.study.calibrated import ERRORS, tabulate_leg_errors
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.fit import read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.model_error import tabulate_model_error
from bayescal.experiments.study.published import read_published
from bayescal.files.csv_tables import format_table
from bayescal.inference.importance import smooth_weights
from bayescal.limits import OUTLIER, PARETO_K_LIMIT
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.beam import CIRCLE, PIVOT, compute_beam_shift, compute_circle_shift
from bayescal.machines.models.legs import list_dimensions
from bayescal.numerics.geometry import Array, rotation_vector_from_matrix
from bayescal.numerics.units import MICROMETRE
from bayescal.report.symbols import is_model_error, split_name

BENDING, N_BENDINGS = 1.0, 51  # deg
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
PITS = tuple(f"{name}_pit" for name in (*COMPONENTS, "position", "orientation"))
SETTINGS = {FREE: "variants", ZERO: "without_model_error"}
"""Names of the variants' tables, by the setting of the model error."""
TINY = 1e-300


def describe_poses(inputs: StudyInputs, fits: Mapping[Task, Fit], run: Run) -> Described:
    """Return variants, parameters, errors of poses, and what the targets on the pads show of the joints."""
    del run
    fits = _give_both_settings(fits)
    tables, variants = _summarise_variants(inputs, fits)
    tables |= {
        "parameters": _tabulate_all_parameters(inputs, fits),
        "pose_errors": _tabulate_pose_errors(inputs, fits),
        "poses": _tabulate_poses(inputs, fits),
        "tau_scale": _tabulate_tau_scale(inputs, fits),
        "flexure": tabulate_flexure(inputs.mechanism),
        "ring": _tabulate_ring(inputs),
        "deformation": _tabulate_deformation(inputs),
        ERRORS: tabulate_leg_errors(inputs, {task.variant: fit for task, fit in fits.items() if task.with_model_error}),
        "joints": tabulate_joints(inputs.mechanism, inputs.measured.actuators, inputs.names),
    }
    tables |= tabulate_model_error(inputs, fits)
    return Described(variants, tables, _summarise(inputs, fits))


def _give_both_settings(fits: Mapping[Task, Fit]) -> dict[Task, Fit]:
    """Return fits by task; where some variants have no model error, their only fit stands for both settings."""
    if all(task.with_model_error for task in fits):
        return dict(fits)
    names = [task.variant for task in fits if task.with_model_error]
    both = [Task(name, with_model_error) for with_model_error in (True, False) for name in names]
    return {task: fits.get(task, fits[Task(task.variant)]) for task in both}


def put_to_claims(inputs: StudyInputs, summary: Mapping[str, Any], run: Run) -> dict[str, pd.DataFrame]:
    """Return least squares, and a publication's claims put to the study."""
    identified = run.once("least squares", identify_variants, inputs, (LeastSquaresFit,))
    tables, claims = {"least_squares": tabulate_least_squares(inputs, identified)}, inputs.claims
    if claims is not None:
        tables["claims"] = run.once("claims", _judge, (claims, inputs, dict(summary), identified))
    return tables


def _judge(task: tuple[Claims, StudyInputs, dict[str, Any], dict[str, LeastSquaresFit]]) -> pd.DataFrame:
    claims, inputs, summary, identified = task
    return claims.tabulate(inputs, summary, identified)


def _summarise(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> dict[str, Any]:
    """Return what the summary has of measurements, models and noise (a position's, rms over the poses of each use)."""
    config, seen = inputs.config, {one.name: inputs.machine(one) for one in inputs.config.variants}
    named = {
        variant.name: dict(zip(("model", "deformation"), map(label_class, variant.seen), strict=True))
        for variant in config.variants
        if variant.has_own_name
    }
    free = {symbol for variant in config.variants for symbol in inputs.free(variant)}
    held = {name: [one for one in list_dimensions(machine.layout) if one not in free] for name, machine in seen.items()}
    noise = {}
    for use, verification in (("calibration", False), ("verification", True)):
        covariance = inputs.poses(verification).covariance[:, :3, :3]
        if inputs.measured.has_poses and len(covariance):
            noise[use] = float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean()) / MICROMETRE)
    chosen = {task.variant: fit for task, fit in fits.items() if task.with_model_error}
    optional = {
        "measurement_noise_um": noise,
        "own_names": named,
        "not_free": {name: symbols for name, symbols in held.items() if symbols},
        "stacked": describe_stacking(inputs, chosen) if len(chosen) > 1 else None,
        "publication": None if inputs.claims is None else inputs.claims.describe(),
        "unused": inputs.unused,
    }
    return {
        "models": {label_class(variant.seen[0]): seen[variant.name].model.title for variant in config.variants},
        "drive": inputs.mechanism.drive,
        "tau_scale_um": inputs.config.leg_error.scales(inputs.actuator_noise)[0] / MICROMETRE,
        **inputs.measured.describe(),
        **{key: value for key, value in optional.items() if value},
    }


def _summarise_variants(
    inputs: StudyInputs, posteriors: Mapping[Task, Fit]
) -> tuple[dict[str, pd.DataFrame], dict[str, dict[str, Any]]]:
    """Return variants as tables, ``variants`` and ``without_model_error``, and as the summary has them.

    There each has what no table has, and under ``without_model_error`` the same of that setting; mm and degrees.
    """
    tables, nested = {}, {}
    for setting, name in SETTINGS.items():
        if not any(task.setting == setting for task in posteriors):
            continue
        fits = {task.variant: fit for task, fit in posteriors.items() if task.setting == setting}
        found = {variant: _describe(inputs, variant, fit) for variant, fit in fits.items()}
        rows = pd.DataFrame([{"variant": variant, **row} for variant, (row, _) in found.items()])
        table = tabulate_comparison(rows, {variant: fit.left_out for variant, fit in fits.items()}, "data")
        own = {str(row.pop("variant")): plain(row) for row in table.to_dict("records")}
        tables[name] = table
        nested[setting] = {variant: own[variant] | more for variant, (_, more) in found.items()}
    also = {name: {SETTINGS[ZERO]: one} for name, one in nested.get(ZERO, {}).items()}
    return tables, {name: one | also.get(name, {}) for name, one in nested[FREE].items()}


def _describe(inputs: StudyInputs, variant: str, fit: Fit) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return one posterior's row, and what of it no table has."""
    config, held, prediction = inputs.variant(variant), inputs.verification, read_prediction(fit)
    title = f"{inputs.machine(config).model.title}/{label_class(config.deformation)}"
    errors = {"calibration": summarise_errors(prediction.select(~held))}
    row = {
        "title": variant if config.has_own_name else title,
        "data": f"{int((~held).sum())} poses",
        "n_poses": int((~held).sum()),
        **describe_fit(fit),
        "acceptance": float(fit.acceptance.mean()),
        "elpd": float("nan"),
        "misfit": fit.misfit.factor,
    }
    more: dict[str, Any] = {"wall_seconds": fit.wall_seconds, "verification": None}
    if held.any():
        pointwise = fit.evaluated["log_likelihood"][..., held].reshape(-1, held.sum())
        joint = fit.evaluated["joint_density"].reshape(-1, 1) if "joint_density" in fit.evaluated else pointwise
        row["elpd"], row["elpd_se"] = compute_joint_elpd(joint)
        row["elpd_pose_by_pose"] = compute_elpd(pointwise)
        errors["verification"] = summarise_errors(prediction.select(held))
    for use, one in errors.items():
        for what, unit in (("position", "mm"), ("orientation", "deg")):
            row |= {f"{use}_{what}_error_{k}_{unit}": one[f"{what}_error_{unit}"][k] for k in ("mean", "max")}
    row["distance_from_nominal_mm"] = _measure_distance(inputs, variant, fit)
    row["distance_from_nominal_prior_sd"] = fit.pulls.factor
    if fit.correction is not None:
        row["exact_density_shift"], row["exact_density_se"] = fit.correction.log_ratio, fit.correction.standard_error
        row["exact_density_efficiency"] = float(fit.correction.efficiency)
        row["exact_density_pareto_k"] = float(fit.correction.pareto_k)
    return row, more | errors


def summarise_errors(prediction: Prediction) -> dict[str, Any]:
    """Return mean and largest errors of a prediction, and the coverage of its intervals."""
    position, orientation = prediction.position_error, np.degrees(prediction.orientation_error)
    return {
        "position_error_mm": _summarise_sizes(position),
        "orientation_error_deg": _summarise_sizes(orientation),
        "interval_90_coverage": prediction.coverage,
        "bound_95_coverage": float(np.mean((position <= prediction.position_bound)[np.isfinite(position)])),
    }


def _summarise_sizes(sizes: Array) -> dict[str, float | None]:
    """Return mean and largest of what was measured; None where nothing was."""
    known = sizes[np.isfinite(sizes)]
    return {"mean": float(known.mean()) if len(known) else None, "max": float(known.max()) if len(known) else None}


def _list_nominal(inputs: StudyInputs, variant: str, names: tuple[str, ...]) -> Array:
    """Return nominal values of parameters, zero of what is none of the machine."""
    layout = inputs.likelihood(inputs.variant(variant), verification=False).layout
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    return np.array([float(nominal.get(name, 0.0)) for name in names])


def _measure_distance(inputs: StudyInputs, variant: str, fit: Fit) -> float:
    """Return how far the lengths moved from nominal, rms, mm."""
    own = [not is_model_error(split_name(name)[0]) for name in fit.names]
    lengths = np.array(own) & (np.array(fit.units) == "mm")
    moved = (fit.mean - _list_nominal(inputs, variant, fit.names))[lengths]
    return float(np.sqrt(np.mean(moved**2))) if len(moved) else 0.0


# --- poses that a posterior has not seen -------------------------------------------------------------------------


def _tabulate_poses(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> pd.DataFrame:
    """Return one row per posterior and pose: its density given the others, and where it lies in its prediction.

    The PIT of a measured pose, 0 to 1, says where in the predictive distribution it lies: by components, and by the
    sizes of both errors. A calibration pose is left out by Pareto-smoothed weights, or by a run where these fail; then
    the PITs still rest on the weights. A verification pose is none that the posterior has seen. Where poses may be
    outliers, ``contradicting`` are those that probably are.
    """
    held = inputs.verification
    frames = []
    for task, fit in fits.items():
        flat = fit.evaluated["log_likelihood"].reshape(-1, len(held))[:, held]
        elpd = logsumexp(flat, axis=0) - np.log(len(flat))
        frame = tabulate_left_out(task.variant, fit, inputs.names, held, elpd, task.setting)
        if "outlier_probability" in fit.evaluated:
            outlier = fit.evaluated["outlier_probability"]
            frame = frame.assign(outlier_probability=outlier, contradicting=outlier > OUTLIER)
        pits = pd.DataFrame(compute_pits(fit.evaluated, held), columns=list(PITS))
        frames.append(pd.concat([frame, pits], axis=1))
    table = pd.concat(frames, ignore_index=True)
    if "contradicting" in table:  # of variants that expect none no pose does
        table["contradicting"] = table["contradicting"].eq(True)
    return table


def compute_pits(arrays: Arrays, held: np.ndarray) -> Array:
    """Return where each measured pose lies in its predictive distribution, itself left out, shape (P, 8).

    By its six components, then by the distance and the angle from the mean prediction; NaN where not measured.
    """
    flat = arrays["log_likelihood"].reshape(-1, len(held)).T
    parts = [slice(k, k + POSES) for k in range(0, len(held), POSES)]
    return np.concatenate([_compute_pits(arrays["misfit"][part], flat[part], held[part]) for part in parts])


def _compute_pits(misfit: Array, flat: Array, held: np.ndarray) -> Array:
    """Return `compute_pits` from measured minus replicated poses (P, T, 6) and log-densities (P, S)."""
    from arviz_stats.base import array_stats  # seconds to import, for those who sample

    misfit = misfit.astype(np.float64)
    log_weights = np.zeros(misfit.shape[:2])
    if not held.all():
        log_weights[~held], _ = array_stats.psislw(flat[~held][:, spread(flat.shape[1], misfit.shape[1])])
    weights = np.exp(log_weights - logsumexp(log_weights, axis=1, keepdims=True))
    mean = np.einsum("pt,ptk->pk", weights, misfit)
    away = mean[:, None] - misfit  # replicated minus mean prediction
    measured = [np.zeros(misfit.shape[::2]), *(measure_length(mean[:, k])[:, None] for k in (slice(0, 3), slice(3, 6)))]
    replicated = [-misfit, *(measure_length(away[..., k])[..., None] for k in (slice(0, 3), slice(3, 6)))]
    made, seen = np.concatenate(replicated, axis=-1), np.concatenate(measured, axis=-1)
    pits = np.einsum("pt,ptk->pk", weights, made <= seen[:, None])
    known = np.isfinite(made).all(axis=1)
    return np.where(known, np.clip(pits, 0.0, 1.0), np.nan)


def describe_stacking(inputs: StudyInputs, fits: Mapping[str, Fit]) -> dict[str, Any] | None:
    """Return weights and errors of the stacked prediction of the variants that tie; None where one leads alone."""
    left_out = {name: fit.left_out for name, fit in fits.items()}
    tied = find_tied(compare_variants(left_out))
    if len(tied) < 2:
        return None
    weights = compare_variants({name: left_out[name] for name in tied})["weight"].to_dict()
    chosen = {str(name): float(weight) for name, weight in weights.items()}
    mean, misfit = _mix(fits, chosen)
    prediction, held = summarise_misfit(mean, misfit), inputs.verification
    found: dict[str, Any] = {"weights": chosen, "calibration": summarise_errors(prediction.select(~held))}
    if held.any():
        density = [_joint_density(fits[name], held) + np.log(max(w, TINY)) for name, w in chosen.items()]
        found["verification"] = summarise_errors(prediction.select(held))
        found["elpd"] = float(logsumexp(density))
    return found


def _mix(fits: Mapping[str, Fit], weights: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the mixture's mean error (P, 6) and replicates (T, P, 6), of each variant as many as its weight says."""
    mean = sum(weight * read_prediction(fits[name]).error for name, weight in weights.items())
    parts = [
        _take(fits[name].evaluated["misfit"], round(weight * SAVED_DRAWS))
        for name, weight in weights.items()
        if round(weight * SAVED_DRAWS)
    ]
    return np.asarray(mean), np.concatenate(parts, axis=1).swapaxes(0, 1).astype(np.float64)


def _take(misfit: Array, n: int) -> Array:
    return misfit[:, spread(misfit.shape[1], n)]


def _joint_density(fit: Fit, held: np.ndarray) -> float:
    joint = fit.evaluated["log_likelihood"][..., held].sum(axis=-1)
    joint = fit.evaluated.get("joint_density", joint)
    return float(logsumexp(joint) - np.log(joint.size))


# --- other tables ------------------------------------------------------------------------------------------------


def _tabulate_tau_scale(inputs: StudyInputs, posteriors: Mapping[Task, Fit]) -> pd.DataFrame:
    """Return the log-evidence of every variant for other scales of the model error's half-normal prior.

    Only this prior changes: Z(s) / Z(s0) is the mean of Π p(τ; s) / p(τ; s0) over the posterior's draws. Where the
    weights of these have a heavy tail the posterior lies elsewhere, and there is no answer.
    """
    rows = []
    own = inputs.config.leg_error.scales(inputs.actuator_noise)[0] / MICROMETRE
    for task, fit in posteriors.items():
        if not task.with_model_error:
            continue
        tau = fit.draws[..., [name.partition("[")[0] == TAU for name in fit.names]]
        if not tau.shape[-1]:
            continue
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
    by = ["tau_scale_um", "log_evidence"]
    return table.sort_values(by, ascending=[True, False], ignore_index=True) if rows else table


def _tabulate_all_parameters(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> pd.DataFrame:
    """Return one row per variant, setting of the model error and parameter."""
    frames = []
    for task, fit in fits.items():
        verdicts = judge_contraction(compute_contraction(fit.sd, fit.prior_sd))
        known = inputs.likelihood(inputs.variant(task.variant), verification=False).layout.names
        own = [v if name in known else NOISE for name, v in zip(fit.names, verdicts, strict=True)]
        nominal = list(_list_nominal(inputs, task.variant, fit.names))
        frames.append(tabulate_parameters(task.variant, fit, nominal, own, task.setting))
    return pd.concat(frames, ignore_index=True)


def _tabulate_pose_errors(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> pd.DataFrame:
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


def _tabulate_ring(inputs: StudyInputs) -> pd.DataFrame:
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


def _tabulate_deformation(inputs: StudyInputs) -> pd.DataFrame:
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
