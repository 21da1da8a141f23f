"""What errors of a machine's actuators look like: the share of them that lies along the directions of a usual cause.

Errors e (P, N) of N actuators at P poses, less their means, which no one tells from the zeros of the geometry, are
projected onto the columns of a cause, also less their means:

    share = Σ |Q_iᵀ e_i|² / Σ |e_i|²

with Q_i orthonormal. A cause with k columns has a share of k / (P - 1) of errors that have nothing to do with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from bayescal.numerics.geometry import Array

FEWEST: Final = 0.5
"""Columns of a cause over poses beyond which it would fit anything."""


@dataclass(frozen=True, eq=False)
class Plan:
    """P poses of a machine.

    Attributes
    ----------
    travel : ndarray, shape (P, N)
        Of its own actuators from home, in any units.
    turns : ndarray, shape (P, r)
        What turns the tool at each pose, from home; none of its coordinates may.
    pose : ndarray, shape (P, q)
        All its coordinates, from home, each in units of its own spread.
    order : ndarray, shape (P,), or None
        Place in measuring order.
    """

    travel: Array
    turns: Array
    pose: Array
    order: Array | None


@dataclass(frozen=True)
class Cause:
    """A usual cause: its columns (N or 1, P, k), none where it cannot be, and whether all actuators err alike by it."""

    columns: Callable[[Plan], Array]
    alike: bool = False


def _by_own(plan: Plan) -> Array:
    return plan.travel.T[:, :, None]


def _by_all(plan: Plan) -> Array:
    return plan.travel[None]


def _by_tilt(plan: Plan) -> Array:
    first, second = np.triu_indices(plan.turns.shape[1])
    return (plan.turns[:, first] * plan.turns[:, second])[None]


def _by_pose(plan: Plan) -> Array:
    return np.concatenate([plan.pose, plan.pose**2], axis=1)[None]


def _by_time(plan: Plan) -> Array:
    if plan.order is None:
        return np.zeros((1, len(plan.travel), 0))
    t = plan.order / max(float(np.ptp(plan.order)), 1e-300)
    return np.stack([t, t**2], axis=1)[None]


def _by_direction(plan: Plan) -> Array:
    """Return the sign of each actuator's move since the pose before; none at the first one."""
    if plan.order is None:
        return np.zeros((1, len(plan.travel), 0))
    order, found = np.argsort(plan.order), np.zeros_like(plan.travel)
    found[order[1:]] = np.sign(np.diff(plan.travel[order], axis=0))
    return found.T[:, :, None]


CAUSES: Final[dict[str, Cause]] = {
    "screws": Cause(_by_own),
    "lost motion": Cause(_by_direction),
    "heat": Cause(_by_time),
    "gravity": Cause(_by_pose, alike=True),
    "joints": Cause(_by_tilt),
    "coupling": Cause(_by_all),
}
"""The simpler ones first: of several that explain the errors the first is named."""


def share_causes(errors: Array, plan: Plan) -> dict[str, tuple[Array, float]]:
    """Return of each cause its share of errors (T, P, N) and of errors that have nothing to do with it, (T,) and one.

    Causes that cannot be there, or that have as good as as many columns as there are poses, are left out.
    """
    centred, (_, n_poses, n) = errors - errors.mean(axis=1, keepdims=True), errors.shape
    whole = np.maximum(np.sum(centred**2, axis=(1, 2)), np.finfo(float).tiny)
    found = {}
    for name, cause in CAUSES.items():
        columns = cause.columns(plan)
        axes = [_span(one - one.mean(axis=0)) for one in columns]
        k = max(one.shape[1] for one in axes)
        if not k or k > FEWEST * n_poses:
            continue
        if cause.alike:
            explained = n * np.sum((centred.mean(axis=2) @ axes[0]) ** 2, axis=1)
        else:
            each = axes if len(axes) == n else axes * n
            explained = sum(np.sum((centred[..., i] @ one) ** 2, axis=1) for i, one in enumerate(each))
        found[name] = np.asarray(explained / whole), k / (n_poses - 1) / (n if cause.alike else 1)
    return found


def _span(columns: Array) -> Array:
    """Return orthonormal columns of the same span."""
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > 1e-9 * values.max(initial=0.0)])
