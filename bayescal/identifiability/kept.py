"""Whether calibrated machines keep what is required as often as is claimed: each is moved, by its own kinematics.

A machine that was drawn from the tolerances and calibrated is sent to every pose of the workspace; where it truly comes
to stand, actuators erring, is set against what the calibrated model predicts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import betabinom

from bayescal.identifiability.calibration import SimulatedCalibrations
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.requirements import Requirement
from bayescal.identifiability.sensitivity import compute_sensitivity, root_of
from bayescal.machines.frames import N_FRAME_PARAMETERS, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import Array, compute_pose_error

CHUNK = 25  # machines at once
BAND = 0.99


@dataclass(frozen=True)
class Kept:
    """How many of n calibrated machines kept a requirement in the whole workspace.

    Attributes
    ----------
    kept, n : int
    low, high : int
        Between which the number lies with a probability of 99 %, if the claimed probability is right.
    """

    kept: int
    n: int
    low: int
    high: int

    @property
    def agrees(self) -> bool:
        """Whether the number is one to expect."""
        return self.low <= self.kept <= self.high


def count_kept(
    simulated: SimulatedCalibrations,
    plan: Plan,
    actuators: Array,
    requirements: list[Requirement],
    rng: np.random.Generator,
) -> np.ndarray:
    """Return how many of the converged calibrations keep each requirement at all actuator positions (W, N), (R,)."""
    knowledge = simulated.knowledge
    noise = np.swapaxes(root_of(compute_sensitivity(knowledge, actuators).pose_noise(plan)), -1, -2)
    places = np.flatnonzero(simulated.converged)
    good = np.zeros(len(requirements), dtype=int)
    for k in range(0, len(places), CHUNK):
        part = places[k : k + CHUNK]
        error = _find_errors(knowledge, simulated.truth[part], simulated.estimate[part], actuators)
        error = error + np.einsum("wij,bwj->bwi", noise, rng.standard_normal(error.shape))
        good += [int(r.keeps(error).sum()) for r in requirements]
    return good


def _find_errors(knowledge: Knowledge, truth: Array, estimate: Array, actuators: Array) -> Array:
    """Return true less predicted poses, shape (B, W, 6); infinite where one of both cannot be taken."""
    here, there = (_place(knowledge, theta, actuators) for theta in (truth, estimate))
    error = compute_pose_error(*here[:2], *there[:2])
    return np.where((here[2] & there[2])[..., None], error, np.inf)


def _place(knowledge: Knowledge, theta: Array, actuators: Array) -> tuple[Array, Array, np.ndarray]:
    """Return the poses of machines (B, D) as the instrument sees them, and which of them there are."""
    found = solve_forward_kinematics(knowledge.machine, theta[:, None, :-N_FRAME_PARAMETERS], actuators, check=False)
    position, rotation = move_frames(theta[:, -N_FRAME_PARAMETERS:], found.position, found.rotation)
    return position, rotation, found.converged


def compare_kept(kept: int, n: int, probability: float, draws: int) -> Kept:
    """Return the number of machines that kept a requirement beside what a claimed probability lets expect.

    The probability was itself counted, in so many draws; its uncertainty widens the band.
    """
    good = probability * draws
    low, high = betabinom.interval(BAND, n, good + 0.5, draws - good + 0.5)
    return Kept(kept, n, int(low), int(high))
