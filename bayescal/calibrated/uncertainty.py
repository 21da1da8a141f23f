"""How sure the poses of a calibrated machine are over its workspace: GUM's budget by source, JCGM 101's Monte Carlo.

The law of propagation gives each pose's covariance: that of the geometry and those of what moves the legs besides. By
Monte Carlo draws of the posterior go through the kinematics, each with errors of its own; where both agree the expanded
uncertainty k u of the budget may be stated, otherwise that of the draws (JCGM 101:2008, section 8).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from bayescal.calibrated.machine import CalibratedMachine, IndependentErrors
from bayescal.calibrated.predict import PosePrediction, draw_poses, predict_poses
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

GEOMETRY, ACTUATORS, MODEL, MATRIX = "geometry", "actuator noise", "model error", "deformation matrix"
BATCH = 16  # poses at a time that draws go through


@dataclass(frozen=True, eq=False)
class Budget:
    """Covariances of P poses by source.

    Attributes
    ----------
    actuators : ndarray, shape (P, N)
        mm.
    position : ndarray, shape (P, 3)
        Where the platform's frame is in the base frame, mm.
    parts : dict of str to ndarray, shape (P, 6, 6)
        Of position (mm) and rotation vector (rad) about the base axes, by source.
    """

    actuators: Array
    position: Array
    parts: dict[str, Array]

    @property
    def combined(self) -> Array:
        """Covariance of each pose, all sources together, shape (P, 6, 6)."""
        return np.sum(list(self.parts.values()), axis=0)

    def sd(self, source: str | None = None) -> Array:
        """Return standard uncertainties (P, 6) in mm and rad, of one source or combined."""
        covariance = self.combined if source is None else self.parts[source]
        return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))


@dataclass(frozen=True, eq=False)
class Spread:
    """What Monte Carlo finds of P poses.

    Attributes
    ----------
    half_width : ndarray, shape (P, 6)
        Half the interval, as wide on both sides of the mean, that holds the stated share of draws, mm and rad.
    radius : ndarray, shape (P,)
        Of the sphere about the mean that holds it, mm.
    n_draws : int
        How many draws of the posterior.
    """

    half_width: Array
    radius: Array
    n_draws: int


def compute_budget(calibrated: CalibratedMachine, actuators: Array) -> Budget:
    """Return the covariances of the poses of actuator positions (P, N), mm, by source.

    Raises
    ------
    InputError
        Where there is no covariance of the posterior.
    """
    if calibrated.covariance is None:
        raise InputError(f"experiment {calibrated.source.experiment}: found no draws of its posterior, expected some")
    together = predict_poses(calibrated, actuators)
    assert together.of_geometry is not None
    parts = {GEOMETRY: together.of_geometry}
    for source, errors in _split_errors(calibrated.errors).items():
        alone = predict_poses(replace(calibrated, errors=errors), actuators)
        assert alone.covariance is not None
        assert alone.of_geometry is not None
        parts[source] = alone.covariance - alone.of_geometry
    return Budget(actuators, together.position, parts)


def _split_errors(errors: object) -> dict[str, IndependentErrors]:
    """Return what moves the legs besides the geometry, source by source."""
    if not isinstance(errors, IndependentErrors):
        raise InputError("model error: found a structured one, expected one that is independent from pose to pose")
    none = np.zeros_like(errors.model_variance)
    parts = {ACTUATORS: replace(errors, model_variance=none, matrix_covariance=None)}
    if errors.model_variance.any():
        parts[MODEL] = IndependentErrors(0.0, errors.model_variance)
    if errors.matrix_covariance is not None:
        parts[MATRIX] = IndependentErrors(0.0, none, errors.matrix_covariance)
    return parts


def coverage_factor(coverage: float) -> float:
    """Return k by which a normal quantity lies within k u of its mean with a probability (GUM, annex G)."""
    return float(norm.ppf(0.5 * (1.0 + coverage)))


def propagate(calibrated: CalibratedMachine, actuators: Array, coverage: float, n_draws: int, seed: int) -> Spread:
    """Return by Monte Carlo what holds a share of poses at actuator positions (P, N), mm (JCGM 101:2008, section 7).

    Raises
    ------
    InputError
        Where there are no draws.
    """
    rng, mean = np.random.default_rng(seed), predict_poses(calibrated, actuators)
    half_width, radius, n = np.empty((len(actuators), 6)), np.empty(len(actuators)), 0
    for start in range(0, len(actuators), BATCH):
        part = slice(start, start + BATCH)
        apart = _deviate(mean, part, *draw_poses(calibrated, actuators[part], n_draws, rng))
        half_width[part] = np.nanquantile(np.abs(apart), coverage, axis=0)
        radius[part] = np.nanquantile(np.linalg.norm(apart[..., :3], axis=-1), coverage, axis=0)
        n = len(apart)
    return Spread(half_width, radius, n)


def _deviate(mean: PosePrediction, part: slice, position: Array, rotation: Array) -> Array:
    """Return how far drawn poses (S, P, 3), (S, P, 3, 3) are from the predicted ones, (S, P, 6), mm and rad."""
    turned = rotation @ np.swapaxes(mean.rotation[part], 1, 2)
    there = np.isfinite(turned).all(axis=(-2, -1))
    angles = np.full((*there.shape, 3), np.nan)
    angles[there] = Rotation.from_matrix(turned[there]).as_rotvec()
    return np.concatenate([position - mean.position[part], angles], axis=-1)
