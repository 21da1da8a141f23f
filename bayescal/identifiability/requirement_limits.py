"""What errors of a predicted pose are measured by, component by component."""

from __future__ import annotations

import numpy as np

from bayescal.identifiability.requirements import COMPONENTS, NORMS, Requirement
from bayescal.identifiability.sensitivity import Sensitivity
from bayescal.numerics.geometry import Array


def find_limits(requirements: list[Requirement], workspace: Sensitivity, sd: Array) -> Array:
    """Return limits of the six components, mm and rad, shape (6,); infinite where nothing is required.

    A limit on a length holds for each of its components, where they have no smaller one. Without any requirement they
    are the root mean square errors over the workspace before any measurement, so that all count alike.

    Parameters
    ----------
    requirements : list of Requirement
    workspace : Sensitivity
        Derivatives at the workspace's poses.
    sd : ndarray, shape (L,)
        Tolerances.
    """
    limits = np.full(6, np.inf)
    for requirement in requirements:
        where = NORMS.get(requirement.name) or slice(k := COMPONENTS.index(requirement.name), k + 1)
        limits[where] = np.minimum(limits[where], requirement.limit)
    if np.isfinite(limits).any():
        return limits
    before = np.sqrt(np.mean(np.sum((workspace.slope * sd) ** 2, axis=-1), axis=0))
    return np.where(before > 0.0, before, np.inf)
