"""Which entries of a function's argument may be stepped together: those that no value of the function sees together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    from bayescal.machines.readings.base import Given, ReadingModel

POINTS = 12
SPREAD = 0.3  # of the workspace's half widths
AWAY = 1e-3  # of a parameter's size, or of one unit where it is zero


def draw_points(model: ReadingModel, n: int = POINTS) -> tuple[Array, Array, Given]:
    """Return parameters (n, D) about nominal, poses (n, q) about home and given values (n,), always the same."""
    rng = np.random.default_rng(1974)
    nominal = model.layout.nominal
    theta = nominal + AWAY * np.maximum(np.abs(nominal), 1.0) * rng.uniform(-1.0, 1.0, (n, len(nominal)))
    home = model.home_pose
    pose = home + SPREAD * model.pose_scale * rng.uniform(-1.0, 1.0, (n, len(home)))
    pose[0], theta[0] = home, nominal
    return theta, pose, {name: rng.uniform(0.5, 1.5, n) for name in model.given}


def colour(pattern: np.ndarray) -> np.ndarray:
    """Return a colour for each column of a pattern (K, n), so that columns of one colour share no row; -1 for none.

    Greedy, the fullest columns first (Curtis, Powell and Reid 1974).
    """
    colours = np.full(pattern.shape[1], -1)
    taken: list[np.ndarray] = []
    for column in np.argsort(-pattern.sum(axis=0), kind="stable"):
        own = pattern[:, column]
        if not own.any():
            continue
        free = next((k for k, rows in enumerate(taken) if not (rows & own).any()), len(taken))
        if free == len(taken):
            taken.append(np.zeros(len(own), dtype=bool))
        taken[free] |= own
        colours[column] = free
    return colours
