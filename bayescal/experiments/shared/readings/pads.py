"""What the targets on the legs' pads tell of the joints: deflection, K and κ (RR-8096 eqs. 1 to 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.joint_deflection import (
    JointDeflection,
    KappaEstimate,
    MatrixEstimate,
    fit_linear_deformation,
    fit_matrix_deformation,
    measure_joint_deflection,
)
from bayescal.data.photogrammetry.poses import PoseExtraction
from bayescal.density.calibration.terms import KnownErrors
from bayescal.experiments.shared.readings.measurement import TargetMeasurement
from bayescal.machines.readings import POSE, Legs
from bayescal.machines.readings.legs import divide_closure
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

    def list_terms(self, model: Legs, poses: MeasuredPoses, verification: np.ndarray) -> tuple[KnownErrors, ...]:
        """Return what the uncertainty of the rest of K does to readings of all poses; the diagonal is free or nominal.

        A joint that is known to be deflected by δ more than it is shows in its actuator as (∂f/∂ρ)⁻¹ ∂f/∂δ δ. K was
        measured in the same photographs as the poses for calibration: their errors depend on its own.
        """
        machine, basis = model.machine, model.machine.basis(poses.actuators)
        n = model.n_legs
        rest = np.flatnonzero(~np.eye(n, dtype=bool))
        displacement = poses.actuators - machine.mechanism.initial_actuator_positions
        design = np.einsum("ij,pk->pijk", np.eye(n), displacement).reshape(len(displacement), n, -1)[..., rest]
        root = np.linalg.cholesky(self.matrix.covariance[np.ix_(rest, rest)])
        gain = basis.actuator_gain
        closure = machine.model.prepare(machine.layout, machine.layout.nominal)
        less, more = (
            closure(poses.position, poses.rotation, replace(basis, actuator_gain=one), False).actuators
            for one in (gain, gain + np.eye(n))
        )
        shape = (len(displacement), len(model.channels), len(rest))
        own, beside = np.zeros(shape), np.zeros(shape)
        names = list(model.names)
        legs, seen = ([names.index(one) for one in names if (one in POSE) == of_pose] for of_pose in (False, True))
        own[:, legs] = divide_closure(less, (more - less) @ design @ root)
        on_poses = np.linalg.solve(root, self._with_poses(~verification)[:, rest])
        beside[np.ix_(~verification, seen)] = np.swapaxes(on_poses, -1, -2)
        return KnownErrors(own + beside), KnownErrors(beside, -1.0)

    def _with_poses(self, used: np.ndarray) -> Array:
        """Return the covariance of K, row by row, with the errors of its poses in the base frame, (P, N * N, 6)."""
        assert self.matrix.with_pose is not None
        rotation = self.extraction.base.rotation[used]
        moved, turned = np.split(self.matrix.with_pose, 2, axis=-1)
        return np.concatenate([moved @ rotation, turned @ rotation], axis=-1)


def measure_pads(measured: TargetMeasurement, displacement: Array, noise: float) -> Pads | None:
    """Return what the targets on the pads tell; None without such targets.

    Parameters
    ----------
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
