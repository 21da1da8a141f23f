"""How accurate the tool's centre is with any set of sensors, to first order.

At each pose of the calibration let H and A be the derivatives of all whitened readings by the pose and by the
parameters, these in units of their tolerances. A set S of sensors has rows of them, and over its sensors the sums
G = Σ H_kᵀ H_k and B = Σ H_kᵀ A_k add up. With the pose eliminated the set tells

    Λ_S = Σ_poses [Σ_k A_kᵀ A_k - Bᵀ G⁻¹ B] = Σ_poses (A - H G⁻¹ B)ᵀ (A - H G⁻¹ B),

of which the second form is summed: the first loses the digits that bear on the least known direction. (1 + Λ)⁻¹ is the
covariance of the parameters after the calibration. A parameter that the set does not see keeps its tolerance, and moves
nothing where no sensor in use depends on it.

In use the internal sensors of the set locate the tool's centre. It errs by T δ, with T = V_d - V_v G⁻¹ B there, for an
error δ of the parameters, and by noise of covariance V_v G⁻¹ V_vᵀ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from bayescal.experiments.sensor_placement.alignment import alignment_basis, take_away
from bayescal.experiments.sensor_placement.inputs import PlacementInputs
from bayescal.experiments.shared.sensor_sets import SensorSet
from bayescal.numerics.geometry import Array

SINGULAR = 1e-12
"""Least eigenvalue of G, scaled so that all sensors together have a unit diagonal, with which a pose is determined."""
LEFT = 0.8
"""Share of the tool's variance, noise included, above which the tolerances and not the calibration rule it."""

type Reason = Literal["", "pose", "equations", "tolerances"]


@dataclass(frozen=True, eq=False)
class Placement:
    """Derivatives of all sensors at P poses of the calibration and W of the workspace.

    Attributes
    ----------
    by_pose, by_parameters : ndarray, shapes (P, K, q) and (P, K, n)
        H and A, in units of noise and tolerances.
    in_use_by_pose, in_use_by_parameters : ndarray, shapes (W, K, q) and (W, K, n)
        The same over the workspace.
    tool_by_pose, tool_by_parameters : ndarray, shapes (W, m, q) and (W, m, n)
        V_v and V_d, mm.
    aligned : ndarray, shape (W m, f)
        Orthonormal fields that setting up takes away; none where the frames are given.
    internal : ndarray of bool, shape (K,)
        Which sensors are there in use.
    seen : ndarray of bool, shape (K, n)
        Which parameters each sensor depends on.
    n_frame : int
        How many of the parameters that internal sensors see only say where the frames are.
    """

    by_pose: Array
    by_parameters: Array
    in_use_by_pose: Array
    in_use_by_parameters: Array
    tool_by_pose: Array
    tool_by_parameters: Array
    aligned: Array
    internal: np.ndarray
    seen: np.ndarray
    n_frame: int

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return len(self.by_pose)

    @cached_property
    def units(self) -> Array:
        """What all sensors together resolve of each coordinate of a pose, inverse, shape (P, q)."""
        return np.asarray(np.linalg.norm(self.by_pose, axis=1))

    @cached_property
    def in_use_units(self) -> Array:
        """The same over the workspace, shape (W, q)."""
        return np.asarray(np.linalg.norm(self.in_use_by_pose, axis=1))


@dataclass(frozen=True)
class Accuracy:
    """Errors of the tool's centre over the workspace, norms of one standard deviation, mm; NaN without a pose.

    Attributes
    ----------
    reason : str
        Why the set is no good: ``pose``, ``equations`` or ``tolerances``; empty where it is.
    rms, largest : float
        Of calibration and noise together.
    calibration, noise : float
        The parts, rms.
    beforehand : float
        What the tolerances make of the calibration's part, rms.
    left : float
        Share of the tool's variance, noise included, that comes from directions of which the readings of the
        calibration tell less than the tolerances do.
    """

    reason: Reason
    rms: float = np.nan
    largest: float = np.nan
    calibration: float = np.nan
    noise: float = np.nan
    beforehand: float = np.nan
    left: float = np.nan


def build_placement(inputs: PlacementInputs) -> Placement:
    """Return the derivatives at the machine as expected."""
    model, sensors, free, scale = inputs.model, inputs.sensors, inputs.free, inputs.tolerances
    theta = model.layout.nominal
    here, there = (sensors.linearise(theta, pose) for pose in (inputs.pose, inputs.workspace))
    position, by_pose, by_parameters = model.tool(theta, inputs.workspace)
    n_fields = None if inputs.config.frames == "aligned" else 0
    names = [model.layout.names[k] for k in free]
    return Placement(
        here.by_pose,
        here.by_parameters[..., free] * scale,
        there.by_pose,
        there.by_parameters[..., free] * scale,
        by_pose,
        by_parameters[..., free] * scale,
        alignment_basis(model, position, inputs.workspace, n_fields),
        ~is_external(sensors),
        np.array([np.isin(names, model.seen_parameters([name])) for name in sensors.names]),
        len(model.frame_parameters()) if inputs.config.frames != "given" else 0,
    )


