"""Poses measured of a machine as readings: its own channels are commanded, external ones are the pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.experiments.shared.slip_rows import VariantReadings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import CHANNEL, FRAME, FoundSlip
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array, rotation_vector_from_matrix

MOVED = 1.0  # mm or rad, by which each commanded channel may have moved since its calibration


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


def build_pose_readings(
    model: ReadingModel,
    poses: MeasuredPoses,
    noise: Array | float,
    priors: Mapping[str, Prior],
    errors: ErrorModel,
    fixed: Mapping[str, float],
) -> VariantReadings:
    """Return poses measured of a machine as readings; where these are NaN, a coordinate was not measured.

    ``noise`` is that of the N commanded channels, (P, N) or one for all. Poses that are not known whole are looked for
    where the nominal machine stands at the same commands.
    """
    from bayescal.calibrated.verify.plan import place_poses

    turned = np.isfinite(poses.rotation).all(axis=(1, 2))
    rotation = rotation_vector_from_matrix(np.where(turned[:, None, None], poses.rotation, np.eye(3)))
    pose = np.concatenate([poses.position, np.where(turned[:, None], rotation, np.nan)], axis=1)
    data = place_poses(poses.names, poses.actuators, pose, poses.covariance)
    own = np.isin(model.names, model.commanded)
    data.sd[:, own] = noise
    data = replace(data, commanded=np.tile(own, (data.n_poses, 1)))
    missing = ~np.isfinite(pose).all(axis=1)
    if missing.any():
        nominal, found = model.locate(model.layout.nominal, poses.actuators[missing])
        pose[missing] = np.where(found[:, None], nominal, model.home_pose)
    likelihood = CalibrationLikelihood(model, data, 1.0, pose).plain
    posterior: CalibrationPosterior = Posterior(likelihood, priors, errors, fixed)
    return VariantReadings(posterior, pose.min(axis=0), pose.max(axis=0), own)


def find_reverification_slip(calibrated: CalibratedMachine, poses: MeasuredPoses) -> FoundSlip | None:
    """Return what explains poses measured after a calibration many times better than they are; None without any.

    Single channels and frames are left to the reverification itself: what they read otherwise is a shift of a
    parameter. So is a channel that moved: by so much each may be off in all rows. The calibrated machine has its
    posterior's covariance, and poses are whole, in the base frame.
    """
    names, theta, sd = calibrated.model.layout.names, calibrated.theta, calibrated.sd
    known = list(zip(names, theta.tolist(), sd.tolist(), strict=True))
    priors: dict[str, Prior] = {name: NormalPrior(value, size) for name, value, size in known if size > 0.0}
    fixed = {name: value for name, value, size in known if not size > 0.0}
    errors = calibrated.errors
    noise = np.sqrt(np.diagonal(errors.noise) + errors.model_variance)
    n = len(noise)
    moved = np.broadcast_to(MOVED * np.eye(n + DEGREES_OF_FREEDOM, n), (poses.n_poses, n + DEGREES_OF_FREEDOM, n))
    readings = build_pose_readings(calibrated.model, poses, noise, priors, ErrorModel((SharedErrors(moved),)), fixed)
    return find_slip([readings], (CHANNEL, FRAME))
