"""Slips of a machine on legs: of its actuators, and of the poses that were measured.

Legs have an order, actuators an initial position, rotations a convention. Data are weighed with an error of the legs as
large as suits each case best.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.data.instruments.read_poses import FIXED, ROLL_PITCH_YAW, name_angles
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import Likelihood
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.errors import BayescalError
from bayescal.experiments.shared.measured import MeasuredVariant
from bayescal.experiments.shared.slips import (
    ANGLES,
    LEGS,
    LENGTHS,
    NOTHING,
    POSES,
    ROWS,
    UNIT,
    FoundSlip,
    Slip,
    Weight,
    find_slip,
)
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

ERRORS = np.geomspace(1e-4, 1e2, 25)  # mm, of every leg
REREAD = 1.5
"""Factor by which errors have to fall where what was measured is read in another way: at tilts of some degrees the legs
are then off by two to five times what was stated. Clean twins that err by 50 µm besides gain less than a nat by it."""
SUSPECT = 10.0
"""Legs' errors in units of what was stated, below which no slip of the actuators is tried."""


class Tolerances(NamedTuple):
    """What is free about which machine, and how far, as `bayescal.machines.coordinates.Coordinates` have it.

    Attributes
    ----------
    start : ndarray, shape (D,)
    free : ndarray of int, shape (n,)
    scale : ndarray, shape (n,)
    """

    start: Array
    free: np.ndarray
    scale: Array


@dataclass(frozen=True, eq=False)
class LegData:
    """Actuator positions (P, N), mm, and the poses that were measured; None for points in place of poses."""

    actuators: Array
    poses: MeasuredPoses | None = None

    def pick(self, chosen: np.ndarray) -> LegData:
        """Return some of them."""
        return LegData(self.actuators[chosen], None if self.poses is None else self.poses.select(chosen))


type LikelihoodOf = Callable[[LegData, np.ndarray], Likelihood]
"""Returns the density of data that are some of the measured poses, (Q,)."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """Data under one machine, in which slips are looked for.

    Attributes
    ----------
    likelihood_of : LikelihoodOf
    tolerances : Tolerances
    data : LegData
    stated : float
        Error of a leg that noise and model error let expect, mm.
    """

    likelihood_of: LikelihoodOf
    tolerances: Tolerances
    data: LegData
    stated: float

    def weigh(self, data: LegData, chosen: np.ndarray | None) -> Weight:
        """Return how well data fit under the priors to first order; some of the measured poses where these are given.

        The covariance is C + S Sᵀ, S the slope by the parameters in tolerances, by the determinant lemma.
        """
        some = np.arange(len(data.actuators)) if chosen is None else chosen
        picked = data if len(data.actuators) == len(some) else data.pick(some)
        try:
            with np.errstate(all="ignore"):
                return _weigh(self.likelihood_of(picked, some), self.tolerances, self.stated)
        except (BayescalError, np.linalg.LinAlgError):
            return NOTHING


def find_leg_slip(suspects: Iterable[Suspect], start: Array, denied: Collection[str] = ()) -> FoundSlip | None:
    """Return the slip that explains the data best; None where some machine fits, or none helps.

    Parameters
    ----------
    suspects : iterable of Suspect
        The same data under machines one of which may be right.
    start : ndarray, shape (N,)
        Initial positions, mm.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    weighed: list[tuple[Weight, Suspect]] = []
    for one in suspects:
        weighed.append((one.weigh(one.data, None), one))
        if weighed[-1][0].misfit < REREAD:
            return None
    _, best = max(weighed, key=lambda pair: pair[0].log_density)
    return find_slip(best.weigh, best.data, list_leg_slips(best.data, start), REREAD, denied)


def list_leg_slips(data: LegData, start: Array) -> Iterator[Slip[LegData]]:
    """Yield what may have happened to actuator positions, whose initial ones are ``start``, and to poses."""
    for fault, text, actuators, chosen in _list_actuators(data.actuators, start):
        poses = (data if chosen is None else data.pick(chosen)).poses
        yield Slip(fault, text, LegData(actuators, poses), chosen, tried_from=SUSPECT)
    if data.poses is not None:
        for text, poses in list_rereads(data.poses):
            yield Slip(POSES, text, LegData(data.actuators, poses), least=REREAD)


