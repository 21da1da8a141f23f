"""Deformation of the platform's ring, from targets near the attachments of the legs (RR-8096 sections 3.1 to 3.3).

The targets of the stiff part of the platform give its pose; what the targets on the pad of a leg do beyond that pose,
along z of the platform, is Δb_z of the leg. The error of the pose is common to all legs of a measurement, so that the
legs are correlated; both that and the noise of the pad targets are known, and fits of the matrix model weigh by them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayescal.data.photogrammetry.rigid_fit import RigidFit
from bayescal.errors import InputError, PoseInputError
from bayescal.numerics.geometry import Array

REJECTION = 5.0
"""Distance from the median of a pad beyond which a target is rejected, in units of the pad's scatter."""
MIN_FOR_REJECTION = 3
_MAD_TO_SD = 1.482602218505602  # 1 / Φ⁻¹(3/4)


@dataclass(frozen=True, eq=False)
class JointDeflection:
    """Deflections of the ring at the legs."""

    displacement: Array  # (P, N): Δb_z per pose and leg, along z of the platform frame, mm
    covariance: Array  # (P, N, N): covariance between the legs of each pose, mm²
    # (P, N, 6): covariance with the error of the platform's pose, mm and rad in the measurement frame
    with_pose: Array | None = None

    def select(self, chosen: np.ndarray) -> JointDeflection:
        """Return the deflections of some poses."""
        with_pose = None if self.with_pose is None else self.with_pose[chosen]
        return JointDeflection(self.displacement[chosen], self.covariance[chosen], with_pose)


@dataclass(frozen=True, eq=False)
class KappaEstimate:
    """Posterior of ``Δb_z,i = κ_i Δρ_i`` (RR-8096 eq. 1): independent Student t distributions."""

    kappa: Array  # (N,): posterior mean, mm per mm
    sd: Array  # (N,): posterior standard deviation; the scale of the t distribution is ``sd sqrt((dof - 2) / dof)``
    residual_sd: Array  # (N,): root of the residual sum of squares over ``dof``, mm
    dof: int  # degrees of freedom of the t distributions, one less than the number of poses


@dataclass(frozen=True, eq=False)
class MatrixEstimate:
    """Posterior of ``Δb_z = K Δρ`` (RR-8096 eqs. 2 and 3): a Gaussian."""

    # (N, N): posterior mean of K, mm per mm; the row is the leg that moves, the column the actuator that causes it
    matrix: Array
    covariance: Array  # (N * N, N * N): posterior covariance of K written row by row
    sd: Array  # (N, N): posterior standard deviations
    # whitened sum of squared residuals; well above ``dof`` if the model is wrong, for which ``sd`` does not allow
    chi2: float
    dof: int  # number of measured deflections less N²
    # (P, N * N, 6): covariance of K with the error of the platform's pose at each pose it was fitted to, mm and rad
    # in the measurement frame; None where that of the deflections is not known
    with_pose: Array | None = None

    @property
    def by_row(self) -> Array:
        """Covariance of each row of K, shape (N, N, N)."""
        n, legs = len(self.matrix), np.arange(len(self.matrix))
        return np.asarray(self.covariance.reshape(n, n, n, n)[legs, :, legs, :])


def _find_used_targets(deflection: Array, pad: NDArray[np.bool_], noise: float) -> NDArray[np.bool_]:
    """Return the targets of one pad to average, shape (P, n), from deflections (P, n) in mm with NaN where not seen.

    With three seen targets or more, a target is rejected that is farther from their median than `REJECTION` times their
    scatter, which is the larger of the noise and the normalised median of absolute distances from the median.
    """
    used = np.isfinite(deflection) & pad
    trusted = used.sum(axis=-1) >= MIN_FOR_REJECTION
    values = np.where(used, deflection, np.nan)[trusted]
    distance = np.abs(values - np.nanmedian(values, axis=-1, keepdims=True))
    scatter = np.maximum(noise, _MAD_TO_SD * np.nanmedian(distance, axis=-1, keepdims=True))
    used[trusted] = distance <= REJECTION * scatter
    return used


