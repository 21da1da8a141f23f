"""Poses measured of a machine on legs as readings: its own channels are its actuators, external ones the pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.instruments.readings import PointReadings
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.model_error import IndependentErrors
from bayescal.density.calibration.terms import Errors, ErrorTerm
from bayescal.density.errors import TAU
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.experiments.shared.slip_rows import Readings
from bayescal.experiments.shared.slip_search import find_slip
from bayescal.experiments.shared.slips import CHANNEL, FRAME, FoundSlip
from bayescal.machines.frames import AXES, frame_blocks, frame_symbols, name_frames
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Channel, Instrument, Legs, Parameters, ReadingModel, place
from bayescal.numerics.analytic import rotation_matrix
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


class Probe(Instrument):
    """Points on the tool as S stations read them, in the base frame by the stations' nominal places, (S Q 3).

    Frames have the symbols of `bayescal.machines.frames`.
    """

    def __init__(self, readings: PointReadings) -> None:
        """Lay out frames and channels."""
        super().__init__()
        self.points, self.frames = readings.probe, name_frames(readings.n_stations)
        self.parameters = list(frame_blocks(readings.n_stations))
        stations = [f"{one}_" if readings.n_stations > 1 else "" for one in readings.stations]
        self.channels = [
            Channel(f"{station}{point}[{axis}]", "mm")
            for station in stations
            for point in readings.points
            for axis in AXES
        ]

    def see(self, parameters: Parameters, position: Any, rotation: Any) -> Any:
        """Return where each station reads the points."""

        def take(frame: str) -> tuple[Any, Any]:
            vectors = (np.stack([parameters[one] for one in some], axis=-1) for some in frame_symbols(frame))
            moved, turned = vectors
            return moved, rotation_matrix(turned)

        *bases, (moved, turned) = map(take, self.frames)
        points = np.einsum("...ij,qj->...qi", rotation @ turned, self.points)
        points = points + (position + (rotation @ moved[..., None])[..., 0])[..., None, :]
        seen = [np.einsum("...ij,...qj->...qi", turn, points) + move[..., None, :] for move, turn in bases]
        every = np.concatenate(np.broadcast_arrays(*seen), axis=-2)
        return every.reshape(*every.shape[:-2], -1)


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
    posterior: CalibrationPosterior = Posterior(CalibrationLikelihood(model, data, 1.0, pose), priors, errors, fixed)
    return Readings(posterior, pose.min(axis=0), pose.max(axis=0), own)


def read_points(
    machine: Machine,
    readings: PointReadings,
    noise: float,
    priors: Mapping[str, Prior],
    fixed: Mapping[str, float],
    scale: float,
) -> Readings:
    """Return points seen of a machine on legs, in which slips are looked for; arguments as those of `read_legs`.

    Priors are of frames, too.
    """
    legs = Legs(machine)
    bare = legs.pick(np.arange(legs.n_legs))
    model = place(bare, {PROBE: Probe(readings)})
    own = {name if name in legs.layout.names else f"{PROBE}_{name}": one for name, one in priors.items()}
    n_poses, width = readings.n_poses, readings.values[0].size
    values = np.where(readings.seen[..., None], readings.values, np.nan).reshape(n_poses, width)
    each = np.where(readings.seen[..., None, None], readings.covariance, np.eye(3)).reshape(n_poses, -1, 3, 3)
    covariance = np.zeros((n_poses, width // 3, 3, width // 3, 3))
    points = np.arange(width // 3)
    covariance[:, points, :, points, :] = np.moveaxis(each, 1, 0)
    covariance = covariance.reshape(n_poses, width, width)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    correlation = np.tile(np.eye(legs.n_legs + width), (n_poses, 1, 1))
    correlation[:, legs.n_legs :, legs.n_legs :] = covariance / (sd[:, :, None] * sd[:, None, :])
    data = Measurements(
        readings.names,
        np.concatenate([readings.actuators, values], axis=1),
        np.concatenate([np.ones_like(readings.actuators), sd], axis=1),
        {},
        correlation,
    )
    errors = Errors(_let_legs_err(legs.n_legs, len(model.channels), scale))
    return _place(model, legs, data, np.full((n_poses, DEGREES_OF_FREEDOM), np.nan), noise, own, errors, fixed)


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
