"""From targets to poses: both bodies fitted in the measurement frame, the platform then seen from the base.

Targets that were taken for each other, two names or the pads of two legs, are found by trying it. A body's targets fit
together to within their noise. Where they are off by many times that, and exchanging two names mends it, the names
contradict the coordinates: a robust fit would leave the two out at every pose and say nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import (
    RigidFit,
    compare_noise,
    compute_rigid_residuals,
    fit_least_squares,
    fit_rigid_body,
    weighted_rigid_transform,
)
from bayescal.data.photogrammetry.survey import BodyTargets, Survey
from bayescal.errors import InputError, PoseInputError
from bayescal.numerics.geometry import Array, compute_relative_pose

METHODS: dict[str, Callable[..., RigidFit]] = {
    "robust": fit_rigid_body,
    "line": fit_line,
    "least_squares": fit_least_squares,
}


@dataclass(frozen=True, eq=False)
class PoseExtraction:
    """Poses with the fits they come from."""

    poses: MeasuredPoses  # platform in the base frame, all P poses
    base: RigidFit  # fits of the rigid targets in the measurement frame
    platform: RigidFit
    rejected: tuple[tuple[str, str, str], ...]  # seen targets that the robust fit gave no weight

    @property
    def chi2_per_dof(self) -> float:
        """Sum of squared residuals over its expectation: one where the stated target noise is right."""
        return float(sum(fit.chi2.sum() for fit in (self.base, self.platform)) / self.dof)

    @property
    def dof(self) -> float:
        """Degrees of freedom of all fits."""
        return float(sum(fit.dof.sum() for fit in (self.base, self.platform)))

    @property
    def n_targets(self) -> int:
        """How many rigid targets were given a weight or rejected, each at each pose."""
        used = sum(int(np.count_nonzero(fit.weights)) for fit in (self.base, self.platform))
        return used + len(self.rejected)


def extract_poses(survey: Survey, noise: float, method: str = "robust") -> PoseExtraction:
    """Return the measured pose of the platform at every pose of a survey, for the noise of a target coordinate, mm.

    ``method``: ``robust`` (Haralick et al. 1989) or ``line``, both of RR-8096 section 3.1, or ``least_squares``.
    """
    fits = {}
    rejected: list[tuple[str, str, str]] = []
    for name, body in (("base", survey.base), ("platform", survey.platform)):
        rigid = np.flatnonzero(body.leg == 0)
        try:
            fits[name] = METHODS[method](body.reference[rigid], body.measured[:, rigid], noise)
        except PoseInputError as error:
            raise InputError(f"pose {survey.poses[error.index]!r}: {name}: {_explain(error, body, noise)}") from error
        left_out = np.isfinite(body.measured[:, rigid, 0]) & (fits[name].weights == 0)
        rejected += [(survey.poses[p], name, body.names[rigid[k]]) for p, k in np.argwhere(left_out)]
    position, rotation, covariance = compute_relative_pose(
        (fits["base"].position, fits["base"].rotation, fits["base"].covariance),
        (fits["platform"].position, fits["platform"].rotation, fits["platform"].covariance),
    )
    poses = MeasuredPoses(survey.poses, position, rotation, covariance, survey.actuators)
    return PoseExtraction(poses, fits["base"], fits["platform"], tuple(rejected))


def _explain(error: PoseInputError, body: BodyTargets, noise: float) -> str:
    """Return what is wrong with a pose; where targets contradict each other, with the noise stated and seen."""
    if "consistent" not in error.fault:
        return error.fault
    rigid = body.leg == 0
    return f"{error.fault}; {compare_noise(body.reference[rigid], body.measured[error.index, rigid], noise)}"


SUSPECT = 10.0
"""Noises by which targets are off their body, rms, before anything is tried."""
MIN_EXCHANGE_RATIO = 5.0
"""Factor by which an exchange has to reduce the misfit to be its cause."""
WORST = 10
"""Targets that are tried, those farthest off."""


def check_exchanged(survey: Survey, noise: float) -> None:
    """Raise InputError where most poses say that two targets of a body, or two pads, go by each other's names."""
    for name, body in (("base", survey.base), ("platform", survey.platform)):
        rigid = np.flatnonzero(body.leg == 0)
        found = [find_exchanged(body.reference[rigid], one[rigid], noise) for one in body.measured]
        pairs = [pair for pair in found if pair is not None]
        for pair in dict.fromkeys(pair for pair, _ in pairs):
            factors = [factor for one, factor in pairs if one == pair]
            seen = np.isfinite(body.measured[:, rigid[list(pair)], 0]).all(axis=1).sum()
            if len(factors) > 0.5 * seen:
                one, other = (body.names[rigid[k]] for k in pair)
                raise InputError(
                    f"{name}: found targets {one!r} and {other!r} exchanged (fit "
                    f"{np.median(factors):.3g} times better at {len(factors)} poses)"
                )
    _check_pads(survey.platform)


