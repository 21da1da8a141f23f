"""Where to measure next for a table: poses and places that lower its mean squared error most, chosen one by one.

To first order about the posterior's mode the squared error of all corrections together is tr(J C Jᵀ), with J their
derivative by the parameters' coordinates and C what remains unknown of these; a measurement with the white rows R, its
pose eliminated, leaves C - C Rᵀ (1 + R C Rᵀ)⁻¹ R C.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.shared.readings.knowledge import look
from bayescal.experiments.table.inputs import TableInputs
from bayescal.experiments.table.responses import differentiate_correction
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import add_poses, learn_in_turn

RANDOM_SETS = 20  # of as many measurements, to compare with


@dataclass(frozen=True, eq=False)
class Plan:
    """Measurements in the order in which they were chosen.

    Attributes
    ----------
    pose : ndarray, shape (N, q)
    cell : ndarray, shape (N, A)
    before : float
        Standard deviation of a correction, rms over places and actuators, without any of them.
    after : ndarray, shape (N,)
        The same after each.
    worst : ndarray, shape (N,)
        The largest standard deviation of any correction after each.
    random : ndarray, shape (N,)
        As `after`, of as many candidates at random, rms over sets.
    prior : float
        As `before`, of the tolerances alone.
    """

    pose: Array
    cell: Array
    before: float
    after: Array
    worst: Array
    random: Array
    prior: float


def plan_measurements(inputs: TableInputs, posterior: CalibrationPosterior, y: Array, covariance: Array) -> Plan:
    """Return what to measure beside the data, or in their place.

    Parameters
    ----------
    inputs : TableInputs
    posterior : CalibrationPosterior
    y : ndarray, shape (n,)
        The mode.
    covariance : ndarray, shape (m, m)
        C by the data, of the geometry's coordinates.
    """
    asked, rng = inputs.config.plan, np.random.default_rng([inputs.config.seed, 21])
    slopes = differentiate_correction(inputs, posterior.theta(y[None])[0], posterior.around(y)[1].T)
    flat = slopes.reshape(-1, slopes.shape[-1])
    start = covariance if asked.beside_data else np.eye(len(covariance))
    pose, cell = _list_candidates(inputs, rng)
    every = np.ones(len(inputs.variant.model.channels), dtype=bool)
    tried = look(posterior, inputs.variant, y, pose, every, inputs.given_at(cell))
    count = min(asked.measurements, len(pose))
    order, left = add_poses(tried.rows, flat.T @ flat, count, np.arange(len(pose)), start)
    sets = [rng.permutation(len(pose))[:count] for _ in range(RANDOM_SETS)]
    random = [[_rms(flat, one) for one in learn_in_turn(tried.rows, some, start)] for some in sets]
    return Plan(
        pose[order],
        cell[order],
        _rms(flat, start),
        np.array([_rms(flat, one) for one in left]),
        np.array([_deviations(flat, one).max() for one in left]),
        np.sqrt(np.mean(np.square(random), axis=0)),
        _rms(flat, np.eye(len(covariance))),
    )


def _list_candidates(inputs: TableInputs, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return random poses (c, q) at every place (c, A) at which the machine as expected stands."""
    n, cells = inputs.config.plan.poses, inputs.cells
    cell = np.repeat(cells, n, axis=0)
    pose = inputs.variant.workspace.draw(len(cell), rng)
    stands = np.isfinite(
        inputs.variant.model.read(inputs.variant.posterior().sampling.start, pose, inputs.given_at(cell))
    )
    return pose[stands.all(axis=-1)], cell[stands.all(axis=-1)]


def _deviations(slopes: Array, covariance: Array) -> Array:
    """Return the standard deviations of corrections with derivatives (S, m)."""
    return np.asarray(np.sqrt(np.einsum("si,ij,sj->s", slopes, covariance, slopes, optimize=True)))


def _rms(slopes: Array, covariance: Array) -> float:
    return float(np.sqrt(np.mean(_deviations(slopes, covariance) ** 2)))
