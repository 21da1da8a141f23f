"""Sections that every experiment with a machine's own sensors shares: machine, sensors, tolerances, poses.

Keys carry their units; angles of a machine are in degrees, readings in files in mm and rad.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayescal.config.classes import ClassMark
from bayescal.config.sections import InputFile, Number, Positive, Section, Vector
from bayescal.limits import LARGEST_KAPPA

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
