"""Sections that every experiment with a machine's own sensors shares: machine, sensors, tolerances, poses.

Keys carry their units; angles of a machine are in degrees, readings in files in mm and rad.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import InputFile, Number, Positive, Section, Vector
from bayescal.limits import LARGEST, LARGEST_KAPPA

type Count = Annotated[int, Field(ge=1, le=100_000)]
type Turn = Annotated[float, Field(ge=-360.0, le=360.0, allow_inf_nan=False)]
type Point = Annotated[list[Number], Field(min_length=2, max_length=2)]


class SlidingLegConfig(Section):
    """A leg: where its carriage reads zero, where its guide points, its length, its joint on the platform.

    ``points`` says whether it points along its guide, from the carriage, or against it.
    """

    guide_point_mm: Point
    """Where the carriage reads zero, x and y."""
    guide_angle_deg: Turn
    """Where the guide points, from x towards y."""
    length_mm: Positive
    """Length of the leg."""
    platform_point_mm: Point
    """The leg's joint on the platform, platform frame."""
    points: Literal["along", "against"] = "along"
    """Whether the leg points from the carriage along its guide, or against it."""


class ToolConfig(Section):
    """The tool's centre in the platform's frame."""

    point_mm: Point
    """The tool's centre, platform frame."""


class PlanarHomeConfig(Section):
    """Where the tool's centre stands at home, and how the platform is turned there."""

    tool_mm: Point
    """Where the tool's centre stands at home."""
    angle_deg: Turn
    """How the platform is turned at home."""


class MachineFileConfig(Section):
    """What the file of any machine says."""

    kind: str
    """Class of the machine: a built-in name, or `file.py:Class` beside this file."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    """What tables call the machine."""
    title: str = ""
    """What pages call the machine; its name where nothing is said."""
    source: str = ""
    """Where the dimensions come from."""


class SlidingPlatformConfig(MachineFileConfig):
    """A planar platform on sliding legs; platform points lie in a frame of its own, whose origin does not matter."""

    kind: Literal["sliding_platform"]
    """`"sliding_platform"`."""
    legs: Annotated[list[SlidingLegConfig], Field(min_length=1)]
    """The legs, one table each."""
    tool: ToolConfig
    """The tool on the platform."""
    home: PlanarHomeConfig
    """The home pose."""


class LegsMachineConfig(MachineFileConfig):
    """A mechanism on legs seen by its sensors, through a kinematic model and a deformation of the platform."""

    kind: Literal["legs"]
    """`"legs"`."""
    mechanism: InputFile
    """The mechanism's TOML file."""
    model: Annotated[str, ClassMark("MODELS")]
    """Kinematic model; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    """Deformation of the platform: `none`, `linear` or `matrix`, or one of your own."""
    kappa: Annotated[Number, Field(ge=-LARGEST_KAPPA, le=LARGEST_KAPPA)] = 0.0
    """Nominal share of its leg's displacement by which a joint shifts, for the deformation `linear` [1]."""
    matrix: InputFile | None = None
    """CSV file of the matrix K for the deformation `matrix`, in thousandths."""
    tool_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """The tool's centre, platform frame."""


class ReadingSensorConfig(Section):
    """A sensor, or one on every leg: its noise, in µm or arcsec, and its price."""

    noise_um: Positive | None = None
    """Standard deviation of a reading of length."""
    noise_arcsec: Positive | None = None
    """Standard deviation of a reading of an angle."""
    price: Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)] = 1.0
    """Price of one sensor [any currency]."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        if (self.noise_um is None) == (self.noise_arcsec is None):
            raise ValueError("expected either noise_um or noise_arcsec")
        return self


class ReadingTolerancesConfig(Section):
    """Standard deviations beforehand: of lengths, of guide angles, of the zeros of angle sensors."""

    length_mm: Positive
    """Standard deviation of lengths and places about nominal."""
    angle_deg: Positive
    """Standard deviation of the guides' angles about nominal."""
    zero_deg: Positive
    """Standard deviation of the zeros of angle sensors."""


class PlanarPosesConfig(Section):
    """Poses spread evenly at random about home: tool's centre and angle within half widths."""

    n_poses: Count = 100
    """Number of poses."""
    position_mm: Positive
    """Half width about home of the tool's centre, in x and in y."""
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)]
    """Half width about home of the platform's angle."""