def _compute_pad_shares(deflection: Array, leg: NDArray[np.int64], noise: float, n_legs: int) -> Array:
    """Return the share of each target in the mean of each pad, shape (P, N, m)."""
    shares = []
    for number in range(1, n_legs + 1):
        used = _find_used_targets(deflection, leg == number, noise)
        count = used.sum(axis=-1, keepdims=True)
        if np.any(count == 0):
            pose = int(np.argmin(count[:, 0]))
            raise PoseInputError(pose, f"pad of leg {number}: found no seen target, expected one")
        shares.append(used / count)
    return np.stack(shares, axis=1)


def measure_joint_deflection(
    fit: RigidFit, reference: ArrayLike, measured: ArrayLike, leg: ArrayLike, noise: float, n_legs: int
) -> JointDeflection:
    """Return the deflection of the ring at each leg, ``z · (R^T (m - p) - r)`` averaged over the targets of its pad.

    InputError where shapes or leg numbers disagree, or a pad has no seen target in a pose.

    Parameters
    ----------
    fit : RigidFit, leading shape (P,)
        Pose of the platform in the measurement frame from its rigid targets, which must not include ring targets.
    reference : array_like, shape (m, 3)
        r, ring targets in the platform frame without deformation, mm, taken as exact.
    measured : array_like, shape (P, m, 3)
        Ring targets in the measurement frame, mm; NaN where a target was not seen.
    leg : array_like of int, shape (m,)
        Leg from 1 to N to whose pad each target belongs.
    noise : float
        σ, standard deviation of each measured coordinate, mm.
    n_legs : int
        N.

    Returns
    -------
    JointDeflection
        The covariance is ``σ² diag(1 / n_i) + G C G^T``: n_i averaged targets of leg i, C the covariance of the pose,
        and row i of G ``-[z, l × z]`` with z of the platform in the measurement frame and l the mean lever ``m - p``.
    """
    reference, measured = np.asarray(reference, dtype=float), np.asarray(measured, dtype=float)
    leg = np.asarray(leg)
    expected = (*fit.position.shape[:-1], len(leg), 3)
    if fit.position.ndim != 2 or reference.shape != (len(leg), 3) or measured.shape != expected:
        raise InputError(
            f"ring targets: found reference {reference.shape}, measured {measured.shape}, "
            f"fits {fit.position.shape[:-1]}, expected ({len(leg)}, 3), (P, {len(leg)}, 3) and (P,)"
        )
    if set(np.unique(leg).tolist()) != set(range(1, n_legs + 1)):
        raise InputError(f"ring targets: found legs {np.unique(leg).tolist()}, expected 1 to {n_legs}")
    normal = fit.rotation[..., 2]
    lever = measured - fit.position[:, None]
    deflection = np.einsum("pmi,pi->pm", lever, normal) - reference[:, 2]
    shares = _compute_pad_shares(deflection, leg, noise, n_legs)
    mean_lever = shares @ np.nan_to_num(lever)
    normals = np.broadcast_to(normal[:, None], mean_lever.shape)
    gain = -np.concatenate([normals, np.cross(mean_lever, normals)], axis=-1)
    with_pose = gain @ fit.covariance
    covariance = with_pose @ np.swapaxes(gain, -1, -2)
    covariance = covariance + noise**2 * np.sum(shares**2, axis=-1)[..., None] * np.eye(n_legs)
    displacement = np.einsum("pnm,pm->pn", shares, np.nan_to_num(deflection))
    return JointDeflection(displacement, 0.5 * (covariance + np.swapaxes(covariance, -1, -2)), with_pose)


def _check_actuators(deflection: JointDeflection, actuator_displacement: ArrayLike) -> Array:
    """Return the actuator displacements as an array of the deflections' shape."""
    actuator = np.asarray(actuator_displacement, dtype=float)
    if actuator.shape != deflection.displacement.shape or not np.isfinite(actuator).all():
        raise InputError(
            f"actuator displacements: found shape {actuator.shape}, expected {deflection.displacement.shape}, finite"
        )
    return actuator


