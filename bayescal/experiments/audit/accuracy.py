"""How accurate the variants of a machine's readings are, where to measure next, and which poses to choose.

Poses are chosen before any are measured: those that lower the mean squared error of the tool most. They are added one
by one; by exchange, each time others are then put in their place for as long as that helps. What every number of poses
leaves of the error says where more of them stop paying.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.audit.planned import DesignVariant
from bayescal.experiments.audit.rows import (
    PARAMETER_ERROR,
    RANDOM_ERROR,
    PlannedPoseRow,
    PoseCountRow,
    SelectedPoseRow,
)
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import compute_tool_uncertainty, linearise_workspace, look, weigh
from bayescal.experiments.shared.rows import CandidatePoseRow, ToolUncertaintyRow
from bayescal.identifiability.reading_rows import rms
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import add_poses, compute_gains, learn_in_turn

RANDOM_SETS = 20  # of as many poses, to compare with
MOST_ROUNDS = 20  # of exchanges
LEAST_FALL = 1e-9  # of the mean squared error, for which poses are exchanged


def compute_accuracy(plans: Mapping[str, DesignVariant], run: Run) -> dict[str, pd.DataFrame]:
    """Return the tables of all variants' accuracy and poses."""
    found = list(run.map("variants", _compute_variant, plans, {name: name for name in plans}).values())
    tables = {
        name: pd.concat(some, ignore_index=True)
        for name in ("accuracy", "next", "selected", "pose_counts")
        if (some := [one[name] for one in found if not one[name].empty])
    }
    first = next(iter(plans.values())).variant
    poses = PlannedPoseRow.tabulate(_list_coordinates(first, first.start), pose=first.data.poses)
    return {**tables, "poses": poses}


def _compute_variant(plans: Mapping[str, DesignVariant], name: str) -> dict[str, pd.DataFrame]:
    """Return the tables of how accurate a variant is, and at which poses it is best measured."""
    plan, variant = plans[name], plans[name].variant
    covariance = plan.inform().joint
    knowledge = compute_tool_uncertainty(
        plan.config,
        variant,
        plan.posterior,
        plan.expected,
        lambda at: (plan.predict_tool_errors(plan.expected, at), covariance),
    )
    chosen = select_poses(plan.config, variant, plan.posterior, plan.expected)
    tables = {
        "accuracy": ToolUncertaintyRow.collect(knowledge.accuracy),
        "next": CandidatePoseRow.collect(knowledge.candidates),
        "selected": pd.DataFrame(),
        "pose_counts": pd.DataFrame(),
    }
    if chosen is None:
        return tables
    names = [f"{one.coordinate}_{one.unit}" for one in knowledge.accuracy]
    before = np.array([one.prior_sd for one in knowledge.accuracy])

    def name_errors(start: str, errors: Array) -> dict[str, Array]:
        return {f"{start}{name}": column for name, column in zip(names, errors.T, strict=True)}

    n_lengths = max(1, variant.model.pose_units.count("mm"))  # poses are chosen by the tool's lengths only
    size = np.array([np.linalg.norm(error[:n_lengths]) for error in (before, *chosen.curve)])
    order = np.arange(1, len(chosen.pose) + 1)
    tables["selected"] = SelectedPoseRow.tabulate(
        _list_coordinates(variant, chosen.pose) | name_errors(PARAMETER_ERROR, chosen.after),
        variant=variant.name,
        step=order,
    )
    tables["pose_counts"] = PoseCountRow.tabulate(
        name_errors(PARAMETER_ERROR, chosen.curve) | name_errors(RANDOM_ERROR, chosen.random),
        variant=variant.name,
        n_poses=order,
        error=size[1:],
        error_reduction=1.0 - size[1:] / size[:-1],
    )
    return tables


