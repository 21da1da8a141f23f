"""Pose of a rigid body by plain least squares over all its targets: under Gaussian noise no fit is better.

One wrong target is enough to spoil it, and the residuals tell: where they are larger than the stated noise allows, the
fit is refused, with the noise stated and the noise seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammainccinv

from bayescal.data.photogrammetry.rigid_fit import (
    RigidFit,
    check_targets,
    compute_rigid_covariance,
    compute_rigid_residuals,
    compute_square,
    weighted_rigid_transform,
)
from bayescal.errors import PoseInputError
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

INCOMPATIBLE = 1e-9
"""Probability of residuals so large at the stated noise, below which a fit is refused."""


def fit_least_squares(reference: ArrayLike, measured: ArrayLike, noise: float) -> RigidFit:
    """Return the pose of a rigid body by least squares over all targets seen; three are enough.

    Parameters
    ----------
    reference : array_like, shape (n, 3)
        Targets in the body frame, mm, taken as exact.
    measured : array_like, shape (..., n, 3)
        Targets in the measurement frame, mm; NaN where a target was not seen.
    noise : float
        σ, known standard deviation of each measured coordinate, mm.

    Raises
    ------
    InputError
        As `check_targets`, or where residuals are incompatible with the stated noise.
    """
    reference, flat, seen = check_targets(reference, measured, noise)
    fit = _fit(reference, flat, seen, noise)
    excess = fit.chi2 - 2.0 * gammainccinv(0.5 * fit.dof, INCOMPATIBLE)
    if (excess > 0.0).any():
        pose = int(np.argmax(excess))
        raise PoseInputError(
            pose,
            f"found residuals incompatible with the stated noise, {_state_noise(fit, pose, noise)}; expected both "
            "alike, or the robust fit where some targets are wrong",
        )
    return fit.with_batch(np.shape(measured)[:-2])


def compare_noise(reference: ArrayLike, measured: ArrayLike, noise: float) -> str:
    """Return the noise stated and the noise that least squares sees in targets (n, 3), (n, 3), in words."""
    reference, flat, seen = check_targets(reference, measured, noise)
    return _state_noise(_fit(reference, flat, seen, noise), 0, noise)


def _fit(reference: Array, measured: Array, seen: NDArray[np.bool_], noise: float) -> RigidFit:
    position, rotation = weighted_rigid_transform(reference, measured, seen)
    square = compute_square(compute_rigid_residuals(reference, measured, position, rotation), noise)
    return RigidFit(
        position=position,
        rotation=rotation,
        covariance=compute_rigid_covariance(reference, rotation, seen, noise),
        weights=seen.astype(float),
        chi2=np.sum(np.where(seen, square, 0.0), axis=-1),
        dof=3 * seen.sum(axis=-1) - 6,
        converged=np.ones(len(measured), dtype=bool),
    )


def _state_noise(fit: RigidFit, pose: int, noise: float) -> str:
    found = noise * float(np.sqrt(fit.chi2[pose] / fit.dof[pose]))
    return f"noise stated {noise / MICROMETRE:.3g} µm, noise seen {found / MICROMETRE:.3g} µm"
