"""The schema of ``[[data]]``: tables of what was measured, each of a kind that says how it is read."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, OwnSection
from bayescal.config.load import MEASURED, OWN
from bayescal.config.sections import InputFile, Names, NotNegative, Positive, Section
from bayescal.experiments.shared.schema import FramesConfig, RotationNoiseConfig
from bayescal.limits import LONGEST_NAME

READINGS = "readings"


class DataTable(Section):
    """A table of ``[[data]]``."""

    file: InputFile
    """File of what was measured, CSV but for readers of your own."""


class ReadingsTable(DataTable):
    """A CSV table of readings of channels, a row a pose; rows of the same pose in several tables belong together.

    ``channels`` must be there, all others are optional; columns in ``ignore`` may be there and are not read; poses in
    ``verification_poses`` are kept for verification. Channels in ``commanded_channels`` say where the machine was
    sent to: its poses are uniformly distributed in these then, and not in its coordinates.
    """

    channels: Names = Field(default=[])
    """Channels, or kinds of them, that must be in the table."""
    ignore: Names = Field(default=[])
    """Columns that are not read."""
    verification_poses: Names = Field(default=[])
    """Poses that are kept for verification."""
    commanded_channels: Names = Field(default=[], exclude_if=lambda value: not value)
    """Channels, or kinds of them, that the machine was commanded by: before they are measured its poses are uniformly
    distributed in these; in its coordinates where nothing is said.
    """


class ReadingsDataConfig(ReadingsTable):
    """A CSV table of readings of channels."""

    kind: Literal["readings"] = Field(default="readings", exclude_if=lambda value: value == READINGS)
    """`"readings"`, which is what holds where nothing is said."""


class OwnDataConfig(ReadingsTable, OwnSection):
    """A file that a user-defined reader turns into a table of readings; its options stand beside it."""

    kind: Annotated[str, ClassMark("READERS", beside=True)]
    """Class of the reader, `file.py:Class`; its options stand beside it."""


class TargetDataConfig(DataTable):
    """Photogrammetry targets on base and platform and what is known of their noise."""

    kind: Literal["targets"]
    """`"targets"`."""
    name: ClassVar[str] = ""
    actuators: InputFile
    """CSV file of actuator positions."""
    reference: InputFile
    """CSV file of where targets sit on their bodies."""
    target_noise_um: Positive
    """Standard deviation of a target's coordinates."""
    pose_estimator: Literal["robust", "line", "least_squares"] = "robust"
    """How a body's pose is found: `robust` (targets may be wrong), `line` (RR-8096) or `least_squares`."""


class InstrumentDataConfig(DataTable):
    """What tables of an instrument have in common whose frames may have to be found."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]*$", max_length=LONGEST_NAME)] = Field(
        default="", exclude_if=lambda value: not value
    )
    """Begins the names of its channels and frames; needed where several tables bring their own frames."""
    frames: FramesConfig = Field(default=FramesConfig(), exclude_if=lambda value: value == FramesConfig())
    """Frames that are found with the machine, mm and degrees."""


class PoseDataConfig(InstrumentDataConfig, RotationNoiseConfig):
    """Poses that an instrument handed out, whole or in part; the table states its noise, or these keys do."""

    kind: Literal["poses"]
    """`"poses"`."""
    actuators: InputFile | None = None
    """CSV file of actuator positions, where the table of poses lacks them and no table of readings has them."""
    position_um: Positive | None = None
    """Standard deviation of a position, each axis, where the table does not state it."""


class PointDataConfig(InstrumentDataConfig):
    """Points on the platform that stations tracked; the table states its noise, or these keys do."""

    kind: Literal["points"]
    """`"points"`."""
    probe: InputFile
    """CSV file of where points sit on the platform."""
    actuators: InputFile
    """CSV file of actuator positions."""
    stations: InputFile | None = None
    """CSV file of where stations stand; one in the base frame without it."""
    point_um: Positive | Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = None
    """Standard deviation of coordinates, one or per axis, where the table does not state it."""
    range_um: NotNegative = 0.0
    """Standard deviation of a range."""
    range_ppm: NotNegative = 0.0
    """What is added to it, in millionths of the range."""
    azimuth_arcsec: Positive | None = None
    """Standard deviation of an azimuth."""
    elevation_arcsec: Positive | None = None
    """Standard deviation of an elevation."""

    @model_validator(mode="after")
    def _check_noise(self) -> Self:
        polar = (
            self.range_um + self.range_ppm > 0.0,
            self.azimuth_arcsec is not None,
            self.elevation_arcsec is not None,
        )
        if any(polar) and not all(polar):
            raise ValueError("expected range_um or range_ppm, azimuth_arcsec and elevation_arcsec together")
        if any(polar) and self.point_um is not None:
            raise ValueError("found point_um beside the noise of ranges and angles, expected either")
        return self


def _tag_data(value: object) -> str:
    kind = value.get("kind", READINGS) if isinstance(value, dict) else getattr(value, "kind", READINGS)
    return OWN if isinstance(kind, str) and ":" in kind else f"{MEASURED}{kind}"


type DataConfig = Annotated[
    Annotated[ReadingsDataConfig, Tag(f"{MEASURED}readings")]
    | Annotated[TargetDataConfig, Tag(f"{MEASURED}targets")]
    | Annotated[PoseDataConfig, Tag(f"{MEASURED}poses")]
    | Annotated[PointDataConfig, Tag(f"{MEASURED}points")]
    | Annotated[OwnDataConfig, Tag(OWN)],
    Discriminator(_tag_data),
]
