"""Targets on the pads of a platform on legs: K and κ of its deformation, and what they leave uncertain.

What these tell of the joints is deflection, K and κ (RR-8096 eqs. 1 to 4), and what that leaves of the readings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
from bayescal.density.calibration.terms import CorrelatedNoise, ErrorTerm
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.shared.readings.measurement import Measured, TargetMeasurement
from bayescal.experiments.shared.study_schema import StudyConfig
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.readings import POSE, Legs, ReadingModel
from bayescal.machines.readings.legs import divide_closure
from bayescal.numerics.geometry import Array

MOST_DEFLECTION = 1.0  # mm of a joint by a mm of an actuator: beyond it the actuators are in another unit


@dataclass(frozen=True, eq=False)
class Pads:
    """What the targets on the pads tell."""

    deflection: JointDeflection  # of every leg's joint at every pose
    matrix: MatrixEstimate  # K, from the calibration poses
    kappa: KappaEstimate  # κ, from the calibration poses
    extraction: PoseExtraction  # the poses of base and platform that the deflection was measured from

    def list_terms(
        self, model: Legs, names: Sequence[str], poses: MeasuredPoses, verification: np.ndarray
    ) -> tuple[Array, Array]:
        """Return what the uncertainty of the rest of K does to readings of all poses; the diagonal is free or nominal.

        Of channels with these names, in columns (P, K, n) of n independent normal errors: by the legs and with the
        poses together, and with the poses alone.

        A joint that is known to be deflected by δ more than it is shows in its actuator as (∂f/∂ρ)⁻¹ ∂f/∂δ δ. K was
        measured in the same photographs as the poses for calibration: their errors depend on its own.
        """
        machine, mechanism = model.machine, model.machine.mechanism
        standing, n = mechanism.place_actuators(poses.actuators), model.n_legs
        basis, displacement = machine.basis(standing), standing - mechanism.initial_actuator_positions
        rest = np.flatnonzero(~np.eye(n, dtype=bool))
        design = np.einsum("ij,pk->pijk", np.eye(n), displacement).reshape(len(displacement), n, -1)[..., rest]
        root = np.linalg.cholesky(self.matrix.covariance[np.ix_(rest, rest)])
        gain = basis.actuator_gain
        closure = machine.model.prepare(machine.layout, machine.layout.nominal)
        less, more = (
            closure(poses.position, poses.rotation, replace(basis, actuator_gain=one), False).actuators
            for one in (gain, gain + np.eye(n))
        )
        shape = (len(displacement), len(names), len(rest))
        own, beside = np.zeros(shape), np.zeros(shape)
        legs, seen = ([k for k, one in enumerate(names) if one in some] for some in (model.commanded, POSE))
        moved = divide_closure(less, (more - less) @ design @ root)
        own[:, legs] = moved if mechanism.actuator_gains is None else moved / mechanism.actuator_gains[:, None]
        on_poses = np.linalg.solve(root, self._with_poses(~verification)[:, rest])
        beside[np.ix_(~verification, seen)] = np.swapaxes(on_poses, -1, -2)
        return own + beside, beside

    def _with_poses(self, used: np.ndarray) -> Array:
        """Return the covariance of K, row by row, with the errors of its poses in the base frame, (P, N * N, 6)."""
        assert self.matrix.with_pose is not None
        rotation = self.extraction.base.rotation[used]
        moved, turned = np.split(self.matrix.with_pose, 2, axis=-1)
        return np.concatenate([moved @ rotation, turned @ rotation], axis=-1)


def measure_pads(targets: TargetMeasurement, displacement: Array) -> Pads | None:
    """Return what the targets on the pads tell, at actuator displacements (P, N), mm; None without such targets.

    Raises
    ------
    InputError
        For too few targets on a pad, too few poses, and deflections that are none.
    """
    platform, calibration = targets.survey.platform, ~targets.survey.verification
    on_pad = platform.leg > 0
    if not on_pad.any():
        return None
    deflection = measure_joint_deflection(
        targets.extraction.platform,
        platform.reference[on_pad],
        platform.measured[:, on_pad],
        platform.leg[on_pad],
        targets.noise,
        displacement.shape[1],
    )
    chosen, travel = deflection.select(calibration), displacement[calibration]
    matrix, kappa = fit_matrix_deformation(chosen, travel), fit_linear_deformation(chosen, travel)
    return Pads(deflection, matrix, kappa, targets.extraction)


@dataclass(frozen=True, eq=False)
class SeenPads:
    """Targets that were measured on a mechanism, and perhaps on its pads."""

    mechanism: Mechanism
    measured: Measured
    needs_matrix: bool  # whether a variant takes K from the targets
    from_targets: bool
    reference: str  # where that should be said

    @property
    def displacement(self) -> Array:
        """Actuator displacements from the nominal initial positions, shape (P, N), mm."""
        mechanism = self.mechanism
        return mechanism.place_actuators(self.measured.poses.actuators) - mechanism.initial_actuator_positions

    @cached_property
    def pads(self) -> Pads | None:
        """What the targets on the pads tell; where no variant takes K from them, faults of theirs do not count."""
        targets = self.measured.targets
        assert targets is not None
        try:
            return measure_pads(targets, self.displacement)
        except InputError:
            if self.needs_matrix:
                raise
            return None

    def find_matrix(self) -> Array:
        """Return K from the targets, mm per mm; InputError where there are none."""
        if self.pads is None:
            raise InputError(f"{self.reference}: found no pad target, expected some for deformation.matrix = 'targets'")
        found = self.pads.matrix.matrix
        if (most := float(np.abs(found).max())) > MOST_DEFLECTION:
            raise InputError(
                f"{self.reference}: found pads that move {most:.3g} mm by 1 mm of an actuator, expected at most "
                f"{MOST_DEFLECTION:g}: displacements of actuators from home in metres?"
            )
        return found

    @property
    def matrix(self) -> Callable[[], Array] | None:
        """What finds K, where it is taken from the targets; None where it stands in a file."""
        return self.find_matrix if self.from_targets else None

    def list_terms(self, model: ReadingModel, rows: Sequence[str]) -> tuple[ErrorTerm, ...]:
        """Return what the uncertainty of a measured K does to the readings at poses of a machine that uses it."""
        legs = model.legs
        if legs is None or not (legs.machine.deformation.uses_matrix and self.from_targets):
            return ()
        assert self.pads is not None
        poses, at = self.measured.poses, [list(rows).index(name) for name in self.measured.poses.names]
        both, beside = (
            _place_rows(one, at, len(rows))
            for one in self.pads.list_terms(legs, model.names, poses, self.measured.verification)
        )
        return CorrelatedNoise(both), CorrelatedNoise(beside, -1.0)


def _place_rows(columns: Array, at: Sequence[int], n: int) -> Array:
    """Return columns (P, ...) as some of n rows, the others zero."""
    placed = np.zeros((n, *columns.shape[1:]))
    placed[list(at)] = columns
    return placed


def look_at_pads(config: StudyConfig, measured: Sequence[Measured], machine: ReadingModel) -> SeenPads | None:
    """Return the targets that were measured on a mechanism, None without any; InputError for faults of those on pads.

    Of several tables of targets the first counts.
    """
    legs, found = machine.legs, [one for one in measured if one.targets is not None]
    if legs is None or not found:
        return None
    from_targets, first = config.deformation.matrix == "targets", found[0]
    needed = from_targets and any(one.deformation == "matrix" for one in config.variants)
    assert first.data.kind == "targets"
    reference = str(first.folder / first.data.reference)
    seen = SeenPads(legs.machine.mechanism, first, needed, from_targets, reference)
    with name_faults(first.folder / first.data.file):
        try:
            _ = seen.pads  # computed now, so that a fault of the targets on the pads shows at once
        except PoseInputError as error:
            raise InputError(f"pose {first.poses.names[error.index]!r}: {error.fault}") from error
    return seen
