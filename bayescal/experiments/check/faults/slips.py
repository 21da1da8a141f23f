"""Slips of the data: units, signs, exchanged legs and shifted rows, each tried as if it were so.

Those of the actuators are tried by every study whose data do not fit (`bayescal.experiments.shared.slips`); a check
tries them on any data, and those of the poses besides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.errors import BayescalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.subject import Subject
from bayescal.experiments.shared.slips import CLEARLY, SCALES, UNIT, list_moves, weigh_likelihood
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

CHECK = "Units and legs"
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
    chosen : ndarray of int, optional
        Which of the poses they are; all by default.
    """

    fault: str
    text: str
    poses: MeasuredPoses
    log_volume: float = 0.0
    chosen: np.ndarray | None = None


def check_slips(subject: Subject) -> Finding:
    """Return whether some slip explains the data better than the data as they stand."""
    poses = subject.measured.poses
    stated = _weigh(subject, poses)
    best, gain = None, CLEARLY
    for slip in list_slips(subject):
        beside = stated if slip.chosen is None else _weigh(subject, poses.select(slip.chosen), slip.chosen)
        found = _weigh(subject, slip.poses, slip.chosen) + slip.log_volume - beside
        if found > gain:
            best, gain = slip, found
    if best is None:
        return Finding(CHECK, "", "good", "no other unit, sign or order of legs or rows explains the data better.")
    text = f"{best.text} (better by {gain:.0f} nats). Mend the table; what else is said here rests on it."
    return Finding(CHECK, best.fault, "bad", text)


def list_slips(subject: Subject) -> Iterator[Slip]:
    """Yield the slips that are tried."""
    poses, start = subject.measured.poses, subject.measured.machine.mechanism.initial_actuator_positions
    for moved in list_moves(poses.actuators, start):
        chosen = moved.chosen if len(moved.chosen) < poses.n_poses else None
        some = poses.select(moved.chosen)
        yield Slip(moved.fault, moved.text, replace(some, actuators=moved.actuators), chosen=chosen)
    for words, factor in SCALES.items():
        if factor > 0.0:
            count = 3 * poses.n_poses * float(np.log(factor))
            scaled = replace(poses, position=factor * poses.position)
            yield Slip(UNIT, f"positions of the poses seem to be {words}", scaled, count)
    for words, factor in ANGLES.items():
        turned = matrix_from_rotation_vector(factor * rotation_vector_from_matrix(poses.rotation))
        volume = 3 * poses.n_poses * float(np.log(abs(factor)))
        yield Slip(UNIT, f"rotations of the poses seem to be {words}", replace(poses, rotation=turned), volume)


def _weigh(subject: Subject, poses: MeasuredPoses, chosen: np.ndarray | None = None) -> float:
    """Return the log-density of the poses under the priors to first order, at the best error of the legs."""
    try:
        with np.errstate(all="ignore"):
            return weigh_likelihood(
                subject.likelihood(poses, chosen), subject.posterior.sampling.coordinates
            ).log_density
    except (BayescalError, np.linalg.LinAlgError):
        return -np.inf
