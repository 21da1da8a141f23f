"""What any set of sensors would tell at the planned poses, to first order about the machine expected.

The derivatives by pose and parameters are taken once, of all sensors there are to choose from. A set has rows of them:
with its poses eliminated, R = A - H H⁺ A at every planned pose, it leaves (1 + Σ RᵀR)⁻¹ of the parameters. In use the
machine's own sensors of the set locate the tool.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.errors import InputError
from bayescal.experiments.audit.schema import SensorChoiceConfig
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import N_WORKSPACE, differentiate
from bayescal.experiments.shared.readings.workspace import SINGULAR
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.reading_rows import Slopes, rms
from bayescal.identifiability.requirements import Forecast, Requirement
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

type Reason = Literal["", "calibration", "use"]


@dataclass(frozen=True)
class Choice:
    """A sensor, or an instrument of several readings.

    Attributes
    ----------
    name : str
    channels : tuple of str
    price : float
        NaN where no prices are stated.
    """

    name: str
    channels: tuple[str, ...]
    price: float = np.nan


def list_choices(model: ReadingModel, section: SensorChoiceConfig) -> tuple[Choice, ...]:
    """Return what there is to choose from, kinds spread, with prices.

    Raises
    ------
    InputError
        For unknown sensors and those listed twice; where there are prices, for one without and a price of nothing.
    """
    candidates, always, prices = section.candidates, section.always, section.prices
    found: list[Choice] = []
    for entry in candidates:
        if isinstance(entry, list):
            found.append(Choice(" + ".join(entry), tuple(model.names[k] for k in model.select(entry))))
        else:
            found += [Choice(model.names[k], (model.names[k],)) for k in model.select([entry])]
    taken = [model.names[k] for k in model.select(always)] + [name for one in found for name in one.channels]
    for name in taken:
        if taken.count(name) > 1:
            raise InputError(f"found {name} twice in candidates and always, expected each sensor once")
    if not prices:
        return tuple(found)
    named = [one.name if one.name in prices else one.name.partition("[")[0] for one in found]
    for name in named:
        if name not in prices:
            raise InputError(f"prices: found none of {name}, expected one of each candidate, or of its kind")
    for name in prices:
        if name not in named:
            raise InputError(f"prices: found {name!r}, expected some of {', '.join(dict.fromkeys(named))}")
    return tuple(replace(one, price=prices[name]) for one, name in zip(found, named, strict=True))


@dataclass(frozen=True, eq=False)
class SensorSets:
    """Derivatives of all sensors in question, from which every set of them is judged.

    Attributes
    ----------
    by_pose, by_parameters : ndarray, shapes (P, K, q) and (P, K, m)
        Of the white readings at the planned poses, by the pose and by the posterior's coordinates.
    around : Slopes
        Of W poses of the workspace.
    internal : ndarray of bool, shape (K,)
        The machine's own sensors.
    members : ndarray of bool, shape (C, K)
        Which sensors each choice has.
    always : ndarray of bool, shape (K,)
        Which sensors are in every set.
    requirements : tuple of Requirement
        Of the tool's coordinates.
    n_lengths : int
        How many of the tool's coordinates, the first, count where nothing is required.
    """

    by_pose: Array
    by_parameters: Array
    around: Slopes
    internal: np.ndarray
    members: np.ndarray
    always: np.ndarray
    requirements: tuple[Requirement, ...]
    n_lengths: int


@dataclass(frozen=True, eq=False)
class SetAccuracy:
    """How good a set of sensors is.

    Attributes
    ----------
    reason : str
        Why it is no good: its readings would not tell the poses of the ``calibration``, or its own sensors not where
        the machine stands in ``use``; empty where it is.
    missing : int
        How many coordinates are not told, in calibration and in use together.
    goal : float
        What is to be small: the largest standard deviation as a share of its limit, at the worst pose or rms as is
        required; where nothing is required the root mean square of the tool's error, lengths together. Infinite for a
        set that is no good.
    error, after, noise : ndarray, shape (t,)
        Root mean square over the workspace of all together, of what is unknown of the parameters, of noise in use.
    sd : ndarray, shape (m,)
        What remains of each parameter's tolerance, as a share.
    n_readings : int
        At a pose.
    """

    reason: Reason
    missing: int
    goal: float
    error: Array
    after: Array
    noise: Array
    sd: Array
    n_readings: int


def build_sensor_sets(
    variant: Variant,
    posterior: CalibrationPosterior,
    choices: Sequence[Choice],
    always: Sequence[str],
    requirements: tuple[Requirement, ...],
    seed: int,
) -> SensorSets:
    """Return the derivatives at the planned poses and over the workspace, of the machine as expected."""
    expected, model = np.zeros(posterior.n_parameters), variant.model
    white, stand = posterior.likelihood.explain(*posterior.at(expected[None]))
    _, by_pose, by_parameters = posterior.likelihood.rows(*posterior.around(expected), white, stand.pose)
    pose = variant.workspace.draw(N_WORKSPACE, np.random.default_rng([seed, 5]))
    return SensorSets(
        by_pose,
        by_parameters,
        differentiate(posterior, variant, expected, pose),
        variant.internal,
        np.array([np.isin(model.names, one.channels) for one in choices]),
        np.isin(model.names, [model.names[k] for k in model.select(always)]),
        requirements,
        max(1, model.pose_units.count("mm")),
    )


@dataclass(frozen=True, eq=False)
class SeenSet:
    """What a set of sensors tells: what it does not, or what it informs of and how the tool then errs.

    Attributes
    ----------
    lost, lost_in_use : int
        Coordinates of a pose that its readings do not tell in the calibration, and its own sensors not in use.
    n_readings : int
        At a pose.
    information : Information or None
        None where any coordinate is lost, as is the forecast.
    forecast : Forecast or None
    """

    lost: int
    lost_in_use: int
    n_readings: int
    information: Information | None = None
    forecast: Forecast | None = None


def see_set(sets: SensorSets, chosen: np.ndarray) -> SeenSet:
    """Return what a set of choices (C,), bool, tells."""
    some, at = sets.always | sets.members[chosen].any(axis=0), sets.around
    own = some & sets.internal
    white, n_readings = at.white[own, None], int(some.sum())
    basis, values, _ = np.linalg.svd(sets.by_pose[:, some] * at.half, full_matrices=False)
    in_use, sizes, turned = np.linalg.svd(white * at.by_pose[:, own] * at.half, full_matrices=False)
    lost, lost_in_use = (_count_untold(one, len(at.half)) for one in (values, sizes))
    if lost or lost_in_use:
        return SeenSet(lost, lost_in_use, n_readings)
    by_parameters = sets.by_parameters[:, some]
    rows = by_parameters - basis @ (np.swapaxes(basis, -1, -2) @ by_parameters)
    gain = np.swapaxes(turned * at.half, -1, -2) / sizes[:, None] @ np.swapaxes(in_use, -1, -2)
    located = at.tool_by_pose @ gain
    forecast = Forecast(at.mislocate(located, white * at.seen[:, own]), located @ np.swapaxes(located, -1, -2))
    return SeenSet(0, 0, n_readings, information_of_rows(rows, np.ones(rows.shape[-1])), forecast)


def judge_set(sets: SensorSets, chosen: np.ndarray) -> SetAccuracy:
    """Return how good a set of choices (C,), bool, is."""
    seen = see_set(sets, chosen)
    if seen.information is None or seen.forecast is None:
        nothing = np.full(sets.around.tool_by_pose.shape[1], np.nan)
        all_of_it = np.ones(sets.by_parameters.shape[-1])
        reason: Reason = "calibration" if seen.lost else "use"
        missing = seen.lost + seen.lost_in_use
        return SetAccuracy(reason, missing, np.inf, nothing, nothing, nothing, all_of_it, seen.n_readings)
    covariance, forecast = seen.information.covariance, seen.forecast
    after = rms(forecast.slope, covariance)
    noise = np.sqrt(np.diagonal(forecast.noise, axis1=-2, axis2=-1).mean(axis=0))
    error = np.hypot(after, noise)
    if sets.requirements:
        tool = forecast.covariance(covariance) + forecast.noise
        goal = max(one.size(tool) / one.limit for one in sets.requirements)
    else:
        goal = float(np.linalg.norm(error[: sets.n_lengths]))
    deviations = np.sqrt(np.diagonal(covariance))
    return SetAccuracy("", 0, goal, error, after, noise, deviations, seen.n_readings)


def find_probability(sets: SensorSets, chosen: np.ndarray, rng: np.random.Generator) -> float:
    """Return the probability that a set of choices (C,), bool, keeps all requirements; NaN without any."""
    seen = see_set(sets, chosen)
    if seen.information is None or seen.forecast is None or not sets.requirements:
        return float("nan")
    return seen.forecast.keep_all(sets.requirements, seen.information, rng)


def _count_untold(values: Array, q: int) -> int:
    """Return how many of q coordinates readings of singular values (P, k) do not tell where they tell least."""
    told = (values > SINGULAR * values.max(axis=1, initial=0.0)[:, None]).sum(axis=1)
    return int(q - told.min())