@dataclass(frozen=True, eq=False)
class ChosenPoses:
    """Poses in the order in which they were chosen, or would have been among themselves."""

    pose: Array  # (N, q)
    # (N, t): root mean square error of the tool over the workspace by what is then unknown of the parameters
    after: Array
    curve: Array  # (N, t): the same with the best set found of 1 to N poses
    random: Array  # (N, t): the same with as many of the candidates at random, root mean square of several sets


def _list_coordinates(variant: Variant, pose: Array) -> dict[str, Array]:
    """Return the coordinates of poses (N, q) as columns with units."""
    return {f"{one.name}_{one.unit}": pose[:, k] for k, one in enumerate(variant.model.coordinates)}


# --- poses to choose -------------------------------------------------------------------------------------------------


def select_poses(
    config: AuditConfig, variant: Variant, posterior: CalibrationPosterior, expected: Array
) -> ChosenPoses | None:
    """Return poses chosen out of random ones of the workspace, read by all sensors of a variant, about a machine (n,).

    Systematic errors count as noise, as large as they are. None where none are asked for, or where the machine's own
    sensors do not tell what has to be accurate.
    """
    if config.selection is None:
        return None
    at = linearise_workspace(variant, posterior, expected, np.random.default_rng([config.seed, 5]))
    weight = weigh(variant, at)
    if not np.isfinite(weight).all():
        return None
    candidates = variant.workspace.draw(config.selection.candidates, np.random.default_rng([config.seed, 9]))
    every = np.ones(len(variant.model.channels), dtype=bool)
    tried = look(posterior, variant, expected, candidates, every)
    count = min(config.selection.count, len(tried.pose))
    order, left = add_poses(tried.rows, weight, count, np.arange(len(tried.pose)))
    curve = left
    if config.selection.method == "exchange":
        order, curve = _exchange_all(tried.rows, weight, count)
        order, left = add_poses(tried.rows, weight, count, np.array(order, dtype=int))
    rng = np.random.default_rng([config.seed, 10])
    orders = [rng.permutation(len(tried.pose))[:count] for _ in range(RANDOM_SETS)]
    spread = [[rms(at.tool, one) for one in learn_in_turn(tried.rows, some)] for some in orders]
    random = np.sqrt(np.mean(np.square(np.array(spread).reshape(RANDOM_SETS, count, -1)), axis=0))
    after, best = (np.array([rms(at.tool, one) for one in some]).reshape(count, -1) for some in (left, curve))
    return ChosenPoses(tried.pose[order], after, best, random)


def _exchange_all(rows: Array, weight: Array, count: int) -> tuple[list[int], list[Array]]:
    """Return the best candidates found by adding and exchanging, and what 1 to ``count`` of them leave, C (m, m)."""
    chosen: list[int] = []
    left = []
    for _ in range(count):
        gains = compute_gains(rows, _leave(rows, chosen), weight)
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
        for _ in range(MOST_ROUNDS):
            if not _exchange_one(rows, weight, chosen):
                break
        left.append(_leave(rows, chosen))
    return chosen, left


def _exchange_one(rows: Array, weight: Array, chosen: list[int]) -> bool:
    """Put a better candidate in the place of one, in place, where that lowers tr(W C) most; whether any did."""
    least, swap = (1.0 - LEAST_FALL) * float(np.trace(weight @ _leave(rows, chosen))), None
    for place in range(len(chosen)):
        without = _leave(rows, chosen[:place] + chosen[place + 1 :])
        gains = compute_gains(rows, without, weight)
        gains[chosen] = -np.inf
        best = int(gains.argmax())
        value = float(np.trace(weight @ without)) * (1.0 - gains[best])
        if value < least:
            least, swap = value, (place, best)
    if swap is not None:
        chosen[swap[0]] = swap[1]
    return swap is not None


def _leave(rows: Array, chosen: list[int]) -> Array:
    """Return (1 + Σ RᵀR)⁻¹ of some candidates."""
    some = rows[chosen].reshape(-1, rows.shape[-1])
    return np.asarray(np.linalg.inv(np.eye(rows.shape[-1]) + some.T @ some))
