"""What would help: the same audit under other plans of measurement, one by one and swept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.planned import Planned
from bayescal.experiments.audit.schema import WhatIfConfig
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import Forecast
from bayescal.numerics.geometry import Array

MOST_POSES = 10_000
USUAL = (
    WhatIfConfig(name="twice the poses", poses_factor=2.0),
    WhatIfConfig(name="ten times the poses", poses_factor=10.0),
    WhatIfConfig(name="half the measurement noise", noise_factor=0.5),
    WhatIfConfig(name="a tenth of the measurement noise", noise_factor=0.1),
    WhatIfConfig(name="a tenth of the actuator noise", actuator_noise_factor=0.1),
    WhatIfConfig(name="a tenth of both noises", noise_factor=0.1, actuator_noise_factor=0.1),
    WhatIfConfig(name="twice the displacements", workspace_factor=2.0),
    WhatIfConfig(name="five times the displacements", workspace_factor=5.0),
)
"""Changes of any plan that are looked at where the config names none."""


@dataclass(frozen=True, eq=False)
class ChangeEffect:
    """What a changed plan would tell.

    Attributes
    ----------
    name : str
    n_poses : int
    information : Information or None
        None where the machine cannot take the changed poses.
    beyond_range : bool
        Whether the actuators would have to reach further than they do.
    required_sd : dict of requirement to float
        Predicted sd over the workspace, in inner units.
    """

    name: str
    n_poses: int
    information: Information | None
    beyond_range: bool
    required_sd: dict[str, float]


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """One point of a sweep.

    Attributes
    ----------
    sweep : str
        ``noise``, ``poses`` or ``workspace``.
    value : float
    outcome : ChangeEffect
    """

    sweep: str
    value: float
    outcome: ChangeEffect


def list_changes(inputs: Planned) -> list[WhatIfConfig]:
    """Return the config's what-ifs, or the usual ones where it lists none."""
    return list(inputs.config.what_if) or [*USUAL, *inputs.list_changes()]


def check_changes(inputs: Planned) -> None:
    """Raise InputError where a what-if names a sensor or poses that are not there, or more poses than anybody takes."""
    for change in inputs.config.what_if:
        count = round(change.poses_factor * inputs.n_poses)
        if count > MOST_POSES:
            raise InputError(
                f"what_if {change.name!r}: poses_factor: found {count} poses, expected at most {MOST_POSES}"
            )
        if change.sensors is not None or change.poses is not None:
            inputs.change(change)


def evaluate_change(inputs: Planned, change: WhatIfConfig, forecast: Forecast | None) -> ChangeEffect:
    """Return what a changed plan would tell; the workspace and its requirements stay."""
    count = max(1, round(change.poses_factor * inputs.n_poses))
    try:
        return evaluate_plan(change.name, inputs.change(change), forecast)
    except InputError:
        return ChangeEffect(change.name, count, None, False, {})


def evaluate_plan(name: str, changed: Planned, forecast: Forecast | None) -> ChangeEffect:
    """Return what another plan would tell; accuracy only where the present plan has a forecast."""
    beyond = changed.is_beyond_range
    try:
        information = changed.inform()
        required = {} if forecast is None else _predict(changed, information)
    except InputError:
        return ChangeEffect(name, changed.n_poses, None, beyond, {})
    return ChangeEffect(name, changed.n_poses, information, beyond, required)


def _predict(changed: Planned, information: Information) -> dict[str, float]:
    forecast = changed.forecast()
    covariance = forecast.covariance(information.covariance) + forecast.noise
    return {one.name: one.size(covariance) for one in changed.requirements}


def list_sweeps(inputs: Planned) -> list[tuple[str, float, WhatIfConfig]]:
    """Return sweep, value and change of all points: factors on noise and on displacements, and numbers of poses."""
    n, config = inputs.n_poses, inputs.config.sweep
    changes = [("noise", value, WhatIfConfig(name="", noise_factor=value)) for value in config.noise]
    changes += [("poses", float(value), WhatIfConfig(name="", poses_factor=value / n)) for value in config.poses]
    changes += [("workspace", value, WhatIfConfig(name="", workspace_factor=value)) for value in config.workspace]
    return changes


def evaluate_changes(inputs: Planned, forecast: Forecast, run: Run) -> tuple[list[ChangeEffect], list[SweepPoint]]:
    """Return what changed plans would tell, the last with poses that are proposed, and all points of the sweeps."""
    changes, points = list_changes(inputs), list_sweeps(inputs)
    tasks: dict[str, WhatIfConfig | None] = {f"{k} {change.name}": change for k, change in enumerate(changes)}
    tasks["I-optimal poses"] = None
    tasks |= {f"{sweep} {k}": change for k, (sweep, _, change) in enumerate(points)}
    found = list(run.map("other plans", _evaluate, (inputs, forecast), tasks, (ChangeEffect,)).values())
    what_ifs, swept = found[: len(changes) + 1], found[len(changes) + 1 :]
    sweeps = [SweepPoint(sweep, value, one) for (sweep, value, _), one in zip(points, swept, strict=True) if one]
    return [one for one in what_ifs if one is not None], sweeps


def _evaluate(shared: tuple[Planned, Forecast], change: WhatIfConfig | None) -> ChangeEffect | None:
    inputs, forecast = shared
    if change is not None:
        return evaluate_change(inputs, change, forecast)
    try:
        proposed = inputs.propose()
    except InputError:
        return None  # there are none for this plan
    return None if proposed is None else evaluate_plan(*proposed, forecast)


def contraction_of_symbols(information: Information, symbols: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return the contraction of the least and of the best known parameter of each symbol."""
    named: dict[str, list[float]] = {}
    for symbol, value in zip(symbols, information.contraction, strict=True):
        named.setdefault(symbol, []).append(float(value))
    return {symbol: (min(values), max(values)) for symbol, values in named.items()}


def contraction_along(outcome: ChangeEffect, directions: Array) -> Array:
    """Return the contraction of directions (n, k) under a changed plan; NaN where there is none."""
    if outcome.information is None:
        return np.full(directions.shape[1], np.nan)
    return outcome.information.contraction_along(directions)
