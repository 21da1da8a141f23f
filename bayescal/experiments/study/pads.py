"""What the targets on the legs' pads tell of the joints: deflection, K and κ (RR-8096 eqs. 1 to 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.data.photogrammetry.joint_deflection import (
    JointDeflection,
    KappaEstimate,
    MatrixEstimate,
    fit_linear_deformation,
    fit_matrix_deformation,
    measure_joint_deflection,
)
from bayescal.data.photogrammetry.poses import PoseExtraction
from bayescal.density.exact import CommonErrors
from bayescal.experiments.study.measurement import TargetMeasurement
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Pads:
    """What the targets on the pads tell.

    Attributes
    ----------
    deflection : JointDeflection
        Of every leg's joint at every pose.
    matrix : MatrixEstimate
        K, from the calibration poses.
    kappa : KappaEstimate
        κ, from the calibration poses.
    extraction : PoseExtraction
        The poses of base and platform that the deflection was measured from.
    """

    deflection: JointDeflection
    matrix: MatrixEstimate
    kappa: KappaEstimate
    extraction: PoseExtraction

    def errors(self, displacement: Array, used: np.ndarray | None) -> CommonErrors:
        """Return what the uncertainty of the rest of K leaves of Δb_z; the diagonal is free or nominal.

        Parameters
        ----------
        displacement : ndarray, shape (P, N)
            Of the actuators, mm.
        used : ndarray of bool, optional
            Which of all poses these are, if K was measured at them: their errors have a part in its own.
        """
        n_legs = displacement.shape[1]
        rest = np.flatnonzero(~np.eye(n_legs, dtype=bool))
        design = np.einsum("ij,pk->pijk", np.eye(n_legs), displacement)
        design = design.reshape(*displacement.shape, -1)[..., rest]
        with_poses = None if used is None else self._with_poses(used)[:, rest]
        return CommonErrors(design, self.matrix.covariance[np.ix_(rest, rest)], with_poses)

    def _with_poses(self, used: np.ndarray) -> Array:
        """Return the covariance of K, row by row, with the errors of its poses in the base frame, (P, N * N, 6)."""
        assert self.matrix.with_pose is not None
        rotation = self.extraction.base.rotation[used]
        moved, turned = np.split(self.matrix.with_pose, 2, axis=-1)
        return np.concatenate([moved @ rotation, turned @ rotation], axis=-1)

    def shared_errors(self, displacement: Array, actuator_weight: Array) -> Array:
        """Return what each entry of K, in units of its standard deviation, adds to the legs' errors, (P, N, N * N).

        Parameters
        ----------
        displacement, actuator_weight : ndarray, shape (P, N)
            Of the calibration poses; see `bayescal.density.legs`.
        """
        n_poses, n = displacement.shape
        change = np.zeros((n_poses, n, n, n))
        for leg in range(n):
            change[:, leg, leg] = displacement
            change[:, leg, leg, leg] = 0.0  # the diagonal is free or nominal
        size = np.sqrt(actuator_weight)[..., None]
        root = _square_root(self.matrix.covariance.reshape(n * n, n * n))
        return np.asarray(size * (change.reshape(n_poses, n, n * n) @ root))


def measure_pads(measured: TargetMeasurement, displacement: Array, noise: float) -> Pads | None:
    """Return what the targets on the pads tell; None without such targets.

    Parameters
    ----------
    measured : TargetMeasurement
    displacement : ndarray, shape (P, N)
        Of the actuators, mm.
    noise : float
        Standard deviation of a target coordinate, mm.

    Raises
    ------
    InputError
        For too few targets on a pad, too few poses, and deflections that are none.
    """
    platform, n_legs = measured.survey.platform, displacement.shape[1]
    on_pad = platform.leg > 0
    if not on_pad.any():
        return None
    deflection = measure_joint_deflection(
        measured.extraction.platform,
        platform.reference[on_pad],
        platform.measured[:, on_pad],
        platform.leg[on_pad],
        noise,
        n_legs,
    )
    calibration = ~measured.verification
    chosen, travel = deflection.select(calibration), displacement[calibration]
    matrix, kappa = fit_matrix_deformation(chosen, travel), fit_linear_deformation(chosen, travel)
    return Pads(deflection, matrix, kappa, measured.extraction)


def _square_root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