def fit_linear_deformation(deflection: JointDeflection, actuator_displacement: ArrayLike) -> KappaEstimate:
    """Return the coefficient of each leg in ``Δb_z,i = κ_i Δρ_i + ε`` (RR-8096 eq. 1).

    The residuals are mostly what the model leaves out, so their variance is taken as unknown, one per leg, with the
    Jeffreys prior 1/σ² and a flat prior for κ. The posterior of κ_i is then a Student t distribution with P - 1 degrees
    of freedom around the least-squares value, of scale ``s_i / sqrt(Σ Δρ_i²)``, s_i being ``residual_sd``. The
    covariance of the deflections is not used. Δρ (P, N) counts from the pose of the ring's reference, mm. InputError
    where shapes disagree, poses are fewer than four (the t distribution would have no variance), or an actuator never
    moves.
    """
    actuator = _check_actuators(deflection, actuator_displacement)
    dof = len(actuator) - 1
    if dof < 3:
        raise InputError(f"linear deformation: found {len(actuator)} poses, expected at least 4")
    power = np.sum(actuator**2, axis=0)
    if np.any(power == 0):
        raise InputError(f"linear deformation: found no movement of actuator {np.argmin(power) + 1}")
    kappa = np.sum(actuator * deflection.displacement, axis=0) / power
    residual_sd = np.sqrt(np.sum((deflection.displacement - kappa * actuator) ** 2, axis=0) / dof)
    return KappaEstimate(kappa, residual_sd / np.sqrt(power) * np.sqrt(dof / (dof - 2)), residual_sd, dof)


def fit_matrix_deformation(deflection: JointDeflection, actuator_displacement: ArrayLike) -> MatrixEstimate:
    """Return the coefficient matrix in ``Δb_z = K Δρ`` (RR-8096 eqs. 2 and 3) by generalised least squares.

    Where RR-8096 fits each leg by itself with equal weights, here the legs are fitted together with the known
    covariance C_p of each pose. With a flat prior the posterior of K, row by row, is Gaussian with precision
    ``Σ_p C_p^-1 ⊗ Δρ_p Δρ_p^T``. Δρ (P, N) counts from the pose of the ring's reference, mm. InputError where shapes
    disagree, or the actuator displacements of all poses span fewer than N directions.
    """
    actuator = _check_actuators(deflection, actuator_displacement)
    n_poses, n_legs = actuator.shape
    rank = int(np.linalg.matrix_rank(actuator))
    if rank < n_legs:
        raise InputError(
            f"matrix deformation: found {n_poses} poses of rank {rank}, expected {n_legs} for {n_legs**2} coefficients"
        )
    weight = np.linalg.inv(deflection.covariance)
    precision = np.einsum("pij,pa,pb->iajb", weight, actuator, actuator).reshape(n_legs**2, n_legs**2)
    target = np.einsum("pij,pj,pa->ia", weight, deflection.displacement, actuator)
    covariance = np.linalg.inv(precision)
    covariance = 0.5 * (covariance + covariance.T)
    matrix = (covariance @ target.ravel()).reshape(n_legs, n_legs)
    residuals = deflection.displacement - actuator @ matrix.T
    with_pose = None
    if deflection.with_pose is not None:
        weighted = np.einsum("pij,pjk,pa->piak", weight, deflection.with_pose, actuator)
        with_pose = covariance @ weighted.reshape(n_poses, n_legs**2, -1)
    return MatrixEstimate(
        matrix=matrix,
        covariance=covariance,
        sd=np.sqrt(np.diagonal(covariance)).reshape(n_legs, n_legs),
        chi2=float(np.einsum("pi,pij,pj->", residuals, weight, residuals)),
        dof=n_poses * n_legs - n_legs**2,
        with_pose=with_pose,
    )
