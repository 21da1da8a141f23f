"""Sections that every experiment with a machine's own sensors shares: machine, sensors, tolerances, poses.

Keys carry their units; angles of a machine are in degrees, readings in files in mm and rad.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import Number, Positive, Section
from bayescal.limits import LARGEST

type Count = Annotated[int, Field(ge=1, le=100_000)]
type Turn = Annotated[float, Field(ge=-360.0, le=360.0, allow_inf_nan=False)]
type Point = Annotated[list[Number], Field(min_length=2, max_length=2)]


class SlidingLegConfig(Section):
    """A leg: where its carriage reads zero, where its guide points, its length, its joint on the platform.

    ``points`` says whether it points along its guide, from the carriage, or against it.
    """

    guide_point_mm: Point
    guide_angle_deg: Turn
    length_mm: Positive
    platform_point_mm: Point
    points: Literal["along", "against"] = "along"


class ToolConfig(Section):
    """The tool's centre in the platform's frame."""

    point_mm: Point


class PlanarHomeConfig(Section):
    """Where the tool's centre stands at home, and how the platform is turned there."""

    tool_mm: Point
    angle_deg: Turn


class SlidingPlatformConfig(Section):
    """A planar platform on sliding legs; platform points lie in a frame of its own, whose origin does not matter."""

    kind: Literal["sliding_platform"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    title: str = ""
    source: str = ""
    legs: Annotated[list[SlidingLegConfig], Field(min_length=1)]
    tool: ToolConfig
    home: PlanarHomeConfig


class MachineFileConfig(Section):
    """What the file of a machine of one function says beside the machine's own section ``[machine]``."""

    kind: str
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    title: str = ""
    source: str = ""


class ReadingSensorConfig(Section):
    """A sensor, or one on every leg: its noise, in µm or arcsec, and its price."""

    noise_um: Positive | None = None
    noise_arcsec: Positive | None = None
    price: Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)] = 1.0

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.noise_um is None) == (self.noise_arcsec is None):
            raise ValueError("expected either noise_um or noise_arcsec")
        return self


class ReadingTolerancesConfig(Section):
    """Standard deviations beforehand: of lengths, of guide angles, of the zeros of angle sensors."""

    length_mm: Positive
    angle_deg: Positive
    zero_deg: Positive


class PlanarPosesConfig(Section):
    """Poses spread evenly at random about home: tool's centre and angle within half widths."""

    n_poses: Count = 100
    position_mm: Positive
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)]
