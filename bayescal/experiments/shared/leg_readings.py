"""Poses measured of a machine on legs as readings: its own channels are its actuators, external ones the pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.model_error import IndependentErrors
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.density.sorts import TAU
from bayescal.experiments.shared.slip_rows import Readings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import CHANNEL, FRAME, FoundSlip
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs, ReadingModel
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, rotation_vector_from_matrix

PROBE = "probe"
MOVED = 1.0  # mm, by which each leg may have moved since its calibration


@dataclass(frozen=True)
class SharedErrors(ErrorTerm):
    """Errors that all poses share: what M unknowns, standard normal, add to the readings, (P, K, M)."""

    each: Array
    names = units = ()
    priors = ()

    def columns(self, zeta: Array, data: Measurements) -> Array:
        """Return them, row by row as these stand among all."""
        del zeta
        return self.each[data.order][None]


def place_legs(
    model: Legs,
    poses: MeasuredPoses,
    noise: Array | float,
    priors: Mapping[str, Prior],
    errors: Errors,
    fixed: Mapping[str, float],
) -> Readings:
    """Return poses measured of a machine on legs as readings; where these are NaN, a coordinate was not measured.

    Parameters
    ----------
    noise : ndarray, shape (P, N), or float
        Of the actuators, mm.
    """
    from bayescal.calibrated.recheck.plan import place_poses

    turned = np.isfinite(poses.rotation).all(axis=(1, 2))
    rotation = rotation_vector_from_matrix(np.where(turned[:, None, None], poses.rotation, np.eye(3)))
    pose = np.concatenate([poses.position, np.where(turned[:, None], rotation, np.nan)], axis=1)
    data = place_poses(poses.names, poses.actuators, pose, poses.covariance)
    return _place(model, model, data, pose, noise, priors, errors, fixed)


def _place(
    model: ReadingModel,
    legs: Legs,
    data: Measurements,
    pose: Array,
    noise: Array | float,
    priors: Mapping[str, Prior],
    errors: Errors,
    fixed: Mapping[str, float],
) -> Readings:
    """Return readings of legs and of what stands beside them, poses (P, 6) near, NaN where these are not known."""
    own, pose = np.arange(len(model.channels)) < legs.n_legs, pose.copy()
    data.sd[:, own] = noise
    data = replace(data, commanded=np.tile(own, (data.n_poses, 1)))
    missing = ~np.isfinite(pose).all(axis=1)
    if missing.any():  # where the nominal machine stands at the same actuator positions
        nominal, found = legs.locate(legs.layout.nominal, data.values[missing][:, own])
        pose[missing] = np.where(found[:, None], nominal, legs.home_pose)
    likelihood = CalibrationLikelihood(model, data, 1.0, pose).plain
    posterior: CalibrationPosterior = Posterior(likelihood, priors, errors, fixed)
    return Readings(posterior, pose.min(axis=0), pose.max(axis=0), own)


def _let_legs_err(n_legs: int, n_channels: int, scale: float) -> tuple[ErrorTerm, ...]:
    legs = np.arange(n_channels) < n_legs
    return (IndependentErrors(TAU, legs, scale, "mm", np.ones(n_channels), 0.0),) if scale > 0.0 else ()


def read_legs(
    machine: Machine,
    poses: MeasuredPoses,
    noise: Array | float,
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
    scale: float = 0.0,
    shared: Array | None = None,
) -> Readings:
    """Return poses measured of a machine on legs, in which slips are looked for; arguments as those of `place_legs`.

    Parameters
    ----------
    scale : float, optional
        By what each leg errs from pose to pose, mm: what a study's model error allows for is no slip.
    shared : ndarray, shape (P, N + 6, M), optional
        What M unknowns, standard normal, do to the readings of all poses.
    """
    model = Legs(machine)
    terms = _let_legs_err(model.n_legs, len(model.channels), scale)
    terms = terms if shared is None else (*terms, SharedErrors(shared))
    return place_legs(model, poses, noise, priors, Errors(terms), fixed)


def find_recheck_slip(calibrated: CalibratedMachine, poses: MeasuredPoses) -> FoundSlip | None:
    """Return what explains poses measured after a calibration many times better than they are; None without any.

    Single channels and frames are left to the recheck itself: what they read otherwise is a shift of a parameter. So is
    a leg that moved: by so much each may be off in all rows.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With its posterior's covariance.
    poses : MeasuredPoses
        Whole, in the base frame.
    """
    names, theta, sd = calibrated.legs.layout.names, calibrated.theta, calibrated.sd
    known = list(zip(names, theta.tolist(), sd.tolist(), strict=True))
    priors: dict[str, Prior] = {name: NormalPrior(value, size) for name, value, size in known if size > 0.0}
    fixed = {name: value for name, value, size in known if not size > 0.0}
    errors = calibrated.errors
    noise = np.sqrt(np.diagonal(errors.noise) + errors.model_variance)
    n = len(noise)
    moved = np.broadcast_to(MOVED * np.eye(n + DEGREES_OF_FREEDOM, n), (poses.n_poses, n + DEGREES_OF_FREEDOM, n))
    return find_slip([read_legs(calibrated.legs, poses, noise, priors, fixed, shared=moved)], (CHANNEL, FRAME))
