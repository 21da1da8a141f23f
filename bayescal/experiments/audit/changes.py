"""What would help: the same audit under other plans of measurement, one by one and swept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.i_optimal import ProposedPlan, propose_i_optimal
from bayescal.experiments.audit.inputs import AuditInputs, list_measuring
from bayescal.experiments.audit.schema import PosesConfig, WhatIfConfig
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.shared.design import choose_sensors
from bayescal.identifiability.design import Plan
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import Forecast, Requirement
from bayescal.identifiability.structured_noise import inform
from bayescal.numerics.geometry import Array

MOST_POSES = 10_000


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
        Predicted sd over the workspace, mm or rad.
    """

    name: str
    n_poses: int
    information: Information | None
    beyond_range: bool
    required_sd: dict[str, float]


def list_changes(inputs: AuditInputs) -> list[WhatIfConfig]:
    """Return the design's what-ifs, or the usual ones where it lists none."""
    config = inputs.config
    if config.what_if:
        return list(config.what_if)
    changes = [
        WhatIfConfig(name="twice the poses", poses_factor=2.0),
        WhatIfConfig(name="ten times the poses", poses_factor=10.0),
        WhatIfConfig(name="half the measurement noise", noise_factor=0.5),
        WhatIfConfig(name="a tenth of the measurement noise", noise_factor=0.1),
        WhatIfConfig(name="a tenth of the actuator noise", actuator_noise_factor=0.1),
        WhatIfConfig(name="a tenth of both noises", noise_factor=0.1, actuator_noise_factor=0.1),
        WhatIfConfig(name="twice the displacements", workspace_factor=2.0),
        WhatIfConfig(name="five times the displacements", workspace_factor=5.0),
    ]
    n = inputs.plan.n_poses
    for plan, words in (("extremes", "at the ends of the range"), ("uniform", "spread evenly over the range")):
        if config.data is None and config.poses.plan != plan:
            poses = PosesConfig.model_validate({"plan": plan, "count": n})
            changes.append(WhatIfConfig(name=f"{n} poses {words}", poses=poses))
    measuring = list_measuring(config)
    for name in config.sensors:
        if name not in measuring:
            words = name.replace("_", " ")
            changes.append(WhatIfConfig(name=f"{words} instead", sensors=[name]))
            changes.append(WhatIfConfig(name=f"{words} too", sensors=[*measuring, name]))
    return changes


def check_changes(inputs: AuditInputs) -> None:
    """Raise InputError where a what-if names a sensor or poses that are not there, or more poses than anybody takes."""
    for change in inputs.config.what_if:
        count = round(change.poses_factor * inputs.plan.n_poses)
        if count > MOST_POSES:
            raise InputError(
                f"what_if {change.name!r}: poses_factor: found {count} poses, expected at most {MOST_POSES}"
            )
        if change.sensors is not None:
            choose_sensors(inputs.sensors, change.sensors, f"what_if {change.name!r}: sensors")
        if change.poses is not None:
            apply_change(inputs, change)


def apply_change(inputs: AuditInputs, change: WhatIfConfig) -> Plan:
    """Return the changed plan."""
    plan, mechanism = inputs.plan, inputs.knowledge.machine.mechanism
    count = max(1, round(change.poses_factor * plan.n_poses))
    config = change.poses or (None if inputs.measured is not None else inputs.config.poses)
    information = plan.pose_information
    if config is not None:
        if change.poses is not None and change.poses_factor == 1.0:
            actuators = inputs.actuators(config, change.workspace_factor)
        else:
            actuators = inputs.actuators(config, change.workspace_factor, count)
    else:
        again = np.arange(count) % plan.n_poses
        start = mechanism.initial_actuator_positions
        actuators = start + change.workspace_factor * (plan.actuators[again] - start)
        information = None if information is None else information[again]
    sensors = plan.sensors
    if change.sensors is not None:
        sensors = choose_sensors(inputs.sensors, change.sensors, f"what_if {change.name!r}: sensors")
        information = None
    return replace(
        plan,
        actuators=actuators,
        sensors=sensors,
        pose_information=information,
        noise_factor=plan.noise_factor * change.noise_factor,
        actuator_noise=plan.actuator_noise * change.actuator_noise_factor,
        model_error=plan.model_error,
    )


