"""How actuators and pose respond to what changes: the numbers of a look-up table, for batches of machines.

Where h are the readings of the actuators, v₀ the commanded pose and x₀ the reference, the correction at x is

    Δq(x) = h(v₀, x) - h(v₀, x₀),

what the actuators have to add so that the platform stands where it stood; without it the platform moves to the v with
h(v, x) = h(v₀, x₀), by v - v₀.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.measurements import Comparison
from bayescal.experiments.table.inputs import TableInputs
from bayescal.machines.readings import Given
from bayescal.numerics.geometry import Array

STEPS = 8  # of Newton's method; two do for displacements of micrometres
ARRIVED = 1e-10  # of the workspace's half widths
BATCH = 4096  # poses of machines at once


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of T machines at G places.

    Attributes
    ----------
    correction : ndarray, shape (T, G, n)
        Δq, in the actuators' units.
    offset : ndarray, shape (T, G, q)
        v - v₀ where nothing is corrected, mm and rad.
    """

    correction: Array
    offset: Array


def respond(inputs: TableInputs, theta: Array, cells: Array) -> Responses:
    """Return the responses of machines (T, D) at places (G, A); NaN where a machine does not stand."""
    size = max(1, BATCH // len(cells))
    parts = [_respond(inputs, theta[start : start + size], cells) for start in range(0, len(theta), size)]
    return Responses(np.concatenate([one.correction for one in parts]), np.concatenate([one.offset for one in parts]))


def _respond(inputs: TableInputs, theta: Array, cells: Array) -> Responses:
    model, theta = inputs.actuators, theta[:, None]
    given = {name: value[None] for name, value in inputs.given_at(cells).items()}
    held = model.read(theta, inputs.pose, _give(inputs.reference))
    correction = Comparison(model.channels).subtract(model.read(theta, inputs.pose, given), held)
    start = np.broadcast_to(inputs.pose, (*correction.shape[:2], len(inputs.pose)))
    return Responses(correction, _follow(inputs, theta, held, given, start) - inputs.pose)


def _follow(inputs: TableInputs, theta: Array, held: Array, given: Given, pose: Array) -> Array:
    """Return where the platform stands while the actuators stay as they are, (T, G, q), by Newton's method."""
    model, half = inputs.actuators, inputs.variant.workspace.half
    for _ in range(STEPS):
        here = model.linearise(theta, pose, False, given)
        left = Comparison(model.channels).subtract(np.broadcast_to(held, here.values.shape), here.values)
        step = (np.linalg.pinv(np.nan_to_num(here.by_pose)) @ left[..., None])[..., 0]
        pose = pose + step
        if not np.any(np.abs(step) > ARRIVED * half):
            break
    return pose


def differentiate_correction(inputs: TableInputs, theta: Array, moves: Array) -> Array:
    """Return the derivatives of Δq at all places by coordinates that move one machine (D,) by (m, D), (G, n, m)."""
    model, cells = inputs.actuators, inputs.cells
    reference = {name: np.full(1, value) for name, value in inputs.reference.items()}
    pose = np.broadcast_to(inputs.pose, (len(cells), len(inputs.pose)))
    here = model.linearise(theta, pose, True, inputs.given_at(cells)).by_parameters
    there = model.linearise(theta, pose[:1], True, reference).by_parameters
    return np.asarray((here - there) @ moves.T)


def measure_elsewhere(inputs: TableInputs, theta: Array, poses: Array) -> Array:
    """Return by how much at most Δq of one machine (D,) differs at other poses (W, q) from that of the table, (n,)."""
    model = inputs.actuators
    compare, given = Comparison(model.channels), inputs.given_at(inputs.cells)

    def correct(pose: Array) -> Array:
        held = model.read(theta, pose, _give(inputs.reference))
        return compare.subtract(model.read(theta, pose, given), held)

    found = np.abs(correct(poses[:, None]) - correct(inputs.pose[None, None]))
    return np.asarray(np.nanmax(found, axis=(0, 1)))


def _give(reference: dict[str, float]) -> dict[str, Array]:
    return {name: np.array(value) for name, value in reference.items()}