def is_external(sensors: SensorSet) -> np.ndarray:
    """Return which sensors stand beside the machine, shape (K,), bool."""
    return np.array([sensors.model.channels[k].external for k in sensors.chosen])


@dataclass(frozen=True, eq=False)
class Elimination:
    """Poses eliminated from readings (P, k), where they determine them.

    Attributes
    ----------
    inverse : ndarray, shape (P, q, q)
        G⁻¹.
    shift : ndarray, shape (P, q, n)
        G⁻¹ B: how the pose found moves with the parameters, but for the sign.
    """

    inverse: Array
    shift: Array


def eliminate(by_pose: Array, by_parameters: Array, units: Array) -> Elimination | None:
    """Return what is needed to do without the poses; None where some pose is not determined.

    Parameters
    ----------
    by_pose, by_parameters : ndarray, shapes (P, k, q) and (P, k, n)
        H and A of the sensors there are.
    units : ndarray, shape (P, q)
        In which the pose's coordinates are of one size; of all sensors, for a coordinate that these do not see leaves
        nothing but rounding.
    """
    if by_pose.shape[-2] < by_pose.shape[-1]:
        return None
    turned = np.swapaxes(by_pose, -1, -2)
    scale = units[:, :, None] * units[:, None]
    scaled = (turned @ by_pose) / scale
    if np.linalg.eigvalsh(scaled)[:, 0].min() < SINGULAR:
        return None
    inverse = np.linalg.inv(scaled) / scale
    return Elimination(inverse, inverse @ (turned @ by_parameters))


def compute_information(placement: Placement, chosen: np.ndarray) -> Array | None:
    """Return Λ_S of chosen sensors (K,), shape (n, n), in units of the tolerances; None without a pose."""
    by_pose, by_parameters = placement.by_pose[:, chosen], placement.by_parameters[:, chosen]
    found = eliminate(by_pose, by_parameters, placement.units)
    if found is None:
        return None
    rows = by_parameters - by_pose @ found.shift
    rows = rows.reshape(-1, rows.shape[-1])
    return np.asarray(rows.T @ rows)


def evaluate_set(placement: Placement, chosen: np.ndarray) -> Accuracy:
    """Return how accurate the tool's centre is with chosen sensors, shape (K,), bool."""
    information = compute_information(placement, chosen)
    internal = chosen & placement.internal
    in_use = eliminate(
        placement.in_use_by_pose[:, internal], placement.in_use_by_parameters[:, internal], placement.in_use_units
    )
    if information is None or in_use is None:
        return Accuracy("pose")
    n_places = len(placement.tool_by_pose)
    slope = placement.tool_by_parameters - placement.tool_by_pose @ in_use.shift
    slope = take_away(placement.aligned, slope.reshape(-1, slope.shape[-1]))
    values, vectors = np.linalg.eigh(information)
    told = 1.0 + np.maximum(values, 0.0)
    square = (slope @ vectors) ** 2
    by_direction = square.sum(axis=0) / told / n_places
    noise = np.einsum("wij,wjk,wik->w", placement.tool_by_pose, in_use.inverse, placement.tool_by_pose, optimize=True)
    total = (square / told).sum(axis=1).reshape(n_places, -1).sum(axis=1) + noise
    left = float(by_direction[values < 1.0].sum() / total.mean())
    return Accuracy(
        "equations" if _count_missing(placement, chosen) > 0 else "tolerances" if left > LEFT else "",
        rms=float(np.sqrt(total.mean())),
        largest=float(np.sqrt(total.max())),
        calibration=float(np.sqrt(by_direction.sum())),
        noise=float(np.sqrt(noise.mean())),
        beforehand=float(np.sqrt(square.sum() / n_places)),
        left=left,
    )


def _count_missing(placement: Placement, chosen: np.ndarray) -> int:
    """Return how many more unknowns than equations there are; the frames are no unknowns without an instrument."""
    n_unknowns = int(placement.seen[chosen].any(axis=0).sum())
    if not (chosen & ~placement.internal).any():
        n_unknowns -= min(placement.n_frame, n_unknowns)
    redundancy = int(chosen.sum()) - placement.by_pose.shape[-1]
    return n_unknowns - placement.n_poses * max(redundancy, 0)


def evaluate_sets(placement: Placement, sets: np.ndarray) -> list[Accuracy]:
    """Return the accuracy of sets of sensors (S, K), bool."""
    return [evaluate_set(placement, chosen) for chosen in sets]
