"""The schema of a look-up table."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import Number, Section
from bayescal.experiments.shared.derived import OfAnotherConfig

type Axis = Annotated[list[Number], Field(min_length=2, max_length=1000)]


class TablePlanConfig(Section):
    """Where to measure next: poses and places on the axes, chosen one by one out of random poses at every place."""

    measurements: Annotated[int, Field(ge=1, le=1000)] = 10
    """How many measurements to choose."""
    poses: Annotated[int, Field(ge=1, le=1000)] = 10
    """How many random poses of the workspace are candidates at every place of the table."""
    include_existing_data: bool = True
    """Whether they add to the study's data, or replace it."""


class TableConfig(OfAnotherConfig):
    """What the actuators have to do where what is known of each pose changes, of a study's posterior."""

    kind: Literal["table"]
    """`"table"`."""
    variant: str = ""
    """Its variant; needed where it has several."""
    axes: Annotated[dict[str, Axis], Field(min_length=1, max_length=2)]
    """By column of the data, such as `elevation_deg`: the values of the table [as in the data]."""
    reference: Annotated[dict[str, Number], Field(min_length=1)]
    """By column: where the table is zero [as in the data]."""
    pose: dict[str, Number] = Field(default={})
    """By coordinate: the commanded pose, in the units that the study states; the middle of the
    workspace where nothing is said [the study's].
    """
    plan: TablePlanConfig = TablePlanConfig()
    """Where to measure next."""
    mode: Annotated[int, Field(ge=1, le=100)] | None = Field(default=None, exclude_if=lambda value: value is None)
    """Which of several solutions of the posterior, the most probable first; needed where it has several."""
    allow_unconverged: bool = False
    """Make the table of a posterior that did not converge, too."""

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
        for name, values in self.axes.items():
            if name not in self.reference:
                raise ValueError(f"reference: found no {name}, expected it as an axis")
            if any(not low < high for low, high in pairwise(values)):
                raise ValueError(f"axes.{name}: found values that do not rise, expected each above the last")
        return self
