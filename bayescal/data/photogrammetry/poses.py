"""From targets to poses: both bodies fitted in the measurement frame, the platform then seen from the base."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.least_squares_fit import compare_noise, fit_least_squares
from bayescal.data.photogrammetry.line_fit import fit_line
from bayescal.data.photogrammetry.rigid_fit import RigidFit, fit_rigid_body
from bayescal.data.photogrammetry.survey import BodyTargets, Survey
from bayescal.errors import InputError, PoseInputError
from bayescal.numerics.geometry import compute_relative_pose

METHODS: dict[str, Callable[..., RigidFit]] = {
    "robust": fit_rigid_body,
    "line": fit_line,
    "least_squares": fit_least_squares,
}


@dataclass(frozen=True, eq=False)
class PoseExtraction:
    """Poses with the fits they come from.

    Attributes
    ----------
    poses : MeasuredPoses
        Platform in the base frame, all P poses.
    base, platform : RigidFit
        Fits of the rigid targets in the measurement frame.
    rejected : tuple of (pose, body, target)
        Seen targets that the robust fit gave no weight.
    """

    poses: MeasuredPoses
    base: RigidFit
    platform: RigidFit
    rejected: tuple[tuple[str, str, str], ...]

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
    """Return the measured pose of the platform at every pose of a survey.

    Parameters
    ----------
    survey : Survey
        Targets and actuator positions.
    noise : float
        Standard deviation of a target coordinate, mm.
    method : str
        ``robust`` (Haralick et al. 1989) or ``line``, both of RR-8096 section 3.1, or ``least_squares``.
    """
    fits = {}
    rejected: list[tuple[str, str, str]] = []
    for name, body in (("base", survey.base), ("platform", survey.platform)):
        rigid = body.leg == 0
        try:
            fits[name] = METHODS[method](body.reference[rigid], body.measured[:, rigid], noise)
        except PoseInputError as error:
            raise InputError(f"pose {survey.poses[error.index]!r}: {name}: {_explain(error, body, noise)}") from error
        rejected.extend(_find_rejected(survey, name, body, fits[name]))
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


def _find_rejected(survey: Survey, name: str, body: BodyTargets, fit: RigidFit) -> list[tuple[str, str, str]]:
    rigid = np.flatnonzero(body.leg == 0)
    seen = np.isfinite(body.measured[:, rigid, 0])
    return [(survey.poses[p], name, body.names[rigid[k]]) for p, k in np.argwhere(seen & (fit.weights == 0))]
