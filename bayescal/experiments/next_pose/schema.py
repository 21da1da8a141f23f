"""The schema of the question for the next pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import InputFile, Names, Positive, Section
from bayescal.experiments.shared.derived import OfAnotherConfig
from bayescal.experiments.shared.schema import AccuracyFrame, AnyWorkspaceConfig, Extent, Turns, UnitsConfig

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array


class NextCandidatesConfig(Section):
    """Poses that may be measured: those of a table, or a grid over the actuators' range or over limits of the pose."""

    configurations: InputFile | None = None
    """CSV file of actuator displacements, a row a pose; without legs of poses: pose, x_mm ... A grid where nothing is
    said, without legs random poses of the workspace.
    """
    unit_mm: Positive = 1.0
    """Unit of its numbers."""
    count: Annotated[int, Field(ge=2, le=20_000)] = 729
    """How many poses there are then."""
    range_mm: Positive | None = None
    """Largest displacement of an actuator to either side; the actuators' range where nothing is said."""
    position_mm: Extent | None = None
    """Limits of the platform's displacement in x, y and z, to either side of home."""
    rotation_deg: Turns | None = None
    """Limits of its rotation vector."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        told = self.model_fields_set & {"count", "range_mm", "position_mm", "rotation_deg"}
        if self.configurations is not None and told:
            raise ValueError(f"found {' and '.join(sorted(told))} with configurations, expected either")
        if (self.position_mm is None) != (self.rotation_deg is None):
            raise ValueError("expected position_mm with rotation_deg, or neither")
        if self.position_mm is not None and self.range_mm is not None:
            raise ValueError("found range_mm with pose limits, expected either")
        return self

    @property
    def half(self) -> Array | None:
        """Limits of the pose, shape (6,), mm and rad."""
        if self.position_mm is None or self.rotation_deg is None:
            return None
        import numpy as np

        return np.concatenate([self.position_mm, np.radians(self.rotation_deg)])


class NextPoseConfig(OfAnotherConfig):
    """Which pose to measure next, and whether to stop."""

    kind: Literal["next_pose"] = "next_pose"
    """Nothing has to be said: a file that names a study asks for the next pose."""
    n_first_poses: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """Only the first so many of these poses, to see what would have been said then; all where nothing is said."""
    variants: Names = Field(default=[])
    """Variants of the study that may be right; all where nothing is said."""
    with_model_error: bool = True
    """Whether legs may err by more than their geometry and the instruments, as the study's model error says."""
    goal: Literal["requirements", "variants"] = "requirements"
    """What the next pose is for: to meet the `requirements`, or to distinguish the leading `variants`."""
    probability: Annotated[float, Field(ge=0.5, le=0.9999)] = 0.95
    """How probable it has to be that the requirements hold, or which variant is right, before one stops [1]."""
    units: UnitsConfig = UnitsConfig()
    """Units of the requirements."""
    workspace: AnyWorkspaceConfig | None = None
    """Where accuracy counts; without legs by coordinate: smallest and largest value, the calibration's where nothing is
    said [units].
    """
    requirements: dict[str, Positive] = Field(default={})
    """By component of what has to be accurate: largest error anywhere in the workspace. Of a platform `x`, `y`, `z`,
    `position`, `rotation_x`, `rotation_y`, `rotation_z`, `rotation`; without legs what the machine's tool is, and
    `position` for its lengths together [units].
    """
    accuracy_frame: AccuracyFrame | None = Field(default=None, exclude_if=lambda value: value is None)
    """Whether errors are what remains after a best fit of the frames of base and tool (`aligned`), or are relative to
    marks on the `base`; as of the study where nothing is said.
    """
    candidates: NextCandidatesConfig = NextCandidatesConfig()
    """Poses that may be measured."""
    horizon: Annotated[int, Field(ge=1, le=200)] = 40
    """How many further poses are looked ahead at most."""
    draws: Annotated[int, Field(ge=200, le=20_000)] = 2000
    """Draws of the posterior that stand for the true machine."""

    @model_validator(mode="after")
    def _check_goal(self) -> Self:
        if self.goal == "requirements" and not self.requirements:
            raise ValueError("found no [requirements], expected them, or goal = 'variants'")
        return self
