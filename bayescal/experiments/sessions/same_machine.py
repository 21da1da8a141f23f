"""Whether sessions are of one machine: another one of the same design is off by its tolerances, no drift is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.density.sessions.model import SessionModel
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

FAR = 20.0
"""Prior scales of the drift, over the time that went by, that legs of one machine are never off."""
WARM = 0.1
"""Millimetres that a leg may be off besides, by temperature, noise and model error."""


def check_same_machine(model: SessionModel, theta: Array, labels: Sequence[str]) -> None:
    """Raise InputError where the legs of a session are off those of the first by far more than they can have moved.

    Parameters
    ----------
    model : SessionModel
        Of a walk.
    theta : ndarray, shape (D,)
        The machine that explains the first session best by itself.
    labels : sequence of str
    """
    off = _find_offsets(model, theta)
    elapsed = np.sqrt(np.sum(model.drift.loadings**2, axis=1))  # √month since the first
    limit = FAR * float(model.drift.scale.max()) * np.maximum(elapsed, 1.0) + WARM
    beyond = np.flatnonzero(np.abs(off - off[0]).max(axis=1) > limit)
    if len(beyond):
        k = int(beyond[0])
        leg = int(np.argmax(np.abs(off[k] - off[0])))
        raise InputError(
            f"session {labels[k]!r}: found leg {leg + 1} off by {abs(off[k, leg] - off[0, leg]):.3g} mm from session "
            f"{labels[0]!r}, expected at most {limit[k]:.3g} mm of one machine with this drift; for several machines "
            'say hierarchy = "machines"'
        )


def _find_offsets(model: SessionModel, theta: Array) -> Array:
    """Return the mean error of each leg in each session for one machine θ (D,), shape (S, N), mm."""
    total, count = np.zeros((model.n_sessions, model.parts[0].rows.width)), np.zeros(model.n_sessions)
    for part in model.parts:
        errors = part.rows.linearise(theta).errors
        total[part.session] += errors.sum(axis=0)
        count[part.session] += len(errors)
    return total / count[:, None]