def find_exchanged(reference: Array, measured: Array, noise: float) -> tuple[tuple[int, int], float] | None:
    """Return which two of n targets are exchanged at a pose, and how much better they fit exchanged; None if none are.

    Targets (n, 3) and their noise are in mm, NaN where a target was not seen.
    """
    seen = np.flatnonzero(np.isfinite(measured[:, 0]))
    reference, measured = reference[seen], measured[seen]
    if len(seen) < 4:  # three fit in any order but for their distances
        return None
    off = _misfit(reference[None], measured)[0]
    stated = float(np.sqrt(np.mean(off**2)))
    if stated < SUSPECT * noise:
        return None
    apart = np.linalg.norm(reference[:, None] - reference, axis=-1)
    misplaced = np.abs(np.linalg.norm(measured[:, None] - measured, axis=-1) - apart).sum(axis=1)
    pairs = list(combinations(np.sort(np.argsort(-misplaced)[:WORST]), 2))
    order = np.tile(np.arange(len(seen)), (len(pairs), 1))
    for k, (one, other) in enumerate(pairs):
        order[k, [one, other]] = other, one
    tried = np.sqrt(np.mean(_misfit(reference[order], measured) ** 2, axis=1))
    best = int(np.argmin(tried))
    factor = stated / max(float(tried[best]), noise)
    one, other = pairs[best]
    return ((int(seen[one]), int(seen[other])), factor) if factor > MIN_EXCHANGE_RATIO else None


def _misfit(reference: Array, measured: Array) -> Array:
    """Return the distances of targets (n, 3) from where rigid bodies (B, n, 3) have them at best, shape (B, n), mm."""
    fit = weighted_rigid_transform(reference, measured, np.ones(reference.shape[:-1]))
    return np.asarray(np.linalg.norm(compute_rigid_residuals(reference, measured, *fit), axis=-1))


# --- pads ------------------------------------------------------------------------------------------------------------


def _check_pads(platform: BodyTargets) -> None:
    """Raise InputError where the targets of a leg's pad were measured where those of another leg's are."""
    legs = [int(leg) for leg in np.unique(platform.leg) if leg > 0]
    if len(legs) < 2:
        return
    from scipy.optimize import linear_sum_assignment  # a tenth of a second to import

    places = np.array([platform.reference[platform.leg == leg].mean(axis=0) for leg in legs])
    rigid = platform.leg == 0
    votes = np.zeros((len(legs), len(legs)))
    for measured in platform.measured:
        seen = rigid & np.isfinite(measured[:, 0])
        origin, rotation = weighted_rigid_transform(platform.reference[seen], measured[seen], np.ones(seen.sum()))
        for k, leg in enumerate(legs):
            own = measured[(platform.leg == leg) & np.isfinite(measured[:, 0])]
            if len(own):
                votes[k] += np.linalg.norm((own.mean(axis=0) - origin) @ rotation - places, axis=1)
    _, best = linear_sum_assignment(votes)
    wrong = [k for k in range(len(legs)) if best[k] != k and SUSPECT * votes[k, best[k]] < votes[k, k]]
    if wrong:
        one, other = legs[wrong[0]], legs[int(best[wrong[0]])]
        raise InputError(
            f"found targets on the pad of leg {one} where leg {other} should be, expected each on its own pad"
        )


def check_pad_places(platform: BodyTargets, joints: Array) -> None:
    """Raise InputError where pads stand in the reference at other legs' joints (N, 3), platform frame, mm."""
    legs = [int(leg) for leg in np.unique(platform.leg) if leg > 0]
    for leg in legs:
        centre = platform.reference[platform.leg == leg].mean(axis=0)
        away = np.linalg.norm(joints - centre, axis=1)
        nearest = int(np.argmin(away))
        if SUSPECT * away[nearest] < away[leg - 1]:
            raise InputError(
                f"found targets on the pad of leg {leg} {away[leg - 1]:.4g} mm from its joint, "
                f"{away[nearest]:.3g} mm from that of leg {nearest + 1}, expected each on its own pad"
            )
