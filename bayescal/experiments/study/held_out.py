"""How well poses are predicted that a posterior has not seen: pose by pose, variant against variant, and stacked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.density.legs import POSES
from bayescal.density.prediction import measure_length, summarise_misfit
from bayescal.experiments.shared.estimate import Arrays, Fit
from bayescal.experiments.shared.stacking import compare_variants, find_tied
from bayescal.experiments.shared.trees import SAVED_DRAWS, spread
from bayescal.experiments.shared.variant_tables import tabulate_left_out
from bayescal.experiments.study.fit import Task, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.summary import summarise_errors
from bayescal.limits import BLUNDER
from bayescal.numerics.geometry import Array

PITS = tuple(f"{name}_pit" for name in ("x", "y", "z", "rx", "ry", "rz", "position", "orientation"))


def tabulate_poses(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> pd.DataFrame:
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
        if "blunder_probability" in fit.evaluated:
            outlier = fit.evaluated["blunder_probability"]
            frame = frame.assign(outlier_probability=outlier, contradicting=outlier > BLUNDER)
        pits = pd.DataFrame(compute_pits(fit.evaluated, held), columns=list(PITS))
        frames.append(pd.concat([frame, pits], axis=1))
    return pd.concat(frames, ignore_index=True)


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


TINY = 1e-300


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
    return float(logsumexp(joint) - np.log(joint.size))
