"""A platform on legs that an instrument saw: what was measured, K from targets on its pads, and what that leaves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayescal.data.actuators import check_moves, check_range
from bayescal.density.calibration.terms import ErrorTerm
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.shared.readings.measurement import (
    Measured,
    check_measurement,
    name_actuator_table,
    name_data,
    read_measurement,
)
from bayescal.experiments.shared.readings.pads import Pads, measure_pads
from bayescal.experiments.shared.study_schema import StudyConfig, TargetDataConfig
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism
from bayescal.machines.readings import Legs, Placed, ReadingModel
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class SeenLegs:
    """What was measured of a mechanism.

    Attributes
    ----------
    needs_matrix : bool
        Whether a variant takes K from the targets.
    reference : Path
        Where that should be said.
    """

    mechanism: Mechanism
    measured: Measured
    needs_matrix: bool
    from_targets: bool
    reference: str

    @property
    def displacement(self) -> Array:
        """Actuator displacements from the nominal initial positions, shape (P, N), mm."""
        return self.measured.poses.actuators - self.mechanism.initial_actuator_positions

    @cached_property
    def pads(self) -> Pads | None:
        """What the targets on the pads tell; where no variant takes K from them, faults of theirs do not count."""
        targets = self.measured.targets
        if targets is None:
            return None
        try:
            return measure_pads(targets, self.displacement, targets.noise)
        except InputError:
            if self.needs_matrix:
                raise
            return None

    def find_matrix(self) -> Array:
        """Return K from the targets, mm per mm; InputError where there are none."""
        if self.pads is None:
            raise InputError(
                f"{self.reference}: found no target on a leg's pad, expected some, since deformation.matrix is "
                "'targets'"
            )
        return self.pads.matrix.matrix

    @property
    def matrix(self) -> Callable[[], Array] | None:
        """What finds K, where it is taken from the targets; None where it stands in a file."""
        return self.find_matrix if self.from_targets else None

    def list_terms(self, model: ReadingModel) -> tuple[ErrorTerm, ...]:
        """Return what the uncertainty of a measured K does to the readings of a machine that uses it."""
        if not (isinstance(model, Legs) and model.machine.deformation.uses_matrix and self.from_targets):
            return ()
        assert self.pads is not None
        return self.pads.list_terms(model, self.measured.poses, self.measured.verification)

    def check(self, model: ReadingModel, config: StudyConfig, folder: Path) -> None:
        """Raise InputError where the measurements cannot be in the units that their tables name."""
        legs = model.whole if isinstance(model, Placed) else model
        assert isinstance(legs, Legs)
        check_measurement(self.measured, legs.machine, config.measured, folder)


def look(config: StudyConfig, folder: Path) -> SeenLegs:
    """Return what a study's instrument saw of its mechanism; InputError for faults of its files."""
    mechanism, data = load_mechanism(folder / config.machine), config.measured
    measured = read_measurement(config, folder, mechanism)
    poses, used = measured.poses, ~measured.verification
    with name_faults(name_actuator_table(data, folder)):
        check_range(poses.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, poses.names)
        check_moves(poses.actuators[used])
    from_targets = config.deformation.matrix == "targets"
    needed = from_targets and any(one.deformation == "matrix" for one in config.variants)
    where = str(folder / data.reference) if isinstance(data, TargetDataConfig) else "deformation.matrix"
    found = SeenLegs(mechanism, measured, needed, from_targets, where)
    with name_faults(name_data(data, folder)):
        try:
            _ = found.pads  # computed now, so that a fault of the targets on the pads shows at once
        except PoseInputError as error:
            raise InputError(f"pose {poses.names[error.index]!r}: {error.fault}") from error
    return found