def evaluate_change(inputs: AuditInputs, change: WhatIfConfig, forecast: Forecast | None) -> ChangeEffect:
    """Return what a changed plan would tell; the workspace and its requirements stay."""
    return evaluate_plan(inputs, ProposedPlan(change.name, apply_change(inputs, change)), forecast)


def evaluate_plan(inputs: AuditInputs, proposed: ProposedPlan, forecast: Forecast | None) -> ChangeEffect:
    """Return what another plan would tell; the workspace and its requirements stay."""
    plan, knowledge = proposed.plan, inputs.knowledge
    mechanism = knowledge.machine.mechanism
    moved = np.abs(plan.actuators - mechanism.initial_actuator_positions)
    beyond = bool(np.any(moved > mechanism.actuator_range * (1 + 1e-9)))
    try:
        information = inform(knowledge, plan)
    except InputError:
        return ChangeEffect(proposed.name, plan.n_poses, None, beyond, {})
    return ChangeEffect(
        proposed.name, plan.n_poses, information, beyond, _required(forecast, plan, information, inputs.requirements)
    )


def _required(
    forecast: Forecast | None, plan: Plan, information: Information, requirements: Sequence[Requirement]
) -> dict[str, float]:
    if forecast is None:
        return {}
    covariance = forecast.covariance(information.covariance) + forecast.sensitivity.pose_noise(plan)
    return {r.name: float(np.sqrt(r.variance(covariance).max())) for r in requirements}


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


def list_sweeps(inputs: AuditInputs) -> list[tuple[str, float, WhatIfConfig]]:
    """Return sweep, value and change of all points: factors on noise and on displacements, and numbers of poses."""
    n, config = inputs.plan.n_poses, inputs.config.sweep
    changes = [("noise", value, WhatIfConfig(name="", noise_factor=value)) for value in config.noise]
    changes += [("poses", float(value), WhatIfConfig(name="", poses_factor=value / n)) for value in config.poses]
    changes += [("workspace", value, WhatIfConfig(name="", workspace_factor=value)) for value in config.workspace]
    return changes


def evaluate_changes(inputs: AuditInputs, forecast: Forecast, run: Run) -> tuple[list[ChangeEffect], list[SweepPoint]]:
    """Return what changed plans would tell, the last with poses chosen I-optimally, and all points of the sweeps."""
    changes, points = list_changes(inputs), list_sweeps(inputs)
    tasks: dict[str, WhatIfConfig | None] = {f"{k} {change.name}": change for k, change in enumerate(changes)}
    tasks["I-optimal poses"] = None
    tasks |= {f"{sweep} {k}": change for k, (sweep, _, change) in enumerate(points)}
    found = list(run.map("other plans", _evaluate, (inputs, forecast), tasks, (ChangeEffect,)).values())
    what_ifs, swept = found[: len(changes) + 1], found[len(changes) + 1 :]
    sweeps = [SweepPoint(sweep, value, one) for (sweep, value, _), one in zip(points, swept, strict=True) if one]
    return [*_leave_function_out(inputs, forecast), *(one for one in what_ifs if one is not None)], sweeps


def _leave_function_out(inputs: AuditInputs, forecast: Forecast) -> list[ChangeEffect]:
    """Return what the plan would tell if legs did not err by a function of the pose; nothing where they do not."""
    if inputs.plan.function is None:
        return []
    plan = ProposedPlan("no error that is a function of the pose", replace(inputs.plan, function=None))
    return [evaluate_plan(inputs, plan, forecast)]


def _evaluate(shared: tuple[AuditInputs, Forecast], change: WhatIfConfig | None) -> ChangeEffect | None:
    inputs, forecast = shared
    if change is not None:
        return evaluate_change(inputs, change, forecast)
    try:
        return evaluate_plan(inputs, propose_i_optimal(inputs), forecast)
    except InputError:
        return None  # there are none for this design


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