def list_pose_units(data: LegData) -> Iterator[Slip[LegData]]:
    """Yield measured poses as if they had other units."""
    assert data.poses is not None
    poses, count = data.poses, 3 * data.poses.n_poses
    for words, factor in LENGTHS.items():
        if factor > 0.0:
            scaled, volume = replace(poses, position=factor * poses.position), count * float(np.log(factor))
            text = f"positions of the poses seem to be {words}"
            yield Slip(UNIT, text, LegData(data.actuators, scaled), None, volume)
    for words, factor in ANGLES.items():
        turned = matrix_from_rotation_vector(factor * rotation_vector_from_matrix(poses.rotation))
        text = f"rotations of the poses seem to be {'inverted' if factor < 0.0 else words}"
        moved = LegData(data.actuators, replace(poses, rotation=turned))
        yield Slip(UNIT, text, moved, None, count * float(np.log(abs(factor))))


def _list_actuators(actuators: Array, start: Array) -> Iterator[tuple[str, str, Array, np.ndarray | None]]:
    """Yield what may have happened to actuator positions (P, N), mm: fault, words, positions, and which poses."""
    n_poses, n_legs = actuators.shape
    for words, factor in LENGTHS.items():
        yield UNIT, f"actuator displacements seem to be {words}", start + factor * (actuators - start), None
        if factor > 0.0:
            yield UNIT, f"actuator positions seem to be {words}", factor * actuators, None
    if start.any():
        yield UNIT, "displacements seem to stand in place of actuator positions", actuators + start, None
    for one, other in combinations(range(n_legs), 2):
        order = np.arange(n_legs)
        order[[one, other]] = other, one
        yield LEGS, f"legs {one + 1} and {other + 1} seem to be exchanged", actuators[:, order], None
    yield LEGS, "legs seem to be numbered the other way round", actuators[:, ::-1], None
    for step in range(1, n_legs):
        order = np.roll(np.arange(n_legs), -step)
        yield LEGS, f"legs seem to be counted from leg {step + 1}", actuators[:, order], None
    every = np.arange(n_poses)
    for step, words in ((1, "earlier"), (-1, "later")):
        if n_poses > 2:
            there = every[step:] if step > 0 else every[:step]
            text = f"rows seem to be shifted by one: readings belong to the actuator positions of the row {words}"
            yield ROWS, text, actuators[there - step], there


def list_rereads(poses: MeasuredPoses) -> Iterator[tuple[str, MeasuredPoses]]:
    """Yield what may have happened to poses, in words, and the poses without it; their covariances stay as they are.

    They are tried from a misfit on that one of them could mend: angles taken for rotation vectors are off by little
    where tilts are small.
    """
    position, rotation = poses.position, poses.rotation
    vectors = rotation_vector_from_matrix(rotation)
    for axes in permutations(FIXED):
        order = [FIXED.index(axis) for axis in axes]
        turned = Rotation.from_euler("".join(axes), vectors[:, order]).as_matrix()
        yield _describe_angles("".join(axes)), replace(poses, rotation=turned)
    back = np.swapaxes(rotation, 1, 2)
    yield (
        "rotations seem to be those of the base seen from the platform, the other way round",
        replace(poses, rotation=back),
    )
    yield (
        "poses seem to be those of the base in the platform's frame",
        replace(poses, position=-np.einsum("pij,pj->pi", back, position), rotation=back),
    )
    for k, axis in enumerate(FIXED):
        flipped = position * np.where(np.arange(3) == k, -1.0, 1.0)
        yield f"{axis}_mm seems to be of the other sign", replace(poses, position=flipped)
    for one, other in combinations(range(3), 2):
        exchanged = position.copy()
        exchanged[:, [one, other]] = position[:, [other, one]]
        text = f"{FIXED[one]}_mm and {FIXED[other]}_mm seem to be exchanged"
        yield text, replace(poses, position=exchanged)


def _describe_angles(axes: str) -> str:
    columns = ROLL_PITCH_YAW if axes == FIXED else name_angles(axes)
    return (
        "rx_deg, ry_deg and rz_deg seem to be no rotation vectors but angles about the fixed axes "
        f"{', '.join(axes)} one after the other: call them {', '.join(columns)}"
        + ("" if axes == FIXED else ", in that order of axes")
    )


# --- machines that were measured ---------------------------------------------------------------------------------


def find_slip_of_legs(variants: Iterable[MeasuredVariant], denied: Collection[str] = ()) -> FoundSlip | None:
    """Return what explains measured poses many times better than they are; None where some variant fits them.

    Parameters
    ----------
    variants : iterable of MeasuredVariant
        The same calibration poses under models one of which may be right.
    denied : collection of str, optional
        Faults that are none, as somebody says who looked.
    """
    measured = list(variants)
    start, stated = measured[0].machine.mechanism.initial_actuator_positions, max(map(state_error, measured))
    return find_leg_slip((suspect_poses(one, stated) for one in measured), start, denied)


