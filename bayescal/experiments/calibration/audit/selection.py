"""Choosing poses before any are measured: one by one, those that lower the mean squared error of the tool most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.posterior import CalibrationPosterior
from bayescal.experiments.calibration.inputs import Variant
from bayescal.experiments.calibration.knowledge import compute_gains, look, look_around, rms, weigh
from bayescal.experiments.calibration.schema import CalibrationAuditConfig
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Selection:
    """Poses in the order in which they were chosen.

    Attributes
    ----------
    pose : ndarray, shape (N, q)
    after : ndarray, shape (N, t)
        Root mean square error of the tool over the workspace by what is then unknown of the parameters.
    """

    pose: Array
    after: Array


def select_poses(config: CalibrationAuditConfig, variant: Variant, posterior: CalibrationPosterior) -> Selection | None:
    """Return poses chosen greedily out of random ones of the workspace, read by all sensors of a variant.

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
    covariance, left = np.eye(posterior.n_geometry), np.ones(len(tried.pose), dtype=bool)
    chosen, after = [], []
    for _ in range(min(config.selection.count, len(tried.pose))):
        gains = compute_gains(tried.rows, covariance, weight)
        best = int(np.where(left, gains, -np.inf).argmax())
        left[best] = False
        covariance = _learn(covariance, tried.rows[best])
        chosen.append(best)
        after.append(rms(at.tool, covariance))
    return Selection(tried.pose[chosen], np.array(after).reshape(len(chosen), -1))


def _learn(covariance: Array, rows: Array) -> Array:
    """Return C - C Rᵀ (1 + R C Rᵀ)⁻¹ R C, what remains unknown after the readings of one pose, R (K, m)."""
    seen = rows @ covariance
    result = covariance - seen.T @ np.linalg.solve(np.eye(len(rows)) + seen @ rows.T, seen)
    return np.asarray(0.5 * (result + result.T))
