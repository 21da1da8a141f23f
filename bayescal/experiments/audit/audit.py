"""The audit as a whole: what a plan determines, and what other plans of measurement would, one by one and swept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.proposal import propose
from bayescal.experiments.audit.schema import ScenarioConfig
from bayescal.experiments.runner.parallel import Run
from bayescal.identifiability.directions import Direction, Verdict, find_directions, judge_parameters
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import RequirementForecast, WorkspaceErrorModel
from bayescal.identifiability.ridges import Ridge
from bayescal.identifiability.selection import ParameterSelection, ReducedSet, judge_reduced, select_parameters
from bayescal.identifiability.structure import Structure
from bayescal.limits import NINETY_FIVE
from bayescal.numerics.geometry import Array

type Harm = Literal["harmless", "noticeable", "harmful", "unknown"]

HARMLESS = 0.1  # of a limit, that the remaining uncertainty along a direction may take
HARMFUL_LIMIT_RATIO = 1.0
MOST_POSES = 10_000
USUAL = (
    ScenarioConfig(name="twice the poses", poses_factor=2.0),
    ScenarioConfig(name="ten times the poses", poses_factor=10.0),
    ScenarioConfig(name="half the measurement noise", noise_factor=0.5),
    ScenarioConfig(name="a tenth of the measurement noise", noise_factor=0.1),
    ScenarioConfig(name="a tenth of the actuator noise", actuator_noise_factor=0.1),
    ScenarioConfig(name="a tenth of both noises", noise_factor=0.1, actuator_noise_factor=0.1),
    ScenarioConfig(name="twice the displacements", workspace_factor=2.0),
    ScenarioConfig(name="five times the displacements", workspace_factor=5.0),
)
"""Changes of any plan that are looked at where the config names none."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """What the plan tells of the parameters, without words: what is fast and what tests and sweeps want."""

    structure: Structure
    information: Information
    selection: ParameterSelection
    directions: list[Direction]
    verdicts: tuple[Verdict, ...]  # of each parameter
    # what a calibration of the selected parameters alone claims and errs by; None where these are none, or all
    reduced: ReducedSet | None


@dataclass(frozen=True, eq=False)
class ChangeEffect:
    """What a changed plan would tell."""

    name: str
    n_poses: int
    information: Information | None  # None where the machine cannot take the changed poses
    beyond_range: bool  # whether the actuators would have to reach further than they do
    required_sd: dict[str, float]  # by requirement: predicted sd over the workspace, in inner units

    def contraction_along(self, directions: Array) -> Array:
        """Return the contraction of directions (n, k); NaN where the machine cannot take the poses."""
        if self.information is None:
            return np.full(directions.shape[1], np.nan)
        return self.information.contraction_along(directions)


type SweepPoint = tuple[str, float, ChangeEffect]
"""A point of a sweep: ``noise``, ``poses`` or ``workspace``, the value, and what is then determined."""


@dataclass(frozen=True, eq=False)
class AuditOutcome:
    """An audit with everything it says."""

    inputs: DesignVariant
    analysis: Analysis
    ridges: list[Ridge]  # the structural and practical directions, described
    forecast: WorkspaceErrorModel  # of the workspace, or of the planned poses where there is no workspace
    outlooks: list[RequirementForecast]  # one per requirement
    together: float  # probability that all requirements are kept; NaN without any
    scenarios: list[ChangeEffect]
    sweeps: list[SweepPoint]

    def measure_left(self) -> float:
        """Return the error that unknown parameters leave over the workspace, rms after by before, over all units."""
        after = self.forecast.covariance(self.analysis.information.covariance)
        before = self.forecast.covariance(np.eye(self.forecast.slope.shape[-1]))
        parts = [np.diagonal(one, axis1=-2, axis2=-1).mean(axis=0) for one in (after, before)]
        moved = parts[1] > 0.0
        return float(np.sqrt(np.mean(parts[0][moved] / parts[1][moved]))) if moved.any() else float("nan")

    def harm(self, direction: Direction) -> tuple[Harm, float, str]:
        """Return whether what remains unknown along a direction matters, the share of a limit, and of which.

        The share is that of 1.96 standard deviations that remain, as is required: anywhere in the workspace, or rms.
        """
        requirements = self.inputs.requirements
        if not requirements or not np.isfinite(self.forecast.slope).all():
            return "unknown", float("nan"), ""
        effect = self.forecast.effect(direction.vector)
        share, name = max(((r.sum_up(effect) / r.limit, r.name) for r in requirements), key=lambda pair: pair[0])
        share *= NINETY_FIVE * float(np.sqrt(max(0.0, 1.0 - direction.contraction)))
        return (
            ("harmless" if share < HARMLESS else "noticeable" if share < HARMFUL_LIMIT_RATIO else "harmful"),
            share,
            name,
        )


def analyse(inputs: DesignVariant) -> Analysis:
    """Return what the plan tells of the parameters."""
    structure = inputs.find_structure(np.random.default_rng([inputs.config.seed, 2]))
    information = inputs.inform()
    selection = select_parameters(information, inputs.symbols, inputs.frames)
    frames = tuple(k for k, symbol in enumerate(inputs.symbols) if symbol in inputs.frames)
    directions = find_directions(information, structure.null_space, selection.fixed, frames)
    verdicts = judge_parameters(information, structure.null_space)
    reduced = judge_reduced(information, selection.free)
    return Analysis(structure, information, selection, directions, verdicts, reduced)


def judge(inputs: DesignVariant) -> AuditOutcome:
    """Return what the plan tells and how requirements stand, without other plans."""
    analysis, forecast = analyse(inputs), inputs.forecast()
    rng, requirements = np.random.default_rng([inputs.config.seed, 3]), inputs.requirements
    outlooks, together = forecast.judge(requirements, analysis.information, rng, analysis.selection.free)
    return AuditOutcome(inputs, analysis, [], forecast, outlooks, together if requirements else float("nan"), [], [])


def run_audit(inputs: DesignVariant, run: Run) -> AuditOutcome:
    """Return the audit of a plan; one of poses chosen I-optimally is among the changes."""
    return complete(judge(inputs), run)


def complete(audit: AuditOutcome, run: Run) -> AuditOutcome:
    """Return an audit with its ridges in words and with other plans."""
    inputs = audit.inputs
    check_changes(inputs)
    scenarios, sweeps = evaluate_changes(inputs, audit.forecast, run)
    return replace(audit, ridges=inputs.describe(audit.analysis.directions), scenarios=scenarios, sweeps=sweeps)


# --- other plans -----------------------------------------------------------------------------------------------------


def list_changes(inputs: DesignVariant) -> list[ScenarioConfig]:
    """Return the config's what-ifs, or the usual ones where it lists none."""
    return list(inputs.config.scenarios) or [*USUAL, *inputs.list_changes()]


