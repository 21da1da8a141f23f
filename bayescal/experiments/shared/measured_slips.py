"""Slips in the poses of a machine that was measured: by a study that others build on, or after its calibration."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.likelihood import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.slips import FoundSlip, Suspect, find_slip
from bayescal.numerics.geometry import Array


def find_measured_slip(variants: Iterable[MeasuredVariant], denied: Collection[str] = ()) -> FoundSlip | None:
    """Return what explains measured poses many times better than they stand; None where some variant fits them.

    Parameters
    ----------
    variants : iterable of MeasuredVariant
        The same calibration poses under models one of which may be right.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    measured = list(variants)
    start = measured[0].machine.mechanism.initial_actuator_positions
    return find_slip(map(_suspect, measured), start, max(map(_state_error, measured)), denied)


@dataclass(frozen=True, eq=False)
class _Known:
    """What a calibration leaves open, as `slips.Tolerances`."""

    start: Array
    free: np.ndarray
    scale: Array


def find_recheck_slip(calibrated: CalibratedMachine, poses: MeasuredPoses) -> FoundSlip | None:
    """Return what explains poses measured after a calibration many times better than they stand; None without any.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With its posterior's covariance.
    poses : MeasuredPoses
        Whole, in the base frame.
    """
    assert calibrated.covariance is not None
    sd, start = np.sqrt(np.diagonal(calibrated.covariance)), calibrated.machine.mechanism.initial_actuator_positions
    free = np.flatnonzero(sd > 0.0)

    def likelihood_of(actuators: Array, chosen: np.ndarray) -> Likelihood:
        return PoseLikelihood(calibrated.machine, replace(poses.select(chosen), actuators=actuators), 0.0)

    still, unit = np.zeros((1, calibrated.n_legs)), np.eye(calibrated.n_legs)[None]
    of_legs = np.diagonal(calibrated.errors.covariance(still, unit), axis1=1, axis2=2).mean()
    stated = float(np.sqrt(of_legs + _position_variance(poses)))
    suspect = Suspect(likelihood_of, _Known(calibrated.theta, free, sd[free]), poses.actuators)
    return find_slip([suspect], start, stated)


def _suspect(measured: MeasuredVariant) -> Suspect:
    def likelihood_of(actuators: Array, chosen: np.ndarray) -> Likelihood:
        poses = replace(measured.poses.select(chosen), actuators=actuators)
        return PoseLikelihood(measured.machine, poses, measured.actuator_noise)

    return Suspect(likelihood_of, measured.posterior.sampling.coordinates, measured.poses.actuators)


def _state_error(measured: MeasuredVariant) -> float:
    """Return what a leg may err by as stated: model error, actuators, the measured position, mm."""
    scale = measured.posterior.errors.model_error.scale or 0.0
    return float(np.sqrt(_position_variance(measured.poses) + scale**2 + measured.actuator_noise**2))


def _position_variance(poses: MeasuredPoses) -> float:
    return float(np.diagonal(poses.covariance, axis1=1, axis2=2)[:, :3].mean())