def audit_legs(
    measured: MeasuredVariant,
) -> tuple[Callable[[LegData, np.ndarray | None], Weight], list[Slip[LegData]], float, FoundSlip | None]:
    """Return how poses are weighed, all that may have happened to them, up to what they fit, and what explains best."""
    suspect = suspect_poses(measured, state_error(measured), whole=True)
    start = measured.machine.mechanism.initial_actuator_positions
    slips = [*list_leg_slips(suspect.data, start), *list_pose_units(suspect.data)]
    found = find_slip(suspect.weigh, suspect.data, [replace(one, least=0.0, tried_from=0.0) for one in slips], 0.0)
    return suspect.weigh, slips, REREAD, found


def suspect_poses(measured: MeasuredVariant, stated: float, whole: bool = False) -> Suspect:
    """Return measured poses in which slips are looked for; of the poses' own form, too, where these are ``whole``."""
    likelihood_of = weigh_poses(measured.machine, measured.poses, measured.actuator_noise)
    data = LegData(measured.poses.actuators, measured.poses if whole else None)
    known = measured.posterior.sampling.coordinates
    return Suspect(likelihood_of, Tolerances(known.start, known.free, known.scale), data, stated)


def weigh_poses(machine: Machine, poses: MeasuredPoses, noise: float) -> LikelihoodOf:
    """Return what makes the density of data that are some of the poses, read otherwise where the data say so."""

    def likelihood_of(data: LegData, chosen: np.ndarray) -> Likelihood:
        moved = poses.select(chosen) if data.poses is None else data.poses
        return PoseLikelihood(machine, replace(moved, actuators=data.actuators), noise)

    return likelihood_of


def find_recheck_slip(calibrated: CalibratedMachine, poses: MeasuredPoses) -> FoundSlip | None:
    """Return what explains poses measured after a calibration many times better than they are; None without any.

    Parameters
    ----------
    calibrated : CalibratedMachine
        With its posterior's covariance.
    poses : MeasuredPoses
        Whole, in the base frame.
    """
    sd, start = calibrated.sd, calibrated.legs.mechanism.initial_actuator_positions
    free = np.flatnonzero(sd > 0.0)
    of_legs = (np.diagonal(calibrated.errors.noise) + calibrated.errors.model_variance).mean()
    known, stated = Tolerances(calibrated.theta, free, sd[free]), float(np.sqrt(of_legs + _position_variance(poses)))
    weigh = weigh_poses(calibrated.legs, poses, 0.0)
    return find_leg_slip([Suspect(weigh, known, LegData(poses.actuators), stated)], start)


def state_error(measured: MeasuredVariant) -> float:
    """Return what a leg may err by as stated: model error, actuators, the measured position, mm."""
    scale = measured.posterior.errors.model_error.scale or 0.0
    return float(np.sqrt(_position_variance(measured.poses) + scale**2 + measured.actuator_noise**2))


def _position_variance(poses: MeasuredPoses) -> float:
    return float(np.diagonal(poses.covariance, axis1=1, axis2=2)[:, :3].mean())


# --- how data are weighed ----------------------------------------------------------------------------------------


def _weigh(likelihood: Likelihood, tolerances: Tolerances, stated: float) -> Weight:
    errors, slope = likelihood.error_jacobian(tolerances.start)
    slope = slope[..., tolerances.free] * tolerances.scale
    if not (np.isfinite(errors).all() and np.isfinite(slope).all()):
        return NOTHING
    sizes = {
        float(size): _log_density(
            errors, slope, likelihood.error_covariance(np.full(likelihood.n_model_errors, float(size)))
        )
        for size in ERRORS
    }
    best = max(sizes, key=sizes.__getitem__)
    return Weight(sizes[best], best / stated)


def _log_density(errors: Array, slope: Array, covariance: Array) -> float:
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, errors[..., None])[..., 0]
    rows = np.linalg.solve(factor, slope)
    log_det = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    along = np.einsum("pik,pi->k", rows, white)
    inner = np.eye(slope.shape[-1]) + np.einsum("pik,pil->kl", rows, rows)
    _, more = np.linalg.slogdet(inner)
    square = float(np.sum(white**2) - along @ np.linalg.solve(inner, along))
    return -0.5 * (square + log_det + float(more))
