"""Errors at the tool before and after the calibration, of poses that an instrument saw, and requirements on them.

Before it the machine is what the priors expect; its instrument stands where the calibration found it. A best fit of six
numbers of the base frame, by the calibration poses, is taken out of both, unless accuracy is stated in the base frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from bayescal.calibrated.in_use import MachineInUse
from bayescal.density.calibration.prediction import predict_poses
from bayescal.density.calibration.terms import ErrorModel
from bayescal.density.prediction import Prediction
from bayescal.errors import NumericalError
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import linearise_workspace
from bayescal.experiments.shared.requirements import name_required_units, read_requirements
from bayescal.experiments.shared.rows import USES
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.experiments.study.rows import BeforeAfterRow, RequirementResultRow
from bayescal.experiments.study.tables import find_seen
from bayescal.identifiability.reading_rows import typical_given
from bayescal.identifiability.requirements import RequirementSummary
from bayescal.numerics.geometry import Array

ALL = "all"  # what requirements are called together
AXES = "xyz"
FEWEST = 6  # poses that six numbers of a frame are fitted to
DRAWS = 500  # of the posterior, that stand for the true machine
KEPT = 0.95  # probability with which an error is said to be kept


def tabulate_before_after(
    variant: Variant, found: Prediction | None, mean: Mapping[str, float], rng: np.random.Generator
) -> pd.DataFrame:
    """Return the position errors of poses that an instrument saw, mm, a row a pose; no rows where it saw none.

    Parameters
    ----------
    variant : Variant
    found : Prediction or None
        Errors of all poses by the calibrated machine.
    mean : mapping of str to float
        Of the posterior, by the names of parameters.
    rng : Generator
    """
    seen = find_seen(variant.model)
    channels = [variant.model.channels[k] for k in seen[:3] if k is not None]
    named = [one.stem[-1:] for one in channels] == list(AXES[: len(channels)])
    if found is None or not channels or not named or len({one.kind for one in channels}) not in (1, len(channels)):
        return pd.DataFrame()
    places, plain = [k for k in seen[:3] if k is not None], replace(variant.plain(), errors=ErrorModel())
    expected, frames = np.zeros((1, plain.n_geometry)), set(variant.model.instrument_symbols)
    for k, name in enumerate(plain.sampling.names):
        if name.partition("[")[0] in frames and name in plain.priors:
            expected[0, k] = plain.priors[name].standardise(np.array(mean[name]))
    every = np.ones(variant.data.n_poses, dtype=bool)
    likelihood = replace(variant.likelihood(every).plain, hidden=False)
    with np.errstate(all="ignore"):
        before = predict_poses(plain, likelihood, expected, rng, variant.internal, seen, expected)
    measured, errors = variant.data.values[:, places], list[Array]()
    for one in (before, found):
        error = one.error[:, : len(places)]
        errors.append(_fit(measured - error, measured, ~variant.verification) if variant.aligned else error)
    sizes = [np.linalg.norm(one, axis=1) for one in errors]
    there = np.isfinite(sizes).all(axis=0)
    table = BeforeAfterRow.tabulate(
        variant=variant.name,
        pose=variant.data.poses,
        use=np.where(variant.verification, *reversed(USES)),
        before_mm=sizes[0],
        after_mm=sizes[1],
    )
    return table[there] if there.any() else pd.DataFrame()


def _fit(predicted: Array, measured: Array, used: np.ndarray) -> Array:
    """Return measured less predicted positions (P, k) after the rotation and shift that fit some of them best."""
    n = measured.shape[1]
    flat = [np.pad(one, ((0, 0), (0, len(AXES) - n))) for one in (predicted, measured)]
    chosen = used & np.isfinite(flat[0] + flat[1]).all(axis=1)
    if chosen.sum() < FEWEST:
        return measured - predicted
    centres = [one[chosen].mean(axis=0) for one in flat]
    source, target = (one - centre for one, centre in zip(flat, centres, strict=True))
    left, _, right = np.linalg.svd(source[chosen].T @ target[chosen])
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((target - source @ (left @ mirror @ right))[:, :n])


def tabulate_requirements(
    config: StudyConfig, variant: Variant, machine: MachineInUse, y: Array, seed: int
) -> pd.DataFrame:
    """Return with which probability a variant keeps each requirement at every pose of the workspace.

    The last row is of `ALL` together. Draws (T, n) of the posterior stand for the true machine; NaN where the machine's
    own sensors do not determine its tool.
    """
    required = read_requirements(config.requirements, variant.model, config.units)
    if not required:
        return pd.DataFrame()
    some = y[np.linspace(0, len(y) - 1, min(DRAWS, len(y))).astype(int)]
    at = linearise_workspace(variant, machine.posterior, machine.y, np.random.default_rng([seed, 5]))
    given, standing = typical_given(variant.data.given, len(at.pose)), None
    if np.isfinite(at.noise).all():
        remaining = machine.remain(variant.internal, at.pose, given, some, seed, variant.aligned)
        drawn = machine.draw(some, np.random.default_rng([seed, 6]))
        try:
            theta = machine.posterior.theta(some)
            standing = RequirementSummary(remaining.find_largest(required, theta, drawn[:, len(machine.geometry) :]))
        except NumericalError:  # poses that the calibrated machine cannot take
            standing = None
    units, nan = name_required_units(config.requirements, variant.model, config.units), float("nan")
    limits = np.array([config.requirements[one.name] for one in required])
    bounds, each, together = np.full(len(required), nan), np.full(len(required), nan), nan
    if standing is not None:
        bounds, each, together = standing.bound(KEPT), standing.probabilities, standing.probability
    return RequirementResultRow.tabulate(
        variant=variant.name,
        requirement=[*(one.name for one in required), ALL],
        unit=[*(units[one.name] for one in required), ""],
        limit=[*limits, nan],
        limit_inner=[*(one.limit for one in required), nan],
        error=[*(limits * bounds), nan],
        probability=[*each, together],
    )
