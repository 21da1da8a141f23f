"""Choosing poses before any are measured: those that lower the mean squared error of the tool most.

They are added one by one; by exchange, each time others are then put in their place for as long as that helps. What
every number of poses leaves of the error says where more of them stop paying.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.knowledge import look, look_around, weigh
from bayescal.identifiability.reading_rows import rms
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import add_poses, compute_gains, learn_in_turn

RANDOM_SETS = 20  # of as many poses, to compare with
MOST_ROUNDS = 20  # of exchanges
LEAST_FALL = 1e-9  # of the mean squared error, for which poses are exchanged


@dataclass(frozen=True, eq=False)
class Selection:
    """Poses in the order in which they were chosen, or would have been among themselves.

    Attributes
    ----------
    pose : ndarray, shape (N, q)
    after : ndarray, shape (N, t)
        Root mean square error of the tool over the workspace by what is then unknown of the parameters.
    curve : ndarray, shape (N, t)
        The same with the best set found of 1 to N poses.
    random : ndarray, shape (N, t)
        The same with as many of the candidates at random, root mean square of several sets.
    """

    pose: Array
    after: Array
    curve: Array
    random: Array


def select_poses(config: AuditConfig, variant: Variant, posterior: CalibrationPosterior) -> Selection | None:
    """Return poses chosen out of random ones of the workspace, read by all sensors of a variant.

    None where none are asked for, or where the machine's own sensors do not tell what has to be accurate.
    """
    if config.selection is None:
        return None
    expected = np.zeros(posterior.n_parameters)
    at = look_around(variant, posterior, expected, np.random.default_rng([config.seed, 5]))
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
    return Selection(tried.pose[order], after, best, random)


def _exchange_all(rows: Array, weight: Array, count: int) -> tuple[list[int], list[Array]]:
    """Return the best candidates found by adding and exchanging, and what 1 to ``count`` of them leave, C (m, m)."""
    chosen: list[int] = []
    left = []
    for _ in range(count):
        gains = compute_gains(rows, _know(rows, chosen), weight)
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
        for _ in range(MOST_ROUNDS):
            if not _exchange_one(rows, weight, chosen):
                break
        left.append(_know(rows, chosen))
    return chosen, left


def _exchange_one(rows: Array, weight: Array, chosen: list[int]) -> bool:
    """Put a better candidate in the place of one, in place, where that lowers tr(W C) most; whether any did."""
    least, swap = (1.0 - LEAST_FALL) * float(np.trace(weight @ _know(rows, chosen))), None
    for place in range(len(chosen)):
        without = _know(rows, chosen[:place] + chosen[place + 1 :])
        gains = compute_gains(rows, without, weight)
        gains[chosen] = -np.inf
        best = int(gains.argmax())
        value = float(np.trace(weight @ without)) * (1.0 - gains[best])
        if value < least:
            least, swap = value, (place, best)
    if swap is not None:
        chosen[swap[0]] = swap[1]
    return swap is not None


def _know(rows: Array, chosen: list[int]) -> Array:
    """Return (1 + Σ RᵀR)⁻¹ of some candidates."""
    some = rows[chosen].reshape(-1, rows.shape[-1])
    return np.asarray(np.linalg.inv(np.eye(rows.shape[-1]) + some.T @ some))