def check_changes(inputs: DesignVariant) -> None:
    """Raise InputError where a what-if names a sensor or poses that are not there, or more poses than anybody takes."""
    for change in inputs.config.scenarios:
        count = round(change.poses_factor * inputs.n_poses)
        if count > MOST_POSES:
            raise InputError(
                f"scenario {change.name!r}: poses_factor: found {count} poses, expected at most {MOST_POSES}"
            )
        if change.sensors is not None or change.poses is not None:
            inputs.change(change)


def evaluate_change(
    inputs: DesignVariant, change: ScenarioConfig, forecast: WorkspaceErrorModel | None
) -> ChangeEffect:
    """Return what a changed plan would tell; the workspace and its requirements stay."""
    count = max(1, round(change.poses_factor * inputs.n_poses))
    try:
        return evaluate_plan(change.name, inputs.change(change), forecast)
    except InputError:
        return ChangeEffect(change.name, count, None, False, {})


def evaluate_plan(name: str, changed: DesignVariant, forecast: WorkspaceErrorModel | None) -> ChangeEffect:
    """Return what another plan would tell; accuracy only where the present plan has a forecast."""
    beyond = changed.is_beyond_range
    try:
        information = changed.inform()
        required = {}
        if forecast is not None:
            own = changed.forecast()
            covariance = own.covariance(information.joint) + own.noise
            required = {one.name: one.size(covariance) for one in changed.requirements}
    except InputError:
        return ChangeEffect(name, changed.n_poses, None, beyond, {})
    return ChangeEffect(name, changed.n_poses, information, beyond, required)


def evaluate_changes(
    inputs: DesignVariant, forecast: WorkspaceErrorModel, run: Run
) -> tuple[list[ChangeEffect], list[SweepPoint]]:
    """Return what changed plans would tell, the last with poses that are proposed, and all points of the sweeps."""
    changes, n, swept = list_changes(inputs), inputs.n_poses, inputs.config.sweep
    points = [("noise", value, ScenarioConfig(name="", noise_factor=value)) for value in swept.noise]
    points += [("poses", float(value), ScenarioConfig(name="", poses_factor=value / n)) for value in swept.poses]
    points += [("workspace", value, ScenarioConfig(name="", workspace_factor=value)) for value in swept.workspace]
    tasks: dict[str, ScenarioConfig | None] = {f"{k} {change.name}": change for k, change in enumerate(changes)}
    tasks["I-optimal poses"] = None
    tasks |= {f"{sweep} {k}": change for k, (sweep, _, change) in enumerate(points)}
    found = list(run.map("other plans", _evaluate, (inputs, forecast), tasks, (ChangeEffect,)).values())
    scenarios, others = found[: len(changes) + 1], found[len(changes) + 1 :]
    sweeps = [(sweep, value, one) for (sweep, value, _), one in zip(points, others, strict=True) if one]
    return [one for one in scenarios if one is not None], sweeps


def _evaluate(shared: tuple[DesignVariant, WorkspaceErrorModel], change: ScenarioConfig | None) -> ChangeEffect | None:
    inputs, forecast = shared
    if change is not None:
        return evaluate_change(inputs, change, forecast)
    try:
        proposed = propose(inputs)
    except InputError:
        return None  # there are none for this plan
    return None if proposed is None else evaluate_plan(*proposed, forecast)
