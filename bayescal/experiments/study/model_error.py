"""The model error of a study of legs, term by term: what is kept of its posteriors, and the tables that say how large.

Its terms are what all poses have alike, drawn anew at every pose (τ), and functions of the pose of several sorts
(`bayescal.density.functions`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import pandas as pd

from bayescal.density.directions import CAUSES
from bayescal.density.errors import TAU
from bayescal.density.functions import FunctionLikelihood, LegRows
from bayescal.density.legs import LegPosterior, Likelihood
from bayescal.density.prediction import FUNCTION_DRAWS, draw_functions, predict_given
from bayescal.density.schema import TERMS
from bayescal.experiments.shared.estimate import Arrays, Fit
from bayescal.experiments.shared.function_errors import tabulate_causes
from bayescal.experiments.shared.hidden import tabulate_hidden
from bayescal.experiments.shared.trees import spread
from bayescal.identifiability.hidden import hide_in_posterior
from bayescal.inference.causes import NONE, Alone, weigh_causes
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

if TYPE_CHECKING:
    from bayescal.experiments.shared.study_inputs import Task
    from bayescal.experiments.study.inputs import StudyInputs

OF_FUNCTIONS = "function_"
"""Before the names of arrays of the functions: fields of `FunctionDraws`."""
BY_LEG = "function_by_leg"
HIDDEN = "function_hidden"
ALONE = "function_alone"
BY_POSE = ("mean", "low", "high")


def evaluate_functions(
    posterior: LegPosterior,
    others: Likelihood | None,
    held: np.ndarray,
    y: Array,
    chosen: np.ndarray,
    seed: np.random.SeedSequence,
    unseen: Mapping[str, float],
) -> Arrays:
    """Return densities, predictions and the functions at all poses, from draws (E, S, n), and what they may hide.

    The density of a calibration pose is that given all other ones, that of a held-back pose given the calibration
    poses; so are they predicted.

    Parameters
    ----------
    posterior : LegPosterior
        Of the calibration poses, by a `FunctionLikelihood`.
    others : Likelihood or None
        Density of the held-back poses by themselves.
    held : ndarray of bool, shape (P,)
        Which poses are held back.
    y : ndarray, shape (E, S, n)
    chosen : ndarray of int, shape (T,)
        Draws, chains laid end to end, whose replicates are kept.
    seed : SeedSequence
    unseen : mapping of str to float
        Root mean squares by term, mm, of errors that leave no trace.
    """
    likelihood, flat = cast("FunctionLikelihood", posterior.likelihood), y.reshape(-1, y.shape[-1])
    rngs = [np.random.default_rng(one) for one in seed.spawn(4)]
    theta, errors = posterior.theta(flat), posterior.errors.amplitudes(posterior.zeta(flat))
    rows, together = cast("LegRows | None", others), {"calibration_density": likelihood(theta, errors)}
    summaries, misfits, densities = list[Arrays](), list[np.ndarray](), list[Array]()
    for some, rng in zip((None, rows) if rows is not None else (None,), rngs, strict=False):
        given = predict_given(likelihood, some, theta, errors, chosen, rng)
        if given.together is not None:
            together["joint_density"] = given.together
        densities.append(given.pointwise)
        summaries.append(vars(given.replicates.summarise()))
        misfits.append(given.replicates.misfit.astype(np.float32).swapaxes(0, 1))
    few = spread(len(flat), FUNCTION_DRAWS)
    functions = vars(draw_functions(likelihood, rows, theta[few], errors[few], rngs[2]))
    back = np.argsort(np.concatenate([np.flatnonzero(held == use) for use in (False, True)]))
    by_pose = {name: np.concatenate([one[name] for one in summaries]) for name in summaries[0]}
    by_pose |= {"misfit": np.concatenate(misfits)} | {OF_FUNCTIONS + name: functions.pop(name) for name in BY_POSE}
    pointwise = np.concatenate(densities, axis=1)[:, back]
    return {
        "log_likelihood": pointwise.reshape(*y.shape[:2], -1),
        **{name: one[back] for name, one in by_pose.items()},
        **{OF_FUNCTIONS + name: one for name, one in functions.items()},
        HIDDEN: hide_in_posterior(posterior, flat, unseen),
        ALONE: _list_causes(weigh_causes(posterior, flat.mean(axis=0), rngs[3]), likelihood.functions.sorts),
        **together,
    }


def _list_causes(weights: Mapping[str, Alone], sorts: Sequence[str]) -> Array:
    """Return `Alone` of none, all sorts and named causes, NaN for what cannot be; empty where nothing is weighed."""
    names = (NONE, *sorts, *CAUSES) if weights else ()
    nothing = [np.nan] * len(Alone._fields)
    return np.array([weights.get(name, nothing) for name in names])


def tabulate_model_error(inputs: StudyInputs, fits: Mapping[Task, Fit]) -> dict[str, pd.DataFrame]:
    """Return what each term of the model error contributes, µm along the legs, as tables by name; some may be empty.

    ``model_error`` has root mean squares over calibration poses and legs, ``model_error_members`` those of each leg, of
    the posterior mean of each term, ``model_error_poses`` all functions together at every pose, ``model_error_hidden``
    what errors that leave no trace hide of each parameter, and ``model_error_alone`` how far one sort of functions
    explains all.
    """
    terms, members, poses, hidden, alone = (list[pd.DataFrame]() for _ in range(5))
    for task, fit in fits.items():
        if not task.with_model_error:
            continue
        sorts, of = inputs.list_sorts(inputs.variant(task.variant)), fit.evaluated
        tau = _find_tau(inputs, task.variant, fit)
        by_term = {"independent": tau} if tau.size else {}
        by_term |= {name: of[f"{OF_FUNCTIONS}size"][:, k] for k, name in enumerate(sorts)}
        terms += [_summarise(task.variant, name, by_term[name]) for name in TERMS if name in by_term]
        if sorts:
            together = np.sqrt(np.mean(of[BY_LEG] ** 2, axis=1))
            terms.append(_summarise(task.variant, "together", together))
            members.append(_tabulate_members(task.variant, sorts, of[f"{OF_FUNCTIONS}mean_by_leg"]))
            poses.append(_tabulate_poses(inputs, task.variant, of))
            n = len(of[HIDDEN])
            if len(of[ALONE]):
                weights = zip((NONE, *sorts, *CAUSES), of[ALONE].tolist(), strict=True)
                there = {name: Alone(*one) for name, one in weights if np.isfinite(one[0])}
                alone.append(tabulate_causes(task.variant, there))
            hidden.append(tabulate_hidden(task.variant, fit.names[:n], fit.units[:n], of[HIDDEN], fit.sd[:n]))
    found = {"model_error": terms, "model_error_members": members, "model_error_poses": poses}
    found |= {"model_error_hidden": hidden, "model_error_alone": alone}
    return {name: pd.concat(frames, ignore_index=True) for name, frames in found.items() if frames}


def _find_tau(inputs: StudyInputs, variant: str, fit: Fit) -> Array:
    """Return draws of τ, mm, root mean square over legs where each has one; empty where there is none."""
    tau = fit.draws[..., [name.partition("[")[0] == TAU for name in fit.names]].reshape(fit.draws[..., 0].size, -1)
    floor = inputs.model_error(inputs.variant(variant)).lengths().get("independent", 0.0)
    return np.sqrt(np.mean(tau**2, axis=1) + floor**2) if tau.shape[1] else np.empty(0)


def _summarise(variant: str, term: str, draws: Array) -> pd.DataFrame:
    low, middle, high = np.quantile(draws / MICROMETRE, [0.05, 0.5, 0.95])
    return pd.DataFrame([{"variant": variant, "term": term, "median_um": middle, "q05_um": low, "q95_um": high}])


def _tabulate_members(variant: str, sorts: tuple[str, ...], size: Array) -> pd.DataFrame:
    """Return root mean squares over calibration poses of posterior means, (C, N), in mm, as rows."""
    legs = [f"leg {leg}" for leg in range(1, size.shape[1] + 1)]
    return pd.DataFrame(
        {
            "variant": variant,
            "member": np.repeat(legs, len(sorts)),
            "term": np.tile(sorts, len(legs)),
            "rms_um": (size.T / MICROMETRE).ravel(),
        }
    )


def _tabulate_poses(inputs: StudyInputs, variant: str, arrays: Arrays) -> pd.DataFrame:
    n_poses, n_legs = inputs.displacement.shape
    return pd.DataFrame(
        {
            "variant": variant,
            "pose": np.repeat(inputs.names, n_legs),
            "use": np.repeat(np.where(inputs.verification, "verification", "calibration"), n_legs),
            "member": np.tile([f"leg {leg}" for leg in range(1, n_legs + 1)], n_poses),
            **{f"{name}_um": (arrays[f"{OF_FUNCTIONS}{name}"] / MICROMETRE).ravel() for name in BY_POSE},
        }
    )
