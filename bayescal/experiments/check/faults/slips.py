"""Slips of the data: units, signs and exchanged legs, each tried as if it were so.

A slip is looked for before anything is fitted closely: the density of all poses under the priors, to first order about
the nominal machine, with an error of the legs as large as suits each case best. Right data close to within the
tolerances and what the first order leaves; slipped ones are off by as much as the machine moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.errors import BayescalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.subject import Subject
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector, rotation_vector_from_matrix

CHECK, UNIT, LEGS = "Units and legs", "unit", "legs"
CLEARLY = 20.0  # nats by which a slip has to explain the data better
ERRORS = np.geomspace(1e-4, 1e2, 13)  # mm, of every leg
SCALES = {
    "1000 times too large": 1e-3,
    "1000 times too small": 1e3,
    "100 times too large": 1e-2,
    "100 times too small": 1e2,
    "10 times too large (cm for mm)": 0.1,
    "10 times too small (mm for cm)": 10.0,
    "in inches": 25.4,
    "in mm where inches are stated": 1.0 / 25.4,
    "of the other sign": -1.0,
}
ANGLES = {"in degrees": np.pi / 180.0, "in radians where degrees are stated": 180.0 / np.pi, "inverted": -1.0}


@dataclass(frozen=True, eq=False)
class Slip:
    """Data as they would be without a slip.

    Attributes
    ----------
    fault : str
    text : str
        What the slip would be.
    poses : MeasuredPoses
    log_volume : float
        Of the data's change, for densities of changed data to be compared.
    """

    fault: str
    text: str
    poses: MeasuredPoses
    log_volume: float = 0.0


def check_slips(subject: Subject) -> Finding:
    """Return whether some slip explains the data better than the data as they stand."""
    poses = subject.measured.poses
    stated = _weigh(subject, poses)
    best, gain = None, CLEARLY
    for slip in list_slips(subject):
        found = _weigh(subject, slip.poses) + slip.log_volume - stated
        if found > gain:
            best, gain = slip, found
    if best is None:
        return Finding(CHECK, "", "good", "no other unit, sign or order of the legs explains the data better.")
    text = f"{best.text} (better by {gain:.0f} nats). Mend the table; what else is said here rests on it."
    return Finding(CHECK, best.fault, "bad", text)


def list_slips(subject: Subject) -> Iterator[Slip]:
    """Yield the slips that are tried."""
    poses, start = subject.measured.poses, subject.measured.machine.mechanism.initial_actuator_positions
    for words, factor in SCALES.items():
        moved = replace(poses, actuators=start + factor * (poses.actuators - start))
        yield Slip(UNIT, f"actuator displacements seem to be {words}", moved)
        if factor > 0.0:
            whole = replace(poses, actuators=factor * poses.actuators)
            yield Slip(UNIT, f"actuator positions seem to be {words}", whole)
            count = 3 * poses.n_poses * float(np.log(factor))
            scaled = replace(poses, position=factor * poses.position)
            yield Slip(UNIT, f"positions of the poses seem to be {words}", scaled, count)
    for words, factor in ANGLES.items():
        turned = matrix_from_rotation_vector(factor * rotation_vector_from_matrix(poses.rotation))
        volume = 3 * poses.n_poses * float(np.log(abs(factor)))
        yield Slip(UNIT, f"rotations of the poses seem to be {words}", replace(poses, rotation=turned), volume)
    for one, other in combinations(range(poses.actuators.shape[1]), 2):
        actuators = poses.actuators.copy()
        actuators[:, [one, other]] = actuators[:, [other, one]]
        yield Slip(LEGS, f"legs {one + 1} and {other + 1} seem to be exchanged", replace(poses, actuators=actuators))


def _weigh(subject: Subject, poses: MeasuredPoses) -> float:
    """Return the log-density of the poses under the priors to first order, at the best error of the legs.

    The covariance C + S Sᵀ, S the slope by the parameters in tolerances, by the determinant lemma.
    """
    try:
        with np.errstate(all="ignore"):
            likelihood = subject.likelihood(poses)
            coordinates = subject.posterior.coordinates
            errors, slope = likelihood.error_jacobian(coordinates.start)
            slope = slope[..., coordinates.free] * coordinates.scale
            if not (np.isfinite(errors).all() and np.isfinite(slope).all()):
                return -np.inf
            return max(
                _log_density(errors, slope, likelihood.error_covariance(np.full(likelihood.n_legs, size)))
                for size in ERRORS
            )
    except (BayescalError, np.linalg.LinAlgError):
        return -np.inf


def _log_density(errors: Array, slope: Array, covariance: Array) -> float:
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, errors[..., None])[..., 0]
    rows = np.linalg.solve(factor, slope)
    log_det = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
    told = np.einsum("pik,pi->k", rows, white)
    inner = np.eye(slope.shape[-1]) + np.einsum("pik,pil->kl", rows, rows)
    _, more = np.linalg.slogdet(inner)
    square = float(np.sum(white**2) - told @ np.linalg.solve(inner, told))
    return -0.5 * (square + log_det + float(more))
