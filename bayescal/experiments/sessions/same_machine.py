"""Whether sessions are of one machine: another one of the same design is off by its tolerances, no drift is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.sessions import SessionModel
from bayescal.errors import InputError
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.numerics.geometry import Array

FAR = 20.0
"""Prior scales of the drift, over the time that went by, that legs of one machine are never off."""
WARM = 0.1
"""Millimetres that a leg may be off besides, by temperature, noise and model error."""


def check_same_machine(model: SessionModel, sessions: Sequence[MeasuredVariant], labels: Sequence[str]) -> None:
    """Raise InputError where the legs of a session are off those of the first by far more than they can have moved.

    Parameters
    ----------
    model : SessionModel
        Of a walk.
    sessions : sequence of MeasuredVariant
    labels : sequence of str
    """
    first = sessions[0].posterior
    theta = first.theta(first.approach()[None])[0]  # the machine that explains the first session best by itself
    off = np.stack([_find_offsets(one, theta) for one in sessions])
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


def _find_offsets(measured: MeasuredVariant, theta: Array) -> Array:
    """Return the mean error of each leg in a session for one machine θ (D,), shape (N,), mm."""
    likelihood = PoseLikelihood(measured.machine, measured.poses, measured.actuator_noise)
    return np.asarray(likelihood.error_jacobian(theta)[0].mean(axis=0))
