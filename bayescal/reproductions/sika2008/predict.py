"""What the paper's procedure leaves of errors, to first order and without simulation.

The unweighted estimate of the parameters is G Zᵀe, with G the pseudo-inverse of the rows ZᵀA that are free of the
poses and e the noise of the readings, in the units that the procedure weighs them in; its covariance is
G ZᵀΣZ Gᵀ.
"""

from __future__ import annotations

import numpy as np

from bayescal.numerics.geometry import Array
from bayescal.reproductions.sika2008.calibrate import unweighted
from bayescal.reproductions.sika2008.sensor_sets import compute_tool_sensitivity, null_basis
from bayescal.reproductions.sika2008.setup import Plan


def predict_covariance(plan: Plan, pose: Array) -> Array:
    """Return the covariance (n, n) of the parameters calibrated at poses (P, q), mm and rad."""
    sensors, free = unweighted(plan.sensors), plan.free
    here = sensors.linearise(free.centre, pose)
    basis = null_basis(here.by_pose)
    rows = basis @ (here.by_parameters[..., free.places] * free.scale)
    whitened = basis * (plan.sensors.noise / sensors.noise)
    gain = np.linalg.pinv(rows.reshape(-1, len(free.places)))
    gain = gain.reshape(len(free.places), len(pose), -1)
    spread = np.einsum("npz,pzk->npk", gain, whitened).reshape(len(free.places), -1) * free.scale[:, None]
    return np.asarray(spread @ spread.T)


def predict_tool(plan: Plan, covariance: Array, targets: Array) -> float:
    """Return the root mean square error of the tool's centre over poses (V, q), readings without noise, mm."""
    sensitivity = compute_tool_sensitivity(unweighted(plan.sensors), plan.free.centre, targets)
    parts = sensitivity.covariance(plan.free.places, covariance)
    return float(np.sqrt(np.mean(np.trace(parts, axis1=-2, axis2=-1))))
