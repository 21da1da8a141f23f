"""How well poses are predicted that a posterior has not seen: pose by pose, variant against variant, and stacked."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from bayescal.density.batches import POSES
from bayescal.density.prediction import measure_length, summarise_misfit
from bayescal.experiments.shared.trees import SAVED_DRAWS, spread
from bayescal.experiments.study.fit import Arrays, Task, read_left_out, read_prediction
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.summary import summarise_errors
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from arviz_stats.utils import ELPDDataLOO

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
TIED = 2.0
"""Standard errors of the difference of elpd within which two variants predict alike."""


def tabulate_left_out(inputs: StudyInputs, fits: Mapping[Task, Arrays]) -> pd.DataFrame:
    """Return one row per posterior and pose: the density it gives to a pose that it has not seen, and where this lies.

    The PIT of a measured pose, 0 to 1, says where in the predictive distribution it lies: by components, and by the
    sizes of both errors. A calibration pose is left out by Pareto-smoothed weights, or by a run where these fail; then
    the PITs still rest on the weights. A verification pose is none that the posterior has seen.
    """
    held = inputs.verification
    frames = []
    for task, arrays in fits.items():
        left_out, pits = read_left_out(arrays), compute_pits(arrays, held)
        flat = arrays["log_likelihood"].reshape(-1, len(held))
        elpd = logsumexp(flat, axis=0) - np.log(len(flat))
        elpd[~held] = left_out.elpd
        frame = pd.DataFrame(
            {
                "variant": task.variant,
                "model_error": "free" if task.with_model_error else "zero",
                "pose": inputs.names,
                "use": np.where(held, "verification", "calibration"),
                "elpd": elpd,
                "pareto_k": _over_all(left_out.pareto_k, held, np.nan),
                "refitted": _over_all(left_out.was_refitted, held, False).astype(bool),
            }
        )
        names = [f"{name}_pit" for name in (*COMPONENTS, "position", "orientation")]
        frames.append(pd.concat([frame, pd.DataFrame(pits, columns=names)], axis=1))
    return pd.concat(frames, ignore_index=True)


def _over_all(values: Array, held: np.ndarray, elsewhere: float) -> Array:
    """Return values of the calibration poses (P',) at all poses (P,)."""
    spread_out = np.full(len(held), elsewhere)
    spread_out[~held] = values
    return spread_out


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


# --- variants against each other -------------------------------------------------------------------------------------


def compare_variants(fits: Mapping[str, Arrays]) -> pd.DataFrame:
    """Return elpd differences from the best variant with standard errors over the poses, and stacking weights.

    The densities of each pose are taken relative to the best variant's there: neither differences nor weights change,
    and no exponential overflows.
    """
    from arviz_stats import compare

    left_out = {name: read_left_out(arrays) for name, arrays in fits.items()}
    best = np.max([one.elpd for one in left_out.values()], axis=0)
    data = {name: _as_elpd_data(one.elpd - best, one.pareto_k) for name, one in left_out.items()}
    with warnings.catch_warnings():
        # bad poses are refitted or counted, and which variant to choose the evidence says
        warnings.simplefilter("ignore", UserWarning)
        return compare(data, method="stacking", round_to="none")


def _as_elpd_data(elpd: Array, pareto_k: Array) -> ELPDDataLOO:
    import xarray as xr
    from arviz_stats.utils import ELPDDataLOO

    n = len(elpd)
    pointwise, k = (xr.DataArray(values, dims=["calibration_pose"]) for values in (elpd, pareto_k))
    se = float(np.sqrt(n * np.var(elpd)))
    return ELPDDataLOO(
        elpd=float(elpd.sum()),
        se=se,
        p=0.0,
        n_samples=0,
        n_data_points=n,
        scale="log",
        warning=False,
        good_k=PARETO_K_LIMIT,
        elpd_i=pointwise,
        pareto_k=k,
    )


def find_tied(comparison: pd.DataFrame) -> list[str]:
    """Return the variants whose elpd is within two standard errors of the best one's, that one first."""
    tied = comparison["elpd_diff"].abs() <= TIED * comparison["dse"]
    tied.iloc[0] = True
    return [str(name) for name in comparison.index[tied]]


def describe_stacking(inputs: StudyInputs, fits: Mapping[str, Arrays]) -> dict[str, Any] | None:
    """Return weights and errors of the stacked prediction of the variants that tie; None where one leads alone."""
    tied = find_tied(compare_variants(fits))
    if len(tied) < 2:
        return None
    weights = compare_variants({name: fits[name] for name in tied})["weight"].to_dict()
    chosen = {str(name): float(weight) for name, weight in weights.items()}
    mean, misfit = _mix(fits, chosen)
    prediction, held = summarise_misfit(mean, misfit), inputs.verification
    found: dict[str, Any] = {"weights": chosen, "calibration": summarise_errors(prediction.select(~held))}
    if held.any():
        density = [_joint_density(fits[name], held) + np.log(max(w, TINY)) for name, w in chosen.items()]
        found["verification"] = {**summarise_errors(prediction.select(held)), "elpd": float(logsumexp(density))}
    return found


TINY = 1e-300


def _mix(fits: Mapping[str, Arrays], weights: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the mixture's mean error (P, 6) and replicates (T, P, 6), of each variant as many as its weight says."""
    mean = sum(weight * read_prediction(fits[name]).error for name, weight in weights.items())
    parts = [
        fits[name]["misfit"][:, spread(fits[name]["misfit"].shape[1], round(weight * SAVED_DRAWS))]
        for name, weight in weights.items()
        if round(weight * SAVED_DRAWS)
    ]
    return np.asarray(mean), np.concatenate(parts, axis=1).swapaxes(0, 1).astype(np.float64)


def _joint_density(arrays: Arrays, held: np.ndarray) -> float:
    joint = arrays["log_likelihood"][..., held].sum(axis=-1)
    return float(logsumexp(joint) - np.log(joint.size))
