"""How requirements stand: at the worst pose of the workspace, and with what probability they are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.identifiability.reading_rows import View
from bayescal.identifiability.requirements import DRAWS, draw_errors
from bayescal.identifiability.sensitivity import root_of
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Outlook:
    """How limits on the tool's t coordinates stand; NaN where its own sensors do not tell it.

    Attributes
    ----------
    worst : ndarray, shape (t,)
        Largest standard deviation at any pose of the workspace, by parameters and noise together.
    worst_pose : ndarray, shape (t, q)
        Where that is.
    before, probability : ndarray, shape (t,)
        That a machine's root mean square error over the workspace keeps the limit, beforehand and calibrated.
    everywhere : ndarray, shape (t,)
        That none of its poses errs by more than the limit, calibrated.
    together : float
        That all root mean square errors keep their limits at once, calibrated.
    """

    worst: Array
    worst_pose: Array
    before: Array
    probability: Array
    everywhere: Array
    together: float


def foresee(at: View, covariance: Array, limits: Array, rng: np.random.Generator) -> Outlook:
    """Return how limits (t,), infinite where nothing is required, stand for machines that may be the one expected.

    Parameters
    ----------
    at : View
        Poses of the workspace as the machine's own sensors see them.
    covariance : ndarray, shape (m, m)
        What remains unknown of the parameters, in the posterior's coordinates.
    """
    n_tool = len(limits)
    if not np.isfinite(at.tool).all():
        nothing = np.full(n_tool, np.nan)
        return Outlook(nothing, np.full((n_tool, at.pose.shape[1]), np.nan), nothing, nothing, nothing, np.nan)
    variance = np.einsum("wti,ij,wtj->wt", at.tool, covariance, at.tool, optimize=True) + at.noise
    before, _, _ = _draw(at, np.eye(len(covariance)), limits, rng)
    probability, everywhere, together = _draw(at, root_of(covariance).T, limits, rng)
    worst = variance.argmax(axis=0)
    return Outlook(np.sqrt(variance.max(axis=0)), at.pose[worst], before, probability, everywhere, together)


def _draw(at: View, root: Array, limits: Array, rng: np.random.Generator) -> tuple[Array, Array, float]:
    """Return the shares of machines whose rms errors, and whose errors at every pose, keep the limits; and all rms."""
    kept, everywhere, together = np.zeros(len(limits)), np.zeros(len(limits)), 0
    for error in draw_errors(at.tool @ root, at.located, rng):
        within = np.sqrt(np.mean(error**2, axis=1)) <= limits
        kept += within.sum(axis=0)
        everywhere += (np.abs(error) <= limits).all(axis=1).sum(axis=0)
        together += int(within.all(axis=1).sum())
    return kept / DRAWS, everywhere / DRAWS, together / DRAWS
